"""Events at the end of a silence whose reference stays (`dead_time_without_reset`): an atom of probability.

What the change went through while the comparator was blind is made up for at its end, tq: the pixel fires at once with
the probability that the threshold drawn lay below the level there.  Two stamps, of this event and of the one before,
blur the moment, so that an event t seconds after tq has the density

    Φ((z(tq + h) − M)/S) · N(t; 0, w²)     for |t| < h = WINDOW · w
    w² = 2 (tick²/12 + jitter²) + (SHARE · silence)²

with M and S mean and spread of the thresholds that its group draws.  From tq + h on, the density is the usual one.
Together they integrate to one: Φ(z(tq + h)) is the chance of an event before, whether on the way or at once.  The level
at tq + h is that at the event, carried on by its slope.  Such events say of thresholds only that they lay below; a
group's posterior is that of its other events.

SHARE keeps w from being as short as a nanosecond, where no optimiser would find it; the silence is known to w/√n
anyway.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from pixelid.likelihood.layout import EventRows, Layout
from pixelid.stages.comparator import memory_factor

SHARE = 1e-3  # of the silence: 60 events tell it to 1e-4 of itself all the same, and optimisers have something to climb
WINDOW = 5.0  # standard deviations: 6e-7 are beyond
NONE = np.empty(0, np.int64)

factor = njit(memory_factor, cache=True, error_model="numpy", inline="always")


class Released(NamedTuple):
    """(j,) events near the end of a silence.

    k: which;  late: seconds after it;  width: w, seconds
    level, rate: at the event, in thresholds' units, whatever the sign of the rate
    """

    k: np.ndarray
    late: np.ndarray
    width: np.ndarray
    level: np.ndarray
    rate: np.ndarray


def candidates(layout: Layout, rows: EventRows, numbers) -> np.ndarray:
    """(j,) indices of the events near the end of a silence; none where pixels do not fall silent."""
    if not numbers.silent > 0.0:
        return NONE
    return np.flatnonzero(np.abs(rows.early) < WINDOW * _width(layout.tick_s, numbers))


def released(k: np.ndarray, layout: Layout, rows: EventRows, numbers) -> Released:
    """The events `k` (j,), near the end of a silence."""
    growth = 1.0 + numbers.threshold_drift * layout.time_s[k]
    scale = layout.sign[k] / (growth * memory_factor(numbers.polarity_memory, layout.alike[k]))
    level = scale * (rows.change[k] + numbers.on_threshold * rows.drift[k])
    rate = scale * (rows.slope[k] + numbers.on_threshold * rows.drift_slope[k])
    rate = rate - level * numbers.threshold_drift / growth
    return Released(k, -rows.early[k], _width(layout.tick_s[k], numbers), level, rate)


def _width(tick_s: np.ndarray, numbers) -> np.ndarray:
    return np.sqrt(tick_s**2 / 6.0 + 2.0 * numbers.jitter**2 + (SHARE * numbers.silent) ** 2)


@njit(cache=True, error_model="numpy")
def spread_of_draws(at_group, noise, g, shrunk, light, k):
    """Standard deviation of the thresholds that group g draws, given its events, in units of levels.

    shrunk: the thresholds' factor, which neither their noise nor that of the light has;  light: variances, of which the
    k-th is added, or empty
    """
    drawn = (noise * at_group.mean[g]) ** 2 + (light[k] if len(light) > 0 else 0.0)
    return math.sqrt(drawn / (shrunk * shrunk) + at_group.variance[g])


@njit(cache=True, error_model="numpy")
def log_chance(margin):
    """(log Φ, φ/Φ) of a margin."""
    if margin > -30.0:
        chance = 0.5 * math.erfc(-margin / math.sqrt(2.0))
        return math.log(chance), math.exp(-0.5 * margin * margin) / math.sqrt(2.0 * math.pi) / chance
    return -0.5 * margin * margin - math.log(-margin * math.sqrt(2.0 * math.pi)), -margin


@njit(cache=True, error_model="numpy")
def margin_of(j, alike, group, numbers, light, release, at_group):
    """(margin of the level at the window's end above the threshold, standard deviation that it is measured in)."""
    k = release.k[j]
    wide = spread_of_draws(at_group, numbers.noise, group[k], factor(numbers.polarity_memory, alike[k]), light, k)
    level = release.level[j] + (WINDOW * release.width[j] - release.late[j]) * release.rate[j]
    return (level - at_group.mean[group[k]]) / wide, wide


@njit(cache=True, nogil=True, error_model="numpy")
def at_release(alike, group, numbers, log_background, light, release, at_group, event, background):
    """Fill terms, levels and variances of events at the end of a silence; `background` where the background explains
    them better.
    """
    for j in range(len(release.k)):
        k, w = release.k[j], release.width[j]
        chance = log_chance(margin_of(j, alike, group, numbers, light, release, at_group)[0])[0]
        term = chance - 0.5 * (release.late[j] / w) ** 2 - math.log(w * math.sqrt(2.0 * math.pi))
        background[k] = not term > log_background
        event.term[k] = log_background if background[k] else term
        drawn = numbers.noise * at_group.mean[group[k]] / factor(numbers.polarity_memory, alike[k])
        event.variance[k] = drawn**2
        if not background[k]:
            event.level[k] = release.level[j] + (WINDOW * w - release.late[j]) * release.rate[j]


@njit(cache=True, nogil=True, error_model="numpy")
def at_release_back(alike, group, numbers, light, release, at_group, by_mean, by_variance, by_drawn):
    """(j,) derivatives of the terms by the level at the window's end, and that by the polarity memory; adds those by
    the groups' thresholds, as `spread_back`.
    """
    by_level, by_memory = np.empty(len(release.k)), 0.0
    for j in range(len(release.k)):
        k = release.k[j]
        margin, wide = margin_of(j, alike, group, numbers, light, release, at_group)
        slope = log_chance(margin)[1] / wide
        by_level[j] = slope
        by_mean[group[k]] -= slope
        by_memory += spread_back(
            -slope * margin / (2.0 * wide), wide, group[k], alike[k], numbers, at_group, by_variance, by_drawn
        )
    return by_level, by_memory


@njit(cache=True, error_model="numpy")
def spread_back(by_square, wide, g, alike, numbers, at_group, by_variance, by_drawn):
    """Back through `spread_of_draws`, whose value is `wide`, from the derivative by its square.

    Adds the derivatives by the variance of the group's threshold and by that of its draws; returns that by the polarity
    memory.
    """
    shrunk = factor(numbers.polarity_memory, alike)
    by_variance[g] += by_square
    by_drawn[g] += by_square / (shrunk * shrunk)
    return -2.0 * by_square * (wide * wide - at_group.variance[g]) * alike / shrunk


@njit(cache=True, nogil=True, error_model="numpy")
def release_rows_back(sign, alike, time, numbers, release, by_level, rows, by_rows):
    """Fill the derivatives by the rows of events at the end of a silence.

    Returns the parts of the derivatives by the ON threshold, drift and polarity memory, and those by jitter and silence
    as factors of jitter and silence.
    """
    on, drift = numbers.on_threshold, numbers.threshold_drift
    by_on, by_drift, by_memory, by_jitter, by_silent = 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(len(release.k)):
        k, w, late = release.k[j], release.width[j], release.late[j]
        level, rate, ahead = release.level[j], release.rate[j], WINDOW * w - late
        growth, shrunk = 1.0 + drift * time[k], factor(numbers.polarity_memory, alike[k])
        by_rate = by_level[j] * ahead / (growth * shrunk)
        by_z = by_level[j] / (growth * shrunk) - by_rate * drift / growth
        by_drift -= shrunk * ((by_z * level + by_rate * rate) * time[k] + by_rate * level)
        by_memory -= by_level[j] * (level + ahead * rate) * alike[k] / shrunk
        by_rows.change[k], by_rows.slope[k] = sign[k] * by_z, sign[k] * by_rate
        by_rows.drift[k], by_rows.drift_slope[k] = on * by_rows.change[k], on * by_rows.slope[k]
        by_on += rows.drift[k] * by_rows.change[k] + rows.drift_slope[k] * by_rows.slope[k]
        by_rows.early[k] = by_level[j] * rate + late / w**2
        by_width = by_level[j] * WINDOW * rate + late**2 / w**3 - 1.0 / w
        by_jitter += by_width * 2.0 / w
        by_silent += by_width * SHARE**2 / w
    return by_on, by_drift, by_memory, by_jitter, by_silent
