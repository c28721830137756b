"""Global periodic lines: light or readout that makes the whole sensor fire in time.

The events of each polarity, and of both, are counted in fine bins; in their spectrum (Hann taper) a line is a bin
that stands out from the smooth background, the median over neighbouring frequencies: of a stationary process
without lines every bin is exponential about it (Brillinger, Time Series, 1981, ch. 5).  Polarities are looked at
apart as well because a lamp makes them alternate, so that their sum shows twice its frequency.  Harmonics are
joined to their fundamental.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from pixelid.recordings.events import Events

BIN_S = 5e-5
MAX_FREQUENCY_HZ = 2500.0
MAX_BINS = 1 << 22
BINS_PER_EVENT = 128  # 6 ms: with fewer events no lamp shows, and time would go with the span, not with the events
MIN_BINS = 64
MIN_CYCLES = 6
MIN_EVENTS = 200
FALSE_ALARM = 1e-3
REFINE_BINS = 1 << 19
SECOND_BINS = round(1.0 / BIN_S)
PARTS, FULL = 20, 18  # a second is full where 18 of its 20 parts have events
MOST_EMPTY, LEAST_FULL = 0.1, 3  # share of seconds without an event, above which there are gaps; full ones between them


@dataclass(frozen=True)
class Line:
    """One periodic line of the global event rate.

    frequency_hz, uncertainty_hz: the fundamental and its standard deviation
    modulation: amplitude of the fundamental relative to the mean rate, of the polarity, or both, that shows it best
    strength: power over the background
    p_value: chance of a line as strong anywhere in the spectrum
    harmonics_hz: multiples of the fundamental that stand out as well
    """

    frequency_hz: float
    uncertainty_hz: float
    modulation: float
    strength: float
    p_value: float
    harmonics_hz: tuple[float, ...] = ()


class Spectra:
    """Spectra of the ON events, the OFF events and both, in a reading part by part that knows how long it will be.

    Segments as long as memory allows resolve best.  In a recording with gaps their taper lies on nothing, and a line is
    as broad as the stretches are short: there seconds that are full of events count, and nothing else.
    """

    def __init__(self, events: int, first_ns: int, last_ns: int) -> None:
        self._first = first_ns
        bins = int(float(last_ns - first_ns) * 1e-9 / BIN_S) if events >= MIN_EVENTS else 0
        long = bins // max(-(-bins // MAX_BINS), 1)
        dense = bins <= max(MAX_BINS, BINS_PER_EVENT * events)
        self._long = _Segments(bins, long) if long >= MIN_BINS and dense else None
        self._seconds = _Segments(bins, SECOND_BINS, only_full=True) if bins >= 2 * SECOND_BINS else None

    def add(self, events: Events) -> None:
        """Take in events that follow those taken in before."""
        if not len(events):
            return
        index, on = (events.t - self._first) // round(BIN_S * 1e9), events.p == 1
        for segments in (self._long, self._seconds):
            if segments is not None:
                segments.add(index, on)

    def lines(self, tick_s: float | None) -> list[Line]:
        """The lines, strongest first; none above half the frequency of the tick."""
        if self._seconds is not None and self._seconds.lie_between_gaps():
            return self._seconds.lines(tick_s)
        return [] if self._long is None else self._long.lines(tick_s)


class _Segments:
    """Consecutive segments of `length` bins, and the mean of their tapered spectra; of those full of events only, where
    asked for."""

    def __init__(self, bins: int, length: int, only_full: bool = False) -> None:
        self._length, self._whole, self._only_full = length, bins // length, only_full
        self._taper = np.hanning(length).astype(np.float32)
        self._current = 0  # segment that is being counted
        self._counts = [np.zeros(length, np.float32) for _ in range(2)]  # ON, OFF
        self._power = [np.zeros(length // 2 + 1) for _ in range(3)]  # ON, OFF, both
        self._totals = [0, 0]
        self._used, self._empty = 0, 0  # segments
        # of a short recording a line's frequency is refined on the counts themselves
        self._keeps_counts = self._whole == 1 and bins <= REFINE_BINS

    def add(self, index: np.ndarray, on: np.ndarray) -> None:
        """Take in events by their bins (n,), and which of them are ON."""
        begin = 0
        while begin < len(index):
            segment = int(index[begin]) // self._length
            if segment >= self._whole:  # the rest of a division, and what lies behind the last whole bin
                return
            self._advance(segment)
            end = int(np.searchsorted(index, (segment + 1) * self._length))
            inside, these = index[begin:end] - segment * self._length, on[begin:end]
            low = int(inside[0])
            for counts, chosen in zip(self._counts, (these, ~these), strict=True):
                found = np.bincount(inside[chosen] - low)
                counts[low : low + len(found)] += found
            begin = end

    def _next(self) -> None:
        """Take the segment that was counted into the spectra, and begin another."""
        on, off = self._counts
        both = on + off
        full = np.count_nonzero([part.any() for part in np.array_split(both, PARTS)]) >= FULL
        self._empty += not both.any()
        if full or not self._only_full:
            for power, part in zip(self._power, (on, off, both), strict=True):
                if part.any():
                    power += np.abs(np.fft.rfft((part - part.mean()) * self._taper)) ** 2
            self._totals = [total + int(part.sum()) for total, part in zip(self._totals, (on, off), strict=True)]
            self._used += 1
        self._current += 1
        if not self._keeps_counts:
            on[:] = 0
            off[:] = 0

    def _advance(self, segment: int) -> None:
        """Take in what was counted, where that was before `segment`; those between hold nothing."""
        if segment > self._current:
            self._next()
            nothing = segment - self._current
            self._empty += nothing
            self._used += 0 if self._only_full else nothing
            self._current = segment

    def lie_between_gaps(self) -> bool:
        """Whether the recording has gaps of whole segments, and some that are full."""
        self._advance(self._whole)
        return self._empty >= MOST_EMPTY * self._whole and self._used >= LEAST_FULL

    def lines(self, tick_s: float | None) -> list[Line]:
        """The lines, strongest first; none above half the frequency of the tick."""
        self._advance(self._whole)
        if not self._used:
            return []
        resolution = 1 / (self._length * BIN_S)
        ratio, modulation, series = None, None, []
        on, off = self._counts
        for power, total, counts in zip(
            self._power, (*self._totals, sum(self._totals)), (on, off, on + off), strict=True
        ):
            if total < MIN_EVENTS:
                continue
            power = power / self._used
            relative = 2 * np.sqrt(power) / (max(total / (self._used * self._length), 1e-30) * float(self._taper.sum()))
            r = power / _background(power, self._used)
            series.append(counts if self._keeps_counts else None)
            if ratio is None or modulation is None:
                ratio, modulation, best = r, relative, np.zeros(len(r), np.int64)
            else:
                better = r > ratio
                ratio, modulation = np.where(better, r, ratio), np.where(better, relative, modulation)
                best = np.where(better, len(series) - 1, best)
        if ratio is None or modulation is None:
            return []
        last = min(int(MAX_FREQUENCY_HZ / resolution), len(ratio) - 9)
        p = _p_values(ratio, self._used, len(series) * max(last, 1))
        lines = []
        for k in range(MIN_CYCLES, last):
            if p[k] > FALSE_ALARM or ratio[k] < ratio[k - 2 : k + 3].max() or not _narrow(ratio, k):
                continue
            frequency = _refine(series[best[k]], ratio, k, resolution)
            if tick_s and frequency * tick_s > 0.5:
                continue
            uncertainty = np.sqrt(1.5) / np.pi * resolution / np.sqrt(ratio[k] * self._used)
            lines.append(Line(frequency, float(uncertainty), float(modulation[k]), float(ratio[k]), float(p[k])))
        return sorted(map(_sharpen, _group_harmonics(lines, resolution)), key=lambda line: -line.strength)


def _background(power: np.ndarray, segments: int) -> np.ndarray:
    """The smooth part of `power`: medians over blocks that widen with frequency, joined in log-log."""
    from scipy.stats import gamma

    edges = [2]
    while edges[-1] < len(power) - 1:
        edges.append(edges[-1] + max(16, edges[-1] // 5))
    edges[-1] = len(power)
    blocks = [np.arange(a, b) for a, b in pairwise(edges) if b > a]
    centre = np.log([block.mean() for block in blocks])
    median = gamma.median(segments) / segments
    level = np.log([max(float(np.median(power[block])), 1e-12) / median for block in blocks])
    k = np.log(np.maximum(np.arange(len(power)), 1))
    smooth = np.interp(k, centre, level)
    if len(level) > 1:
        slope = min(0.0, (level[1] - level[0]) / (centre[1] - centre[0]))
        smooth = np.where(k < centre[0], level[0] + slope * (k - centre[0]), smooth)
    return np.exp(smooth)


def _p_values(ratio: np.ndarray, segments: int, looked_at: int) -> np.ndarray:
    """Chance of `ratio` in any of `looked_at` bins: the mean of `segments` exponentials is gamma distributed."""
    from scipy.stats import gamma

    return np.minimum(gamma.sf(ratio * segments, segments) * looked_at, 1.0)


def _narrow(ratio: np.ndarray, k: int) -> bool:
    """Whether bin k stands out from the bins next to the taper's main lobe, on both sides."""
    sides = ratio[max(k - 8, 1) : k - 2], ratio[k + 3 : k + 9]
    return all(len(side) > 0 and ratio[k] > 8 * side.mean() for side in sides)


