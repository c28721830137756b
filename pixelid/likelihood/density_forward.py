"""The density of event times, compiled: `forward` fills all its pieces.  Formulas: `density.py`.

Loops over events are kept free of branches and of scattered sums wherever possible: background events have weight 0
instead.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from pixelid.dynamics.vector_math import vlog
from pixelid.likelihood.density_release import at_release, factor, spread_of_draws


class Numbers(NamedTuple):
    """What the density itself takes from the circuit; the fields are the circuit's."""

    on_threshold: float
    off_threshold: float
    noise: float
    mismatch: float
    threshold_drift: float
    jitter: float
    silent: float
    polarity_memory: float


class EventTerms(NamedTuple):
    """(n,) per event.

    level, rate: z and dz/dt;  variance: of z about its group's threshold;  weight: 1/variance, 0 for background events
    clock: variance in time of its interval, s²;  reached: the other polarity's extreme level;  term: log-likelihood
    """

    level: np.ndarray
    rate: np.ndarray
    variance: np.ndarray
    weight: np.ndarray
    clock: np.ndarray
    reached: np.ndarray
    term: np.ndarray


class GroupTerms(NamedTuple):
    """(g,) per pixel and polarity.

    centre, spread: mean and variance of the population's thresholds
    first_W, first_A: Σ w, Σ w z with the population's noise;  own: the threshold they imply, which scales the noise
    W, A: the same sums with the group's own noise;  weighted_mean: A/W, 0 without events
    mean, variance: of the threshold, given the events;  term: log-likelihood
    """

    centre: np.ndarray
    spread: np.ndarray
    first_W: np.ndarray
    first_A: np.ndarray
    own: np.ndarray
    W: np.ndarray
    A: np.ndarray
    weighted_mean: np.ndarray
    mean: np.ndarray
    variance: np.ndarray
    term: np.ndarray


