"""Light that differs between the pixels of a pool: each pixel sees the stimulus times a factor of its own."""

from __future__ import annotations

import numpy as np

from pixelid.errors import InputError
from pixelid.simulate import random
from pixelid.stimuli.pixel_lights import MOST_VALUES, Light, PixelLights
from pixelid.stimuli.stimulus import Stimulus

SPREAD = 9  # stream of random numbers, after those of `random.py` and `readout.py`


def spread_light(stimulus: object, sigma: float, size: tuple[int, int], seed: int) -> Light:
    """The stimulus times e^{σ ξ} in each pixel.

    Args:
        stimulus: Full-field.
        sigma: Standard deviation of log radiance over the pixels.
        size: (width, height) of the sensor.
        seed: Of the factors.

    Raises:
        InputError: For another stimulus, or lights that do not fit into memory.
    """
    if not isinstance(stimulus, Stimulus) or not stimulus.full_field:
        raise InputError("light_spread: needs a full-field stimulus, whose light it spreads over the pixels")
    pixels = size[0] * size[1]
    if pixels * len(stimulus.t) > MOST_VALUES:
        raise InputError(
            f"light_spread: {pixels} pixels with {len(stimulus.t)} samples of light each; at most {MOST_VALUES} in all"
        )
    draws = np.empty(pixels)
    random.fill_normals(seed, SPREAD, 0, draws)
    lights = [
        Stimulus(stimulus.t, float(factor) * stimulus.radiance, stimulus.unit, stimulus.interpolation)
        for factor in np.exp(sigma * draws)
    ]
    return PixelLights.of_groups(lights, np.arange(pixels).reshape(size[1], size[0]))
