"""Other maxima of a log posterior, where a search ended on a plateau.

A pole that is far too fast does not show, and neither does the way back: its time constant, taken from a dead time or
from another pole, may have a maximum of its own where it does show.  A coordinate that shows nothing where a search
ended is moved to where it would, all else maximised there, and set free.
"""

from __future__ import annotations

import numpy as np

from pixelid.fit.bench import is_of_bench
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.newton import Optimum
from pixelid.fit.newton import maximise as newton_steps
from pixelid.fit.uncertainty.profiles import at_fixed

RIDGE, ROUNDING = 1e-6, 1e-9  # of information, by which a coordinate without any, or without its own, is no exception
TOLERANCE = 1e-2  # nats, of a maximum that is to be compared


def beyond_plateaus(objective: EventTimesObjective, optimum: Optimum) -> Optimum | None:
    """A better maximum beyond the plateaus that an optimum lies on; None where there is none.

    Args:
        objective: Of events.
        optimum: Of it.
    """
    best = optimum
    names = objective.coordinates.names
    plateau = 1.0  # information by a coordinate, all else open: below, a move by e is worth half a nat
    for i in np.flatnonzero(_shown(optimum.local.information) < plateau):
        moved = None if is_of_bench(names[i]) else _where_it_shows(objective, best.x, int(i))
        if moved is None:
            continue
        start = at_fixed(objective, moved, int(i))[1]
        wanted = best.local.value + plateau
        end = newton_steps(objective.near(start), start, tolerance=TOLERANCE, max_steps=60, wanted=wanted)
        if end.local.value > best.local.value + plateau:
            best = end
    return None if best is optimum else best


def _where_it_shows(objective: EventTimesObjective, x: np.ndarray, i: int) -> np.ndarray | None:
    """x with coordinate i moved, whichever way is shorter, to where the events would know it; None: nowhere."""
    lower, upper = objective.coordinates.bounds()
    step = objective.coordinates.longest_moves()[i]
    shown = 100.0  # at which it would be known to a tenth
    most_moves = 10  # by a longest move each
    for k in range(1, most_moves + 1):
        for sign in (-1.0, 1.0):
            moved = x.copy()
            moved[i] += sign * k * step
            if lower[i] <= moved[i] <= upper[i] and _shown(objective.local(moved).information)[i] > shown:
                return moved
    return None


def _shown(information: np.ndarray) -> np.ndarray:
    """(d,) information by each coordinate, all else open."""
    each = np.diag(information) + RIDGE
    scale = np.sqrt(np.outer(each, each))
    return each / np.diag(np.linalg.inv(information / scale + ROUNDING * np.eye(len(each))))
