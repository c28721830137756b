"""How many events, how fast, and of which polarity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pixelid.recordings.columns import duplicated
from pixelid.recordings.events import Events

PEAK_WINDOW_S = 1e-3


@dataclass(frozen=True)
class Counts:
    """Totals of a recording.

    on_fraction: share of ON events, None without events
    mean_hz: events per second between the first and the last event, None when they do not span any time
    peak_hz: the highest rate within one window of `peak_window_s`
    active_pixels: pixels with at least one event
    duplicates: events that repeat an earlier one in time, pixel and polarity; None when pixels are pooled
    """

    events: int
    duration_s: float
    on_fraction: float | None
    mean_hz: float | None
    peak_hz: float | None
    peak_window_s: float
    active_pixels: int
    duplicates: int | None


def count(events: Events, pooled: bool = False) -> Counts:
    """The totals of `events`."""
    n, duration = len(events), events.duration_s
    window = min(PEAK_WINDOW_S, duration) if duration > 0 else PEAK_WINDOW_S
    mean = peak = None
    if duration > 0:
        mean = n / duration
        starts = np.flatnonzero(np.diff((events.t - events.t[0]) // round(window * 1e9), prepend=-1))
        peak = float(np.diff(starts, append=n).max() / window)
    return Counts(
        events=n,
        duration_s=duration,
        on_fraction=float(events.p.mean()) if n else None,
        mean_hz=mean,
        peak_hz=peak,
        peak_window_s=window,
        active_pixels=int(np.count_nonzero(np.bincount(events.pixel, minlength=1))) if n else 0,
        duplicates=None if pooled else len(duplicated(events)),
    )
