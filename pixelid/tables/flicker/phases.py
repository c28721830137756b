"""Events under periodic light as a table over phase: where the last event reset the pixel, and where the next one came.

The reference of the comparator is the level at the last event, so for light of one frequency all that matters about the
past is the phase of that event.  Counts and seconds of exposure per (phase of reset, phase now) say everything.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pixelid.errors import InputError
from pixelid.recordings.events import Events

BINS = 32
SLICE_S = 0.1


@dataclass(frozen=True)
class PhaseTable:
    """on, off: (BINS, BINS) events by (phase of reset, phase now);  exposure: (BINS, BINS) seconds;  pixels, events"""

    on: np.ndarray
    off: np.ndarray
    exposure: np.ndarray
    pixels: int
    events: int


def quiet_windows(events: Events, ratio: float = 1.3) -> list[tuple[float, float]]:
    """Windows [s] whose event rate is at most `ratio` times the 20th percentile: no motion, the light alone.

    Raises InputError for recordings shorter than ten slices.
    """
    t = events.t * 1e-9
    count = int((t[-1] - t[0]) / SLICE_S) if len(t) else 0
    if count < 10:
        raise InputError(f"flicker: expected at least {10 * SLICE_S:g} s of events, found {events.duration_s:g} s")
    edges = t[0] + SLICE_S * np.arange(count + 1)
    rate = np.histogram(t, edges)[0]
    quiet = np.append(rate <= ratio * np.percentile(rate, 20), False)
    starts = np.flatnonzero(quiet & ~np.append(False, quiet[:-1]))
    return [(float(edges[k]), float(edges[k + np.argmin(quiet[k:])])) for k in starts]


def locked_frequency(events: Events, near_hz: float, windows: list[tuple[float, float]]) -> tuple[float, float]:
    """(frequency, standard error) within 2 % of near_hz that ON and OFF events lock to best.

    The error is a jackknife over tenths of the pixels.
    """
    t = events.t * 1e-9
    inside = np.zeros(len(t), bool)
    for a, b in windows:
        inside |= (t >= a) & (t < b)
    t, sign, pixel = t[inside], np.where(events.p[inside] == 1, 1.0, -1.0), events.pixel[inside]
    centre = t.mean() if len(t) else 0.0

    def best(keep: np.ndarray, around: float, width: float) -> float:
        grid = np.linspace(around - width, around + width, 61)
        clock, weight = t[keep] - centre, sign[keep]
        power = np.array([abs(np.exp(2j * np.pi * f * clock) @ weight) for f in grid])
        k = int(np.clip(power.argmax(), 1, len(grid) - 2))
        a, b, c = power[k - 1 : k + 2]
        return float(grid[k] + 0.5 * (grid[1] - grid[0]) * (a - c) / min(a - 2 * b + c, -1e-12))

    thin = np.arange(len(t)) % max(len(t) // 10_000, 1) == 0
    coarse = best(thin, near_hz, 0.02 * near_hz)
    fine = best(thin, coarse, 0.2)
    folds = [best(thin & (pixel % 10 != k), fine, 0.2) for k in range(10)]
    return float(np.mean(folds)), float(np.sqrt(0.9 * np.sum((np.array(folds) - np.mean(folds)) ** 2)))


def phase_table(
    events: Events, keep: np.ndarray, frequency_hz: float, windows: list[tuple[float, float]]
) -> PhaseTable:
    """The table of the pixels where `keep` (flat, pixels of the sensor) holds, over the windows.

    A pixel counts from its first event in a window on; its last interval is cut at the window's end.
    """
    chosen = np.flatnonzero(keep[events.pixel])
    order = chosen[np.lexsort((events.t[chosen], events.pixel[chosen]))]
    t, pixel, on = events.t[order] * 1e-9, events.pixel[order], events.p[order] == 1
    following = np.append(t[1:], np.inf)
    following[np.append(pixel[1:] != pixel[:-1], True)] = np.inf
    next_on = np.append(on[1:], False)
    counts = np.zeros((2, BINS, BINS))
    exposure = np.zeros((BINS, BINS))
    used = 0
    for start, end in windows:
        inside = (t >= start) & (t < end)
        begin, until = t[inside] * frequency_hz, np.minimum(following[inside], end) * frequency_hz
        ends = following[inside] < end
        a = _bin(begin)
        np.add.at(counts, (next_on[inside][ends].astype(int), a[ends], _bin(until[ends])), 1.0)
        cycles = np.floor(until - begin)
        exposure += np.bincount(a, cycles, BINS)[:, None] / BINS
        rest = until - begin - cycles
        first = np.floor(begin * BINS)
        for j in range(BINS + 1):
            low = np.maximum(begin, (first + j) / BINS)
            high = np.minimum(begin + rest, (first + j + 1) / BINS)
            np.add.at(exposure, (a, (a + j) % BINS), np.maximum(high - low, 0.0))
        used += int(ends.sum())
    return PhaseTable(counts[1], counts[0], exposure / frequency_hz, len(np.unique(pixel)), used)


def _bin(cycles: np.ndarray) -> np.ndarray:
    return np.floor((cycles % 1.0) * BINS).astype(int) % BINS
