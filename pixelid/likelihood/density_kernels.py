"""The density of event times as two compiled passes: `forward` to all its pieces, `backward` to all its derivatives.

Formulas: `density.py`.  Backward, with W = Σ w, A = Σ w z, z̄ = A/W, S = τ² the spread of thresholds and
D = (z̄ − C)/(S + 1/W) per group, the term of a group −½ log(1 + S W) − ½ (z̄ − C) D has

    ∂/∂C = D      ∂/∂S = −½ W/(1 + S W) + ½ D²      ∂/∂W = −½ S/(1 + S W) − ½ D²/W²  (z̄ held)      ∂/∂z̄ = −D

and the posterior of its threshold, M = (C + S A)/q, G = S/q with q = 1 + S W,

    ∂M/∂C = 1/q   ∂M/∂S = (A − C W)/q²   ∂M/∂W = −M S/q   ∂M/∂A = S/q   ∂G/∂S = 1/q²   ∂G/∂W = −S²/q².

An event's term is ½ log(r² w/2π) − ½ w (z − z̄)²; w = 1/V, and V = (σ own)² + r² · clock, where `own` is a posterior
mean M too, from the weights in which the population's C scales the noise.  Loops over events are kept free of branches
and of scattered sums wherever possible: background events have weight 0 instead.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from pixelid.dynamics.vector_math import vlog

NO_ZERO = 1e-300  # below any sum of weights


class Numbers(NamedTuple):
    """What the density itself takes from the circuit; the fields are the circuit's."""

    on_threshold: float
    off_threshold: float
    noise: float
    mismatch: float
    threshold_drift: float
    jitter: float


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
    first_W, first_A: Σ w, Σ w z with the population's noise;  own: the threshold they tell, which scales the noise
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
    sign, group, time, tick, clock_share, last_pixel, last_time, rows, ends, numbers, background_hz, missed,
    event, impossible, background, at_group, end_term,
):  # fmt: skip
    """Fill EventTerms `event`, `background` (n,), GroupTerms `at_group` and `end_term` (m,).

    impossible: (n,) work space
    """
    _populations(numbers, at_group)
    _levels(sign, group, time, tick, clock_share, rows, numbers, at_group.centre, event, impossible)
    _classify(group, event, impossible, background_hz, at_group, background)
    for g in range(len(at_group.own)):
        at_group.own[g] = _posterior(at_group, at_group.first_W, at_group.first_A, g)[0]
    _scale_noise(group, numbers[2], at_group, background, event)
    _sum_weights(group, event, at_group.W, at_group.A)
    _group_terms(at_group)
    _event_terms(group, background, math.log(background_hz), at_group, event)
    _survivals(group, time, last_pixel, last_time, rows, ends, numbers, missed, at_group, event, end_term)


@njit(cache=True, error_model="numpy")
def _populations(numbers, at_group):
    on, off, _, mismatch, _, _ = numbers
    for g in range(len(at_group.centre)):
        at_group.centre[g] = on if g % 2 == 1 else off
        at_group.spread[g] = (mismatch * at_group.centre[g]) ** 2


@njit(cache=True, nogil=True, error_model="numpy")
def _levels(sign, group, time, tick, clock_share, rows, numbers, centre, event, impossible):
    """Level, rate and variance of every event, and whether the circuit cannot have fired it."""
    on, off, noise, _, drift, jitter = numbers
    noise_on, noise_off = (noise * on) ** 2, (noise * off) ** 2
    z, rate, variance, clock = event.level, event.rate, event.variance, event.clock
    change, slope, leak, leak_rate, early = rows.change, rows.slope, rows.drift, rows.drift_slope, rows.early
    for k in range(len(z)):
        growth = 1.0 + drift * time[k]
        scale = sign[k] / growth
        z[k] = scale * (change[k] + on * leak[k])
        rate[k] = scale * (slope[k] + on * leak_rate[k]) - z[k] * drift / growth
    # a change beyond any sensible level comes from parameters far outside physics: not worth its digits
    for k in range(len(z)):
        impossible[k] = (not rate[k] > 0.0) or early[k] > 0.0 or (not abs(z[k]) < 1e6) or (not rate[k] < 1e12)
    for k in range(len(z)):
        z[k] = 0.0 if impossible[k] else z[k]
        rate[k] = 1.0 if impossible[k] else rate[k]
    for k in range(len(z)):
        clock[k] = clock_share[k] * (tick[k] * tick[k] / 12.0 + jitter * jitter)
        variance[k] = (noise_on if sign[k] > 0.0 else noise_off) + rate[k] * rate[k] * clock[k]