@njit(cache=True, nogil=True, error_model="numpy")
def forward(
    sign, alike, group, time, tick, clock_share, last_pixel, last_time, last_sign, rows, ends, numbers, background_hz,
    missed, light, release, event, impossible, background, at_group, end_term,
):  # fmt: skip
    """Fill EventTerms `event`, `background` (n,), GroupTerms `at_group` and `end_term` (m,).

    alike: (n,) as of `Layout`;  light: variances (n,), (n,), (m,) by the light, see `Layout`, or three empty arrays
    release: events that may be those at the end of a silence, `density_release.Released`;  impossible: (n,) work space
    """
    _populations(numbers, at_group)
    _levels(sign, alike, time, tick, clock_share, rows, numbers, event, impossible)
    for j in range(len(release.k)):
        k = release.k[j]
        impossible[k], event.level[k], event.rate[k] = True, 0.0, 1.0
    for k in range(len(light[0])):
        event.variance[k] += light[0][k] / factor(numbers.polarity_memory, alike[k]) ** 2
    _classify(group, event, impossible, background_hz, at_group, background)
    for g in range(len(at_group.own)):
        at_group.own[g] = posterior(at_group, at_group.first_W, at_group.first_A, g)[0]
    _scale_noise(alike, group, numbers, at_group, background, event)
    _sum_weights(group, event, at_group.W, at_group.A)
    _group_terms(at_group)
    _event_terms(group, background, math.log(background_hz), at_group, event)
    at_release(alike, group, numbers, math.log(background_hz), light[0], release, at_group, event, background)
    _survivals(
        alike, group, time, last_pixel, last_time, last_sign, rows, ends, numbers, missed, light[1], light[2], at_group,
        event, end_term,
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _populations(numbers, at_group):
    on, off, _, mismatch, _, _, _, _ = numbers
    for g in range(len(at_group.centre)):
        at_group.centre[g] = on if g % 2 == 1 else off
        at_group.spread[g] = (mismatch * at_group.centre[g]) ** 2


@njit(cache=True, nogil=True, error_model="numpy")
def _levels(sign, alike, time, tick, clock_share, rows, numbers, event, impossible):
    """Level, rate and variance of every event, and whether the circuit cannot have fired it."""
    on, off, noise, _, drift, jitter, _, memory = numbers
    noise_on, noise_off = (noise * on) ** 2, (noise * off) ** 2
    z, rate, variance, clock = event.level, event.rate, event.variance, event.clock
    change, slope, leak, leak_rate, early = rows.change, rows.slope, rows.drift, rows.drift_slope, rows.early
    for k in range(len(z)):
        growth = 1.0 + drift * time[k]
        scale = sign[k] / (growth * factor(memory, alike[k]))
        z[k] = scale * (change[k] + on * leak[k])
        rate[k] = scale * (slope[k] + on * leak_rate[k]) - z[k] * drift / growth
    # a change beyond any sensible level comes from parameters far outside physics: not worth its digits
    for k in range(len(z)):
        impossible[k] = (not rate[k] > 0.0) or early[k] >= 0.0 or (not abs(z[k]) < 1e6) or (not rate[k] < 1e12)
    for k in range(len(z)):
        z[k] = 0.0 if impossible[k] else z[k]
        rate[k] = 1.0 if impossible[k] else rate[k]
    for k in range(len(z)):
        clock[k] = clock_share[k] * (tick[k] * tick[k] / 12.0 + jitter * jitter)
        drawn = (noise_on if sign[k] > 0.0 else noise_off) / factor(memory, alike[k]) ** 2
        variance[k] = drawn + rate[k] * rate[k] * clock[k]


@njit(cache=True, error_model="numpy")
def posterior(at_group, W, A, g):
    """(mean, variance) of group g's threshold, given sums of weights and of weighted levels."""
    C, S = at_group.centre[g], at_group.spread[g]
    q = 1.0 + S * W[g]
    return (C + S * A[g]) / q, S / q


@njit(cache=True, nogil=True, error_model="numpy")
def _classify(group, event, impossible, background_hz, at_group, background):
    """Fill `background`: events that the background explains better, first against the population, then against the
    threshold that the rest of their group implies; and the sums of that rest.
    """
    W, A = at_group.first_W, at_group.first_A
    centre, extra = at_group.centre.copy(), at_group.spread.copy()
    for _ in range(2):
        _compare(group, event, impossible, background_hz, centre, extra, background)
        for k in range(len(background)):
            event.weight[k] = 0.0 if background[k] else 1.0 / event.variance[k]
        _sum_weights(group, event, W, A)
        for g in range(len(W)):
            centre[g], extra[g] = posterior(at_group, W, A, g)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _compare(group, event, impossible, background_hz, centre, extra, background):
    """Fill `background`: where N(z; centre, variance + extra) · rate < background_hz, or the event is impossible.

    Nearly all events need no exponential: (1 − x/64)^64 ≤ e^−x decides.
    """
    z, rate, variance = event.level, event.rate, event.variance
    least = 2.0 * math.pi * background_hz * background_hz
    for k in range(len(group)):
        total, away = variance[k] + extra[group[k]], z[k] - centre[group[k]]
        bound = max(1.0 - away * away / (64.0 * total), 0.0)
        for _ in range(6):
            bound *= bound
        background[k] = impossible[k] or not rate[k] * rate[k] * bound > least * total
    for k in range(len(group)):
        if background[k] and not impossible[k]:
            total, away = variance[k] + extra[group[k]], z[k] - centre[group[k]]
            background[k] = rate[k] * rate[k] * math.exp(-away * away / total) < least * total


@njit(cache=True, nogil=True, error_model="numpy")
def _sum_weights(group, event, W, A):
    W[:] = 0.0
    A[:] = 0.0
    for k in range(len(group)):
        W[group[k]] += event.weight[k]
        A[group[k]] += event.weight[k] * event.level[k]


@njit(cache=True, nogil=True, error_model="numpy")
def _scale_noise(alike, group, numbers, at_group, background, event):
    """Noise that scales with each group's own threshold instead of the population's, and the weights under it."""
    more = (numbers.noise * at_group.own) ** 2 - (numbers.noise * at_group.centre) ** 2
    for k in range(len(group)):
        event.variance[k] += more[group[k]] / factor(numbers.polarity_memory, alike[k]) ** 2
    for k in range(len(group)):
        event.weight[k] = 0.0 if background[k] else 1.0 / event.variance[k]


@njit(cache=True, nogil=True, error_model="numpy")
def _group_terms(at_group):
    C, S, W, A = at_group.centre, at_group.spread, at_group.W, at_group.A
    for g in range(len(W)):
        at_group.mean[g], at_group.variance[g] = posterior(at_group, W, A, g)
        at_group.weighted_mean[g] = 0.0
        at_group.term[g] = 0.0
        if W[g] > 0.0:
            at_group.weighted_mean[g] = A[g] / W[g]
            away = at_group.weighted_mean[g] - C[g]
            at_group.term[g] = -0.5 * math.log(1.0 + S[g] * W[g]) - 0.5 * away * away / (S[g] + 1.0 / W[g])


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _event_terms(group, background, log_background, at_group, event):
    """Fill the terms with log N(z; weighted mean, variance) + log rate, or the background's."""
    z, rate, variance, term, mean = event.level, event.rate, event.variance, event.term, at_group.weighted_mean
    for k in range(len(group)):
        term[k] = z[k] - mean[group[k]]
    for k in range(len(group)):
        V = variance[k]
        term[k] = 0.5 * (vlog(rate[k] * rate[k] / (2.0 * math.pi * V)) - term[k] * term[k] / V)
    for k in range(len(group)):
        term[k] = log_background if background[k] else term[k]


@njit(cache=True, error_model="numpy")
def survival(margin, missed):
    """(log chance, its derivative) that a threshold `margin` standard deviations above an extreme was not reached, or
    that its event is missing."""
    if margin > 8.5:
        return 0.0, 0.0
    chance = missed + (1.0 - missed) * 0.5 * math.erfc(-margin / math.sqrt(2.0))
    slope = (1.0 - missed) * math.exp(-0.5 * margin * margin) / math.sqrt(2.0 * math.pi)
    return math.log(chance), slope / chance


@njit(cache=True, nogil=True, error_model="numpy")
def _survivals(
    alike, group, time, last_pixel, last_time, last_sign, rows, ends, numbers, missed, reset, last, at_group, event,
    end_term,
):  # fmt: skip
    """Add the survival of the other polarity to the events' terms, and fill the terms of the unfinished intervals.

    reset, last: variances by the light, (n,) and (m,), see `Layout`, or empty
    """
    on, _, noise, _, drift, _, _, memory = numbers
    mean, reached = at_group.mean, event.reached
    for k in range(len(group)):
        growth = (1.0 + drift * time[k]) * factor(memory, -alike[k])
        reached[k] = (rows.opposite[k] + on * rows.opposite_drift[k]) / growth
    for k in range(len(group)):
        if reached[k] > 0.0:
            other = group[k] ^ 1
            sd = spread_of_draws(at_group, noise, other, factor(memory, -alike[k]), reset, k)
            event.term[k] += survival((mean[other] - reached[k]) / sd, missed[0])[0]
    for i in range(len(last_pixel)):
        end_term[i] = 0.0
        for side in range(2):
            g, extreme, leaked, shrunk = end_of(i, side, last_pixel, last_sign, ends, memory)
            level = (extreme[i] + on * leaked[i]) / ((1.0 + drift * last_time[i]) * shrunk)
            sd = spread_of_draws(at_group, noise, g, shrunk, last, i)
            end_term[i] += survival((mean[g] - level) / sd, missed[1])[0]


@njit(cache=True, nogil=True, error_model="numpy")
def spreads_of_others(alike, group, numbers, reset, at_group):
    """(n,) `spread_of_draws` of the other polarity at each event; reset: as of `_survivals`."""
    wide = np.empty(len(group))
    for k in range(len(group)):
        shrunk = factor(numbers.polarity_memory, -alike[k])
        wide[k] = spread_of_draws(at_group, numbers.noise, group[k] ^ 1, shrunk, reset, k)
    return wide


@njit(cache=True, error_model="numpy", inline="always")
def end_of(i, side, last_pixel, last_sign, ends, memory):
    """(group, extremes, what has leaked there, factor of the thresholds) of an unfinished interval, for ON (side 0) or
    OFF (1)."""
    if side == 0:
        return 2 * last_pixel[i] + 1, ends.rise, ends.rise_drift, factor(memory, last_sign[i])
    return 2 * last_pixel[i], ends.fall, ends.fall_drift, factor(memory, -last_sign[i])
