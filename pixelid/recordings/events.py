"""The events of one recording, as immutable columns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from pixelid.errors import InputError

if TYPE_CHECKING:
    from jaxtyping import Int64, UInt8, UInt16

# A unit of time is coarse from this share of a pixel's shortest intervals (their 1 % quantile) on.  Thresholds scatter
# by 2 % and more of an interval; rounding at both ends of it adds (0.02/√12)² twice, a sixth of that variance.
COARSE_UNIT_SHARE, SHORT_QUANTILE = 0.02, 0.01
NS_PER_UNIT = {"ns": 1, "us": 1_000, "ms": 1_000_000, "s": 1_000_000_000}
NO_WAYS: Mapping[str, str] = MappingProxyType({})
MOST_SIDE = 1 << 16  # addresses have 16 bits
MOST_PIXELS = 1 << 24  # ten times the largest sensors; one number per pixel takes 128 MiB


@dataclass(frozen=True)
class Events:
    """Address events of a `width` × `height` sensor.

    t: (n,) int64, nanoseconds from the recording's time zero, non-decreasing
    x, y: (n,) uint16, pixel column and row
    p: (n,) uint8, 1 for ON (brighter), 0 for OFF (darker)
    tick_ns: the unit in which the source counted time (1 for ns files, 1000 for µs files)
    """

    t: Int64[np.ndarray, " events"]
    x: UInt16[np.ndarray, " events"]
    y: UInt16[np.ndarray, " events"]
    p: UInt8[np.ndarray, " events"]
    width: int
    height: int
    tick_ns: int = 1

    def __len__(self) -> int:
        return len(self.t)

    @cached_property
    def pixel(self) -> np.ndarray:
        """(n,) int64 flat pixel index, y · width + x."""
        return self.y.astype(np.int64) * self.width + self.x

    @property
    def duration_s(self) -> float:
        """Seconds between the first and the last event (0 when there are fewer than two)."""
        return float(self.t[-1] - self.t[0]) * 1e-9 if len(self) > 1 else 0.0

    def select(self, keep: np.ndarray | slice) -> Events:
        """The events where `keep` (boolean or index array, or slice) holds, on the same sensor."""
        return Events(self.t[keep], self.x[keep], self.y[keep], self.p[keep], self.width, self.height, self.tick_ns)

    @staticmethod
    def empty(width: int, height: int, tick_ns: int = 1, where: str = "events") -> Events:
        """No events on a sensor of the given size; `where` is named in errors of that."""
        nothing = np.empty(0, np.int64)
        return Events.from_columns(nothing, nothing, nothing, nothing, width, height, tick_ns=tick_ns, where=where)

    @staticmethod
    def from_columns(
        t, x, y, p, width: int, height: int, *, tick_ns: int = 1, where: str = "events", before: int = 0,
        not_before_ns: int = 0, ways: Mapping[str, str] = NO_WAYS,
    ) -> Events:  # fmt: skip
        """Validated events from array-likes; `t` in nanoseconds.

        A part of a longer recording says how many events came `before` and the time of the last of them; `ways` are
        what a reader's user may do about "negative" times, a "fall" of them and pixels "outside".

        Raises InputError naming `where` for unequal lengths, non-integer or negative or decreasing
        times, sensors larger than any that exist, pixels outside the sensor, and polarities other than 0 and 1.
        """
        t, x, y, p = (np.asarray(c) for c in (t, x, y, p))
        lengths = {len(c) for c in (t, x, y, p)}
        if len(lengths) != 1:
            raise InputError(f"{where}: t, x, y, p must have one length, found {len(t)}, {len(x)}, {len(y)}, {len(p)}")
        for name, column in (("t", t), ("x", x), ("y", y)):
            if column.dtype.kind not in "iu":
                raise InputError(f"{where}/{name}: expected integers, found {column.dtype}")
        if t.dtype.kind == "u" and len(t) and int(t.max()) > np.iinfo(np.int64).max:
            raise InputError(f"{where}/t: {int(t.max())} does not fit a signed 64-bit integer")
        if width <= 0 or height <= 0:
            raise InputError(f"{where}: sensor size must be positive, found {width} x {height}")
        if max(width, height) > MOST_SIDE or width * height > MOST_PIXELS:
            raise InputError(
                f"{where}: expected a sensor of at most {MOST_SIDE} columns and rows and {MOST_PIXELS} pixels, found "
                f"{width} x {height}"
            )
        t = t.astype(np.int64, copy=False)
        if len(t):
            if t[0] < 0:
                raise InputError(
                    f"{where}/t: times must not be negative, first is {int(t[0])} ns{ways.get('negative', '')}"
                )
            falling = np.flatnonzero(t[1:] < t[:-1])
            if t[0] < not_before_ns or len(falling):
                k = 0 if t[0] < not_before_ns else int(falling[0]) + 1
                fall_s = 1e-9 * float((t[k - 1] if k else not_before_ns) - t[k])
                raise InputError(
                    f"{where}/t: timestamps must not decrease, event {before + k} is earlier than event "
                    f"{before + k - 1} by {fall_s:g} s{ways.get('fall', '')}"
                )
            for name, column, limit in (("x", x, width), ("y", y, height)):
                if column.min() < 0 or column.max() >= limit:
                    k = int(np.argmax((column < 0) | (column >= limit)))
                    raise InputError(
                        f"{where}/{name}: event {before + k} has {name} = {int(column[k])}, expected 0..{limit - 1}"
                        f"{ways.get('outside', '')}"
                    )
            if p.dtype != bool and not ((p == 0) | (p == 1)).all():
                k = int(np.argmin((p == 0) | (p == 1)))
                hint = "; the coding looks like -1/1, write -1 as 0" if p.min() == -1 and p.max() <= 1 else ""
                raise InputError(f"{where}/p: polarity must be 1 (ON) or 0 (OFF), event {before + k} has {p[k]}{hint}")
        return Events(
            t,
            x.astype(np.uint16, copy=False),
            y.astype(np.uint16, copy=False),
            p.astype(np.uint8, copy=False),
            int(width),
            int(height),
            int(tick_ns),
        )
