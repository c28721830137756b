"""Bursts of pooled events: how many pixels are in the pool, their dead time, and the rows of the readout.

Where the light steps far enough, every pixel fires once within microseconds: a burst of exactly N events, N the number
of pixels, and then none for the dead time.  Events of one polarity are cut where nothing comes for a while.  Sizes of
bursts then end at N: those of N events hold more events than any other size, and larger ones are few.  The wait that
cuts is not known beforehand, so several are tried and the one under which most events lie in full bursts is kept.

Of any N + 1 events in a row, two are of one pixel, so they take at least a dead time: the least that a tenth more than
N take bounds the dead time from above, and is little longer where the light moves fast.  Rows that a readout scans
share a time stamp: within full bursts most groups of equal stamps then have the size of a row.

Pixels that fire on their own leave no silence after a part of them has fired: the others may follow at once, whatever
the dead time of the first.  A readout that takes all that wait in one cycle, and is busy the longer the more it takes,
makes all of them wait: silences then grow with the size of the burst before.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from pixelid.recordings.events import Events
from pixelid.recordings.recording import Recording

WAITS_NS = (1_000, 2_000, 3_000, 5_000, 7_000, 10_000, 15_000, 20_000, 30_000)  # a readout's gaps to a fast ramp's
MOST_EVENTS = 4_000_000  # looked at
LEAST_PIXELS, LEAST_BURSTS = 4, 20
MORE = 1.1  # times N: so much noise is in few stretches, or pixels that N lacks
SMALL, LARGE = (0.125, 0.25), (0.5, 1.0)  # of N: bursts whose silences are compared
SELDOM = 0.1  # of silences are shorter than the one compared
NEARLY = 0.9  # of the most full cycles that any wait parts: a longer one joins small cycles
BEYOND = 0.02  # cycles of more than all pixels, per full one: noise
IQR = 1.349  # of a normal distribution, in standard deviations
GROWS = 2.0  # times as long after large bursts: without a shared readout neither is longer than the wait that cuts


@dataclass(frozen=True)
class Cycle:
    """How long a shared readout is busy: a cycle of n events `cycle_s` + n `event_s`, give or take `spread` of it."""

    cycle_s: float
    event_s: float
    spread: float


@dataclass(frozen=True)
class Bursts:
    """What full bursts show.

    pixels: of the pool; None where bursts do not end at a size, and `reason` says why;  full: how many bursts had all
    length_s: of a full burst, median;  spacing_s: the least that `MORE` times as many events take, None without N
    row: events with one time stamp within full bursts, None where they have stamps of their own
    silence_s: nine in ten silences after bursts of half to all but one of the pixels are longer, where silences grow
        with bursts as those of a shared readout do; else None
    wait_ns: longer pauses part its cycles;  cycle: how long one lasts, None where silences do not grow
    """

    pixels: int | None
    reason: str = ""
    full: int = 0
    length_s: float | None = None
    spacing_s: float | None = None
    row: int | None = None
    silence_s: float | None = None
    wait_ns: int = 0
    cycle: Cycle | None = None

    def as_dict(self) -> dict[str, Any]:
        """The entry in inspect.json."""
        return {
            "pixels": self.pixels, "reason": self.reason, "full_bursts": self.full, "burst_s": self.length_s,
            "dead_time_at_most_s": self.spacing_s, "row_pixels": self.row,
            "shared_silence_s": self.silence_s,
        }  # fmt: skip


class BurstCounter:
    """Events of a recording, part by part, up to `MOST_EVENTS`."""

    def __init__(self) -> None:
        self._t: list[np.ndarray] = []
        self._p: list[np.ndarray] = []
        self._left = MOST_EVENTS

    def add(self, events: Events) -> None:
        """Take the next events in order of time."""
        if self._left > 0:
            self._t.append(events.t[: self._left])
            self._p.append(events.p[: self._left])
            self._left -= len(self._t[-1])

    def bursts(self) -> Bursts:
        """What they show."""
        return find_bursts(np.concatenate(self._t), np.concatenate(self._p)) if self._t else Bursts(None, "no events")


def bursts_of(recording: Recording) -> Bursts:
    """What the events of a pooled recording show."""
    counter = BurstCounter()
    counter.add(recording.events)
    return counter.bursts()


def find_bursts(t: np.ndarray, p: np.ndarray) -> Bursts:
    """The full bursts among times t (n,) ns, in order, of polarities p (n,) 0 or 1."""
    found = []
    for wait in WAITS_NS:
        parts = [_cut(t[p == polarity], wait) for polarity in (0, 1)]
        sizes = np.concatenate([size for _, _, size in parts])
        pixels = _last_size(sizes)
        if pixels is not None:
            found.append((pixels, pixels * int(np.sum(sizes == pixels)), parts))
    if not found:
        return Bursts(None, "no size of bursts stands out: the light never makes all pixels fire at once")
    # Rows are bursts too, and parts of the whole pool's.
    nested = 0.5  # of the events in full bursts of any size: bursts of fewer are chance
    enough = nested * max(events for _, events, _ in found)
    pixels, _, parts = max((one for one in found if one[1] >= enough), key=lambda one: one[:2])
    full = 0
    lengths, grouped = [], np.zeros(pixels + 1)
    for polarity, (first, last, size) in enumerate(parts):
        times = t[p == polarity]
        whole = size == pixels
        full, begin = full + int(whole.sum()), times[first]
        lengths.append((times[last] - begin)[whole])
        within = np.repeat(whole, size)
        stamps = times[within] * 1.0
        change = np.flatnonzero(np.diff(stamps) != 0)
        runs = np.diff(np.concatenate([[-1], change, [len(stamps) - 1]]))
        grouped += np.bincount(np.minimum(runs, pixels), minlength=pixels + 1) * np.arange(pixels + 1)
    more = math.ceil(MORE * pixels)
    shared = _shared(t, pixels)
    length, spacing = np.concatenate(lengths), t[more:] - t[:-more]
    row = int(np.argmax(grouped))
    shortest = 0.01  # of the times that so many events take: a window with more noise is chance
    row_share = 0.5  # of the events of full bursts in groups of one size
    return Bursts(
        pixels,
        "",
        full,
        float(np.median(length)) * 1e-9,
        float(np.quantile(spacing, shortest)) * 1e-9 if len(spacing) else None,
        row if 1 < row < pixels and grouped[row] > row_share * grouped.sum() else None,
        *((None, 0, None) if shared is None else (shared[1], shared[0], _cycle(t, pixels, shared[0]))),
    )


def cycles(t: np.ndarray, wait_ns: int) -> tuple[np.ndarray, np.ndarray]:
    """(when each began, how many events it has) of the cycles of a shared readout, from times t (n,) ns, in order."""
    first, _, size = _cut(t, wait_ns)
    return t[first], size


def _shared(t: np.ndarray, pixels: int) -> tuple[int, float] | None:
    """(pauses longer than which, ns, part cycles of a shared readout;  `Bursts.silence_s`).

    t: (n,) ns, in order.  None where silences do not grow.  A pixel is in a cycle once: under the right wait none has
    more than all.
    """
    found = []
    for wait in WAITS_NS:
        first, last, size = _cut(t, wait)
        full = int(np.sum(size == pixels))
        if full < LEAST_BURSTS or np.sum(size > pixels) > BEYOND * full:
            continue
        silence, size = t[first[1:]] - t[last[:-1]], size[:-1]
        groups = [silence[(size >= low * pixels) & (size < high * pixels)] for low, high in (SMALL, LARGE)]
        if min(map(len, groups)) < LEAST_BURSTS:
            continue
        after_small, after_large = (float(np.quantile(group, SELDOM)) for group in groups)
        if after_large > GROWS * after_small:
            found.append((full, wait, 1e-9 * after_large))
    enough = NEARLY * max((full for full, _, _ in found), default=0)
    return next(((wait, silence_s) for full, wait, silence_s in found if full >= enough), None)


def _cycle(t: np.ndarray, pixels: int, wait_ns: int) -> Cycle:
    """The readout's cycle from times t (n,) ns, in order.

    Two full bursts in a row leave no pause between cycles, and of small ones the shortest waits have none.  Those
    before a burst of several pixels have hardly any.
    """
    begun, size = cycles(t, wait_ns)
    length, size, after = np.diff(begun) * 1e-9, size[:-1], size[1:]
    small, full = size <= SMALL[0] * pixels, (size == pixels) & (after == pixels)
    few, least = float(size[small].mean()), float(np.quantile(length[small], SELDOM))
    event_s = max((float(np.median(length[full])) - least) / (pixels - few), 0.0)
    cycle_s = max(least - few * event_s, 0.0)
    several = after > SMALL[0] * pixels
    off = length[several] / (cycle_s + event_s * size[several])
    return Cycle(cycle_s, event_s, float(np.subtract(*np.quantile(off, (0.75, 0.25)))) / IQR)


def _cut(times: np.ndarray, wait_ns: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(first, last, size) of bursts, indices into times (n,) ns of one polarity."""
    if len(times) == 0:
        none = np.zeros(0, np.int64)
        return none, none, none
    ends = np.flatnonzero(np.diff(times) > wait_ns)
    first, last = np.concatenate([[0], ends + 1]), np.concatenate([ends, [len(times) - 1]])
    return first, last, last - first + 1


def _last_size(sizes: np.ndarray) -> int | None:
    """The size at which bursts end; None where none does."""
    counts = np.bincount(sizes, minlength=1)
    events = counts * np.arange(len(counts))
    pixels = int(np.argmax(events))
    beyond = counts[pixels + 1 : pixels + 1 + max(pixels // 2, 1)].sum()
    largest_rest = 0.2  # bursts of N + 1 to 1.5 N events, per burst of N: chance unions of two, and noise
    stands_out = counts[pixels] >= LEAST_BURSTS and beyond < largest_rest * counts[pixels]
    return pixels if pixels >= LEAST_PIXELS and stands_out else None
