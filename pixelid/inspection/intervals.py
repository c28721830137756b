"""The times between successive events of each pixel."""

from __future__ import annotations

import numpy as np

from pixelid.recordings.events import Events


def pixel_intervals(events: Events) -> np.ndarray:
    """(m,) int64 nanoseconds between successive events of the same pixel, both polarities, in no stated order."""
    interval, same = _successive(events)
    return interval[same]


def pixel_interval_pairs(events: Events) -> np.ndarray:
    """(k, 2) int64 nanoseconds: every two successive intervals of a pixel, the earlier first."""
    interval, same = _successive(events)
    both = same[1:] & same[:-1]
    return np.stack([interval[:-1][both], interval[1:][both]], axis=1)


def _successive(events: Events) -> tuple[np.ndarray, np.ndarray]:
    """(n − 1,) differences of time in the order of pixels, and whether both ends belong to one pixel."""
    if len(events) < 2:
        return np.empty(0, np.int64), np.empty(0, bool)
    pixel = events.y.astype(np.int32) * np.int32(events.width) + events.x
    order = np.argsort(pixel, kind="stable")
    t, pixel = events.t[order], pixel[order]
    return np.diff(t), pixel[1:] == pixel[:-1]
