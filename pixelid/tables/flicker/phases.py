"""Events under periodic light as a table over phase: where the last event reset the pixel, and where the next one came.

The reference of the comparator is the level at the last event, so for light of one frequency all that matters about the
past is the phase of that event.  Counts and seconds of exposure per (phase of reset, phase now) say everything.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pixelid.errors import InputError
from pixelid.recordings.events import Events

# A light of four thresholds moves by 0.1 of one from bin to bin, less than the noise of a comparator; 32 bins took
# 5 % off an amplitude of two, seven of its errors
BINS = 128
COARSE = 32  # where searches start: a sixteenth of the cost
SLICE_S = 0.1
QUIET = 1.3  # of the 20th percentile of rates: more is motion
PERIODS = 2.0  # of the light in a slice at least, or its own phases would be taken for motion
FEW = 10.0  # events of a slice below which an empty one is chance (5e-5), and above which it is a gap
LONGEST_S = 1e6  # a week and a half
WITHIN = 0.02  # of the expected frequency
MOST_EVENTS = 100_000  # that a frequency is sought with: a second's work
GRID = 60  # steps of a grid, a third of what a stretch tells apart
NARROWER = 5.0  # the next grid, for stretches so much longer
FOLDS = 10
LOCK_CHANCE = 1e-3  # of a power as large among all frequencies tried, without a light


@dataclass(frozen=True)
class PhaseTable:
    """on, off: (BINS, BINS) events by (phase of reset, phase now);  exposure: (BINS, BINS) seconds;  pixels, events"""

    on: np.ndarray
    off: np.ndarray
    exposure: np.ndarray
    pixels: int
    events: int


@dataclass(frozen=True)
class Lock:
    """The frequency that events lock to best, its standard error, and whether there is a light of that frequency."""

    frequency_hz: float
    error_hz: float
    sure: bool


def quiet_windows(events: Events, near_hz: float) -> list[tuple[float, float]]:
    """Windows [s] whose event rate is at most `QUIET` times the 20th percentile: no motion, the light alone.

    Slices without an event are gaps of the recording, unless events are so few that there would be such slices anyway.

    Raises InputError for recordings shorter than ten slices, or longer than `LONGEST_S`.
    """
    length = max(SLICE_S, PERIODS / near_hz)
    t = events.t * 1e-9
    if events.duration_s > LONGEST_S:
        raise InputError(
            f"flicker: expected at most {LONGEST_S:g} s of events, found {events.duration_s:g} s; is one timestamp off?"
        )
    count = int((t[-1] - t[0]) / length) if len(t) else 0
    if count < 10:
        raise InputError(f"flicker: expected at least {10 * length:g} s of events, found {events.duration_s:g} s")
    edges = t[0] + length * np.arange(count + 1)
    rate = np.histogram(t, edges)[0]
    usual = np.percentile(rate[rate > 0], 20)
    quiet = np.append((rate <= QUIET * usual) & ((rate > 0) | (usual < FEW)), False)
    starts = np.flatnonzero(quiet & ~np.append(False, quiet[:-1]))
    return [(float(edges[k]), float(edges[k + np.argmin(quiet[k:])])) for k in starts]


def locked_frequency(events: Events, near_hz: float, windows: list[tuple[float, float]]) -> Lock:
    """The frequency within 2 % of `near_hz` that ON and OFF events lock to best, and whether they do.

    Powers of short stretches are added first, which a coarse grid resolves; then stretches grow and the grid narrows,
    until one stretch is the whole.  The error is a jackknife over tenths of the pixels, or of the time where there are
    fewer than ten pixels.
    """
    t = events.t * 1e-9
    inside = np.zeros(len(t), bool)
    for a, b in windows:
        inside |= (t >= a) & (t < b)
    inside[inside] = np.arange(inside.sum()) % max(int(inside.sum()) // MOST_EVENTS, 1) == 0
    if not inside.any():
        return Lock(near_hz, np.inf, False)
    t, sign = t[inside], np.where(events.p[inside] == 1, 1.0, -1.0)
    rank = np.unique(events.pixel[inside], return_inverse=True)[1]
    clock, span = t - t.mean(), float(np.ptp(t))
    around, width, within = near_hz, WITHIN * near_hz, True
    while True:
        length = min(GRID / (6.0 * width), span) if span > 0 else 1.0
        stretch = np.minimum(((t - t[0]) / length).astype(np.int64), max(int(span / length) - 1, 0))
        around, powers, inner = _peak(clock, sign, stretch, around, width)
        within &= inner
        if length >= span:
            break
        width /= NARROWER
    folds = rank % FOLDS if rank.max() + 1 >= FOLDS else np.arange(len(t)) * FOLDS // len(t)
    without = [
        _peak(clock[folds != k], sign[folds != k], stretch[folds != k], around, width)[0]
        for k in np.unique(folds)
        if (folds != k).any()
    ]
    n, spread = len(without), np.sum((np.array(without) - np.mean(without)) ** 2) if without else np.inf
    error = float(np.sqrt((n - 1) / n * spread)) if n > 1 else np.inf
    tried = max(2.0 * WITHIN * near_hz * span, 1.0)  # frequencies that the span tells apart
    aside = near_hz * np.concatenate([np.linspace(0.7, 0.93, 101), np.linspace(1.07, 1.3, 101)])
    noise = float(np.median(_powers(clock, sign, stretch, aside)))  # of its powers, exponentially distributed, half
    chance = tried * 0.5 ** (powers.max() / max(noise, 1e-300))
    within &= abs(around - near_hz) <= WITHIN * near_hz
    return Lock(around, error, bool(within and chance < LOCK_CHANCE))


def _powers(clock, sign, stretch, frequencies: np.ndarray) -> np.ndarray:
    """(f,) powers of ON less OFF events at frequencies [Hz], summed over stretches."""
    powers = np.empty(len(frequencies))
    for i, f in enumerate(frequencies):
        wave = sign * np.exp(2j * np.pi * f * clock)
        powers[i] = np.sum(np.bincount(stretch, wave.real) ** 2 + np.bincount(stretch, wave.imag) ** 2)
    return powers


def _peak(clock, sign, stretch, around: float, width: float) -> tuple[float, np.ndarray, bool]:
    """(frequency of the largest power on a grid about one, the powers, whether it is inside the grid)."""
    grid = np.linspace(around - width, around + width, GRID + 1)
    powers = _powers(clock, sign, stretch, grid)
    k = int(powers.argmax())
    if k in (0, GRID):
        return float(grid[k]), powers, False
    a, b, c = np.sqrt(powers[k - 1 : k + 2])
    shift = 0.5 * (a - c) / (a - 2 * b + c) if a - 2 * b + c < 0 else 0.0
    return float(grid[k] + (grid[1] - grid[0]) * np.clip(shift, -1.0, 1.0)), powers, True


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
        exposure += _cycles_before(a, until - np.floor(begin)) - _cycles_before(a, begin - np.floor(begin))
        used += int(ends.sum())
    return PhaseTable(counts[1], counts[0], exposure / frequency_hz, len(np.unique(pixel)), used)


def coarse(table: PhaseTable) -> PhaseTable:
    """The table in `COARSE` bins."""
    blocks = (COARSE, BINS // COARSE) * 2
    on, off, exposure = (cells.reshape(blocks).sum((1, 3)) for cells in (table.on, table.off, table.exposure))
    return PhaseTable(on, off, exposure, table.pixels, table.events)


def _cycles_before(row: np.ndarray, end: np.ndarray) -> np.ndarray:
    """(BINS, BINS) cycles by (row, phase) of intervals that begin at phase 0.

    Args:
        row: (n,) of each interval.
        end: (n,) where it ends, in cycles.
    """
    whole = np.floor(end * BINS).astype(np.int64)
    last = whole % BINS
    ends = np.bincount(row * BINS + last, minlength=BINS**2).reshape(BINS, BINS)
    part = np.bincount(row * BINS + last, end * BINS - whole, BINS**2).reshape(BINS, BINS)
    rounds = np.bincount(row, whole // BINS, BINS)[:, None]
    beyond = ends[:, ::-1].cumsum(1)[:, ::-1] - ends  # intervals whose last bin is a later one
    return (rounds + beyond + part) / BINS


def _bin(cycles: np.ndarray) -> np.ndarray:
    return np.floor((cycles % 1.0) * BINS).astype(int) % BINS
