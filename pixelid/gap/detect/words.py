"""Where the model and the events disagree, in one sentence."""

from __future__ import annotations

from collections import Counter

import numpy as np

from pixelid.gap.detect.maps import Cell, Maps
from pixelid.likelihood.event_times import EventTimes


def where(maps: Maps, likelihood: EventTimes, background: np.ndarray, sigma: float) -> str:
    """The largest disagreement: events without a cause, else the cell of the maps that stands out most.

    background: (n,) events without a cause;  sigma: relative threshold noise, the unit of a residual
    """
    parts = []
    mentioned_background = 1e-3  # fraction of the events: fewer without a cause are not mentioned
    if background.mean() > mentioned_background:
        parts.append(_without_cause(likelihood, background))
    telling = _telling(maps)
    if telling is not None:
        parts.append(in_words(telling, sigma))
    return "; ".join(parts) or "nowhere in particular"


def _telling(maps: Maps) -> Cell | None:
    """The most telling cell: a shift of the level where that is nearly as clear as anything else."""
    if not maps.cells:
        return None
    top = maps.cells[0]
    mentioned_shift = 0.5  # of the largest score: a shift of the level that reaches it is mentioned, as it says more
    shifts = [c for c in maps.cells if c.response == "level" and abs(c.score) > mentioned_shift * abs(top.score)]
    return shifts[0] if shifts else top


def in_words(cell: Cell, sigma: float) -> str:
    """One cell as a clause."""
    n = f"{cell.events} events"
    if cell.response == "level":
        percent = 100.0 * abs(cell.mean) * sigma
        side = "late, as if the threshold were" if cell.mean > 0 else "early, as if the threshold were"
        return f"{cell.label}: {n} come {side} {percent:.2g} % {'higher' if cell.mean > 0 else 'lower'}"
    if cell.response == "spread":
        return f"{cell.label}: {n} scatter {'more' if cell.mean > 0 else 'less'} than threshold noise allows"
    return f"{cell.label}: an event's deviation {'repeats' if cell.mean > 0 else 'reverses'} the one before ({n})"


def _without_cause(likelihood: EventTimes, background: np.ndarray) -> str:
    at = np.flatnonzero(background)
    names = [r.name for r in likelihood.recordings]
    home = Counter((names[likelihood.recording_of_event[k]], "ON" if likelihood.sign[k] > 0 else "OFF") for k in at)
    (name, polarity), n = home.most_common(1)[0]
    on = float(np.mean(likelihood.sign[at] > 0))
    kind = "all ON" if on > 0.98 else "all OFF" if on < 0.02 else f"{100 * on:.0f} % ON"
    return f"{len(at)} events have no cause in the model ({kind}), most of them {polarity} in {name} ({n})"
