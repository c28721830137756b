"""What no event says: pixels and times at which nothing fired, where the light hardly changed.

Chains hold what lies between two events of a pixel, and begin at one event as likely as at another.  A pixel that saw
nothing but the background for a second makes no event, so nothing would keep haze out of its view; and an interval as
long as a turn of the camera is asked for as rarely as one of a millisecond.  So pairs of times are drawn here, evenly
over all pixels and all of the recording, both within one interval without events.  Between them the light has moved by
less than the two thresholds together; as ℓ_tv does, the loss takes it for as little as the scene allows,

    ℓ_quiet = |u(t₂) − u(t₁)|/C̄,     u = ln L, rounded off near zero.

It is the light that is compared, not the response: within an interval that long the pixel has caught up, but for its
lag before the next event, which is left out.

A pixel without any event among pixels that fire is no witness: it may be broken.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pixelid.inspection.hot_pixels import median_around

LONG = 8.0  # of the shortest quiet interval: the image then moves by four pixels; what is shorter, chains see enough of
EVENTS_AT_ONCE = 4_000_000  # of which intervals are made at a time: bounds memory, changes nothing
LAGS = 2.0  # time constants of the slowest pole before an event, in which the light may have moved already


class Quiet(NamedTuple):
    """Intervals without events (n,) of pixels, s;  pixel: row-major index;  until: (n,) running sum of lengths."""

    begin: np.ndarray
    end: np.ndarray
    pixel: np.ndarray
    until: np.ndarray


class Pairs(NamedTuple):
    """t: (n, 2) s, both within one quiet interval;  pixel: (n,)."""

    t: np.ndarray
    pixel: np.ndarray


NOTHING = Quiet(np.zeros(0), np.zeros(0), np.zeros(0, np.int32), np.zeros(0))


def quiet_intervals(
    t, pixel, width: int, height: int, *, least: float, dead: float, left_out, kept: np.ndarray | None = None
) -> Quiet:
    """The quiet intervals of a recording, from its first event to its last.

    Args:
        t: (N,) s, of all events in order of time.
        pixel: (N,) row-major index.
        width: of the sensor.
        height: of the sensor.
        least: s, shorter ones are left out.
        dead: s after an event in which a pixel does not look.
        left_out: (k,) pixels that are no witnesses.
        kept: (pixels,) bool, whose events the recording has: others are no witnesses either; None for all.

    Returns:
        Intervals of at least `least`, by pixel and time.
    """
    pixels = width * height
    counts = np.bincount(pixel, minlength=pixels)
    beside = median_around(counts.reshape(height, width), kept, side=3, centre=False)
    firing = 4  # events of the median neighbour: a working pixel would be silent beside it one time in fifty
    asked = (counts > 0) | (beside < firing)
    if kept is not None:
        asked &= kept
    asked[np.asarray(left_out, np.int64)] = False
    order = np.argsort(pixel, kind="stable")
    first = np.concatenate([[0], np.cumsum(counts)])
    parts, low = [], 0
    while low < pixels:
        high = max(int(np.searchsorted(first, first[low] + EVENTS_AT_ONCE, side="right")) - 1, low + 1)
        times = t[order[first[low] : first[high]]]
        begins, ends, of = _between(times, counts[low:high], float(t[0]), float(t[-1]), dead)
        kept = asked[low:high][of] & (ends - begins > max(least, 0.0))
        parts.append((begins[kept], ends[kept], of[kept] + np.int32(low)))
        low = high
    begins, ends, of = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Quiet(begins, ends, of, np.cumsum(ends - begins))


def _between(times, counts, start: float, stop: float, dead: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(begins, ends, pixel) of what lies before, between and behind events; those of a pixel follow each other.

    times: (N,) s, pixel after pixel;  counts: (pixels,) of each, with the sum N
    """
    of = np.repeat(np.arange(len(counts), dtype=np.int32), counts + 1)
    last = np.zeros(len(of), bool)  # interval j of a pixel is before its event j; the last one is behind all of them
    last[np.cumsum(counts + 1) - 1] = True
    begins, ends = np.empty(len(of)), np.empty(len(of))
    ends[~last], ends[last] = times, stop
    begins[np.roll(~last, 1)], begins[np.roll(last, 1)] = times + dead, start
    return begins, ends, of


def draw_pairs(quiet: Quiet, number: int, lag: float, rng: np.random.Generator) -> Pairs:
    """Pairs whose intervals are drawn evenly over quiet time, both times anywhere in the interval.

    lag: s before the end of an interval in which no time is taken
    """
    at = rng.random(number) * quiet.until[-1]
    k = np.minimum(np.searchsorted(quiet.until, at, side="right"), len(quiet.until) - 1)
    begin, length = quiet.begin[k], np.maximum(quiet.end[k] - quiet.begin[k] - lag, 0.0)
    return Pairs(begin[:, None] + rng.random((number, 2)) * length[:, None], quiet.pixel[k].astype(np.int64))
