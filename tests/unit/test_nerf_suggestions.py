"""Strengths that residuals suggest, alone and beside each other."""

import math

import numpy as np
import pytest

from pixelid.nerf.effects.suggestions import Suggested


def suggested(**strengths: float) -> Suggested:
    """Of rows to which two effects that look much alike, and one of either sign, add as told."""
    rng = np.random.default_rng(0)
    common = rng.random(400)
    slopes = {"leak": common, "parasitic_photocurrent": common * rng.uniform(0.2, 0.6, 400),
              "threshold_drift": 0.1 * rng.normal(size=400), "polarity_memory": np.zeros(400)}  # fmt: skip
    return Suggested(slopes, sum(strengths[name] * slopes[name] for name in strengths) + 0.01 * rng.normal(size=400))


def test_what_an_effect_lacks_does_not_pass_for_its_neighbour():
    """A leak told too small suggests a parasitic photocurrent, but none beside the leak itself."""
    of = suggested(leak=3.0)
    assert of.of({"parasitic_photocurrent": 0.0})["parasitic_photocurrent"] > 3.0
    both = of.of({"leak": -1.0, "parasitic_photocurrent": 0.0})
    assert both["leak"] == pytest.approx(3.0, abs=0.1)
    assert both["parasitic_photocurrent"] == pytest.approx(0.0, abs=0.1)


def test_strengths_stay_above_their_least():
    of = suggested(leak=-3.0, threshold_drift=-20.0)
    found = of.of({"leak": -1.0, "threshold_drift": -math.inf, "polarity_memory": 0.0})
    assert found["leak"] == pytest.approx(-1.0)
    assert found["threshold_drift"] < -10.0
    assert found["polarity_memory"] == 0.0  # of which no row says anything
    assert suggested().of({}) == {}
