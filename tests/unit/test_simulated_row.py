"""Sensors of more pixels than addresses are wide."""

from __future__ import annotations

import numpy as np
import pytest

import pixelid.simulate.row as row
from pixelid.model.shipped import find_model
from pixelid.simulate import Twins, simulate, simulate_row
from pixelid.stimuli.pixel_lights import PixelLights, in_a_row
from pixelid.stimuli.shapes import steps

LIGHTS = [steps(radiance, seed=1) for radiance in (24.0, 60.0)]
OF_PIXEL = np.arange(10) % 2


@pytest.mark.parametrize("light", [LIGHTS[0], PixelLights.of_groups(LIGHTS, OF_PIXEL[None, :])], ids=["one", "groups"])
def test_a_long_row_is_folded_and_says_the_same(light, monkeypatch):
    model = find_model("dvs128")
    thresholds = np.linspace(0.2, 0.5, 10)
    twins = Twins(thresholds, thresholds, np.full(10, 0.05), np.ones(10))
    seen = in_a_row(light, np.arange(10))
    whole = simulate(model, seen, width=10, height=1, seed=3, twins=twins).events
    monkeypatch.setattr(row, "LONGEST_SIDE_PIXELS", 4)  # three rows of four, two pixels of them filled up
    folded = simulate_row(model, seen, 10, seed=3, twins=twins).events
    assert (folded.width, folded.height) == (4, 3)
    assert len(whole) > 100
    for pixel in range(10):
        np.testing.assert_array_equal(folded.t[folded.pixel == pixel], whole.t[whole.pixel == pixel])
    assert folded.pixel.max() == 9
