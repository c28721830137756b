"""External trigger edges: what a cable from the stimulus to the camera has put among the events."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from pixelid.errors import InputError, shown
from pixelid.recordings.columns import INT64_MAX

COLUMNS = ("t", "rising", "channel")


@dataclass(frozen=True)
class Triggers:
    """Edges on the camera's trigger inputs, on the clock of the events.

    t: (n,) int64, nanoseconds, non-decreasing
    rising: (n,) bool
    channel: (n,) uint8, the input's number
    """

    t: np.ndarray
    rising: np.ndarray
    channel: np.ndarray

    def __len__(self) -> int:
        return len(self.t)

    @staticmethod
    def from_columns(t, rising, channel, *, where: str = "triggers") -> Triggers:
        """Validated trigger edges from array-likes, sorted by time.

        Raises:
            InputError: naming `where`, for unequal lengths, times and channels that are no integers or do not fit, and
                edges that are neither true nor false.
        """
        t, rising, channel = np.asarray(t), np.asarray(rising), np.asarray(channel)
        if not t.size == rising.size == channel.size:
            found = f"{t.size}, {rising.size}, {channel.size}"
            raise InputError(f"{where}: t, rising and channel must have one length, found {found}")
        for name, column, kinds, least, most in (
            ("t", t, "iu", -INT64_MAX, INT64_MAX),
            ("channel", channel, "iub", 0, 255),
            ("rising", rising, "iubf", 0, 1),
        ):
            if column.ndim != 1 or column.dtype.kind not in kinds:
                found = f"{column.dtype} of shape {column.shape}"
                raise InputError(f"{where}/{name}: expected one column of integers, found {found}")
            if len(column) and not (least <= column.min() and column.max() <= most):
                outside = column.min() if not least <= column.min() else column.max()
                raise InputError(
                    f"{where}/{name}: expected numbers from {least} to {most}, found {shown(outside.item())}"
                )
        order = np.argsort(t, kind="stable")
        return Triggers(
            t[order].astype(np.int64, copy=False), rising[order].astype(bool), channel[order].astype(np.uint8)
        )

    def edges_s(self, channel: int | None = None) -> np.ndarray:
        """(k,) seconds of the rising edges, or of all edges where none rises; of one channel or of all."""
        mine = np.ones(len(self), bool) if channel is None else self.channel == channel
        rising = mine & self.rising
        return self.t[rising if rising.any() else mine] * 1e-9

    def rises_at(self, seconds: float) -> bool:
        """Whether one of `edges_s` rises."""
        return bool(self.rising[self.t * 1e-9 == seconds].any())

    def shifted(self, by_ns: int) -> Triggers:
        """The same edges, later by `by_ns`."""
        return Triggers(self.t + by_ns, self.rising, self.channel)

    @staticmethod
    def joined(parts: Iterable[Triggers | None]) -> Triggers | None:
        """The edges of all parts, sorted by time; None where no part has any."""
        some = [part for part in parts if part is not None]
        if not some:
            return None
        return Triggers.from_columns(*(np.concatenate([getattr(part, name) for part in some]) for name in COLUMNS))
