"""Intervals along a curved ridge, against a posterior whose exact intervals are known.

With T and B independent normals, the coordinates are a = −ln(1 + T) and b = (1 + T)/2 + B: a lag that a pole of rate
e^a causes, and a delay that stands for half of it.  In a the posterior is curved; T and b have normal intervals.
"""

from dataclasses import dataclass

import numpy as np
import pytest

from pixelid.fit.coordinates import Coordinates
from pixelid.fit.objective import Local, Objective
from pixelid.fit.uncertainty.curvature import Identified, read_curvature
from pixelid.fit.uncertainty.ridge import profile_of_ridge, widened
from pixelid.fit.uncertainty.small_sample import intervals
from pixelid.model.shipped import find_model
from pixelid.parameters.parameter import Parameter
from pixelid.statistics import Z95

LAG_SD, DELAY_SD = 0.3, 0.05
A, B = 0, 1  # places of the coordinates


@dataclass
class Bent(Objective):
    """The log posterior of (a, b); likelihood: unused, as `profile` makes the objective anew from both."""

    likelihood: None
    coordinates: Coordinates

    def _values(self, x: np.ndarray) -> tuple[float, float]:
        values = self.coordinates.values(x)
        return values["a"], values["b"]

    def value(self, x: np.ndarray) -> float:
        a, b = self._values(x)
        return -0.5 * (((np.exp(-a) - 1) / LAG_SD) ** 2 + ((b - 0.5 * np.exp(-a)) / DELAY_SD) ** 2)

    def local(self, x: np.ndarray) -> Local:
        a, b = self._values(x)
        lag = np.exp(-a)
        jacobian = np.array([[-lag / LAG_SD, 0.0], [0.5 * lag / DELAY_SD, 1.0 / DELAY_SD]])  # of the two residuals
        free = [("a", "b").index(name) for name in self.coordinates.names]
        residual = np.array([(lag - 1) / LAG_SD, (b - 0.5 * lag) / DELAY_SD])
        J = jacobian[:, free]
        return Local(self.value(x), -J.T @ residual, J.T @ J)


def curved(most: float) -> Bent:
    """The posterior with a up to `most`."""
    model = find_model("dvs128")
    model = model.fix(dict.fromkeys(model.free))
    nuisances = Parameter("a", 0.0, lower=-3.0, upper=most), Parameter("b", 1.0, lower=-9.0, upper=9.0)
    return Bent(None, Coordinates.of(model, nuisances))


def found(objective: Bent):
    """Optimum, reading, profile, and the limits that follow it."""
    x = np.array([0.0, 0.5])
    reading = read_curvature(objective.coordinates, objective.local(x).information, np.zeros(2, bool))
    profile = profile_of_ridge(objective, x, reading)  # pyright: ignore[reportArgumentType]
    assert profile is not None
    normal = intervals("ab", x, reading.sd, 9)
    return reading, profile, widened(normal, profile, objective, x, reading.covariance)  # pyright: ignore[reportArgumentType]


def test_limits_are_exact_where_the_ridge_bends():
    reading, profile, (low, high) = found(curved(3.0))
    half, whole = Z95 * LAG_SD, Z95 * np.hypot(0.5 * LAG_SD, DELAY_SD)
    assert profile.name == "a"
    assert [low[A], high[A]] == pytest.approx([-np.log(1 + half), -np.log(1 - half)], abs=0.02)
    assert [low[B], high[B]] == pytest.approx([0.5 - whole, 0.5 + whole], abs=0.02)
    assert high[A] - Z95 * reading.sd[A] > 0.2  # the curvature alone says something else


def test_a_side_that_the_profile_leaves_open_ends_at_the_bound():
    _, profile, (low, high) = found(curved(0.5))  # before the limit at 0.89
    assert profile.interval_95[1] is None
    assert high[A] == 0.5
    assert low[A] == pytest.approx(-np.log(1 + Z95 * LAG_SD), abs=0.02)
    assert low[B] == pytest.approx(0.5 - np.hypot(0.5 * (1 - np.exp(-0.5)), Z95 * DELAY_SD), abs=0.02)


@pytest.mark.parametrize(
    ("widths", "bends"),
    [((0.01, 0.05), False), ((0.01, 0.3), True), ((0.3, 2.0), True), ((0.9, 2.0), False), ((0.3,), True), ((), False)],
)
def test_a_profile_is_asked_for_where_one_direction_is_known_little(widths, bends):
    """Better than to 10 % a parabola will do; where several directions are open, one profile would not."""
    directions = tuple({"in_words": "", "sd": width} for width in widths)
    assert Identified(np.eye(2), np.ones(2), np.ones(2, bool), (), directions=directions).bends == bends
