"""First events of a region's pixels: order statistics of a known number of them, and scatter from edge to edge.

A pixel fires when the change reaches its level, and is heard of a delay later:

    t = T(C + s z) + b exp(σ_b ζ),   z, ζ standard normal,   s² = (σ_m C)² + (σ_e C)² + σ_shot²

T the time at which the change reaches a level, σ_m the mismatch of thresholds, σ_e their noise from event to event.
z and ζ run over a grid; its nodes in order of their latency are the distribution.  Pixels whose level is never reached
do not fire and drop out: the grid of z ends where the change does, so that all statistics are smooth in the circuit's
numbers, as fits need them (a fixed grid, whose nodes drop out one by one, made latencies jump by up to 30 %).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from pixelid.tables.latency.steps import TIMES_S

NODES, OUTERMOST = 21, 3.8  # of z; ±3.8 σ holds the extremes of 1000 pixels
HALVINGS = 20
LEAST = 1e-9  # share of pixels; with fewer that fire, none does
DELAYS = np.linspace(-2.8, 2.8, 7)
_OF_DELAYS = np.exp(-0.5 * DELAYS**2)
DELAY_MASS = _OF_DELAYS / _OF_DELAYS.sum()


@dataclass(frozen=True)
class Regions:
    """Regions of interest after an edge of the light, one value per row.

    step: which row of `steps.changes` drives it;  threshold: log radiance;  delay: s, from crossing to time stamp
    shot: noise of the output, log radiance;  pixels: how many fired
    """

    step: np.ndarray
    threshold: np.ndarray
    delay: np.ndarray
    shot: np.ndarray
    pixels: np.ndarray


@dataclass(frozen=True)
class Spread:
    """Relative mismatch and noise of thresholds, log spread of delays over pixels, jitter of the edges [s]."""

    mismatch: float
    noise: float
    delay: float
    edge: float


def statistics(changes: np.ndarray, regions: Regions, spread: Spread) -> dict[str, np.ndarray]:
    """Statistic → (rows,) seconds, names as in `reading.STATISTICS`; the last time of the grid where nothing fires.

    Args:
        changes: (steps, times) of `steps.changes`.
        regions: what is measured where.
        spread: of pixels and events.
    """
    C = regions.threshold
    between_events = (spread.noise * C) ** 2 + regions.shot**2
    s = np.sqrt((spread.mismatch * C) ** 2 + between_events + 1e-24)
    highest = (changes[regions.step, -1] - C) / s
    z, mass = _levels(highest)
    level = C[:, None] + s[:, None] * z
    crossing = np.empty_like(level)
    for k, step in enumerate(regions.step):
        crossing[k] = np.interp(level[k], changes[step], TIMES_S, right=np.inf)
    factor = np.exp(spread.delay * DELAYS)
    delays = regions.delay[:, None] * factor
    t = (crossing[:, :, None] + delays[:, None, :]).reshape(len(C), -1)
    order = np.argsort(t, axis=1)
    t = np.take_along_axis(t, order, axis=1)
    both = (mass[:, :, None] * DELAY_MASS).reshape(len(C), -1)
    weight = np.where(np.isfinite(t), np.take_along_axis(both, order, axis=1), 0.0)
    fired = weight.sum(axis=1)
    silent = fired < LEAST
    weight /= np.where(silent, 1.0, fired)[:, None]
    t = np.where(np.isfinite(t), t, 0.0)
    after = np.cumsum(weight, axis=1)
    before = after - weight
    n = regions.pixels[:, None]
    mean = (weight * t).sum(axis=1)
    variance = (weight * (t - mean[:, None]) ** 2).sum(axis=1)
    found = {
        "median": _medians(changes, regions, s, delays, highest),
        "min": (((1.0 - before).clip(0) ** n - (1.0 - after).clip(0) ** n) * t).sum(axis=1),
        "max": ((after**n - before.clip(0) ** n) * t).sum(axis=1),
        "sd": np.sqrt(variance),
        "stdev": np.sqrt(_event_variance(crossing, mass, between_events / s**2) / regions.pixels + spread.edge**2),
    }
    return {name: np.where(silent, TIMES_S[-1], values) for name, values in found.items()}


def _levels(highest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(z, mass), (rows, NODES) each: standard normal levels up to `highest` (rows,) and the share of pixels there."""
    width = np.clip(highest + OUTERMOST, 0.0, 2 * OUTERMOST)[:, None] / NODES
    z = width * (np.arange(NODES) + 0.5) - OUTERMOST
    return z, np.exp(-0.5 * z**2) * width / np.sqrt(2 * np.pi)


def _event_variance(crossing: np.ndarray, mass: np.ndarray, share: np.ndarray) -> np.ndarray:
    """(rows,) variance of a pixel's latency from event to event: its share of the levels' variance."""
    weight = mass * np.isfinite(crossing)
    weight = weight / np.maximum(weight.sum(axis=1), 1e-300)[:, None]
    t = np.where(np.isfinite(crossing), crossing, 0.0)
    mean = (weight * t).sum(axis=1)
    return share * (weight * (t - mean[:, None]) ** 2).sum(axis=1)


def _medians(
    changes: np.ndarray, regions: Regions, s: np.ndarray, delays: np.ndarray, highest: np.ndarray
) -> np.ndarray:
    """(rows,) seconds by which half of the pixels that fire have fired.

    By time t, Φ((c(t − b) − C)/s) of the pixels of delay b have, c the change: a root, bracketed to 2·10⁻⁵ of itself by
    halving and then taken from the chord.  delays: (rows, DELAYS) s;  highest: (rows,) that the change reaches, in s
    """
    wanted, last = 0.5 * ndtr(highest), len(TIMES_S) - 2
    step, threshold = regions.step[:, None], regions.threshold[:, None]

    def missing(t: np.ndarray) -> np.ndarray:
        since = np.clip(t[:, None] - delays, 0.0, TIMES_S[-1])
        k = np.clip(np.searchsorted(TIMES_S, since, side="right") - 1, 0, last)
        before, after = changes[step, k], changes[step, k + 1]
        come = before + (after - before) * (since - TIMES_S[k]) / (TIMES_S[k + 1] - TIMES_S[k])
        share = np.where(t[:, None] > delays, ndtr((come - threshold) / s[:, None]), 0.0)
        return wanted - share @ DELAY_MASS

    low, high = np.full(len(s), TIMES_S[1]), TIMES_S[-1] + delays.max(axis=1)
    for _ in range(HALVINGS):
        middle = np.sqrt(low * high)
        late = missing(middle) < 0
        low, high = np.where(late, low, middle), np.where(late, middle, high)
    at_low, at_high = missing(low), missing(high)
    share = at_low / np.where(at_low > at_high, at_low - at_high, 1.0)
    return low + np.clip(share, 0.0, 1.0) * (high - low)
