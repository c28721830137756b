"""Damped Newton steps on functions whose maximum is known, and searches that are given up early."""

from types import SimpleNamespace

import numpy as np
import pytest

from pixelid.fit.newton import maximise
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
