"""Intervals of a search's parameters: what the data do not tell is open, and never a point."""

import numpy as np
import pytest

from pixelid.fit.maximise import maximise
from pixelid.gap.confirm.intervals import _inverse_or_open, interval_95, open_sides
from pixelid.gap.result import Named
from pixelid.gap.verdict import describe
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.shipped import find_model
from pixelid.simulate import simulate
from pixelid.stimuli.shapes import chirp


def test_a_full_information_is_inverted():
    root = np.random.default_rng(0).normal(size=(4, 4)) * [1.0, 1e3, 1e-3, 1e6]
    information = root.T @ root
    np.testing.assert_allclose(_inverse_or_open(information), np.linalg.inv(information), rtol=1e-6)


def test_an_empty_row_is_open_and_leaves_the_others():
    variance = np.diag(_inverse_or_open(np.diag([4.0, 0.0, 1e8])))
    np.testing.assert_allclose(variance, [0.25, np.inf, 1e-8])


def test_two_that_only_their_sum_is_known_of_are_both_open():
    information = np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 9.0]])
    np.testing.assert_allclose(np.diag(_inverse_or_open(information)), [np.inf, np.inf, 1 / 9])


def test_what_never_acts_has_its_whole_range():
    """Light too slow for the slew limit: neither rate can be told."""
    model = find_model("dvs128").with_effect("slew_limit", {"rise_per_s": 1e6, "fall_per_s": 1e6})
    recording = simulate(model, chirp(100.0, stop_hz=50.0, duration_s=0.3), width=2, height=2, seed=3)
    likelihood = EventTimes([recording])
    end = maximise(likelihood, model.fix({"gamma": None, "refractory_s": None}), tolerance=1e-3, max_steps=30)
    limits = interval_95(likelihood, end)
    for name in ("slew_limit.rise_per_s", "slew_limit.fall_per_s"):
        parameter = model.parameter(name)
        assert limits[name] == pytest.approx((parameter.lower, parameter.upper))
        assert open_sides(limits[name], parameter) == (None, None)
    low, high = limits["on_threshold"]
    assert 0.2 < low < high < 0.3  # four pixels, each with a threshold of its own
    assert open_sides((low, high), model.parameter("on_threshold")) == (low, high)
    assert open_sides(None, model.parameter("on_threshold")) is None
    rounded = (parameter.lower * (1.0 + 1e-15), 1.0)  # a bound, through the logarithm and back
    assert open_sides(rounded, parameter) == (None, 1.0)


def test_a_verdict_says_which_strength_is_not_told():
    strengths = {
        "slew_limit.rise_per_s": (3000.0, (2990.0, 3010.0)),
        "slew_limit.fall_per_s": (2500.0, (None, None)),
        "leak.rate_hz": (1.0, (None, 2.0)),
        "lower_cutoff.cutoff_hz": (1.0, (0.5, None)),
    }
    named = Named("slew_limit", 1e-9, 50.0, None, None, 0.0, "", strengths, "in steps")
    sentence = describe("named", [named], [], None, None, "", None, 1e-9)
    assert "rise_per_s = 3000, 95 % 2990–3010" in sentence
    assert "fall_per_s = 2500, which these recordings do not tell" in sentence
    assert "rate_hz = 1, 95 % below 2" in sentence
    assert "cutoff_hz = 1, 95 % above 0.5" in sentence
