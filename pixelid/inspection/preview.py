"""A stretch of events to look at: enough to see what moves, few enough for a page."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pixelid.recordings.events import Events

MOST_EVENTS = 5000  # consecutive ones; 80 kB of a page


class Preview:
    """Collects consecutive events from a time on."""

    def __init__(self, from_ns: float) -> None:
        self._from, self._left, self._parts = from_ns, MOST_EVENTS, []

    def add(self, events: Events) -> None:
        """Take what is still missing from further events, which follow those before."""
        if self._left and len(events) and events.t[-1] >= self._from:
            first = int(np.searchsorted(events.t, self._from))
            part = slice(first, first + self._left)
            self._parts.append([np.asarray(values[part]) for values in (events.t, events.x, events.y, events.p)])
            self._left -= len(self._parts[-1][0])

    def events(self) -> Mapping[str, np.ndarray]:
        """t [ns since the first of them], x, y, p: (n,) each."""
        if not self._parts:
            return {name: np.empty(0, np.int64) for name in "txyp"}
        t, x, y, p = (np.concatenate(column) for column in zip(*self._parts, strict=True))
        return {"t": t - t[0], "x": x, "y": y, "p": p.astype(np.uint8)}
