"""How a finished fit is judged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pixelid.fit.judge import ResidualTest, at_rest_only, has_arrived, open_sides, precision, significant, status_of
from pixelid.fit.newton import Optimum
from pixelid.fit.objective import Local, Objective
from pixelid.fit.result import Estimate
from pixelid.parameters.parameter import Parameter
from pixelid.status import Status

GAMMA = Parameter("gamma", 1.0, "1/s", 1e-9, 1e9, "log")


class Parabola(Objective):
    """−½ x² with one coordinate."""

    class coordinates:
        names = ("gamma",)

        @staticmethod
        def longest_moves():
            return np.ones(1)

        @staticmethod
        def bounds():
            return np.array([-9.0]), np.array([9.0])

    def value(self, x):
        return float(-0.5 * x @ x)

    def local(self, x):
        return Local(self.value(x), -x, np.eye(1))


def optimum(x=0.0, converged=True, on_bound=False):
    at = np.array([x])
    return Optimum(at, Parabola().local(at), converged, np.array([on_bound]), 3)


def estimate(interval=(0.9, 1.1), identified=True):
    return Estimate("gamma", 1.0, "1/s", 0.05, interval, identified, False)


def status(where, found=None, **details):
    return status_of(Parabola(), where, {"gamma": found or estimate()}, details)


def test_statuses():
    assert status(optimum()) == (Status.converged, "")
    assert status(optimum(2.0, converged=False))[0] is Status.not_converged
    assert status(optimum(9.0, on_bound=True))[0] is Status.at_bound
    assert status(optimum(np.nan))[0] is Status.diverged
    assert status(optimum(), estimate(identified=False))[0] is Status.not_identified
    assert status(optimum(), dispersion=16.8)[0] is Status.misfit
    assert status(optimum(), dispersion=2.0)[0] is Status.converged
    assert status(optimum(), background_events=30, background_fraction=0.01)[0] is Status.misfit
    assert status(optimum(), background_events=1, background_fraction=0.01)[0] is Status.converged
    word, advice = status(optimum(), residual_tests=[{"covariate": "the level", "p_value": 1e-20, "share": 0.2}])
    assert word is Status.misfit
    assert "the level" in advice
    assert "gap" in advice


def test_nothing_is_identified_before_the_maximum():
    """Curvature where a search stopped is not that of a maximum; all of it was called identified."""
    before = {"gamma": estimate(), "held": replace(estimate(), name="held", fixed=True)}
    for status in Status:
        after, said = at_rest_only(before, status)
        at_rest = status not in ("not_converged", "interrupted", "diverged")
        assert after["gamma"].identified is at_rest
        assert after["held"].identified
        assert bool(said) is not at_rest
        assert precision(before["gamma"], GAMMA, status).startswith("not reliable") is not at_rest


def test_a_plateau_counts_as_arrived():
    assert has_arrived(Parabola(), optimum(0.05, converged=False))
    assert not has_arrived(Parabola(), optimum(0.5, converged=False))


def test_structure_must_be_significant_and_matter():
    tests = [ResidualTest("a", 1e-9, 0.05), ResidualTest("b", 1e-9, 0.001), ResidualTest("c", 0.01, 0.05)]
    assert [test.covariate for test in significant(tests)] == ["a"]


@pytest.mark.parametrize(
    ("interval", "expected", "words"),
    [
        ((1e-9, 1e9), (None, None), "gamma is not identified over 18 decades"),
        ((1e-9, 2.0), (None, 2.0), "only an upper limit, 2 1/s"),
        ((0.5, 1e9), (0.5, None), "only a lower limit, 0.5 1/s"),
    ],
)
def test_an_interval_that_ends_at_a_bound_is_open(interval, expected, words):
    changed, sentences = open_sides({"gamma": estimate(interval)}, [GAMMA])
    assert changed["gamma"].interval_95 == expected
    assert not changed["gamma"].identified
    assert words in sentences[0]


def test_an_interval_inside_the_bounds_stays():
    given = {"gamma": estimate()}
    assert open_sides(given, [GAMMA]) == (given, [])


@pytest.mark.parametrize(
    ("interval", "words"),
    [
        ((0.97, 1.03), "known within 3 %"),
        ((1 / 3, 3.0), "known to a factor of 3"),
        ((0.5, None), "only a lower limit"),
        ((None, 2.0), "only an upper limit"),
        ((None, None), "not identified"),
        (None, "not identified"),
    ],
)
def test_precision_in_words(interval, words):
    assert precision(estimate(interval), GAMMA) == words
