"""How many events, how fast, and of which polarity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pixelid.inspection.intervals import Intervals
from pixelid.recordings.columns import RepeatCounter
from pixelid.recordings.events import Events

PEAK_WINDOW_S = 1e-3
GROUPINGS = ("event", "row", "column")


@dataclass(frozen=True)
class Counts:
    """Totals of a recording.

    on_fraction: share of ON events, None without events
    mean_hz: events per second between the first and the last event, None when they do not span any time
    peak_hz: the highest rate within one window of `peak_window_s`
    active_pixels: pixels with at least one event
    duplicates: events that repeat an earlier one in time, pixel and polarity; None when pixels are pooled
    """

    events: int
    duration_s: float
    on_fraction: float | None
    mean_hz: float | None
    peak_hz: float | None
    peak_window_s: float
    active_pixels: int
    duplicates: int | None


def counts_of(survey: Survey, busiest: BusiestWindow) -> Counts:
    """The totals of a recording that both have seen."""
    n, duration = survey.events, survey.duration_s
    return Counts(
        events=n,
        duration_s=duration,
        on_fraction=survey.on / n if n else None,
        mean_hz=n / duration if duration > 0 else None,
        peak_hz=busiest.rate_hz if duration > 0 else None,
        peak_window_s=busiest.window_s,
        active_pixels=survey.active_pixels,
        duplicates=None if survey.pooled else survey.duplicates,
    )


class Survey:
    """What a first reading of a recording shows, part by part: totals, events per pixel, intervals, clock.

    Attributes:
        events, on, duplicates: totals.
        first_ns, last_ns: of the events.
        image: (height, width) events per pixel.
        clock_ns: greatest common divisor of the differences of timestamps, 0 where there are none.
        groups, last_group_ns: by `GROUPINGS`, how many groups of events left the sensor at once, and when the last did.
        intervals: within pixels.
    """

    def __init__(self, width: int, height: int, pooled: bool) -> None:
        self.pooled, self.shape = pooled, (height, width)
        self.events = self.on = self.duplicates = self.first_ns = self.last_ns = self.clock_ns = 0
        self.groups: dict[str, int] = dict.fromkeys(GROUPINGS, 0)
        self.last_group_ns: dict[str, int] = dict.fromkeys(GROUPINGS, 0)
        self.intervals = Intervals(width * height)
        self._image = np.empty(0, np.int64)
        self._repeats, self._groups = RepeatCounter(), Groups()

    @property
    def duration_s(self) -> float:
        """Seconds between the first and the last event."""
        return float(self.last_ns - self.first_ns) * 1e-9 if self.events > 1 else 0.0

    @property
    def active_pixels(self) -> int:
        """Pixels with at least one event."""
        return int(np.count_nonzero(self._image))

    @property
    def image(self) -> np.ndarray:
        """(height, width) events per pixel."""
        pixels = self.shape[0] * self.shape[1]
        counts = self._image if len(self._image) == pixels else np.bincount(np.empty(0, np.int64), minlength=pixels)
        return counts.reshape(self.shape)

    def add(self, events: Events) -> None:
        """Take in events that follow those taken in before."""
        if not len(events):
            return
        steps = np.diff(events.t, prepend=self.last_ns) if self.events else np.diff(events.t)
        self.clock_ns = _divisor(steps, self.clock_ns)
        if not self.events:
            self.first_ns = int(events.t[0])
        self.events, self.on = self.events + len(events), self.on + int(np.count_nonzero(events.p))
        self.last_ns = int(events.t[-1])
        counts = np.bincount(events.pixel, minlength=events.width * events.height)
        self._image = self._image + counts if len(self._image) else counts
        self.intervals.add(events)
        if not self.pooled:
            self.duplicates += self._repeats.add(events)
            for name, first in self._groups.begun(events).items():
                begins = np.flatnonzero(first)
                self.groups[name] += len(begins)
                if len(begins):
                    self.last_group_ns[name] = int(events.t[begins[-1]])


class Groups:
    """Which events begin a group that a sensor sends at once, part by part: an event, or a row or column of a time."""

    def __init__(self) -> None:
        self._last = (-1, -1, -1)

    def begun(self, events: Events) -> dict[str, np.ndarray]:
        """(n,) whether each event begins a group, by `GROUPINGS`."""
        t, y, x = self._last
        new = np.diff(events.t, prepend=t) != 0
        row = new | (np.diff(events.y.astype(np.int32), prepend=np.int32(y)) != 0)
        column = new | (np.diff(events.x.astype(np.int32), prepend=np.int32(x)) != 0)
        if len(events):
            self._last = (int(events.t[-1]), int(events.y[-1]), int(events.x[-1]))
        return {"event": np.ones(len(events), bool), "row": row, "column": column}


class BusiestWindow:
    """The window with the most events, in a second reading part by part."""

    def __init__(self, survey: Survey) -> None:
        duration = survey.duration_s
        self.window_s = min(PEAK_WINDOW_S, duration) if duration > 0 else PEAK_WINDOW_S
        self._first, self._width = survey.first_ns, max(round(self.window_s * 1e9), 1)
        self._most = self._current = 0
        self._index = -1

    @property
    def rate_hz(self) -> float:
        """Events per second in it."""
        return float(max(self._most, self._current) / self.window_s)

    def add(self, events: Events) -> None:
        """Take in events that follow those taken in before."""
        if not len(events):
            return
        index = (events.t - self._first) // self._width
        starts = np.flatnonzero(np.diff(index, prepend=-1 if self._index < 0 else self._index))
        lengths = np.diff(starts, append=len(index))
        ahead = int(starts[0]) if len(starts) else len(index)  # of the window that the part before ended in
        self._current += ahead
        if len(starts):
            self._most = max(self._most, self._current, int(lengths.max()))
            self._current = int(lengths[-1])
        self._index = int(index[-1])


def _divisor(steps: np.ndarray, known: int) -> int:
    """The greatest common divisor of `steps` and what is `known`; most steps are multiples of that."""
    if known:
        steps = steps[steps % known != 0]
    return int(np.gcd.reduce(steps, initial=known))
