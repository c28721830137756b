"""From a file's raw columns to validated events, whatever the file's unit and size conventions."""

from __future__ import annotations

import numpy as np

from pixelid.errors import InputError
from pixelid.recordings.events import NS_PER_UNIT, Events

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
