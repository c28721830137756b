"""Columns of times in any unit, events that repeat, clocks that roll over."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from pixelid.errors import InputError
from pixelid.recordings.events import NS_PER_UNIT, Events

PART_EVENTS = 1 << 20  # of a part of a long recording: 13 MB
INT64_MAX = int(np.iinfo(np.int64).max)


def to_nanoseconds(t: np.ndarray, unit: str, where: str, offset: int = 0) -> np.ndarray:
    """(n,) int64 nanoseconds from (n,) integer times in `unit`, each later by `offset` units.

    Raises InputError naming `where` for non-integers, and times beyond 64 bits.
    """
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


def floats_to_ns(t: np.ndarray, unit: str, where: str) -> np.ndarray:
    """(n,) int64 nanoseconds from (n,) floating times, to the last decimal that all of them can carry.

    A double at 1.7e9 s is a multiple of 0.24 µs: what was written in µs would show a clock of that instead.
    Raises InputError for NaN and times beyond 64 bits.
    """
    if not np.isfinite(t).all():
        raise InputError(
            f"{where}/t: expected finite times, event {int(np.argmin(np.isfinite(t)))} has none; leave such rows out"
        )
    nanoseconds = t.astype(np.float64) * NS_PER_UNIT[unit]
    if len(t) and np.abs(nanoseconds).max() >= 9.2e18:
        found = f"{np.abs(t).max():g} {unit}"
        raise InputError(f"{where}/t: expected times that fit 64 bits in nanoseconds, found {found}")
    last = last_decimal_ns(float(np.spacing(np.abs(t).max(initial=0))), unit)
    return np.rint(nanoseconds / last).astype(np.int64) * last


def last_decimal_ns(spacing: float, unit: str) -> int:
    """The least power of ten, in ns, that floating times so far apart can carry."""
    return 10 ** math.ceil(math.log10(max(1.0, spacing * NS_PER_UNIT[unit])))


def word_pairs(path: Path, start: int, kind: str) -> Iterator[np.ndarray]:
    """(n, 2) of two 32-bit numbers an event behind a header of `start` bytes, block by block.

    Raises:
        InputError: the file ends within an event.
    """
    if left := (path.stat().st_size - start) % 8:
        raise InputError(f"{path}: expected 8 bytes per event after the header, found {left} left over")
    with path.open("rb") as file:
        file.seek(start)
        while len(data := file.read(8 * PART_EVENTS)):
            yield np.frombuffer(data, kind).reshape(-1, 2)


class RepeatCounter:
    """Counts events that repeat an earlier one, part by part; of the last time stamp it remembers the addresses."""

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

    A fall by more than half of `span` is one; any smaller fall stays, for `raw.interpreted` to refuse.
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
