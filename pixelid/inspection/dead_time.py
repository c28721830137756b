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

**Edge and dead time.**  A pixel that follows the light fires again when its signal has crossed the next threshold: its
shortest interval is the dead time *plus* the shortest such crossing, so the edge alone bounds it from above.
It is the dead time itself where events come at random as soon as they can.  Then what successive intervals exceed the
dead time d by, x and y, are independent exponentials of one rate, and u = (x − y)/(x + y) is uniform on [−1, 1]
whatever that rate is, also given x + y.  Intervals that follow a signal resemble their neighbours (u near 0) or
alternate (u near ±1).  Only where u is uniform at every x + y is the edge called a measurement.  (The same idea, as one
number, is the local variation with refractoriness of Shinomoto et al., PLoS Comput. Biol. 5, 2009.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

MIN_INTERVALS = 50
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
PAIR_SUMS = (2.0, 2.5, 3.0, 4.0, 6.0)  # bands of the sum of two intervals, in edges; beyond, the rate varies meanwhile
MIN_PAIRS, MIN_PAIRS_OF_BAND = 200, 40  # fewer leave a deviation of 0.1 in the distribution of u unseen
# Kolmogorov–Smirnov: 1 in 10⁴ of random pixels fails a band; ticks and rates that vary bend u by no more than 0.04
PAIR_LEVEL, PAIR_TOLERANCE = 2.2, 0.04


@dataclass(frozen=True)
class DeadTime:
    """The dead time and how well it is known.

    Attributes:
        value_s: the lower edge of the intervals; None when no edge is visible, and `reason` says why.
        interval_95_s: what holds the dead time: about `value_s` where it is measured, from 0 where it is bounded.
        reason: why nothing is visible, or why the edge is a bound only.
        intervals: how many were looked at.
        below, above: intervals shorter than the edge, and between the edge and 1.5 times it.
        kind: "measured", "upper_bound", or None where nothing is known.
        edge_95_s: interval of the edge itself, from the density of intervals there and the tick.
    """

    value_s: float | None
    interval_95_s: tuple[float, float] | None
    reason: str
    intervals: int
    below: int = 0
    above: int = 0
    kind: str | None = None
    edge_95_s: tuple[float, float] | None = None


def find_dead_time(intervals: np.ndarray, tick_s: float | None, pairs: np.ndarray | None = None) -> DeadTime:
    """The dead time behind intervals within pixels, timestamps lying on a grid of `tick_s`.

    Args:
        intervals: (m,) intervals within pixels [ns].
        tick_s: grid of the timestamps.
        pairs: (k, 2) successive intervals of one pixel [ns]; without them the edge is an upper bound.

    Returns:
        The edge, and whether it is the dead time or bounds it.
    """
    n, tick = len(intervals), (tick_s or 1e-9) * 1e9
    if n < MIN_INTERVALS:
        return DeadTime(None, None, f"{n} intervals within pixels, at least {MIN_INTERVALS} needed", n)
    # Ties hide the density, so each interval is spread over its tick.
    x = np.sort(np.maximum(intervals + np.random.default_rng(0).uniform(-0.5, 0.5, n) * tick, 1e-3 * tick))
    i = _edge(x)
    if i is None:
        return DeadTime(None, None, "intervals thin out towards zero without an edge", n)
    edge = float(x[i])
    above = int(np.searchsorted(x, ABOVE * edge)) - i
    close = int(np.searchsorted(x, CLOSE * edge)) - i
    if int(edge / tick + 0.5) <= 1:
        return DeadTime(None, None, f"intervals reach down to one tick of {tick * 1e-3:g} µs", n, i, above)
    full = close / (CLOSE - 1) >= 0.5 * above / (ABOVE - 1)
    blurred = None if full or tick > COARSE * edge else _half_height(x, edge)
    if not full and blurred is None and x[n // 2] < BROAD * edge:
        reason = "intervals are regular: their lower end follows the rate"
        return DeadTime(None, (0.0, (edge + tick) * 1e-9), reason, n, i, above, kind="upper_bound")
    if blurred is not None:
        value, low, high = blurred
    elif tick > COARSE * edge:
        value, low, high = _between_ticks(intervals, int(edge / tick + 0.5), tick)
    else:
        # A constant density above the edge puts the first interval an exponential distance beyond it.
        step = (float(x[min(i + 9, n - 1)]) - edge) / 9
        value, low, high = edge - np.log(2) * step, edge - 3.7 * step - tick, edge + tick
    bounds = (float(low * 1e-9), float(high * 1e-9))
    why_not = "the order of the intervals is not known" if pairs is None else _why_driven(pairs, value, tick)
    if why_not:
        return DeadTime(
            float(value * 1e-9), (0.0, bounds[1]), why_not, n, i, above, kind="upper_bound", edge_95_s=bounds
        )
    return DeadTime(float(value * 1e-9), bounds, "", n, i, above, kind="measured", edge_95_s=bounds)


def _why_driven(pairs: np.ndarray, edge: float, tick: float) -> str:
    """Why the edge may lie above the dead time; empty where successive intervals are those of random events."""
    spread = np.random.default_rng(1).uniform(-0.5, 0.5, pairs.shape) * tick
    excess = pairs + spread - edge
    excess = excess[(excess > 0).all(axis=1)]
    total = excess.sum(axis=1)
    u = (excess[:, 0] - excess[:, 1]) / total
    band = np.digitize(total / edge + 2.0, PAIR_SUMS)
    inside = [np.sort(u[band == k]) for k in range(1, len(PAIR_SUMS))]
    if sum(map(len, inside)) < MIN_PAIRS:
        return "too few successive short intervals show whether pixels fire at random or follow the light"
    for v in inside:
        if len(v) < MIN_PAIRS_OF_BAND:
            continue
        rank = np.arange(1, len(v) + 1) / len(v)
        distance = float(np.maximum(np.abs(rank - 0.5 * (v + 1)), np.abs(rank - 1 / len(v) - 0.5 * (v + 1))).max())
        if distance > PAIR_LEVEL / np.sqrt(len(v)) + PAIR_TOLERANCE:
            return "pixels follow the light: the dead time plus the time to the next threshold"
    return ""


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
