"""The times between successive events of each pixel, of a whole recording or of its parts one after the other."""

from __future__ import annotations

import numpy as np

from pixelid.recordings.events import Events

# Kept of a long recording, drawn at random: 1 % of them, which decides a dead time, is known to 0.5 %.
MOST_INTERVALS = 1 << 22
NONE = -1  # in place of an interval before the first


def pixel_intervals(events: Events) -> np.ndarray:
    """(m,) int64 nanoseconds between successive events of the same pixel, both polarities, in no stated order."""
    return intervals_of(events).intervals


def intervals_of(events: Events) -> Intervals:
    """All intervals within pixels, and their pairs."""
    every = Intervals(events.width * events.height, len(events))
    every.add(events)
    return every


class Intervals:
    """Intervals within pixels, gathered part by part; beyond `most` of them a random share is kept.

    Attributes:
        count: how many there were.
        share: of them that is kept, a power of one half.
    """

    def __init__(self, pixels: int, most: int = MOST_INTERVALS) -> None:
        self.count, self.share = 0, 1.0
        self._most, self._held, self._random = most, 0, np.random.default_rng(0)
        self._kept: list[np.ndarray] = []  # (m, 2) interval and the one before it
        self._pixels = pixels
        # of each pixel: time of its latest event + 1, and the interval before it + 1 (0: none); made when needed
        self._time = self._interval = np.empty(0, np.int64)
        self._last: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None

    @property
    def intervals(self) -> np.ndarray:
        """(m,) the intervals [ns] that are kept."""
        return self._all()[:, 0]

    @property
    def pairs(self) -> np.ndarray:
        """(k, 2) the pairs [ns] that are kept: an interval and the one after it."""
        every = self._all()
        return every[every[:, 1] != NONE][:, ::-1]

    def _all(self) -> np.ndarray:
        if len(self._kept) > 1:
            self._kept = [np.concatenate(self._kept)]
        return self._kept[0] if self._kept else np.empty((0, 2), np.int64)

    def add(self, events: Events) -> None:
        """Take in events that follow those taken in before."""
        if not len(events):
            return
        self._remember()
        pixel = events.y.astype(np.int64) * events.width + events.x
        order = _in_order_of_pixels(pixel)
        pixel, t = pixel[order], events.t[order]
        first = np.concatenate([[True], pixel[1:] != pixel[:-1]])
        interval = np.diff(t, prepend=t[:1])
        interval[first] = self._since(pixel[first], t[first])
        before = np.concatenate([[NONE], interval[:-1]])
        before[first] = self._earlier(pixel[first])
        last = np.concatenate([first[1:], [True]])
        self._last = pixel[last], t[last], interval[last]
        known = interval != NONE
        self._keep(np.stack([interval[known], before[known]], axis=1))

    def _since(self, pixel: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Time since each pixel's latest event in earlier parts, or NONE."""
        if not len(self._time):
            return np.full(len(pixel), NONE)
        before = self._time[pixel]
        return np.where(before > 0, t - (before - 1), NONE)

    def _earlier(self, pixel: np.ndarray) -> np.ndarray:
        return self._interval[pixel] - 1 if len(self._interval) else np.full(len(pixel), NONE)

    def _remember(self) -> None:
        """Note where the part before left each pixel; a recording of one part needs no such notes."""
        if self._last is None:
            return
        if not len(self._time):
            self._time, self._interval = np.zeros(self._pixels, np.int64), np.zeros(self._pixels, np.int64)
        pixel, t, interval = self._last
        self._time[pixel], self._interval[pixel] = t + 1, interval + 1

    def _keep(self, some: np.ndarray) -> None:
        self.count += len(some)
        if self.share < 1:
            some = some[self._random.random(len(some)) < self.share]
        self._kept.append(some)
        self._held += len(some)
        while self._held > self._most:
            self.share *= 0.5
            self._kept = [part[self._random.random(len(part)) < 0.5] for part in self._kept]
            self._held = sum(map(len, self._kept))


def _in_order_of_pixels(pixel: np.ndarray) -> np.ndarray:
    """(n,) indices that sort by pixel and leave the events of each in order."""
    bits = max(len(pixel) - 1, 1).bit_length()
    if int(pixel.max()) >> (63 - bits):
        return np.argsort(pixel, kind="stable")
    return np.sort(pixel << bits | np.arange(len(pixel))) & ((1 << bits) - 1)  # a third of the time of argsort
