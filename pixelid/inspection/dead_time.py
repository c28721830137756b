"""The dead time: the edge below which a pixel has no intervals.

A pixel that never rests has intervals down to zero (a Poisson process: as many in [0, d] as in [d, 2d]).  A dead
time d removes those below d; a few remain where an event carries a wrong address or time.  The estimate walks up
the sorted intervals and stops at the first that

1. begins a crowd: the next few follow far closer than the density of those below would allow (Poisson tail), so
   that isolated short intervals, the contamination, are passed over;
2. is an edge: far more intervals lie between it and 1.5 times it than below it, more than any number growing
   slower than the cube of the interval would give (binomial tail);
3. where some intervals lie below: is sharp, the density just above it ten times that below.  The slow onset that
   regular firing gives to the intervals is not sharp;
4. is full at once, or rises to a plateau, or lies far below the median interval: otherwise it is the lower end
   of regular firing.

An edge that rises to a plateau is a sharp one blurred by jitter of the timestamps, which leaves its half height
in place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

FEWEST = 50
CONTAMINATION = 0.01
CROWD = 4
CROWD_LEVEL = 2e-4
ABOVE = 1.5
CLOSE = 1.05
SLOWEST_GROWTH = 3.0
SHARP = 10.0
BROAD = 5.0
COARSE = 0.02
WIDEST_BLUR = 1.3
EDGE_LEVEL = 5e-4


@dataclass(frozen=True)
class DeadTime:
    """The dead time and how well it is known; `value_s` is None when no edge is visible, and `reason` says why.

    interval_95_s: bounds of the value, from the density of intervals at the edge and the tick
    below, above: intervals shorter than the edge, and between the edge and 1.5 times it
    """

    value_s: float | None
    interval_95_s: tuple[float, float] | None
    reason: str
    intervals: int
    below: int = 0
    above: int = 0


def find_dead_time(intervals: np.ndarray, tick_s: float | None) -> DeadTime:
    """The dead time behind (m,) `intervals` within pixels [ns], timestamps lying on a grid of `tick_s`.

    The edge of the intervals bounds the dead time from above; it is the dead time itself when some pixels are
    driven hard enough to fire as soon as they can.  Under one deterministic full-field stimulus it may instead be
    the interval at the steepest slope: only a fit with the stimulus tells these apart.
    """
    n, tick = len(intervals), (tick_s or 1e-9) * 1e9
    if n < FEWEST:
        return DeadTime(None, None, f"{n} intervals within pixels, at least {FEWEST} needed", n)
    # Ties hide the density, so each interval is spread over its tick.
    x = np.sort(np.maximum(intervals + np.random.default_rng(0).uniform(-0.5, 0.5, n) * tick, 1e-3 * tick))
    i = _edge(x)
    if i is None:
        return DeadTime(None, None, "intervals thin out towards zero without an edge", n)
    edge = float(x[i])
    above = int(np.searchsorted(x, ABOVE * edge)) - i
    close = int(np.searchsorted(x, CLOSE * edge)) - i
    counted = {"intervals": n, "below": i, "above": above}
    if int(edge / tick + 0.5) <= 1:
        return DeadTime(None, None, f"intervals reach down to one tick of {tick * 1e-3:g} µs", **counted)
    full = close / (CLOSE - 1) >= 0.5 * above / (ABOVE - 1)
    blurred = None if full or tick > COARSE * edge else _half_height(x, edge)
    if not full and blurred is None and x[n // 2] < BROAD * edge:
        return DeadTime(None, None, "intervals are regular: their lower end follows the rate", **counted)
    if blurred is not None:
        value, low, high = blurred
    elif tick > COARSE * edge:
        value, low, high = _between_ticks(intervals, int(edge / tick + 0.5), tick)
    else:
        # A constant density above the edge puts the first interval an exponential distance beyond it.
        step = (float(x[min(i + 9, n - 1)]) - edge) / 9
        value, low, high = edge - np.log(2) * step, edge - 3.7 * step - tick, edge + tick
    return DeadTime(float(value * 1e-9), (float(low * 1e-9), float(high * 1e-9)), "", **counted)


def _edge(x: np.ndarray) -> int | None:
    """Index of the first of the sorted intervals `x` that begins a crowd and is an edge of them all."""
    from scipy.stats import binom, poisson

    i = np.arange(min(int(CONTAMINATION * len(x)) + 3, len(x) - 1))
    crowd = CROWD + i // 8
    i = i[i + crowd < len(x)]
    crowd = crowd[: len(i)]
    expected = (i + 1) * (x[i + crowd] / x[i] - 1)
    i = i[poisson.sf(crowd - 1, expected) < CROWD_LEVEL / (1 + i / 3)]
    above = np.searchsorted(x, ABOVE * x[i]) - i
    close = np.searchsorted(x, CLOSE * x[i]) - i
    edge = binom.cdf(i, i + above, ABOVE**-SLOWEST_GROWTH) < EDGE_LEVEL
    sharp = binom.cdf(i, i + close, 1 / (1 + SHARP * (CLOSE - 1))) < EDGE_LEVEL
    edges = i[edge & ((i == 0) | sharp)]
    if not len(edges):
        return None
    return int(edges[0]) if edges[0] == 0 else _change(x, int(edges[0]))


def _change(x: np.ndarray, first: int) -> int:
    """The index from `first` to 5 % above it that best splits the sorted `x` into two constant densities.

    Maximum likelihood of a Poisson process with one change of rate (Akman & Raftery, Ann. Stat. 1986).
    """
    end = (2 * CLOSE - 1) * x[first]
    total = int(np.searchsorted(x, end))
    j = np.arange(first, max(int(np.searchsorted(x, CLOSE * x[first])), first + 1))
    likelihood = j * np.log(j / x[j]) + (total - j) * np.log(np.maximum(total - j, 1) / (end - x[j]))
    return int(j[np.argmax(likelihood)])


def _half_height(x: np.ndarray, edge: float) -> tuple[float, float, float] | None:
    """Where the density above `edge` reaches half its plateau, with bounds; None when it rises slowly or on and on."""
    bins = edge * np.linspace(1, 1.6, 25)
    density = np.diff(np.searchsorted(x, bins)) / np.diff(bins)
    plateau = float(np.median(density[12:]))
    wide = edge * np.geomspace(1, 20, 30)
    if np.max(np.diff(np.searchsorted(x, wide)) / np.diff(wide)) > 1.5 * plateau:
        return None
    rise = np.maximum.accumulate(density)
    half, most = (int(np.argmax(rise >= share * plateau)) for share in (0.5, 0.9))
    if bins[most + 1] > WIDEST_BLUR * edge:
        return None
    return float(0.5 * (bins[half] + bins[half + 1])), edge, float(bins[most + 1])


def _between_ticks(intervals: np.ndarray, level: int, tick: float) -> tuple[float, float, float]:
    """Value and bounds of an edge between two ticks, from how full the lowest level is.

    Rounding both ends of an interval to ticks spreads it over two levels with triangular weight, so that a dead
    time of (level + s) ticks leaves the lowest level (1 − s)²/2 of the number a full level has.
    """
    levels = np.bincount(
        np.rint(intervals[intervals < (level + 5.5) * tick] / tick).astype(np.int64), minlength=level + 5
    )
    full = max(float(np.mean(levels[level + 2 : level + 5])), 1.0)
    s = 1 - np.sqrt(2 * min(levels[level] / full, 0.5))
    return (level + s) * tick, (level - 1) * tick, (level + 1) * tick
