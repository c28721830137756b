"""Fits to light that the sensor measured itself: what such light can identify, and what a fit has to hold.

The light is known after each event, and between two of them it changed by about a threshold at a moment that only the
event shows.  Poles and dead time act within milliseconds of that moment, which no sample resolves: whatever a fit said
of them would follow from the line drawn between the samples.  They are held where the model has them; what they delay
together is the delay, which is fitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pixelid.fit.event_times import EventTimesObjective
from pixelid.model.model import Model
from pixelid.recordings.recording import Recording
from pixelid.recordings.sensor_light import is_measured
from pixelid.stages import LIBRARY
from pixelid.stages.photoreceptor import parameters as of_photoreceptor
from pixelid.stimuli.pixel_lights import pixel_lights

NO_PHYSICAL = "the photoreceptor is held, not fitted: samples of the light cannot identify it"
BLOCKS = 10  # of events by their interval
UNRESOLVED_STAGES = "photoreceptor", "source_follower"  # act faster than the samples
UNRESOLVED = {"diff_cutoff_hz", "refractory_s", "dead_time_without_reset.s"}


def unresolved(model: Model) -> list[str]:
    """Names of the free parameters that light measured after each event cannot identify."""
    names = {p.name for p in of_photoreceptor(model.photoreceptor)}
    names |= {p.name for e in model.effects for p in LIBRARY[e].parameters if LIBRARY[e].stage in UNRESOLVED_STAGES}
    return [name for name in model.free if name in names | UNRESOLVED]


def as_light_tells(model: Model, recordings: Sequence[Recording]) -> Model:
    """The model with `unresolved` parameters held where any of the recordings measured its light itself.

    Its delay is free within half a gap between samples: what the light between them adds is known at the events'
    stamps.
    """
    if not any(map(is_measured, recordings)):
        return model
    model, most = model.fix(dict.fromkeys(unresolved(model))), 0.5 * typical_gap_s(recordings)
    shift = model.parameter("delay_s")
    near = replace(shift.freed(), lower=min(shift.value, -most), upper=max(shift.value, most))
    return replace(model, parameters={**model.parameters, "delay_s": near})


def line_errors(objective: EventTimesObjective, x: np.ndarray) -> np.ndarray:
    """(p,) standard deviations that the light between samples adds to those of the coordinates, in their units.

    A threshold is the same after short and long intervals.  What the level at events of one polarity differs by,
    between BLOCKS of equally many sorted by their interval, is the light's: scatter of the block means beyond their own
    errors.  Which block is right is not known, so it is not divided by their number.  All blocks share that the light
    was not on the line: it is taken to have been anywhere, on average, as far from it as the next sample is, on either
    side: 1/√3 of that.  Where the level is off, so is the time at which the light was there, by that over the typical
    speed: the delay.
    """
    likelihood, terms = objective.likelihood, objective.terms(x)
    circuit, added = objective.coordinates.circuit(x), np.zeros(len(x))
    if likelihood.unknown_light is None:
        return added
    previous = np.concatenate([intervals.previous_s for intervals in likelihood.intervals])
    since, kept = likelihood.time_s - previous, ~terms.background & likelihood.unknown_light.events
    ahead, late = np.zeros(likelihood.events), [0.0]
    ahead[likelihood.unknown_light.events] = likelihood.unknown_light.ahead
    for name, sign, threshold in (
        ("on_threshold", 1.0, circuit.on_threshold), ("off_threshold", -1.0, circuit.off_threshold)
    ):  # fmt: skip
        mine = np.flatnonzero(kept & (likelihood.sign == sign))
        if len(mine) < 2 * BLOCKS:
            continue
        off, weight = terms.z[mine] / threshold - 1.0, threshold**2 * terms.event.weight[mine]
        blocks = np.array_split(np.argsort(since[mine], kind="stable"), BLOCKS)
        means = np.array([np.average(off[b], weights=weight[b]) for b in blocks])
        error = np.mean([1.0 / weight[b].sum() for b in blocks])
        step = np.average(ahead[mine], weights=weight) / threshold
        relative = float(np.sqrt(max(np.mean(means**2) - error, 0.0) + step**2 / 3.0))
        late.append(relative * threshold / float(np.median(terms.event.rate[mine])))
        if name in objective.coordinates.names:
            added[objective.coordinates.names.index(name)] = relative
    if "delay_s" in objective.coordinates.names:
        added[objective.coordinates.names.index("delay_s")] = max(late)
    return added


def typical_gap_s(recordings: Sequence[Recording]) -> float:
    """Median time between two samples of the light of recordings that measured it themselves."""
    gaps = []
    for recording in filter(is_measured, recordings):
        lights = None if recording.stimulus is None else pixel_lights(recording.stimulus)
        gaps += [np.diff(light.t[1:-1]) for light in (lights.lights if lights else ()) if len(light.t) > 3]
    return float(np.median(np.concatenate(gaps))) if gaps else 0.0


def held_in_words(names: Sequence[str], recordings: Sequence[Recording]) -> list[str]:
    """One sentence that says what was held and why; none where nothing was."""
    if not names:
        return []
    gap = f"{1e3 * typical_gap_s(recordings):.2g} ms"
    return [f"{', '.join(names)}: held as the model has them; samples of the light {gap} apart cannot identify them"]
