"""The readout ceiling: a bus that is never idle delivers at a constant pace.

Events of many independent pixels arrive like a Poisson process: in a window the variance of their number equals
its mean (Fano factor 1) or exceeds it.  A saturated readout empties a queue at its service rate, and the number
per window hardly varies.  Sensors that send a whole row (or column) at once serve groups, so groups are counted.
Windows are short against the pixels' own intervals: regular firing of single pixels does not show in them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pixelid.inspection.counts import GROUPINGS, Groups, Survey
from pixelid.recordings.events import Events

MIN_EVENTS = 1000
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


class Paces:
    """Groups per window for each kind of group, in a second reading part by part."""

    def __init__(self, survey: Survey, clock_s: float | None) -> None:
        enough = survey.events >= MIN_EVENTS and survey.duration_s > 0
        self._first_ns, self._groups = survey.first_ns, Groups()
        self._paces = [_Pace(survey, name, clock_s or 1e-9) for name in GROUPINGS] if enough else []

    def add(self, events: Events) -> None:
        """Take in events that follow those taken in before."""
        if not any(pace.windows for pace in self._paces):
            return
        t, begun = events.t - self._first_ns, self._groups.begun(events)
        for pace in self._paces:
            if pace.windows:
                pace.add(t, begun[pace.grouping])

    def ceiling(self) -> Ceiling | None:
        """The most even of the paces."""
        candidates = [pace.ceiling() for pace in self._paces if pace.windows]
        return min((ceiling for ceiling in candidates if ceiling), key=lambda ceiling: ceiling.fano, default=None)


class _Pace:
    """Evenness of one kind of groups within the busiest blocks of windows."""

    def __init__(self, survey: Survey, grouping: str, clock_s: float) -> None:
        groups, self.grouping, self.windows, self.width_ns = survey.groups[grouping], grouping, 0, 1
        per_window = min(
            GROUPS_PER_WINDOW,
            survey.active_pixels * groups / survey.events / 10,
            groups / (WINDOWS_PER_BLOCK * MIN_BLOCKS * 4),
        )
        if per_window < MIN_GROUPS_PER_WINDOW:
            return
        clock = max(round(clock_s * 1e9), 1)
        self.width_ns = clock * max(1, round(per_window * survey.duration_s * 1e9 / groups / clock))
        last = (survey.last_group_ns[grouping] - survey.first_ns) // self.width_ns
        windows = int(last) // WINDOWS_PER_BLOCK * WINDOWS_PER_BLOCK
        if windows < WINDOWS_PER_BLOCK * MIN_BLOCKS or windows > 4 * groups:
            return
        self.windows = windows
        self._counts = np.zeros(windows, np.int32)
        self._events = np.zeros(windows // WINDOWS_PER_BLOCK, np.int64)

    def add(self, t: np.ndarray, first: np.ndarray) -> None:
        """Take in events at times `t` from the first event on, of which some are the `first` of their groups."""
        index = t // self.width_ns
        index, first = index[index < self.windows], first[index < self.windows]
        if not len(index):
            return
        low, block = int(index[0]), int(index[0]) // WINDOWS_PER_BLOCK  # times rise: a part touches a stretch only
        counts = np.bincount(index[first] - low)
        self._counts[low : low + len(counts)] += counts.astype(np.int32)
        every = np.bincount(index // WINDOWS_PER_BLOCK - block)
        self._events[block : block + len(every)] += every

    def ceiling(self) -> Ceiling | None:
        """None where too few blocks are busy."""
        counts = self._counts.reshape(-1, WINDOWS_PER_BLOCK)
        mean = counts.mean(axis=1)
        busy = mean >= 0.85 * np.quantile(mean, 0.98)
        if np.count_nonzero(busy) < MIN_BLOCKS:
            return None
        fano = float(np.mean(counts[busy].var(axis=1, ddof=1)) / np.mean(mean[busy]))
        groups_hz = float(mean[busy].mean() / (self.width_ns * 1e-9))
        seconds = np.count_nonzero(busy) * WINDOWS_PER_BLOCK * self.width_ns * 1e-9
        rate_hz = float(self._events[busy].sum() / seconds)
        return Ceiling(fano < SATURATED_FANO, rate_hz, groups_hz, fano, float(busy.mean()), self.grouping)
