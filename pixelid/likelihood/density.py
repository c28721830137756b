"""The density of event times and its exact gradient in one compiled pass (the formulas of `event_times.py`).

`terms` of `event_times.py` is the readable form and keeps every piece; this is what optimisers call.  One backward
pass gives the derivative of the log-likelihood with respect to everything `Changes` holds and to the circuit's own
numbers, so that a gradient over any number of parameters costs one density and one product.

With W = Σ w, A = Σ w z, z̄ = A/W, D = (z̄ − C)/(S + 1/W), S = τ² the spread of thresholds, per group:

    ∂/∂z = −w (z − z̄) − D w/W      ∂/∂w = −½ (z − z̄)² − ½ S/(1 + S W) − D (z − z̄)/W − ½ D²/W²
    ∂/∂C = D                       ∂/∂S = −½ W/(1 + S W) + ½ D²

and, of the posterior M = (C + S A)/(1 + S W), G = S/(1 + S W) in the survival factors,

    ∂M/∂A = S/q   ∂M/∂W = −M S/q   ∂M/∂S = (A − C W)/q²   ∂M/∂C = 1/q   ∂G/∂S = 1/q²   ∂G/∂W = −S²/q²   (q = 1 + S W)

The threshold that scales a group's noise is such an M too (`own`), from weights in which the population's C scales it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from pixelid.stages.circuit import Circuit

if TYPE_CHECKING:
    from pixelid.likelihood.event_times import EventTimes

NUMBERS = ("on_threshold", "off_threshold", "noise", "mismatch", "threshold_drift", "jitter")


@dataclass(frozen=True)
class Density:
    """The log-likelihood and its derivatives at one point.

    total: the log-likelihood;  by_change: its derivative by each entry of `EventTimes.gathered`;
    by_number: (6,) by the circuit's `NUMBERS`
    z, rate, variance: (n,) level, its rate of change, its variance;  stray: (n,) bool
    weight_sum, weighted_mean: (g,) per group
    """

    total: float
    by_change: np.ndarray
    by_number: np.ndarray
    z: np.ndarray
    rate: np.ndarray
    variance: np.ndarray
    stray: np.ndarray
    weight_sum: np.ndarray
    weighted_mean: np.ndarray


def density(likelihood: EventTimes, circuit: Circuit, gathered: np.ndarray) -> Density:
    """The density of a likelihood's events under a real circuit; `gathered`: `likelihood.gathered(circuit)`."""
    from pixelid.likelihood.event_times import MISSED, STRAY_HZ

    n, m, groups = likelihood.events, len(likelihood.last_pixel), 2 * likelihood.pixels
    numbers = np.array([float(getattr(circuit, name)) for name in NUMBERS])
    by_change, by_number = np.zeros(7 * n + 4 * m), np.zeros(len(NUMBERS))
    z, rate, variance, stray = np.empty(n), np.empty(n), np.empty(n), np.empty(n, np.bool_)
    W, z_bar = np.empty(groups), np.empty(groups)
    total = _density(
        likelihood.sign, likelihood.group, likelihood.time_s, likelihood.tick_s, likelihood.clock_share,
        likelihood.last_pixel, likelihood.last_time_s, gathered[: 7 * n].reshape(7, n),
        gathered[7 * n :].reshape(4, m), numbers, math.log(STRAY_HZ), MISSED,
        by_change[: 7 * n].reshape(7, n), by_change[7 * n :].reshape(4, m), by_number,
        z, rate, variance, stray, W, z_bar,
    )  # fmt: skip
    return Density(total, by_change, by_number, z, rate, variance, stray, W, z_bar)


@njit(cache=True, error_model="numpy")
def _strays(z, rate, variance, group, C, S, log_stray, falling, stray, W, A):
    """Fill `stray`, and W, A (weight sums) of what is not: first against the population, then against its group."""
    groups = len(C)
    centre, extra = C.copy(), S.copy()
    for _ in range(2):
        W[:] = 0.0
        A[:] = 0.0
        for k in range(len(z)):
            g = group[k]
            total = variance[k] + extra[g]
            log_density = 0.5 * math.log(rate[k] * rate[k] / (2.0 * math.pi * total))
            log_density -= 0.5 * (z[k] - centre[g]) ** 2 / total
            stray[k] = falling[k] or log_density < log_stray
            if not stray[k]:
                W[g] += 1.0 / variance[k]
                A[g] += z[k] / variance[k]
        for g in range(groups):
            q = 1.0 + S[g] * W[g]
            centre[g] = (C[g] + S[g] * A[g]) / q
            extra[g] = S[g] / q