@njit(cache=True, error_model="numpy")
def _posterior(at_group, W, A, g):
    """(mean, variance) of group g's threshold, given sums of weights and of weighted levels."""
    C, S = at_group.centre[g], at_group.spread[g]
    q = 1.0 + S * W[g]
    return (C + S * A[g]) / q, S / q


@njit(cache=True, nogil=True, error_model="numpy")
def _classify(group, event, impossible, background_hz, at_group, background):
    """Fill `background`: events that the background explains better, first against the population, then against the
    threshold that the rest of their group tells; and the sums of that rest.
    """
    W, A = at_group.first_W, at_group.first_A
    centre, extra = at_group.centre.copy(), at_group.spread.copy()
    for _ in range(2):
        _compare(group, event, impossible, background_hz, centre, extra, background)
        for k in range(len(background)):
            event.weight[k] = 0.0 if background[k] else 1.0 / event.variance[k]
        _sum_weights(group, event, W, A)
        for g in range(len(W)):
            centre[g], extra[g] = _posterior(at_group, W, A, g)


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
        background[k] = not rate[k] * rate[k] * bound > least * total
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
def _scale_noise(group, noise, at_group, background, event):
    """Noise that scales with each group's own threshold instead of the population's, and the weights under it."""
    more = (noise * at_group.own) ** 2 - (noise * at_group.centre) ** 2
    for k in range(len(group)):
        event.variance[k] += more[group[k]]
    for k in range(len(group)):
        event.weight[k] = 0.0 if background[k] else 1.0 / event.variance[k]


@njit(cache=True, nogil=True, error_model="numpy")
def _group_terms(at_group):
    C, S, W, A = at_group.centre, at_group.spread, at_group.W, at_group.A
    for g in range(len(W)):
        at_group.mean[g], at_group.variance[g] = _posterior(at_group, W, A, g)
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


@njit(cache=True, error_model="numpy")
def _spread_of_draws(at_group, noise):
    """(g,) standard deviation of the thresholds that a group draws, given its events."""
    return np.sqrt((noise * at_group.mean) ** 2 + at_group.variance)


@njit(cache=True, nogil=True, error_model="numpy")
def _survivals(group, time, last_pixel, last_time, rows, ends, numbers, missed, at_group, event, end_term):
    """Add the survival of the other polarity to the events' terms, and fill the terms of the unfinished intervals."""
    on, _, noise, _, drift, _ = numbers
    mean, sd, reached = at_group.mean, _spread_of_draws(at_group, noise), event.reached
    for k in range(len(group)):
        reached[k] = (rows.opposite[k] + on * rows.opposite_drift[k]) / (1.0 + drift * time[k])
    for k in range(len(group)):
        if reached[k] > 0.0:
            other = group[k] ^ 1
            event.term[k] += survival((mean[other] - reached[k]) / sd[other], missed)[0]
    for i in range(len(last_pixel)):
        growth = 1.0 + drift * last_time[i]
        g = 2 * last_pixel[i]
        rise, fall = (
            (ends.rise[i] + on * ends.rise_drift[i]) / growth,
            (ends.fall[i] + on * ends.fall_drift[i]) / growth,
        )
        end_term[i] = survival((mean[g + 1] - rise) / sd[g + 1], missed)[0]
        end_term[i] += survival((mean[g] - fall) / sd[g], missed)[0]


