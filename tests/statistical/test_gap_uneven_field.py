"""The gap search under an uneven field: gains of pixels are estimated again with the grown model."""

from dataclasses import replace

import numpy as np
import pytest

from pixelid.gap.gap import gap
from pixelid.model.shipped import find_model
from pixelid.recordings.bench import with_pixel_gains
from pixelid.simulate import simulate
from pixelid.stimuli.pixel_lights import PixelLights
from pixelid.stimuli.shapes import chirp

BASE, DARK_FA, PIXELS = find_model("dvs128"), 4.0, 16


@pytest.mark.slow
def test_a_dark_current_is_right_where_pixels_see_different_light():
    gains = 0.1 * np.random.default_rng(5).normal(size=PIXELS)
    gains -= gains.mean()
    camera, recordings = BASE.with_effect("dark_current", radiance=DARK_FA), []
    for k, (level, stop) in enumerate(((3.0, 60.0), (24.0, 200.0), (400.0, 400.0))):
        light = chirp(level, 1.0, 5.0, stop, duration_s=0.6, dt=1e-4)
        lights = [light.brighter_by(float(np.exp(gain))) for gain in gains]
        made = simulate(camera, PixelLights.of_groups(lights, np.arange(PIXELS).reshape(4, 4)), seed=k, sensor_seed=0)
        made = replace(made, stimulus=light, condition=f"chirp_{level:g}")
        recordings.append(with_pixel_gains(made, np.arange(PIXELS), gains))
    found = gap(recordings, BASE, recommend=False)
    assert [effect.name for effect in found.effects] == ["dark_current"]
    assert not found.remainder
    # 3.85 where what gains add is held as without the dark current; a parabola in the gain is good to 1 % here
    assert found.model.values["dark_current.radiance"] == pytest.approx(DARK_FA, rel=0.02)
