"""From an end near the optimum to the optimum of all events, and how the light runs between its samples.

Recorded light may be linear between its samples or smooth, and which of the two only the events show.  Both are fitted,
each over finer samples (`with_fine_light`), and the likelier one is kept.  Where events are many, pixels with
`PART_EVENTS` of them are fitted first: all events then begin a step or two from their optimum, and where the part has
decided how light runs, under that light only.  What is found is the optimum of all events either way.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pixelid.fit.coordinates import Coordinates
from pixelid.fit.engines import Engine
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.newton import Optimum
from pixelid.fit.open_coordinates import beyond_plateaus
from pixelid.likelihood.event_times import EventTimes
from pixelid.recordings.own_light import with_fine_light
from pixelid.recordings.recording import Recording
from pixelid.recordings.selection import few

BETWEEN = ("linear", "smooth")
PART_EVENTS = 40_000  # known to half a percent or so: within a step or two of the optimum of many more
WORTH_A_PART = 4  # times as many events, from which the part costs less than the steps that it saves
# Nats.  The log ratio of two likelihoods close to each other varies by twice its mean: 20 are three standard deviations
# away from the other sign, and all events, of which the part is at most a quarter, say the same with more.
DECIDED_NATS = 20.0
TURNS = 10  # at most, each with what is held as at one point
STEPS = 60  # of a turn, at most
FEW_STEPS = 12  # of one whose levels share the noise of stamps: what is held is known near the point only
AT_REST = 0.01  # what a turn may still move the optimum by: squared, in standard errors
ROUGHLY = 1e-2  # nats, of optima that decide how light runs


@dataclass(frozen=True)
class Refined:
    """The optimum of all events, and how the light runs between its samples.

    objective: of all events under that light
    optimum: of it
    between: "linear" or "smooth"
    details: what decided it, as results show it
    """

    objective: EventTimesObjective
    optimum: Optimum
    between: str
    details: dict[str, float]


def refine(
    recordings: Sequence[Recording],
    coordinates: Coordinates,
    x: np.ndarray,
    kinds: Sequence[str],
    maximiser: Engine,
    rng: np.random.Generator,
    report: Callable[[float], None] = lambda share: None,
) -> Refined:
    """The optimum of recordings from x, an end near it, under the likeliest of some courses of the light.

    Args:
        recordings: With pixel addresses and a light each.
        coordinates: The free parameters.
        x: (d,) Where to begin.
        kinds: Of `BETWEEN`, those to try.
        maximiser: What finds the optimum.
        rng: Chooses the pixels of the part.
        report: Called with the share that is done, after every optimum.
    """
    details: dict[str, float] = {}
    events = sum(len(recording.events) for recording in recordings)
    part = few(recordings, PART_EVENTS, rng) if events > WORTH_A_PART * PART_EVENTS else list(recordings)
    some = sum(len(recording.events) for recording in part)
    if WORTH_A_PART * some <= events:
        ends = _ends(part, coordinates, x, kinds, maximiser, {"tolerance": ROUGHLY}, lambda: report(0.2))
        between = _likeliest(ends)
        x = ends[between][1].x
        if len(ends) == len(BETWEEN) and abs(nats := _smooth_minus_linear(ends)) > DECIDED_NATS:
            kinds = (between,)
            details = {"smooth_minus_linear_nats": nats, "smooth_or_linear_events": some}
        del ends
    done = iter(np.linspace(0.2, 0.8, len(kinds) + 1)[1:])
    ends = _ends(recordings, coordinates, x, kinds, maximiser, {"tolerance": ROUGHLY}, lambda: report(next(done)))
    between = _likeliest(ends)
    if len(ends) == len(BETWEEN):
        details = {"smooth_minus_linear_nats": _smooth_minus_linear(ends)}
    objective, optimum = _at_rest(ends[between][0], ends[between][1].x, maximiser)
    better = beyond_plateaus(objective, optimum)
    if better is not None:
        objective, optimum = _at_rest(objective, better.x, maximiser)
    report(1.0)
    return Refined(objective, optimum, between, details)


def _at_rest(
    objective: EventTimesObjective, x: np.ndarray, maximiser: Engine, **settings: Any
) -> tuple[EventTimesObjective, Optimum]:
    """The optimum from a point near it, with what stamps and gains add held where it is.

    Args:
        settings: Of the engine, in addition to how many steps it may take.
    """
    for _ in range(TURNS):
        free, objective = objective, objective.near(x)
        shares = objective.likelihood.carried is not None
        optimum = maximiser.maximise(objective, x, max_steps=FEW_STEPS if shares else STEPS, **settings)
        went, x = optimum.x - x, optimum.x
        rests = went @ optimum.local.information @ went < AT_REST
        if objective is free or rests or not (shares or optimum.converged):
            break
    if not shares:
        return objective, optimum
    objective = objective.near(x)  # so that what is held is of the optimum itself
    return objective, replace(optimum, local=objective.local(x))


Ends = dict[str, tuple[EventTimesObjective, Optimum]]


def _ends(recordings, coordinates: Coordinates, x, kinds, maximiser: Engine, settings: dict, done) -> Ends:
    """The optimum under each kind of light, each search from the end of the one before."""
    ends: Ends = {}
    for kind in kinds:
        likelihood = EventTimes([with_fine_light(recording, kind) for recording in recordings])
        ends[kind] = _at_rest(EventTimesObjective(likelihood, coordinates), x, maximiser, **settings)
        x = ends[kind][1].x
        done()
    return ends


def _likeliest(ends: Ends) -> str:
    return max(ends, key=lambda kind: ends[kind][1].local.value)


def _smooth_minus_linear(ends: Ends) -> float:
    linear, smooth = (ends[kind][1].local.value for kind in BETWEEN)
    return float(smooth - linear)