@njit(cache=True, nogil=True, error_model="numpy")
def backward(
    sign, group, time, clock_share, last_pixel, last_time, rows, ends, numbers, missed, event, at_group,
    by_rows, by_ends, by_number,
):  # fmt: skip
    """Fill the derivatives of the log-likelihood by the changes, EventRows `by_rows` and EndRows `by_ends` (all but
    `early`), and by the `numbers` (6,).  `event`, `at_group`: what `forward` filled.
    """
    on, _, noise, mismatch, drift, jitter = numbers
    C, S, W, own = at_group.centre, at_group.spread, at_group.W, at_group.own
    groups = len(C)
    by_mean, by_sd = np.zeros(groups), np.zeros(groups)
    by_on, by_drift = _survivals_back(
        group, time, last_pixel, last_time, rows, ends, numbers, missed, event, at_group, by_rows, by_ends,
        by_mean, by_sd,
    )  # fmt: skip

    # groups: their terms, and the posteriors that the survivals saw
    D, by_C, by_S, by_W, by_A = (
        np.zeros(groups),
        np.zeros(groups),
        np.zeros(groups),
        np.zeros(groups),
        np.zeros(groups),
    )
    by_noise = 0.0
    sd = _spread_of_draws(at_group, noise)
    for g in range(groups):
        by_variance = by_sd[g] / (2.0 * sd[g])
        by_mean[g] += by_variance * 2.0 * noise * noise * at_group.mean[g]
        by_noise += by_variance * 2.0 * noise * at_group.mean[g] ** 2
        by_C[g], by_S[g], by_W[g], by_A[g] = _posterior_back(at_group, W, at_group.A, g, by_mean[g], by_variance)
        if W[g] > 0.0:
            D[g] = (at_group.weighted_mean[g] - C[g]) / (S[g] + 1.0 / W[g])
            by_C[g] += D[g]
            by_S[g] += -0.5 * W[g] / (1.0 + S[g] * W[g]) + 0.5 * D[g] ** 2
            by_W[g] += -0.5 * S[g] / (1.0 + S[g] * W[g]) - 0.5 * (D[g] / W[g]) ** 2

    # events, under the noise of their own thresholds
    by_z, by_rate, by_variance = by_rows.change, by_rows.slope, np.empty(len(group))
    _events_back(group, event, at_group, D / np.maximum(W, NO_ZERO), by_W, by_A, by_z, by_rate, by_variance)
    by_V = np.zeros(groups)
    for k in range(len(group)):
        by_V[group[k]] += by_variance[k]
    by_own, first_W, first_A = np.zeros(groups), at_group.first_W, at_group.first_A
    by_first_W, by_first_A = np.zeros(groups), np.zeros(groups)
    for g in range(groups):
        by_noise += by_V[g] * 2.0 * noise * own[g] ** 2
        by_own[g] = by_V[g] * 2.0 * noise * noise * own[g]
        more_C, more_S, by_first_W[g], by_first_A[g] = _posterior_back(at_group, first_W, first_A, g, by_own[g], 0.0)
        by_C[g] += more_C
        by_S[g] += more_S

    # events, under the noise of the population's threshold, from which their own was told
    by_V[:] = 0.0
    _first_events_back(group, noise, event, at_group, by_first_W, by_first_A, by_z, by_rate, by_variance, by_V)
    by_jitter = 0.0
    if jitter > 0.0:
        by_jitter = 2.0 * jitter * _by_clock(clock_share, event.rate, by_variance)
    for g in range(groups):
        by_noise += by_V[g] * 2.0 * noise * C[g] ** 2
        by_C[g] += by_V[g] * 2.0 * noise * noise * C[g] + by_S[g] * 2.0 * mismatch * mismatch * C[g]
    more_on, more_drift = _levels_back(sign, time, rows, on, drift, event, by_rows)
    by_number[0] = by_on + more_on + by_C[1::2].sum()
    by_number[1] = by_C[0::2].sum()
    by_number[2] = by_noise
    by_number[3] = (by_S * 2.0 * mismatch * C * C).sum()
    by_number[4] = by_drift + more_drift
    by_number[5] = by_jitter


@njit(cache=True, error_model="numpy")
def _posterior_back(at_group, W, A, g, by_mean, by_variance):
    """Derivatives by (C, S, W, A) through `_posterior`."""
    C, S = at_group.centre[g], at_group.spread[g]
    mean, variance = _posterior(at_group, W, A, g)
    q = 1.0 + S * W[g]
    by_S = (by_mean * (A[g] - C * W[g]) + by_variance) / (q * q)
    by_W = -by_mean * mean * S / q - by_variance * variance * variance
    return by_mean / q, by_S, by_W, by_mean * S / q


