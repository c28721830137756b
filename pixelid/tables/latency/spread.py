"""First events of a region's pixels: order statistics of a known number of them, and scatter from edge to edge.

A pixel fires when the change reaches its level, and is heard of a delay later:

    t = T(C + s z) + b exp(σ_b ζ),   z, ζ standard normal,   s² = (σ_m C)² + (σ_e C)² + σ_shot²

T the time at which the change reaches a level, σ_m the mismatch of thresholds, σ_e their noise from event to event.
z and ζ run over a grid; its nodes in order of their latency are the distribution.  Nodes whose level is never reached
do not fire and drop out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pixelid.tables.latency.steps import TIMES_S

LEVELS = np.linspace(-3.6, 3.6, 21)  # ±3.6 σ holds the extremes of 1000 pixels
DELAYS = np.linspace(-2.8, 2.8, 7)
_MASS = (np.exp(-0.5 * LEVELS**2)[:, None] * np.exp(-0.5 * DELAYS**2)).ravel()
MASS = _MASS / _MASS.sum()


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
    level = C[:, None] + s[:, None] * LEVELS
    crossing = np.empty_like(level)
    for k, step in enumerate(regions.step):
        crossing[k] = np.interp(level[k], changes[step], TIMES_S, right=np.inf)
    factor = np.exp(spread.delay * DELAYS)
    t = (crossing[:, :, None] + regions.delay[:, None, None] * factor).reshape(len(C), -1)
    order = np.argsort(t, axis=1)
    t = np.take_along_axis(t, order, axis=1)
    weight = np.where(np.isfinite(t), MASS[order], 0.0)
    fired = weight.sum(axis=1)
    silent = fired < 1e-9
    weight /= np.where(silent, 1.0, fired)[:, None]
    t = np.where(np.isfinite(t), t, 0.0)
    after = np.cumsum(weight, axis=1)
    before = after - weight
    n = regions.pixels[:, None]
    mean = (weight * t).sum(axis=1)
    variance = (weight * (t - mean[:, None]) ** 2).sum(axis=1)
    found = {
        "median": _medians(0.5 * (before + after), t),
        "min": (((1.0 - before).clip(0) ** n - (1.0 - after).clip(0) ** n) * t).sum(axis=1),
        "max": ((after**n - before.clip(0) ** n) * t).sum(axis=1),
        "sd": np.sqrt(variance),
        "stdev": np.sqrt(_event_variance(crossing, between_events / s**2) / regions.pixels + spread.edge**2),
    }
    return {name: np.where(silent, TIMES_S[-1], values) for name, values in found.items()}


def _event_variance(crossing: np.ndarray, share: np.ndarray) -> np.ndarray:
    """(rows,) variance of a pixel's latency from event to event: its share of the levels' variance."""
    weight = np.exp(-0.5 * LEVELS**2) * np.isfinite(crossing)
    weight = weight / np.maximum(weight.sum(axis=1), 1e-300)[:, None]
    t = np.where(np.isfinite(crossing), crossing, 0.0)
    mean = (weight * t).sum(axis=1)
    return share * (weight * (t - mean[:, None]) ** 2).sum(axis=1)


def _medians(middle: np.ndarray, t: np.ndarray) -> np.ndarray:
    """(rows,) where the cumulative mass (rows, nodes) passes one half."""
    k = np.clip((middle < 0.5).sum(axis=1), 1, middle.shape[1] - 1)
    rows = np.arange(len(t))
    low, high = middle[rows, k - 1], middle[rows, k]
    share = np.clip((0.5 - low) / np.maximum(high - low, 1e-300), 0.0, 1.0)
    return t[rows, k - 1] + share * (t[rows, k] - t[rows, k - 1])
