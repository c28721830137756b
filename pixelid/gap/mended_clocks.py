"""Clocks of aligned recordings, mended before the search: what an alignment was off by, told with the base circuit.

An alignment by a trigger or by the events leaves a delay and a drift.  They are fitted together with the base circuit
under their priors, as a fit carries them (`likelihood.clocks`), and the light is moved by them: the search then takes
the clocks as exact.  What a missing effect shares with a delay is gone with it, so that no effect is named for the
error of a clock.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pixelid.fit import newton
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.starts import feasible
from pixelid.likelihood.clocks import Clock, clock_parameters, clocks_of, unseparated
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import Model
from pixelid.recordings.own_light import with_fine_light
from pixelid.recordings.recording import Recording
from pixelid.recordings.selection import few

MOST_EVENTS = 20_000  # that tell the clocks: a delay to some µs, below what moves a verdict
MENDED = "mended_clock"  # attribute of a recording: by how much, in s


def with_mended_clocks(recordings: Sequence[Recording], model: Model, seed: int) -> list[Recording]:
    """The recordings with their light where it was on the camera's clock, as events and base circuit tell.

    Recordings that were not aligned, or whose alignment was given, come back as they are.

    Args:
        recordings: with a stimulus each.
        model: the base, where to start.
        seed: of the pixels that are looked at.
    """
    parameters = clock_parameters(recordings)
    if not parameters:
        return list(recordings)
    some = few([r.within_stimulus() for r in recordings], MOST_EVENTS, np.random.default_rng(seed))
    if unseparated(recordings):
        model = model.fix({"delay_s": None})
    best: newton.Optimum | None = None
    coordinates, x = None, None
    for between in ("linear", "smooth"):
        likelihood = EventTimes([with_fine_light(r, between) for r in some])
        if coordinates is None:
            coordinates = Coordinates.of(feasible(model, likelihood), parameters)
        objective = EventTimesObjective(likelihood, coordinates)
        end = newton.maximise(objective, coordinates.start if x is None else x, tolerance=0.05, max_steps=60)
        x = end.x
        if best is None or end.local.value > best.local.value:
            best = end
    assert best is not None
    assert coordinates is not None
    clocks = clocks_of(recordings, coordinates.nuisances_at(best.x))
    assert clocks is not None
    return [r if c is None else _mended(r, c) for r, c in zip(recordings, clocks, strict=True)]


def _mended(recording: Recording, clock: Clock) -> Recording:
    """The light's moment s is at the camera's t = (s + delay − ρ at)/(1 − ρ), ρ = drift/span (`likelihood.clocks`)."""
    assert recording.stimulus is not None
    rate = float(clock.drift_s) / clock.span_s
    light = recording.stimulus.shifted((float(clock.delay_s) - rate * clock.at_s) / (1.0 - rate), 1.0 / (1.0 - rate))
    since = recording.events.t * 1e-9
    inside = (since >= light.start_s) & (since <= light.end_s)
    attributes = {**recording.attributes, MENDED: {"delay_s": float(clock.delay_s), "drift_s": float(clock.drift_s)}}
    return replace(recording, events=recording.events.select(inside), stimulus=light, attributes=attributes)
