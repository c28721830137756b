"""The grid on which timestamps lie: the clock's unit, and the period of a frame-like scan.

A clock shows in every timestamp: all differences are multiples of it.  A sensor that scans its array row by row
gives each row its own phase, so that only the intervals within one pixel are multiples of the scan period T, up
to a small jitter.  Their characteristic function R(f) = |mean exp(2πi f τ)| then stands near one at 1/T and at
its multiples and near zero between them (Mardia & Jupp, Directional Statistics, 2000, ch. 3).  A periodic light
also gives such a peak, but with the jitter of a pixel, so that its multiples fade.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pixelid.recordings.events import Events

LONGEST_S = 2e-3
BIN_NS = 250
BINS = 1 << 19
MIN_INTERVALS = 200
MIN_EVENTS = 100
HARMONICS = (2, 3, 4)


@dataclass(frozen=True)
class Tick:
    """The grid of the timestamps.

    clock_s: greatest common divisor of all differences of timestamps, None for fewer than 100 events
    scan_s: period of a scan, None when there is none
    scan_jitter_s: standard deviation of a timestamp about the scan's grid
    concentration: R(1/T), 1 for a perfect grid
    """

    clock_s: float | None
    scan_s: float | None = None
    scan_jitter_s: float | None = None
    concentration: float | None = None

    @property
    def tick_s(self) -> float | None:
        """The coarser of the two: what limits the time resolution of a pixel."""
        return self.scan_s if self.scan_s is not None else self.clock_s


def find_tick(events: Events, intervals: np.ndarray) -> Tick:
    """The grid of `events`, whose (m,) `intervals` within pixels are given in ns."""
    if len(events) < MIN_EVENTS or events.t[0] == events.t[-1]:
        return Tick(None)
    return tick_of(common_divisor(np.diff(events.t)), intervals)


def tick_of(clock: int, intervals: np.ndarray) -> Tick:
    """The grid of timestamps on a clock of `clock` ns, from (m,) intervals within pixels [ns]."""
    scan = _scan_period(intervals, clock)
    if scan is None:
        return Tick(clock * 1e-9)
    period, concentration = _refine_period(intervals, scan[0]), scan[1]
    near = intervals[(intervals > 0) & (intervals < 1000 * period)]
    residual = near - np.rint(near / period) * period
    jitter = float(np.std(residual) / np.sqrt(2))
    return Tick(clock * 1e-9, period * 1e-9, jitter * 1e-9, concentration)


def common_divisor(nanoseconds: np.ndarray) -> int:
    """The greatest common divisor of times or differences of times [ns]: the clock they were counted with."""
    return int(np.gcd.reduce(nanoseconds))


def _scan_period(intervals: np.ndarray, clock: int) -> tuple[float, float] | None:
    """The period [ns] and concentration of the lowest frequency at which R has a sharp comb, or None."""
    width = clock * max(1, -(-BIN_NS // clock))
    used = intervals[(intervals > 0) & (intervals < BINS * width)]
    if len(used) < MIN_INTERVALS:
        return None
    r = np.abs(np.fft.rfft(np.bincount(used // width, minlength=BINS))) / len(used)
    last = (len(r) - 1) // max(HARMONICS)
    first = max(10, int(BINS * width * 1e-9 / LONGEST_S))
    k = np.arange(first, last)
    combs = k[(r[k] >= 0.7) & (r[k] >= r[k - 1]) & (r[k] >= r[k + 1])]
    for peak in combs[:20_000]:
        between = np.median(r[int(0.6 * peak) : int(0.9 * peak) + 1])
        harmonics = [r[h * peak - h : h * peak + h + 1].max() for h in HARMONICS]
        if between < 0.5 * r[peak] and min(harmonics) >= 0.5 and _count_multiples(used, BINS * width / peak) >= 4:
            return BINS * width / peak, float(r[peak])
    return None


def _count_multiples(intervals: np.ndarray, period: float) -> float:
    """How many different multiples of `period` the intervals take: the inverse of Σ (their shares)²."""
    share = np.bincount(np.rint(intervals / period).astype(np.int64)) / len(intervals)
    return 1 / float(np.sum(share**2))


def _refine_period(intervals: np.ndarray, period: float) -> float:
    """Least squares of τ = n·T over ever longer intervals, as far as the multiple n stays unambiguous."""
    for reach in (10, 30, 100, 300, 1000):
        near = intervals[(intervals > 0) & (intervals < (reach + 0.5) * period)].astype(np.float64)
        n = np.rint(near / period)
        if n.any():
            period = float(np.sum(near * n) / np.sum(n * n))
    return period
