"""Recordings as every likelihood takes them, and a fit's own likelihood, made of them again."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pixelid.fit.event_times import LEVELS_TAKEN_AT, EventTimesObjective
from pixelid.fit.result import FitResult
from pixelid.likelihood.event_times import EventTimes
from pixelid.likelihood.light_between_samples import with_told
from pixelid.recordings.own_light import with_fine_light, with_pixel_lights
from pixelid.recordings.recording import Recording
from pixelid.recordings.selection import named_apart
from pixelid.stimuli.trace_noise import without_trace_noise


def as_fitted(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings as every likelihood of them takes them: within their light, distinguished by their names."""
    recordings = without_trace_noise(named_apart(recordings))
    return with_told(with_pixel_lights([recording.within_stimulus() for recording in recordings]))


def event_times_of(result: FitResult, recordings: Sequence[Recording]) -> EventTimesObjective:
    """The objective whose optimum a fit to event times is, of these recordings or of other pixels of them.

    Recordings are within their light and distinguished as the fit took them, the light between samples runs as it
    found, and where stamps jitter, their noise counts at the reset as well, as at its optimum; so does shot noise in
    levels.

    Args:
        result: of `fit`, without levels of pixels.
        recordings: that it was made of.

    Raises:
        InputError: a recording whose light ends before its events.
    """
    between = result.details.get("stimulus_between_samples", "linear")
    fine = [with_fine_light(r, between) for r in as_fitted(recordings) if r.stimulus is not None]
    objective = EventTimesObjective(EventTimes(fine), result.coordinates).near(result.x)
    if objective.circuit(result.x).shot_density == 0.0:
        return objective
    told = result.details.get("shot_noise", {})
    off = {name: -by for name, by in told.get("parameters_put_right_by", {}).items()}
    taken, names = told.get(LEVELS_TAKEN_AT, {}), result.coordinates.names
    at = np.array([taken.get(name, value) for name, value in zip(names, result.x, strict=True)])
    return EventTimesObjective(objective.likelihood, result.coordinates, off).under_shot_noise(at)
