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
MIN_CYCLES = 6
MIN_EVENTS = 200
FALSE_ALARM = 1e-3
REFINE_BINS = 1 << 19


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


def find_lines(events: Events, tick_s: float | None = None) -> list[Line]:
    """The lines of `events` below 2.5 kHz, strongest first; none above half the frequency of the tick."""
    duration = events.duration_s
    if len(events) < MIN_EVENTS or duration <= 0:
        return []
    bins = int(duration / BIN_S)
    segments = -(-bins // MAX_BINS)
    length = bins // segments
    if length < 64:
        return []
    resolution = 1 / (length * BIN_S)
    ratio, modulation, series = None, None, []
    apart = [_counts(events, polarity, bins) for polarity in (1, 0)]
    for counts in (*apart, apart[0] + apart[1]):
        if counts.sum() < MIN_EVENTS:
            continue
        power, relative = _spectrum(counts, segments, length)
        r = power / _background(power, segments)
        series.append(counts)
        if ratio is None or modulation is None:
            ratio, modulation, best = r, relative, np.zeros(len(r), np.int64)
        else:
            better = r > ratio
            ratio, modulation = np.where(better, r, ratio), np.where(better, relative, modulation)
            best = np.where(better, len(series) - 1, best)
    if ratio is None or modulation is None:
        return []
    last = min(int(MAX_FREQUENCY_HZ / resolution), len(ratio) - 9)
    p = _p_values(ratio, segments, len(series) * max(last, 1))
    lines = []
    for k in range(MIN_CYCLES, last):
        if p[k] > FALSE_ALARM or ratio[k] < ratio[k - 2 : k + 3].max() or not _narrow(ratio, k):
            continue
        frequency = _refine(series[best[k]], segments, ratio, k, resolution)
        if tick_s and frequency * tick_s > 0.5:
            continue
        uncertainty = np.sqrt(1.5) / np.pi * resolution / np.sqrt(ratio[k] * segments)
        lines.append(Line(frequency, float(uncertainty), float(modulation[k]), float(ratio[k]), float(p[k])))
    return sorted(map(_sharpen, _group_harmonics(lines, resolution)), key=lambda line: -line.strength)


def _counts(events: Events, polarity: int, bins: int) -> np.ndarray:
    """(bins,) events of one polarity per BIN_S from the first event on."""
    index = (events.t - events.t[0]) // round(BIN_S * 1e9)
    return np.bincount(index[(events.p == polarity) & (index < bins)], minlength=bins).astype(np.float32)


def _spectrum(counts: np.ndarray, segments: int, length: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean power of the segments, and amplitude relative to the mean rate, per frequency."""
    taper = np.hanning(length).astype(np.float32)
    power = np.zeros(length // 2 + 1)
    for s in range(segments):
        part = counts[s * length : (s + 1) * length]
        power += np.abs(np.fft.rfft((part - part.mean()) * taper)) ** 2
    power /= segments
    return power, 2 * np.sqrt(power) / (max(float(counts.mean()), 1e-30) * float(taper.sum()))


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
    """Whether bin k stands out from the bins beside the taper's main lobe, on both sides."""
    sides = ratio[max(k - 8, 1) : k - 2], ratio[k + 3 : k + 9]
    return all(len(side) > 0 and ratio[k] > 8 * side.mean() for side in sides)


def _refine(counts: np.ndarray, segments: int, ratio: np.ndarray, k: int, resolution: float) -> float:
    """The frequency [Hz] of the peak at bin k: the maximum of the tapered Fourier sum, else of a log parabola."""
    if segments == 1 and len(counts) <= REFINE_BINS:
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
