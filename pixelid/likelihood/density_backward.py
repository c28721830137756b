"""Derivatives of the density of event times, compiled: `backward` goes back through `density_forward.forward`.

With W = Σ w, A = Σ w z, z̄ = A/W, S = τ² the spread of thresholds and D = (z̄ − C)/(S + 1/W) per group, the term of a
group, −½ log(1 + S W) − ½ (z̄ − C) D, has

    ∂/∂C = D      ∂/∂S = −½ W/(1 + S W) + ½ D²      ∂/∂W = −½ S/(1 + S W) − ½ D²/W²  (z̄ held)      ∂/∂z̄ = −D

and the posterior of its threshold, M = (C + S A)/q, G = S/q with q = 1 + S W,

    ∂M/∂C = 1/q   ∂M/∂S = (A − C W)/q²   ∂M/∂W = −M S/q   ∂M/∂A = S/q   ∂G/∂S = 1/q²   ∂G/∂W = −S²/q².

An event's term is ½ log(r² w/2π) − ½ w (z − z̄)²; w = 1/V, and V = (σ own)² + r² · clock, where `own` is a posterior
mean M too, from the weights in which the population's C scales the noise.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pixelid.likelihood.density_forward import end_of, posterior, survival
from pixelid.likelihood.density_release import (
    at_release_back,
    factor,
    release_rows_back,
    spread_back,
    spread_of_draws,
)

NO_ZERO = 1e-300  # below any sum of weights


@njit(cache=True, nogil=True, error_model="numpy")
def backward(
    sign, alike, group, time, clock_share, last_pixel, last_time, last_sign, rows, ends, numbers, missed, light, reset,
    last, event, at_group, release, pull, by_rows, by_ends, by_number,
):  # fmt: skip
    """Fill the derivatives of the log-likelihood by the changes, EventRows `by_rows` and EndRows `by_ends`, and by the
    `numbers` (8,).  `event`, `at_group`: what `forward` filled;  release: events at the end of a silence, `Released`;
    pull: of events after lost ones, `losses.Pull`.
    """
    _, _, noise, mismatch, _, jitter, _, _ = numbers
    C, S, W, own = at_group.centre, at_group.spread, at_group.W, at_group.own
    groups = len(C)
    by_mean, by_spread, by_drawn = np.zeros(groups), np.zeros(groups), np.zeros(groups)
    lossy = len(pull.kept) > 0
    if lossy:
        by_mean += pull.by_mean
        by_spread += pull.by_spread
        by_drawn += pull.by_spread
    by_on, by_drift, by_memory = _survivals_back(
        alike, group, time, last_pixel, last_time, last_sign, rows, ends, numbers, missed, reset, last, event, at_group,
        pull.kept, by_rows, by_ends, by_mean, by_spread, by_drawn,
    )  # fmt: skip

    by_margin, at_memory = at_release_back(
        alike, group, numbers, light, release, at_group, by_mean, by_spread, by_drawn
    )

    # groups: their terms, and the posteriors that the survivals saw
    D, by_C, by_S, by_W, by_A = (
        np.zeros(groups),
        np.zeros(groups),
        np.zeros(groups),
        np.zeros(groups),
        np.zeros(groups),
    )
    by_noise = 0.0
    for g in range(groups):
        by_mean[g] += by_drawn[g] * 2.0 * noise * noise * at_group.mean[g]
        by_noise += by_drawn[g] * 2.0 * noise * at_group.mean[g] ** 2
        by_C[g], by_S[g], by_W[g], by_A[g] = _posterior_back(at_group, W, at_group.A, g, by_mean[g], by_spread[g])
        if W[g] > 0.0:
            D[g] = (at_group.weighted_mean[g] - C[g]) / (S[g] + 1.0 / W[g])
            by_C[g] += D[g]
            by_S[g] += -0.5 * W[g] / (1.0 + S[g] * W[g]) + 0.5 * D[g] ** 2
            by_W[g] += -0.5 * S[g] / (1.0 + S[g] * W[g]) - 0.5 * (D[g] / W[g]) ** 2

    # events, under the noise of their own thresholds
    by_z, by_rate, by_variance = by_rows.change, by_rows.slope, np.empty(len(group))
    _events_back(group, event, at_group, D / np.maximum(W, NO_ZERO), by_W, by_A, by_z, by_rate, by_variance)
    by_V = np.zeros(groups)
    memory = numbers.polarity_memory
    for k in range(len(group)):
        by_V[group[k]] += by_variance[k] / factor(memory, alike[k]) ** 2
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
    by_memory += at_memory
    by_memory += _first_events_back(
        alike, group, numbers, event, at_group, by_first_W, by_first_A, by_z, by_rate, by_variance, by_V
    )
    if lossy:
        by_z += pull.by_level
        by_rate += pull.by_rate
    by_jitter = 0.0
    if jitter > 0.0:
        by_jitter = 2.0 * jitter * _by_clock(clock_share, event.rate, by_variance)
    for g in range(groups):
        by_noise += by_V[g] * 2.0 * noise * C[g] ** 2
        by_C[g] += by_V[g] * 2.0 * noise * noise * C[g] + by_S[g] * 2.0 * mismatch * mismatch * C[g]
    more_on, more_drift, more_memory = _levels_back(sign, alike, time, rows, numbers, event, by_rows)
    by_rows.early[:] = 0.0
    at_on, at_drift, at_memory, at_jitter, by_silent = release_rows_back(
        sign, alike, time, numbers, release, by_margin, rows, by_rows
    )
    by_number[0] = at_on + by_on + more_on + by_C[1::2].sum()
    by_number[1] = by_C[0::2].sum()
    by_number[2] = by_noise
    by_number[3] = (by_S * 2.0 * mismatch * C * C).sum()
    by_number[4] = by_drift + more_drift + at_drift
    by_number[5] = by_jitter + at_jitter * jitter
    by_number[6] = by_silent * numbers.silent
    by_number[7] = by_memory + more_memory + at_memory


@njit(cache=True, error_model="numpy")
def _posterior_back(at_group, W, A, g, by_mean, by_variance):
    """Derivatives by (C, S, W, A) through `posterior`."""
    C, S = at_group.centre[g], at_group.spread[g]
    mean, variance = posterior(at_group, W, A, g)
    q = 1.0 + S * W[g]
    by_S = (by_mean * (A[g] - C * W[g]) + by_variance) / (q * q)
    by_W = -by_mean * mean * S / q - by_variance * variance * variance
    return by_mean / q, by_S, by_W, by_mean * S / q


@njit(cache=True, nogil=True, error_model="numpy")
def _survivals_back(
    alike, group, time, last_pixel, last_time, last_sign, rows, ends, numbers, missed, reset, last, event, at_group,
    kept, by_rows, by_ends, by_mean, by_spread, by_drawn,
):  # fmt: skip
    """Back through the survivals; returns the parts of the derivatives by (ON threshold, drift, polarity memory).

    reset, last: variances by the light, (n,) and (m,), see `Layout`, or empty;  kept: (n,) `losses.Pull`, or empty
    """
    on, _, noise, _, drift, _, _, memory = numbers
    mean, reached = at_group.mean, event.reached
    by_on, by_drift, by_memory = 0.0, 0.0, 0.0
    by_rows.opposite[:] = 0.0
    by_rows.opposite_drift[:] = 0.0
    for k in range(len(group)):
        if reached[k] > 0.0:
            g = group[k] ^ 1
            turned = -alike[k]  # the other polarity
            shrunk = factor(memory, turned)
            wide = spread_of_draws(at_group, noise, g, shrunk, reset, k)
            margin = (mean[g] - reached[k]) / wide
            slope = survival(margin, missed[0])[1] / wide
            if len(kept) > 0:
                slope *= kept[k]
            by_mean[g] += slope
            by_memory += spread_back(
                -slope * margin / (2.0 * wide), wide, g, turned, numbers, at_group, by_spread, by_drawn
            )
            growth = 1.0 + drift * time[k]
            by_rows.opposite[k] = -slope / (growth * shrunk)
            by_rows.opposite_drift[k] = on * by_rows.opposite[k]
            by_on += by_rows.opposite[k] * rows.opposite_drift[k]
            by_drift += slope * reached[k] / growth * time[k]
            by_memory += slope * reached[k] / shrunk * turned
    for i in range(len(last_pixel)):
        growth = 1.0 + drift * last_time[i]
        for side in range(2):
            g, extreme, leaked, shrunk = end_of(i, side, last_pixel, last_sign, ends, memory)
            after = last_sign[i] if side == 0 else -last_sign[i]
            by_extreme, by_leaked = (
                (by_ends.rise, by_ends.rise_drift) if side == 0 else (by_ends.fall, by_ends.fall_drift)
            )
            level = (extreme[i] + on * leaked[i]) / (growth * shrunk)
            wide = spread_of_draws(at_group, noise, g, shrunk, last, i)
            margin = (mean[g] - level) / wide
            slope = survival(margin, missed[1])[1] / wide
            by_mean[g] += slope
            by_memory += spread_back(
                -slope * margin / (2.0 * wide), wide, g, after, numbers, at_group, by_spread, by_drawn
            )
            by_extreme[i] = -slope / (growth * shrunk)
            by_leaked[i] = on * by_extreme[i]
            by_on += by_extreme[i] * leaked[i]
            by_drift += slope * level / growth * last_time[i]
            by_memory += slope * level / shrunk * after
    return by_on, by_drift, by_memory


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _events_back(group, event, at_group, pull, by_W, by_A, by_z, by_rate, by_variance):
    """Back through the events' terms and the sums W, A: by level, rate and variance.  pull: D/W, by group."""
    z, rate, weight, clock, mean = event.level, event.rate, event.weight, event.clock, at_group.weighted_mean
    for k in range(len(group)):
        g, w = group[k], weight[k]
        within = z[k] - mean[g]
        by_z[k] = w * (by_A[g] - pull[g] - within)
        by_weight = by_W[g] + by_A[g] * z[k] - (0.5 * within + pull[g]) * within
        by_variance[k] = -w * (by_weight * w + 0.5)
        by_rate[k] = (1.0 / rate[k] if w > 0.0 else 0.0) + by_variance[k] * 2.0 * rate[k] * clock[k]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _first_events_back(alike, group, numbers, event, at_group, by_W, by_A, by_z, by_rate, by_variance, by_V):
    """Back through the sums first_W, first_A: add to what is known by level, rate, variance; by_V: sums by group.

    Returns the derivative by the polarity memory, through the variance of either pass.
    """
    noise, memory, by_memory = numbers.noise, numbers.polarity_memory, 0.0
    less = (noise * at_group.own) ** 2 - (noise * at_group.centre) ** 2
    z, rate, clock = event.level, event.rate, event.clock
    first = np.empty(len(group))
    for k in range(len(group)):
        g = group[k]
        shrunk = factor(memory, alike[k])
        first_variance = event.variance[k] - less[g] / (shrunk * shrunk)
        w = 1.0 / first_variance if event.weight[k] > 0.0 else 0.0
        by_z[k] += by_A[g] * w
        first[k] = -(by_W[g] + by_A[g] * z[k]) * w * w
        by_rate[k] += first[k] * 2.0 * rate[k] * clock[k]
        timed = rate[k] * rate[k] * clock[k]
        drawn = by_variance[k] * (event.variance[k] - timed) + first[k] * (first_variance - timed)
        by_memory -= 2.0 * drawn * alike[k] / shrunk
        by_variance[k] += first[k]
        first[k] /= shrunk * shrunk
    for k in range(len(group)):
        by_V[group[k]] += first[k]
    return by_memory


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def _by_clock(clock_share, rate, by_variance):
    total = 0.0
    for k in range(len(rate)):
        total += by_variance[k] * rate[k] * rate[k] * clock_share[k]
    return total


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def _levels_back(sign, alike, time, rows, numbers, event, by_rows):
    """Turn derivatives by level and rate, in by_rows.change and .slope, into those by all rows of the level; returns
    the parts of the derivatives by (ON threshold, drift, polarity memory).
    """
    z, rate, on, drift = event.level, event.rate, numbers.on_threshold, numbers.threshold_drift
    by_on, by_drift, by_memory = 0.0, 0.0, 0.0
    for k in range(len(z)):
        growth, shrunk = 1.0 + drift * time[k], factor(numbers.polarity_memory, alike[k])
        by_memory -= (by_rows.change[k] * z[k] + by_rows.slope[k] * rate[k]) * alike[k] / shrunk
        by_rate = by_rows.slope[k] / (growth * shrunk)
        by_z = by_rows.change[k] / (growth * shrunk) - by_rate * drift / growth
        by_drift -= shrunk * ((by_z * z[k] + by_rate * rate[k]) * time[k] + by_rate * z[k])
        by_rows.change[k] = sign[k] * by_z
        by_rows.slope[k] = sign[k] * by_rate
        by_on += rows.drift[k] * by_rows.change[k] + rows.drift_slope[k] * by_rows.slope[k]
    for k in range(len(z)):
        by_rows.drift[k] = on * by_rows.change[k]
        by_rows.drift_slope[k] = on * by_rows.slope[k]
    return by_on, by_drift, by_memory
