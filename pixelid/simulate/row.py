"""Sensors of any number of pixels, distinguished by their place in a row."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pixelid.model.model import Model
from pixelid.recordings.recording import Recording
from pixelid.recordings.selection import LONGEST_SIDE_PIXELS
from pixelid.simulate.full_field import Twins
from pixelid.simulate.simulator import simulate
from pixelid.stimuli.pixel_lights import Light, PixelLights


def simulate_row(
    model: Model,
    light: Light,
    pixels: int,
    *,
    seed: int = 0,
    sensor_seed: int | None = None,
    twins: Twins | None = None,
) -> Recording:
    """The recording of `pixels` pixels; `events.pixel` is each one's place in the row.

    Addresses are 16 bits wide, so a longer row is folded into several, the last one filled up with copies of its last
    pixel whose events are dropped.

    Args:
        model, seed, sensor_seed, twins: as of `simulate`.
        light: full-field, or of a row (1, pixels) as of `in_a_row`.
        pixels: how many.

    Raises:
        InputError: as `simulate`.
    """
    height = -(-pixels // LONGEST_SIDE_PIXELS)
    width = -(-pixels // height)
    more = width * height - pixels
    if height > 1 and isinstance(light, PixelLights):
        light = replace(light, of_pixel=_filled(light.of_pixel.ravel(), more).reshape(height, width))
    if more and twins is not None:
        twins = twins.only(_filled(np.arange(pixels), more))
    run = simulate(model, light, width=width, height=height, seed=seed, sensor_seed=sensor_seed, twins=twins)
    return replace(run, events=run.events.select(run.events.pixel < pixels)) if more else run


def _filled(row: np.ndarray, more: int) -> np.ndarray:
    return np.append(row, np.repeat(row[-1:], more))
