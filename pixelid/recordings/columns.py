"""From a file's raw columns to validated events, whatever the file's unit and size conventions."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from pixelid.errors import InputError
from pixelid.recordings.events import NS_PER_UNIT, Events

PART_EVENTS = 1 << 20  # of a part of a long recording: 13 MB
INT64_MAX = int(np.iinfo(np.int64).max)


def to_nanoseconds(t: np.ndarray, unit: str, where: str, offset: int = 0) -> np.ndarray:
    """(n,) int64 nanoseconds from (n,) integer times in `unit`, each later by `offset` units.

    Raises InputError naming `where` for an unknown unit, non-integers, and times beyond 64 bits.
    """
    if unit not in NS_PER_UNIT:
        raise InputError(f"{where}/t: expected unit {' or '.join(NS_PER_UNIT)}, found {unit!r}")
    if t.dtype.kind not in "iu":
        raise InputError(f"{where}/t: expected integers, found {t.dtype}")
    scale = NS_PER_UNIT[unit]
    if len(t):
        for extreme in (int(t.min()), int(t.max())):
            if abs(extreme + offset) * scale > INT64_MAX or abs(extreme) > INT64_MAX or abs(offset) > INT64_MAX:
                raise InputError(
                    f"{where}/t: expected times that fit 64 bits in nanoseconds, found {extreme + offset} {unit}"
                )
    t = t.astype(np.int64, copy=False)
    if offset:
        t = t + offset
    return t if scale == 1 else t * scale


def sensor_size(x: np.ndarray, y: np.ndarray, width: int | None, height: int | None) -> tuple[int, int]:
    """The stated size, or the smallest that holds every event where the file states none."""
    if width is None:
        width = int(x.max()) + 1 if len(x) else 1
    if height is None:
        height = int(y.max()) + 1 if len(y) else 1
    return max(int(width), 1), max(int(height), 1)


def duplicated(events: Events) -> np.ndarray:
    """(d,) int64 indices of events that repeat an earlier one in t, x, y and p; O(n log n)."""
    if len(events) < 2:
        return np.empty(0, np.int64)
    equal = events.t[1:] == events.t[:-1]
    shared = np.zeros(len(events), bool)
    shared[1:] = equal
    shared[:-1] |= equal
    index = np.flatnonzero(shared)
    address = (events.y[index].astype(np.int64) * events.width + events.x[index]) * 2 + events.p[index]
    order = np.lexsort((address, events.t[index]))
    index, address = index[order], address[order]
    again = (address[1:] == address[:-1]) & (events.t[index[1:]] == events.t[index[:-1]])
    return np.sort(index[1:][again])


class RepeatCounter:
    """Counts what `duplicated` finds, part by part: it remembers the addresses of the last time stamp only."""

    def __init__(self) -> None:
        self._time_ns, self._addresses = -1, np.empty(0, np.int64)

    def add(self, events: Events) -> int:
        """How many of `events`, which follow those of the last call, repeat an earlier one in t, x, y and p."""
        if not len(events):
            return 0
        moment = np.cumsum(np.diff(events.t, prepend=events.t[:1]) != 0)  # 0 for the first time stamp, then 1, 2, …
        address = (events.y.astype(np.int64) << 17) | (events.x.astype(np.int64) << 1) | events.p
        key = (moment << 33) | address
        if events.t[0] == self._time_ns:
            key = np.concatenate([self._addresses, key])
        key.sort()
        again = int(np.count_nonzero(key[1:] == key[:-1]))
        last = key[np.searchsorted(key, int(moment[-1]) << 33) :] - (int(moment[-1]) << 33)
        self._time_ns, self._addresses = int(events.t[-1]), np.unique(last)
        return again


class Rollovers:
    """Undoes the rollovers of a clock whose stamps come block by block.

    A fall by more than half of `span` is one; any smaller fall stays, for `validated` to refuse.
    """

    def __init__(self, span: int) -> None:
        self._span, self._last, self._turns = span, None, 0

    def undone(self, stamps: np.ndarray) -> np.ndarray:
        """(n,) stamps (n,) of the next block, as if the clock had counted on."""
        stamps = stamps.astype(np.int64)
        if not len(stamps):
            return stamps
        before = stamps[0] if self._last is None else self._last
        turns = self._turns + np.cumsum(np.diff(stamps, prepend=before) < -(self._span // 2))
        self._last, self._turns = stamps[-1], turns[-1]
        return stamps + turns * self._span


def validated(
    columns: Iterable[tuple], width: int, height: int, *, unit: str, tick_ns: int, where: str, offset: int = 0
) -> Iterator[Events]:
    """Events of successive blocks of columns (t in `unit`, x, y, p) of one file.

    Raises:
        InputError: as `to_nanoseconds` and `Events.from_columns`, counting events from the first block.
    """
    before, last_ns = 0, 0
    for t, x, y, p in columns:
        nanoseconds = to_nanoseconds(np.asarray(t), unit, where, offset)
        events = Events.from_columns(
            nanoseconds, x, y, p, width, height, tick_ns=tick_ns, where=where, before=before, not_before_ns=last_ns
        )
        before += len(events)
        last_ns = int(events.t[-1]) if len(events) else last_ns
        yield events
