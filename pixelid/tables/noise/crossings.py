"""Expected crossings after a known crossing, or after a reset, as compiled sums over lags (see `first_passage.py`)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

PARTS = 8  # of a grid step that a leaking reference passes; the hazard is log-linear between them


@njit(forceinline=True, error_model="numpy")
def _density(d0, d1, v00, v01, v11):
    """Density of output and slope at d0, d1 from their mean; 0 where the covariance is lost in rounding."""
    det = v00 * v11 - v01 * v01
    if not det > 1e-13 * v00 * v11:
        return 0.0
    q = (v11 * d0 * d0 - 2.0 * v01 * d0 * d1 + v00 * d1 * d1) / det
    return math.exp(-0.5 * q) / (2.0 * math.pi * math.sqrt(det)) if q < 600.0 else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def between_crossings(means, covariances, on, off, slopes, factors, weights, stationary, found):
    """found (2 m, 2 m): ∫ (intensity of crossing i with slope j, a lag after crossing i' with slope j') − stationary.

    means: (lags, 2, 2) of output and slope, per output and slope at lag 0;  covariances: (lags, 3) (00, 01, 11);
    on, off: the two levels;  slopes: (m,) of nodes;  factors: (m,) what turns a density at a node into an intensity;
    weights: (lags,) of the integral;  stationary: (2 m,).
    """
    m = len(slopes)
    levels = (on, off)
    signs = (1.0, -1.0)
    total = weights.sum()
    for i0 in range(2):
        for j0 in range(m):
            row = i0 * m + j0
            for i in range(2 * m):
                found[row, i] = -total * stationary[i]
            z, w = levels[i0], signs[i0] * slopes[j0]
            for t in range(len(weights)):
                mz = means[t, 0, 0] * z + means[t, 0, 1] * w
                mw = means[t, 1, 0] * z + means[t, 1, 1] * w
                v00, v01, v11 = covariances[t, 0], covariances[t, 1], covariances[t, 2]
                for i in range(2):
                    d0 = levels[i] - mz
                    if d0 * d0 > 1200.0 * v00:
                        continue
                    for j in range(m):
                        f = _density(d0, signs[i] * slopes[j] - mw, v00, v01, v11)
                        found[row, i * m + j] += weights[t] * factors[j] * f


@njit(cache=True, nogil=True, error_model="numpy")
def after_reset(
    maps, spread, tails, covariances, z, w, offset, kept, on, off, slopes, factors, weights, stationary, found
):  # fmt: skip
    """found (2 m,): ∫ (intensity of crossing i with slope j, a lag after the reset) − stationary.

    The event was at output z with slope w; the reference that was then stored lies `offset` standard deviations from
    its mean.  maps: (lags, 2, 2) per z and w;  spread: (lags, 2) per offset;  tails: (lags, 2) per `kept`, the
    reference;  others as `between_crossings`.
    """
    m = len(slopes)
    levels = (on, off)
    signs = (1.0, -1.0)
    total = weights.sum()
    for i in range(2 * m):
        found[i] = -total * stationary[i]
    for t in range(len(weights)):
        v00, v01, v11 = covariances[t, 0], covariances[t, 1], covariances[t, 2]
        mz = maps[t, 0, 0] * z + maps[t, 0, 1] * w + spread[t, 0] * offset + tails[t, 0] * kept
        mw = maps[t, 1, 0] * z + maps[t, 1, 1] * w + spread[t, 1] * offset + tails[t, 1] * kept
        for i in range(2):
            d0 = levels[i] - mz
            if d0 * d0 > 1200.0 * v00:
                continue
            for j in range(m):
                f = _density(d0, signs[i] * slopes[j] - mw, v00, v01, v11)
                found[i * m + j] += weights[t] * factors[j] * f


@njit(forceinline=True, error_model="numpy")
def _place(x, first, step, count):
    """(index, fraction) of the four-point interpolation at x on a uniform grid; x is held inside."""
    u = min(max((x - first) / step, 0.0), count - 1.0)
    k = min(max(int(u) - 1, 0), count - 4)
    return k, u - k


@njit(forceinline=True, error_model="numpy")
def _lagrange(p):
    """Four-point interpolation weights at p of nodes 0, 1, 2, 3."""
    return (
        -(p - 1.0) * (p - 2.0) * (p - 3.0) / 6.0, p * (p - 2.0) * (p - 3.0) / 2.0,
        -p * (p - 1.0) * (p - 3.0) / 2.0, p * (p - 1.0) * (p - 2.0) / 6.0,
    )  # fmt: skip


@njit(forceinline=True, error_model="numpy")
def _scatter(into, level, pick, m, share, first, step, count):
    """Add `share` of exits (pick: index of polarity and slope) at a level to the states around it."""
    k, p = _place(level, first, step, count)
    weights = _lagrange(p)
    i, j = pick // m, pick % m
    for q in range(4):
        into[(i * count + k + q) * m + j] += share * weights[q]


@njit(cache=True, nogil=True, error_model="numpy")
def exits_long_after(nodes, on, off, slopes, stationary, resolvent, drift, exits, times):
    """Where a pixel exits that has forgotten its last event but its reference, which falls at the rate `drift`.

    nodes: (k,) references;  on, off: thresholds;  stationary: (k, 2 m);  resolvent: (k, 2 m, 2 m).
    exits: (k, states) filled with shares of the exit states;  times: (k,) with mean times.
    """
    count, m = len(nodes), len(slopes)
    first, step = nodes[0], nodes[1] - nodes[0]
    rates = np.zeros((2, 2 * m))  # at this reference, and at the one below
    totals = np.zeros(2)
    for k in range(count):
        totals[1] = totals[0]
        totals[0] = 1e-300
        for i in range(2 * m):
            rates[1, i] = rates[0, i]
            rates[0, i] = 0.0
            for q in range(2 * m):
                rates[0, i] += stationary[k, q] * resolvent[k, q, i]
            totals[0] += rates[0, i]
        for q in range(exits.shape[1]):
            exits[k, q] = 0.0
        still, times[k] = 1.0, 0.0
        if drift > 0.0 and k:
            width = step / PARTS
            for part in range(PARTS):
                u = (part + 0.5) / PARTS
                rate = math.exp((1.0 - u) * math.log(totals[0]) + u * math.log(totals[1]))
                expected = min(rate * width / drift, 700.0)
                gone = -still * math.expm1(-expected)  # of a rate lost in rounding the time still passes
                times[k] += gone / rate
                for i in range(2 * m):
                    share = (1.0 - u) * rates[0, i] / totals[0] + u * rates[1, i] / totals[1]
                    level = nodes[k] - u * step + (on if i < m else -off)
                    _scatter(exits[k], level, i, m, gone * share, first, step, count)
                still *= math.exp(-expected)
            times[k] += still * times[k - 1]
            for q in range(exits.shape[1]):
                exits[k, q] += still * exits[k - 1, q]
        else:
            times[k] = 1.0 / totals[0]
            for i in range(2 * m):
                level = nodes[k] + (on if i < m else -off)
                _scatter(exits[k], level, i, m, rates[0, i] / totals[0], first, step, count)


@njit(cache=True, nogil=True, error_model="numpy")
def transitions(
    nodes, slopes, omega, stationary_hz, sigma, factors, weights, maps, spread, tails, covariances, reference,
    reference_sd, offsets, offset_weights, on, off, draw_weights, resolvents, exits, times, moved, waited,
):  # fmt: skip
    """The Markov chain of events: moved (states, states) shares, waited (states,) mean time from release to event.

    A state is (polarity, level of the output, slope) at an event.  reference: (2,) mean of the stored reference per
    output and slope, reference_sd: its standard deviation;  offsets: nodes of the reference;  on, off, draw_weights:
    (draws,) pairs of thresholds as they are drawn;  resolvents: (draws, k, 2 m, 2 m).
    """
    count, m = len(nodes), len(slopes)
    first, step = nodes[0], nodes[1] - nodes[0]
    expected = np.empty(2 * m)
    stationary = np.empty(2 * m)
    quick = np.empty(2 * m)
    for i0 in range(2):
        for k0 in range(count):
            for j0 in range(m):
                row = (i0 * count + k0) * m + j0
                z, w = nodes[k0], slopes[j0] if i0 == 0 else -slopes[j0]
                into = moved[row]
                for g in range(len(offsets)):
                    kept = reference[0] * z + reference[1] * w + reference_sd * offsets[g]
                    kept = min(max(kept, nodes[0]), nodes[count - 1])
                    k, p = _place(kept, first, step, count)
                    line = _lagrange(p)
                    for a in range(len(draw_weights)):
                        share = offset_weights[g] * draw_weights[a]
                        up, down = kept + on[a], kept - off[a]
                        for j in range(m):
                            stationary[j] = stationary_hz * math.exp(-0.5 * (up / sigma) ** 2) * omega[j]
                            stationary[m + j] = stationary_hz * math.exp(-0.5 * (down / sigma) ** 2) * omega[j]
                        after_reset(
                            maps, spread, tails, covariances, z, w, offsets[g], kept, up, down, slopes, factors,
                            weights, stationary, expected,
                        )  # fmt: skip
                        sum_quick = 0.0
                        for i in range(2 * m):
                            quick[i] = 0.0
                            for n in range(4):
                                for q in range(2 * m):
                                    quick[i] += line[n] * expected[q] * resolvents[a, k + n, q, i]
                            sum_quick += quick[i]
                        left = 1.0 - sum_quick
                        for i in range(2 * m):
                            level = up if i < m else down
                            _scatter(into, level, i, m, share * quick[i], first, step, count)
                        for n in range(4):
                            part = share * left * line[n]
                            waited[row] += part * times[a, k + n]
                            for q in range(len(into)):
                                into[q] += part * exits[a, k + n, q]
