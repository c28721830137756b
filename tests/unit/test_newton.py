"""Damped Newton steps on functions whose maximum is known, and searches that are given up early."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import optimize

from pixelid.fit.engines.casadi_engine import CasadiEngine
from pixelid.fit.newton import _best_inside, maximise
from pixelid.fit.objective import Local, Objective


class Valley(Objective):
    """−(curvature·(y − bend·x²)² + (x − 1)²)/2: a curved ridge, highest (0) at x = 1, y = bend."""

    def __init__(self, bend, curvature, reach=4.0):
        self.bend, self.curvature, self.evaluations = bend, curvature, 0
        bounds = np.full(2, -reach), np.full(2, reach)
        self.coordinates = SimpleNamespace(bounds=lambda: bounds, longest_moves=lambda: np.ones(2))

    def value(self, x):
        self.evaluations += 1
        return -0.5 * (self.curvature * (x[1] - self.bend * x[0] ** 2) ** 2 + (x[0] - 1.0) ** 2)

    def local(self, x):
        off, slope = x[1] - self.bend * x[0] ** 2, np.array([-2.0 * self.bend * x[0], 1.0])
        gradient = -self.curvature * off * slope - np.array([x[0] - 1.0, 0.0])
        return Local(self.value(x), gradient, self.curvature * np.outer(slope, slope) + np.diag([1.0, 1e-12]))


class Kinked(Valley):
    """The same less kinks of 1e-3, 0.06 apart: between any two of them lies a maximum."""

    def value(self, x):
        return super().value(x) - 1e-3 * np.abs(np.sin(50.0 * x)).sum()

    def local(self, x):
        smooth = super().local(x)
        kinks = 0.05 * np.cos(50.0 * x) * np.sign(np.sin(50.0 * x))
        return Local(smooth.value, smooth.gradient - kinks, smooth.information)


@pytest.mark.parametrize(("bend", "curvature"), [(0.0, 1.0), (1.0, 10.0), (2.0, 1e4)])
def test_ipopt_does_not_halve_steps_to_rounding_on_kinks(bend, curvature):
    """It took three to four thousand values."""
    ridge = Kinked(bend, curvature)
    end = CasadiEngine().maximise(ridge, np.array([-1.5, 3.0]))
    assert ridge.evaluations < 800
    assert end.local.value > -3e-3


@pytest.mark.parametrize(("bend", "curvature"), [(0.0, 1.0), (1.0, 10.0), (2.0, 1e4)])
def test_the_top_of_a_curved_ridge_is_found(bend, curvature):
    end = maximise(Valley(bend, curvature), np.array([-1.5, 3.0]))
    assert end.converged
    np.testing.assert_allclose(end.x, [1.0, bend], atol=2e-3)


def test_a_bound_holds_a_coordinate():
    end = maximise(Valley(0.0, 1.0, reach=0.5), np.array([0.0, 0.0]))
    assert end.converged
    assert end.x[0] == 0.5
    assert end.on_bound.tolist() == [True, False]


def test_what_cannot_be_reached_is_given_up_early():
    start = np.array([-1.5, 3.0])
    patient, hasty = Valley(1.0, 1e4), Valley(1.0, 1e4)
    maximise(patient, start, tolerance=1e-9)
    end = maximise(hasty, start, tolerance=1e-9, wanted=1e4)
    assert not end.converged
    assert end.local.value < 1e4
    assert hasty.evaluations < patient.evaluations


def test_giving_up_changes_no_decision():
    rng = np.random.default_rng(0)
    reached = 0
    for _ in range(200):
        bend, curvature, start = rng.uniform(0.0, 2.0), 10 ** rng.uniform(0, 6), rng.uniform(-3.0, 3.0, 2)
        wanted = rng.uniform(-6.0, 2.0)  # the top is 0
        there = maximise(Valley(bend, curvature), start, tolerance=1e-2).local.value
        asked = maximise(Valley(bend, curvature), start, tolerance=1e-2, wanted=wanted).local.value
        assert (there >= wanted) == (asked >= wanted)
        reached += there >= wanted
    assert 100 < reached < 190


class Flat(Objective):
    """−(x − 3)²/2 and a second coordinate that hardly counts, pushed to its bound at 0 with next to no curvature."""

    def __init__(self):
        bounds = np.array([-9.0, 0.0]), np.array([9.0, 9.0])
        self.coordinates = SimpleNamespace(bounds=lambda: bounds, longest_moves=lambda: np.ones(2))

    def value(self, x):
        return -0.5 * (x[0] - 3.0) ** 2 + 0.02 * x[1] - 1e-9 * x[1] ** 2

    def local(self, x):
        return Local(self.value(x), np.array([3.0 - x[0], 0.02 - 2e-9 * x[1]]), np.diag([1.0, 2e-9]))


def test_a_coordinate_that_hardly_counts_does_not_hold_back_the_others():
    end = maximise(Flat(), np.array([0.0, 0.0]), tolerance=0.1, max_steps=12)
    assert end.converged
    assert end.x[0] == pytest.approx(3.0, abs=0.5)


@pytest.mark.parametrize("seed", range(20))
def test_steps_are_the_best_inside_a_box(seed):
    """Against a general optimiser, on random concave quadratics."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 7))
    root = rng.normal(size=(n, n))
    H, g = root @ root.T + 0.05 * np.eye(n), rng.normal(size=n) * 3.0
    low, high = -rng.uniform(0.0, 1.0, n), rng.uniform(0.0, 1.0, n)
    move = _best_inside(H, g, low, high)
    told = optimize.minimize(
        lambda m: 0.5 * m @ H @ m - g @ m,
        np.zeros(n),
        jac=lambda m: H @ m - g,
        bounds=list(zip(low, high, strict=True)),
        method="L-BFGS-B",
        options={"ftol": 1e-15, "gtol": 1e-10, "maxiter": 5000},
    )
    assert ((move >= low) & (move <= high)).all()
    np.testing.assert_allclose(g @ move - 0.5 * move @ H @ move, -told.fun, rtol=1e-6, atol=1e-9)
