"""Expected Fisher information of stimuli, by simulating them.

The information of the event-time likelihood (`EventTimesObjective.local`) is the average over what might be recorded;
one simulated recording of a few pixels estimates it, since every pixel and every event adds its own share.  It is
computed for `PIXELS` pixels and scaled to the number asked for.

With recordings at hand the candidate is simulated on the same pixels and the information is that of both together: a
second recording of the same pixels teaches nothing new about how thresholds differ among pixels, so the sum of the
two would promise too much.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pixelid.errors import InputError
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.event_times import EventTimesObjective
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import Model
from pixelid.recordings.recording import Recording
from pixelid.recordings.selection import only
from pixelid.simulate import simulate
from pixelid.stimuli.resample import with_overshoots
from pixelid.stimuli.stimulus import Stimulus

PIXELS = 8


def information(recordings: Sequence[Recording], coordinates: Coordinates, x: np.ndarray) -> np.ndarray:
    """(n, n) information of recordings at x, without priors; zeros when no pixel has two events."""
    shown = [r for r in recordings if len(r.events)]
    n = len(coordinates)
    if not shown:
        return np.zeros((n, n))
    try:
        likelihood = EventTimes([_finer(r) for r in shown])
    except InputError as error:
        if "no pixel has two events" in str(error):
            return np.zeros((n, n))
        raise
    information = EventTimesObjective(likelihood, coordinates).local(x).information
    return information - np.diag(coordinates.prior_gradient_and_curvature(x)[1])


def _finer(recording: Recording) -> Recording:
    assert recording.stimulus is not None
    return recording.with_stimulus(with_overshoots(recording.stimulus))


def few_pixels(recordings: Sequence[Recording], seed: int) -> tuple[list[Recording], float]:
    """The recordings cut down to at most `PIXELS` pixels, chosen at random, and how many pixels each stands for.

    Raises InputError for recordings without pixels, without stimulus, or of different sensors.
    """
    for recording in recordings:
        if recording.pooled:
            raise InputError(
                f"{recording.name}: pooled events have no pixels; a design needs the event times of pixels"
            )
        if recording.stimulus is None or not recording.stimulus.full_field or recording.stimulus.unit == "shape":
            raise InputError(f"{recording.name}: a design needs a full-field stimulus of known radiance")
    sizes = {(r.sensor, r.events.width, r.events.height) for r in recordings}
    if len(sizes) > 1:
        raise InputError("--recorded: the recordings come from different sensors; a design is for one")
    every = np.unique(np.concatenate([r.events.pixel for r in recordings]))
    if len(every) == 0:
        raise InputError("--recorded: the recordings hold no events")
    keep = np.sort(np.random.default_rng(seed).permutation(every)[:PIXELS])
    return only(recordings, keep), len(every) / len(keep)


def simulated(model: Model, stimulus: Stimulus, seed: int, like: Sequence[Recording] = ()) -> Recording:
    """`PIXELS` pixels of the model under a stimulus; `like` some recordings: on the pixels that they have."""
    pixels = np.unique(np.concatenate([r.events.pixel for r in like])) if like else np.arange(PIXELS)
    recording = simulate(model, stimulus, width=len(pixels), height=1, seed=seed)
    if not like:
        return recording
    first, events = like[0], recording.events
    width = first.events.width
    place = pixels[events.pixel]
    moved = replace(
        events,
        x=(place % width).astype(np.uint16),
        y=(place // width).astype(np.uint16),
        width=width,
        height=first.events.height,
        tick_ns=first.events.tick_ns,
    )
    return replace(recording, events=moved, sensor=first.sensor)
