"""Recordings as fits read them: light of each pixel's own in groups, and sampled as finely as the closed forms need."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pixelid.errors import InputError
from pixelid.recordings.recording import Recording
from pixelid.recordings.sensor_light import is_measured
from pixelid.stimuli.pixel_lights import PixelLights, pixel_lights
from pixelid.stimuli.resample import with_overshoots


def with_pixel_lights(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings with videos as groups of pixels that share a light, of pixels that fire in any recording.

    All others, full-field ones too, come back as they are.
    """
    if all(r.stimulus is None or r.stimulus.full_field for r in recordings):
        return list(recordings)
    active = np.unique(np.concatenate([r.events.pixel for r in recordings]))
    return [_grouped(r, active) for r in recordings]


def with_fine_light(recording: Recording, between: str) -> Recording:
    """The recording as a fit reads it, its light run `between` samples as said (`with_overshoots`).

    Raises:
        InputError: without a stimulus.
    """
    if recording.stimulus is None:
        raise InputError(
            f"{recording.name}: no stimulus; attach it: `pixelid convert FILE OUT.h5 --stimulus light.csv`"
        )
    grouped = _grouped(recording, recording.events.pixel)
    if is_measured(recording):  # no straighter or smoother than its samples: `likelihood.light_between_samples`
        return grouped
    light = grouped.stimulus
    assert light is not None
    if isinstance(light, PixelLights):  # of its own pixels only: finer samples of all others would be made for nothing
        pixels = np.unique(grouped.events.pixel)
        light = light.restricted(pixels[pixels < grouped.events.width * grouped.events.height])
    return recording.with_stimulus(with_overshoots(light, between))


def _grouped(recording: Recording, pixels: np.ndarray) -> Recording:
    light = recording.stimulus
    if light is None or light.full_field or recording.pooled:
        return recording
    recording.check_stimulus_covers_events()
    inside = pixels[pixels < recording.events.width * recording.events.height]
    return recording.with_stimulus(pixel_lights(light, inside) or light)