def _refine(counts: np.ndarray | None, ratio: np.ndarray, k: int, resolution: float) -> float:
    """The frequency [Hz] of the peak at bin k: the maximum of the tapered Fourier sum of counts, else of a parabola."""
    if counts is not None:
        from scipy.optimize import minimize_scalar

        kept = np.flatnonzero(counts)
        weight = counts[kept] * (0.5 - 0.5 * np.cos(2 * np.pi * kept / (len(counts) - 1)))
        time = kept * BIN_S

        def minus_power(f: float) -> float:
            return -float(np.abs(np.sum(weight * np.exp(-2j * np.pi * f * time))))

        bounds = ((k - 1) * resolution, (k + 1) * resolution)
        return float(
            minimize_scalar(minus_power, bounds=bounds, method="bounded", options={"xatol": 1e-4 * resolution}).x
        )
    a, b, c = np.log(ratio[k - 1 : k + 2])
    return float((k + 0.5 * (a - c) / (a - 2 * b + c)) * resolution)


def _group_harmonics(lines: list[Line], resolution: float) -> list[Line]:
    """Lines in ascending frequency with harmonics joined; one much stronger than its fundamental stays apart."""
    kept: list[Line] = []
    for line in lines:
        for j, base in enumerate(kept):
            n = round(line.frequency_hz / base.frequency_hz)
            near = abs(line.frequency_hz - n * base.frequency_hz) < (1 + 0.1 * n) * resolution
            if n >= 2 and near and line.strength < 10 * base.strength:
                kept[j] = replace(base, harmonics_hz=(*base.harmonics_hz, line.frequency_hz))
                break
        else:
            kept.append(line)
    return kept


def _sharpen(line: Line) -> Line:
    """The line with its fundamental from the harmonics as well: the mean of fₙ/n with weight n²."""
    frequency = np.array([line.frequency_hz, *line.harmonics_hz])
    n = np.rint(frequency / line.frequency_hz)
    mean = float(np.sum(n * frequency) / np.sum(n * n))
    scatter = np.sqrt(np.mean((frequency - n * mean) ** 2) / np.sum(n * n))
    uncertainty = max(line.uncertainty_hz / np.sqrt(np.sum(n * n)), scatter)
    return replace(line, frequency_hz=mean, uncertainty_hz=float(uncertainty))
