"""The times between successive events of each pixel."""

from __future__ import annotations

import numpy as np

from pixelid.recordings.events import Events


def pixel_intervals(events: Events) -> np.ndarray:
    """(m,) int64 nanoseconds between successive events of the same pixel, both polarities, in no stated order."""
    if len(events) < 2:
        return np.empty(0, np.int64)
    pixel = events.y.astype(np.int32) * np.int32(events.width) + events.x
    order = np.argsort(pixel, kind="stable")
    t, pixel = events.t[order], pixel[order]
    return np.diff(t)[pixel[1:] == pixel[:-1]]
