"""What most likely is wrong with a fit that does not describe its data: each cause is tested, none is guessed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pixelid.errors import InputError
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.starts import feasible
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import CLOCK_DELAY

# Nats that a cause must be worth in one recording: of a true statement the best of some twenty shifts gains three.
DECISIVE_NATS = 30.0
# Delays that are tried of a clock that is taken as exact: half a filter's lag at least, what a hand is off by at most.
DELAYS_S = tuple(sign * size for size in (2e-5, 5e-5, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2) for sign in (-1, 1))
LEADING = "{name}: its events fit better {by} ms {way}: is its clock right? Align it: `pixelid check`, or --align auto"
POLARITY = "ON and OFF seem to be exchanged: state --polarity swapped"


def likely_causes(objective: EventTimesObjective, x: np.ndarray) -> list[str]:
    """Sentences on what explains a bad fit: polarity, and clocks that were taken as exact; none where neither does.

    Args:
        objective: Of event times.
        x: (d,) where its search ended.
    """
    try:
        return [*_polarity(objective, x), *_clocks(objective, x)]
    except (InputError, FloatingPointError):
        return []


def _polarity(objective: EventTimesObjective, x: np.ndarray) -> list[str]:
    recordings = objective.likelihood.recordings
    exchanged = EventTimes([replace(r, events=replace(r.events, p=1 - r.events.p)) for r in recordings])
    trial = feasible(objective.coordinates.model_at(x), exchanged)
    gain = exchanged.log_likelihood(trial.circuit()) - objective.terms(x).total
    return [POLARITY] if gain > DECISIVE_NATS * len(recordings) else []


def _clocks(objective: EventTimesObjective, x: np.ndarray) -> list[str]:
    likelihood, circuit = objective.likelihood, objective.circuit(x)
    now = objective.terms(x).per_recording
    shifted = np.array([likelihood.terms(circuit.later_by(delay)).per_recording for delay in DELAYS_S])
    shifted = np.where(np.isfinite(shifted), shifted, -np.inf)
    best = np.argmax(shifted, axis=0)
    sentences = []
    for k, recording in enumerate(likelihood.recordings):
        free = f"{CLOCK_DELAY.name}[{recording.name}]" in objective.coordinates.nuisances
        if free or shifted[best[k], k] - now[k] < DECISIVE_NATS:
            continue
        delay = DELAYS_S[best[k]]
        way = "earlier" if delay > 0 else "later"
        sentences.append(LEADING.format(name=recording.name, by=f"{1e3 * abs(delay):g}", way=way))
    return sentences