@njit(cache=True, error_model="numpy")
def survived(margin, missed):
    """(log chance of survival, its derivative) at `margin` standard deviations."""
    if margin > 8.5:
        return 0.0, 0.0
    chance = missed + (1.0 - missed) * 0.5 * math.erfc(-margin / math.sqrt(2.0))
    slope = (1.0 - missed) * math.exp(-0.5 * margin * margin) / math.sqrt(2.0 * math.pi)
    return math.log(chance), slope / chance


@njit(cache=True, nogil=True, error_model="numpy")
def _density(
    sign, group, time, tick, share, last_pixel, last_time, event, pixel, numbers, log_stray, missed,
    by_event, by_pixel, by_number, z, rate, variance, stray, W, z_bar,
):  # fmt: skip
    on, off, noise, mismatch, drift, jitter = numbers
    n, groups = len(sign), len(W)
    C, S, A = np.empty(groups), np.empty(groups), np.empty(groups)
    for g in range(groups):
        C[g] = on if g % 2 == 1 else off
        S[g] = (mismatch * C[g]) ** 2
    falling = np.empty(n, np.bool_)
    for k in range(n):
        growth = 1.0 + drift * time[k]
        zk = sign[k] * (event[0, k] + on * event[2, k]) / growth
        rk = sign[k] * (event[1, k] + on * event[3, k]) / growth - zk * drift / growth
        falling[k] = (not rk > 0.0) or event[6, k] > 0.0 or (not abs(zk) < 1e6) or (not rk < 1e12)
        z[k] = 0.0 if falling[k] else zk
        rate[k] = 1.0 if falling[k] else rk
        variance[k] = (noise * C[group[k]]) ** 2 + rate[k] * rate[k] * share[k] * (
            tick[k] * tick[k] / 12.0 + jitter * jitter
        )
    _strays(z, rate, variance, group, C, S, log_stray, falling, stray, W, A)
    W0, A0, own = W.copy(), A.copy(), np.empty(groups)
    for g in range(groups):
        own[g] = (C[g] + S[g] * A[g]) / (1.0 + S[g] * W[g])
    W[:] = 0.0
    A[:] = 0.0
    for k in range(n):
        g = group[k]
        variance[k] += (noise * own[g]) ** 2 - (noise * C[g]) ** 2
        if not stray[k]:
            W[g] += 1.0 / variance[k]
            A[g] += z[k] / variance[k]

    # groups: value, derivatives by their sums
    value = 0.0
    M, sd = np.empty(groups), np.empty(groups)
    by_M, by_sd = np.zeros(groups), np.zeros(groups)
    by_A, by_W, by_C, by_S, D = np.zeros(groups), np.zeros(groups), np.zeros(groups), np.zeros(groups), np.zeros(groups)
    for g in range(groups):
        q = 1.0 + S[g] * W[g]
        M[g] = (C[g] + S[g] * A[g]) / q
        sd[g] = math.sqrt((noise * M[g]) ** 2 + S[g] / q)
        z_bar[g] = 0.0
        if W[g] > 0.0:
            z_bar[g] = A[g] / W[g]
            spread = S[g] + 1.0 / W[g]
            D[g] = (z_bar[g] - C[g]) / spread
            value += -0.5 * math.log(q) - 0.5 * (z_bar[g] - C[g]) * D[g]
            by_C[g] = D[g]
            by_S[g] = -0.5 * W[g] / q + 0.5 * D[g] * D[g]
            by_W[g] = -0.5 * S[g] / q - 0.5 * D[g] * D[g] / (W[g] * W[g])

    # survival of the other polarity, and the intervals that the end cuts off
    by_on, by_drift = 0.0, 0.0
    for k in range(n):
        growth = 1.0 + drift * time[k]
        reached = (event[4, k] + on * event[5, k]) / growth
        if reached > 0.0:
            o = group[k] ^ 1
            margin = (M[o] - reached) / sd[o]
            log_chance, slope = survived(margin, missed)
            if slope != 0.0 or log_chance != 0.0:
                value += log_chance
                slope /= sd[o]
                by_M[o] += slope
                by_sd[o] -= slope * margin
                by_event[4, k] = -slope / growth
                by_event[5, k] = -slope * on / growth
                by_on -= slope * event[5, k] / growth
                by_drift += slope * reached / growth * time[k]
    for i in range(len(last_pixel)):
        growth = 1.0 + drift * last_time[i]
        for side in range(2):
            g = 2 * last_pixel[i] + 1 - side
            reached = (pixel[2 * side, i] + on * pixel[2 * side + 1, i]) / growth
            margin = (M[g] - reached) / sd[g]
            log_chance, slope = survived(margin, missed)
            value += log_chance
            slope /= sd[g]
            by_M[g] += slope
            by_sd[g] -= slope * margin
            by_pixel[2 * side, i] = -slope / growth
            by_pixel[2 * side + 1, i] = -slope * on / growth
            by_on -= slope * pixel[2 * side + 1, i] / growth
            by_drift += slope * reached / growth * last_time[i]

    # back through the groups' posteriors
    by_noise, by_mismatch, by_jitter = 0.0, 0.0, 0.0
    for g in range(groups):
        q = 1.0 + S[g] * W[g]
        half = by_sd[g] / (2.0 * sd[g])
        by_M[g] += half * 2.0 * noise * noise * M[g]
        by_C[g] += by_M[g] / q
        by_noise += half * 2.0 * noise * M[g] * M[g]
        by_A[g] = by_M[g] * S[g] / q
        by_S[g] += by_M[g] * (A[g] - C[g] * W[g]) / (q * q) + half / (q * q)
        by_W[g] += -by_M[g] * M[g] * S[g] / q - half * S[g] * S[g] / (q * q)
        by_mismatch += by_S[g] * 2.0 * mismatch * C[g] * C[g]
        by_C[g] += by_S[g] * 2.0 * mismatch * mismatch * C[g]

    # events
    by_own = np.zeros(groups)
    for k in range(n):
        if stray[k]:
            value += log_stray
            continue
        g = group[k]
        V, r = variance[k], rate[k]
        w = 1.0 / V
        off_mean = z[k] - z_bar[g]
        value += 0.5 * math.log(r * r * w / (2.0 * math.pi)) - 0.5 * off_mean * off_mean * w
        by_z = -w * off_mean - D[g] * w / W[g] + by_A[g] * w
        by_w = -0.5 * off_mean * off_mean - D[g] * off_mean / W[g] + by_W[g] + by_A[g] * z[k]
        by_V = -by_w * w * w - 0.5 * w
        by_noise += by_V * 2.0 * noise * own[g] * own[g]
        by_own[g] += by_V * 2.0 * noise * noise * own[g]
        by_jitter += by_V * r * r * share[k] * 2.0 * jitter
        by_event[0, k] = by_z
        by_event[1, k] = 1.0 / r + by_V * 2.0 * r * share[k] * (tick[k] * tick[k] / 12.0 + jitter * jitter)

    # back through the thresholds that scale the noise
    for g in range(groups):
        q = 1.0 + S[g] * W0[g]
        by_C[g] += by_own[g] / q
        by_spread = by_own[g] * (A0[g] - C[g] * W0[g]) / (q * q)
        by_mismatch += by_spread * 2.0 * mismatch * C[g] * C[g]
        by_C[g] += by_spread * 2.0 * mismatch * mismatch * C[g]
        by_own[g] *= S[g] / q
    for k in range(n):
        if stray[k]:
            continue
        g = group[k]
        V, r = variance[k] - (noise * own[g]) ** 2 + (noise * C[g]) ** 2, rate[k]
        by_z = by_event[0, k] + by_own[g] / V
        by_V = -by_own[g] * (z[k] - own[g]) / (V * V)
        by_noise += by_V * 2.0 * noise * C[g] * C[g]
        by_C[g] += by_V * 2.0 * noise * noise * C[g]
        by_jitter += by_V * r * r * share[k] * 2.0 * jitter
        by_rate = by_event[1, k] + by_V * 2.0 * r * share[k] * (tick[k] * tick[k] / 12.0 + jitter * jitter)
        growth = 1.0 + drift * time[k]
        by_z -= by_rate * drift / growth
        dz, dr = sign[k] * by_z / growth, sign[k] * by_rate / growth
        by_event[0, k] = dz
        by_event[1, k] = dr
        by_event[2, k] = on * dz
        by_event[3, k] = on * dr
        by_on += event[2, k] * dz + event[3, k] * dr
        by_drift -= ((by_z * z[k] + by_rate * r) * time[k] + by_rate * z[k]) / growth
    by_off = 0.0
    for g in range(groups):
        if g % 2 == 1:
            by_on += by_C[g]
        else:
            by_off += by_C[g]
    by_number[0], by_number[1], by_number[2] = by_on, by_off, by_noise
    by_number[3], by_number[4], by_number[5] = by_mismatch, by_drift, by_jitter
    return value
