"""The readout ceiling: a bus that is never idle delivers at a constant pace.

Events of many independent pixels arrive like a Poisson process: in a window the variance of their number equals
its mean (Fano factor 1) or exceeds it.  A saturated readout empties a queue at its service rate, and the number
per window hardly varies.  Sensors that send a whole row (or column) at once serve groups, so groups are counted.
Windows are short against the pixels' own intervals: regular firing of single pixels does not show in them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pixelid.recordings.events import Events

GROUPS_PER_WINDOW = 150
MIN_GROUPS_PER_WINDOW = 4
WINDOWS_PER_BLOCK = 8
MIN_BLOCKS = 5
SATURATED_FANO = 0.4


@dataclass(frozen=True)
class Ceiling:
    """Whether the readout saturates.

    saturated: whether the pace at the highest rates is too even for independent pixels
    rate_hz: events per second while at the highest rates
    groups_hz: readout words (events sent together) per second then
    fano: variance over mean of the groups per window then; 1 for independent pixels
    time_fraction: share of the recording spent within 15 % of the highest pace
    grouping: "event" | "row" | "column"
    """

    saturated: bool
    rate_hz: float
    groups_hz: float
    fano: float
    time_fraction: float
    grouping: str


def find_ceiling(events: Events, clock_s: float | None) -> Ceiling | None:
    """The readout ceiling, or None when the events are too few to tell."""
    if len(events) < 1000 or events.duration_s <= 0:
        return None
    pixels = int(np.count_nonzero(np.bincount(events.pixel)))
    new_time = np.diff(events.t, prepend=-1) != 0
    groupings = {
        "event": np.ones(len(events), bool),
        "row": new_time | (np.diff(events.y.astype(np.int32), prepend=-1) != 0),
        "column": new_time | (np.diff(events.x.astype(np.int32), prepend=-1) != 0),
    }
    candidates = [_pace(events, first, name, pixels, clock_s or 1e-9) for name, first in groupings.items()]
    return min((ceiling for ceiling in candidates if ceiling), key=lambda ceiling: ceiling.fano, default=None)


def _pace(events: Events, first: np.ndarray, grouping: str, pixels: int, clock_s: float) -> Ceiling | None:
    """Evenness of the groups that begin where `first` holds, within the busiest blocks of windows."""
    t = events.t[first] - events.t[0]
    per_window = min(
        GROUPS_PER_WINDOW, pixels * len(t) / len(events) / 10, len(t) / (WINDOWS_PER_BLOCK * MIN_BLOCKS * 4)
    )
    if per_window < MIN_GROUPS_PER_WINDOW:
        return None
    clock = max(round(clock_s * 1e9), 1)
    width = clock * max(1, round(per_window * events.duration_s * 1e9 / len(t) / clock))
    windows = int(t[-1] // width) // WINDOWS_PER_BLOCK * WINDOWS_PER_BLOCK
    if windows < WINDOWS_PER_BLOCK * MIN_BLOCKS or windows > 4 * len(t):
        return None
    index = t // width
    counts = np.bincount(index[index < windows], minlength=windows).reshape(-1, WINDOWS_PER_BLOCK)
    mean = counts.mean(axis=1)
    busy = mean >= 0.85 * np.quantile(mean, 0.98)
    if np.count_nonzero(busy) < MIN_BLOCKS:
        return None
    fano = float(np.mean(counts[busy].var(axis=1, ddof=1)) / np.mean(mean[busy]))
    groups_hz = float(mean[busy].mean() / (width * 1e-9))
    inside = np.repeat(busy, WINDOWS_PER_BLOCK)
    all_index = (events.t - events.t[0]) // width
    rate_hz = float(np.count_nonzero(inside[all_index[all_index < windows]]) / (inside.sum() * width * 1e-9))
    return Ceiling(fano < SATURATED_FANO, rate_hz, groups_hz, fano, float(busy.mean()), grouping)
