"""First events of a region's pixels: order statistics of a known number of them, and scatter from edge to edge.

A pixel fires when the change reaches its level, and is heard of a delay later:

    t = T(C + s z) + b exp(σ_b ζ),   z, ζ standard normal,   s² = (σ_m C)² + (σ_e C)² + σ_shot²

T the time at which the change reaches a level, σ_m the mismatch of thresholds, σ_e their noise from event to event.
z and ζ run over a grid; its nodes in order of their latency are the distribution.  Pixels whose level is never reached
do not fire and drop out: the grid of z ends where the change does, so that all statistics are smooth in the circuit's
numbers, as fits need them (a fixed grid, whose nodes drop out one by one, made latencies jump by up to 30 %).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.special import ndtr

from pixelid.tables.latency.steps import TIMES_S

NODES, OUTERMOST = 21, 3.8  # of z; ±3.8 σ holds the extremes of 1000 pixels
NEAR, CLOSE, MOST_ROUNDS = 1.2, 1e-12, 60  # of the brackets of a median, a ratio and relative
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
    crossing = _crossings(level, changes, regions.step, TIMES_S)
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
    after, n = np.cumsum(weight, axis=1), regions.pixels[:, None]
    earliest = -np.diff((1.0 - after).clip(0) ** n, axis=1, prepend=1.0)  # chance that the first of n is there
    latest = np.diff(after**n, axis=1, prepend=0.0**n)
    mean = (weight * t).sum(axis=1)
    variance = (weight * (t - mean[:, None]) ** 2).sum(axis=1)
    found = {
        "median": _medians(changes, regions.step, TIMES_S, C, s, delays, DELAY_MASS, 0.5 * ndtr(highest)),
        "min": (earliest * t).sum(axis=1),
        "max": (latest * t).sum(axis=1),
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


@njit(cache=True, nogil=True, error_model="numpy")
def _crossings(level, changes, step, times):
    """(rows, nodes) when the change of each row's step reaches each level; inf: never."""
    crossing = np.empty_like(level)
    for row in range(len(level)):
        change = changes[step[row]]
        for node in range(level.shape[1]):
            wanted = level[row, node]
            k = np.searchsorted(change, wanted, side="right") - 1
            if wanted > change[-1]:
                crossing[row, node] = np.inf
            elif k < 0 or k == len(change) - 1:
                crossing[row, node] = times[k] if k > 0 else times[0]
            else:
                part = (wanted - change[k]) / (change[k + 1] - change[k])
                crossing[row, node] = times[k] + part * (times[k + 1] - times[k])
    return crossing


@njit(cache=True, nogil=True, error_model="numpy")
def _fired(t, change, times, threshold, s, delays, mass):
    """Share of the pixels that have fired by time t: Φ((c(t − b) − C)/s) of those of delay b, c the change."""
    share = 0.0
    for j in range(len(delays)):
        since = min(t - delays[j], times[-1])
        if since <= 0.0:
            continue
        k = min(np.searchsorted(times, since, side="right") - 1, len(times) - 2)
        come = change[k] + (change[k + 1] - change[k]) * (since - times[k]) / (times[k + 1] - times[k])
        share += mass[j] * 0.5 * math.erfc((threshold - come) / (s * math.sqrt(2.0)))
    return share


@njit(cache=True, nogil=True, error_model="numpy")
def _medians(changes, step, times, threshold, s, delays, mass, half):
    """(rows,) seconds by which `half` (rows,) of the pixels have fired.

    A root, bracketed by halving and then taken by regula falsi, the end that stays counted half (Illinois; Dowell &
    Jarratt 1971, BIT 11, 168).
    """
    medians = np.empty(len(threshold))
    for row in range(len(threshold)):
        change, own = changes[step[row]], delays[row]
        low, high = times[1], times[-1] + own.max()
        missing_low = half[row] - _fired(low, change, times, threshold[row], s[row], own, mass)
        missing_high = half[row] - _fired(high, change, times, threshold[row], s[row], own, mass)
        if missing_low <= 0.0 or missing_high >= 0.0:
            medians[row] = low if missing_low <= 0.0 else high
            continue
        last = 0
        for _ in range(MOST_ROUNDS):
            falsi = high < NEAR * low
            t = low + (high - low) * missing_low / (missing_low - missing_high) if falsi else math.sqrt(low * high)
            missing = half[row] - _fired(t, change, times, threshold[row], s[row], own, mass)
            if missing > 0.0:
                low, missing_low = t, missing
                missing_high *= 0.5 if falsi and last == 1 else 1.0
                last = 1
            else:
                high, missing_high = t, missing
                missing_low *= 0.5 if falsi and last == -1 else 1.0
                last = -1
            if high - low < CLOSE * high or missing == 0.0:
                break
        medians[row] = t
    return medians
