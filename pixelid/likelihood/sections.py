"""Recordings divided into sections: intervals whose light is evaluated at one go, by one thread.

A recording under full-field light is one section.  Under light of each pixel's own it is several, each with as many
lights as make `SECTION_SAMPLES`: enough for a section to be worth its calls, few enough for its trajectories to stay in
a processor's cache and for all threads to have work.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pixelid.errors import InputError
from pixelid.likelihood.sequences import Sequences, sequences
from pixelid.recordings.recording import Recording
from pixelid.stimuli.pixel_lights import PixelLights, pixel_lights
from pixelid.stimuli.stimulus import Stimulus

SECTION_SAMPLES = 20_000  # 1 MB of states; does not matter from 5,000 to 100,000: benchmarks/pixel_light.py
OF_INTERVALS = ("previous_s", "time_s", "sign", "previous_sign", "pixel", "event", "previous_event")
OF_LAST = ("last_s", "last_pixel", "last_sign")


@dataclass(frozen=True)
class Section:
    """Intervals and the full-field lights that their pixels saw.

    light: (n,) and last_light: (m,) int32, which of `lights` each interval and each unfinished one belongs to
    """

    lights: tuple[Stimulus, ...]
    intervals: Sequences
    light: np.ndarray
    last_light: np.ndarray

    @property
    def samples(self) -> int:
        """Of all its lights."""
        return sum(len(light.t) for light in self.lights)


def sections_of(recording: Recording) -> tuple[Sequences, list[Section]]:
    """The intervals of a recording and its sections, which are cuts of them.

    Intervals are in order of time, under light of each pixel's own in order of light and time.

    Raises:
        InputError: as `Recording.check_stimulus_covers_events`, and for a pixel with events whose light is not known.
    """
    recording.check_stimulus_covers_events()
    intervals, stimulus = sequences(recording), recording.stimulus
    assert stimulus is not None
    grouped = pixel_lights(stimulus, intervals.last_pixel)
    if grouped is None:
        assert isinstance(stimulus, Stimulus)
        light, last_light = np.zeros(len(intervals), np.int32), np.zeros(len(intervals.last_s), np.int32)
        return intervals, [Section((stimulus,), intervals, light, last_light)]
    if stimulus.unit == "shape":
        raise InputError(f"{recording.name}: light of unit shape is known up to offset and gain; it must be full-field")
    return _divided(intervals, grouped)


def _divided(intervals: Sequences, lights: PixelLights) -> tuple[Sequences, list[Section]]:
    light, last_light = lights.of_pixels(intervals.pixel), lights.of_pixels(intervals.last_pixel)
    order, last_order = np.argsort(light, kind="stable"), np.argsort(last_light, kind="stable")
    intervals = _chosen(intervals, order, last_order)
    light, last_light = light[order], last_light[last_order]
    present = np.unique(last_light)
    if not len(present):
        return intervals, []
    samples = np.cumsum([len(lights.lights[k].t) for k in present])
    part = np.concatenate([[0], samples[:-1]]) // SECTION_SAMPLES
    sections = []
    for mine in np.split(present, np.flatnonzero(np.diff(part)) + 1):
        begin, end = np.searchsorted(light, [mine[0], mine[-1] + 1])
        first, last = np.searchsorted(last_light, [mine[0], mine[-1] + 1])
        sections.append(
            Section(
                tuple(lights.lights[k] for k in mine),
                _chosen(intervals, slice(begin, end), slice(first, last)),
                np.searchsorted(mine, light[begin:end]).astype(np.int32),
                np.searchsorted(mine, last_light[first:last]).astype(np.int32),
            )
        )
    return intervals, sections


def _chosen(intervals: Sequences, chosen: np.ndarray | slice, chosen_last: np.ndarray | slice) -> Sequences:
    """Some of the intervals, and some of the unfinished ones."""
    rows = {name: getattr(intervals, name)[chosen] for name in OF_INTERVALS}
    return replace(intervals, **rows, **{name: getattr(intervals, name)[chosen_last] for name in OF_LAST})