@njit(cache=True, nogil=True, error_model="numpy")
def _survivals_back(
    group, time, last_pixel, last_time, rows, ends, numbers, missed, event, at_group, by_rows, by_ends, by_mean, by_sd
):  # fmt: skip
    """Back through `_survivals`; returns the parts of the derivatives by (ON threshold, drift)."""
    on, _, noise, _, drift, _ = numbers
    mean, sd, reached = at_group.mean, _spread_of_draws(at_group, noise), event.reached
    by_on, by_drift = 0.0, 0.0
    by_rows.opposite[:] = 0.0
    by_rows.opposite_drift[:] = 0.0
    for k in range(len(group)):
        if reached[k] > 0.0:
            g = group[k] ^ 1
            margin = (mean[g] - reached[k]) / sd[g]
            slope = survival(margin, missed)[1] / sd[g]
            by_mean[g] += slope
            by_sd[g] -= slope * margin
            growth = 1.0 + drift * time[k]
            by_rows.opposite[k] = -slope / growth
            by_rows.opposite_drift[k] = -slope * on / growth
            by_on -= slope * rows.opposite_drift[k] / growth
            by_drift += slope * reached[k] / growth * time[k]
    for i in range(len(last_pixel)):
        growth = 1.0 + drift * last_time[i]
        for side in range(2):
            g = 2 * last_pixel[i] + 1 - side
            extreme, leaked = (ends.rise, ends.rise_drift) if side == 0 else (ends.fall, ends.fall_drift)
            by_extreme, by_leaked = (
                (by_ends.rise, by_ends.rise_drift) if side == 0 else (by_ends.fall, by_ends.fall_drift)
            )
            level = (extreme[i] + on * leaked[i]) / growth
            margin = (mean[g] - level) / sd[g]
            slope = survival(margin, missed)[1] / sd[g]
            by_mean[g] += slope
            by_sd[g] -= slope * margin
            by_extreme[i] = -slope / growth
            by_leaked[i] = -slope * on / growth
            by_on -= slope * leaked[i] / growth
            by_drift += slope * level / growth * last_time[i]
    return by_on, by_drift


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _events_back(group, event, at_group, by_own_mean, by_W, by_A, by_z, by_rate, by_variance):
    """Back through the events' terms and the sums W, A: by level, rate and variance.  by_own_mean: D/W."""
    z, rate, weight, clock, mean = event.level, event.rate, event.weight, event.clock, at_group.weighted_mean
    for k in range(len(group)):
        g, w = group[k], weight[k]
        within = z[k] - mean[g]
        by_z[k] = w * (by_A[g] - by_own_mean[g] - within)
        by_weight = by_W[g] + by_A[g] * z[k] - (0.5 * within + by_own_mean[g]) * within
        by_variance[k] = -w * (by_weight * w + 0.5)
        by_rate[k] = (1.0 / rate[k] if w > 0.0 else 0.0) + by_variance[k] * 2.0 * rate[k] * clock[k]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _first_events_back(group, noise, event, at_group, by_W, by_A, by_z, by_rate, by_variance, by_V):
    """Back through the sums first_W, first_A: add to what is known by level, rate, variance; by_V: sums by group."""
    less = (noise * at_group.own) ** 2 - (noise * at_group.centre) ** 2
    z, rate, clock = event.level, event.rate, event.clock
    first = np.empty(len(group))
    for k in range(len(group)):
        g = group[k]
        w = 1.0 / (event.variance[k] - less[g]) if event.weight[k] > 0.0 else 0.0
        by_z[k] += by_A[g] * w
        first[k] = -(by_W[g] + by_A[g] * z[k]) * w * w
        by_rate[k] += first[k] * 2.0 * rate[k] * clock[k]
        by_variance[k] += first[k]
    for k in range(len(group)):
        by_V[group[k]] += first[k]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def _by_clock(clock_share, rate, by_variance):
    total = 0.0
    for k in range(len(rate)):
        total += by_variance[k] * rate[k] * rate[k] * clock_share[k]
    return total


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def _levels_back(sign, time, rows, on, drift, event, by_rows):
    """Turn derivatives by level and rate, in by_rows.change and .slope, into those by all rows of the level; returns
    the parts of the derivatives by (ON threshold, drift).
    """
    z, rate = event.level, event.rate
    by_on, by_drift = 0.0, 0.0
    for k in range(len(z)):
        growth = 1.0 + drift * time[k]
        by_rate = by_rows.slope[k] / growth
        by_z = by_rows.change[k] / growth - by_rate * drift / growth
        by_drift -= (by_z * z[k] + by_rate * rate[k]) * time[k] + by_rate * z[k]
        by_rows.change[k] = sign[k] * by_z
        by_rows.slope[k] = sign[k] * by_rate
        by_on += rows.drift[k] * by_rows.change[k] + rows.drift_slope[k] * by_rows.slope[k]
    for k in range(len(z)):
        by_rows.drift[k] = on * by_rows.change[k]
        by_rows.drift_slope[k] = on * by_rows.slope[k]
    return by_on, by_drift
