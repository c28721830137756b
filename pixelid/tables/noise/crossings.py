"""Expected crossings after a known crossing, or after a reset, as compiled sums over lags (see `first_passage.py`)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

FARTHEST = 100.0  # squared standard deviations from a mean: e⁻⁵⁰ of a density is nothing beside rates of e⁻⁴⁰
PARTS = 8  # of a grid step that a leaking reference passes; the hazard is log-linear between them


@njit(forceinline=True, error_model="numpy")
def hidden_mean(hidden, t, z, w, offset, into):
    """Mean of the hidden states at the end: see `hidden.Hidden`."""
    end_mean, end_spread = hidden[3], hidden[4]
    for e in range(len(into)):
        into[e] = end_mean[t, e, 0] * z + end_mean[t, e, 1] * w + end_spread[t, e] * offset


@njit(forceinline=True, error_model="numpy")
def _add(into, first, f, d0, d1, hidden, t, before, after):
    """Add the intensity f of a crossing, and its moments, to into[:, first:]: rows of the start, columns of the end.

    d0, d1: output and slope from their mean;  before, after: (n,) means of the hidden states that know neither.
    """
    start_gain, end_gain, cross = hidden[0], hidden[1], hidden[2]
    n = len(before)
    for b in range(n + 1):
        start = before[b - 1] + start_gain[t, b - 1, 0] * d0 + start_gain[t, b - 1, 1] * d1 if b else 1.0
        into[b, first] += f * start
        for e in range(n):
            end = after[e] + end_gain[t, e, 0] * d0 + end_gain[t, e, 1] * d1
            into[b, first + 1 + e] += f * (start * end + (cross[t, e, b - 1] if b else 0.0))


@njit(forceinline=True, error_model="numpy")
def add_crossings(into, weight, mz, mw, laws, hidden, t, before, after, levels, slopes, factors):
    """Add to into (s, 2 m s) weight times the intensities of crossings at lag t, by level, slope and moment.

    mz, mw: means of output and slope there;  laws: `hidden.normal_laws`;  others as `_add` and `between_crossings`.
    """
    m, s = len(slopes), len(before) + 1
    farthest, p00, p01, p11 = FARTHEST * laws[t, 0], laws[t, 1], 2.0 * laws[t, 2], laws[t, 3]
    highest = weight * laws[t, 4]
    for i in range(2):
        d0 = levels[i] - mz
        if d0 * d0 > farthest:
            continue
        for j in range(m):
            d1 = (slopes[j] if i == 0 else -slopes[j]) - mw
            q = p00 * d0 * d0 + (p01 * d0 + p11 * d1) * d1
            f = highest * factors[j] * math.exp(-0.5 * q) if q < FARTHEST else 0.0
            if f > 0.0:
                _add(into, (i * m + j) * s, f, d0, d1, hidden, t, before, after)


@njit(forceinline=True, error_model="numpy")
def mean_after_reset(maps, spread, tails, t, z, w, offset, kept):
    """(output, slope) a lag after a reset: see `after_reset`."""
    return (
        maps[t, 0, 0] * z + maps[t, 0, 1] * w + spread[t, 0] * offset + tails[t, 0] * kept,
        maps[t, 1, 0] * z + maps[t, 1, 1] * w + spread[t, 1] * offset + tails[t, 1] * kept,
    )


@njit(cache=True, nogil=True, error_model="numpy")
def between_crossings(means, laws, hidden, on, off, slopes, factors, weights, stationary, found):
    """found (2 m s, 2 m s): ∫ (intensity of crossings of one level and slope, a lag after another) − stationary.

    Per slope there are s moments: 1 and the mean of each hidden state.
    means: (lags, 2, 2) of output and slope, per output and slope at lag 0;  laws: (lags, 5) `hidden.normal_laws`;
    hidden: arrays of `hidden.Hidden`;  on, off: the two levels;  slopes: (m,) of nodes;  factors: (m,) what turns a
    density at a node into an intensity;  weights: (lags,) of the integral;  stationary: (2 m s,).
    """
    m, n = len(slopes), hidden[0].shape[1]
    s = n + 1
    levels = (on, off)
    signs = (1.0, -1.0)
    total = weights.sum()
    before, after = np.zeros(n), np.empty(n)
    for i0 in range(2):
        for j0 in range(m):
            row = (i0 * m + j0) * s
            into = found[row : row + s]
            into[:] = 0.0
            for i in range(2 * m * s):
                into[0, i] = -total * stationary[i]
            z, w = levels[i0], signs[i0] * slopes[j0]
            for t in range(len(weights)):
                mz = means[t, 0, 0] * z + means[t, 0, 1] * w
                mw = means[t, 1, 0] * z + means[t, 1, 1] * w
                hidden_mean(hidden, t, z, w, 0.0, after)
                add_crossings(into, weights[t], mz, mw, laws, hidden, t, before, after, levels, slopes, factors)


@njit(cache=True, nogil=True, error_model="numpy")
def after_reset(
    maps, spread, tails, laws, hidden, start_spread, z, w, offset, kept, on, off, slopes, factors, weights,
    stationary, found,
):  # fmt: skip
    """found (s, 2 m s): ∫ (intensity of crossing i with slope j, a lag after the reset) − stationary.

    The event was at output z with slope w; the reference that was then stored lies `offset` standard deviations from
    its mean.  maps: (lags, 2, 2) per z and w;  spread: (lags, 2) per offset;  tails: (lags, 2) per `kept`, the
    reference;  start_spread: (n,) mean of the hidden states at the event per offset;  others as `between_crossings`.
    """
    levels = (on, off)
    total = weights.sum()
    before, after = start_spread * offset, np.empty(len(start_spread))
    for i in range(len(stationary)):
        found[0, i] = -total * stationary[i]
        for b in range(len(before)):
            found[1 + b, i] = found[0, i] * before[b]
    for t in range(len(weights)):
        mz, mw = mean_after_reset(maps, spread, tails, t, z, w, offset, kept)
        hidden_mean(hidden, t, z, w, offset, after)
        add_crossings(found, weights[t], mz, mw, laws, hidden, t, before, after, levels, slopes, factors)


@njit(forceinline=True, error_model="numpy")
def place(x, first, step, count):
    """(index, fraction) of the four-point interpolation at x on a uniform grid; x is held inside."""
    u = min(max((x - first) / step, 0.0), count - 1.0)
    k = min(max(int(u) - 1, 0), count - 4)
    return k, u - k


@njit(forceinline=True, error_model="numpy")
def lagrange(p):
    """Four-point interpolation weights at p of nodes 0, 1, 2, 3."""
    return (
        -(p - 1.0) * (p - 2.0) * (p - 3.0) / 6.0, p * (p - 2.0) * (p - 3.0) / 2.0,
        -p * (p - 1.0) * (p - 3.0) / 2.0, p * (p - 1.0) * (p - 2.0) / 6.0,
    )  # fmt: skip


@njit(forceinline=True, error_model="numpy")
def _scatter(into, level, pick, each, share, first, step, count):
    """Add `share` of exits at a level to the states around it.

    pick: index of polarity, slope and moment, of which `each` are of one polarity.
    """
    k, p = place(level, first, step, count)
    weights = lagrange(p)
    i, j = pick // each, pick % each
    for q in range(4):
        into[(i * count + k + q) * each + j] += share * weights[q]


@njit(cache=True, nogil=True, error_model="numpy")
def exits_long_after(nodes, on, off, moments, stationary, resolvent, drift, exits, times):
    """Where a pixel exits that has forgotten its last event but its reference, which falls at the rate `drift`.

    nodes: (k,) references;  on, off: thresholds;  moments: s, the first of which is the share itself;
    stationary: (k, 2 m s);  resolvent: (k, 2 m s, 2 m s).
    exits: (k, states) filled with shares of the exit states;  times: (k,) with mean times.
    """
    count, each = len(nodes), stationary.shape[1] // 2
    first, step = nodes[0], nodes[1] - nodes[0]
    rates = np.zeros((2, 2 * each))  # at this reference, and at the one below
    totals = np.zeros(2)
    for k in range(count):
        totals[1] = totals[0]
        totals[0] = 1e-300
        for i in range(2 * each):
            rates[1, i] = rates[0, i]
            rates[0, i] = 0.0
            for q in range(0, 2 * each, moments):
                rates[0, i] += stationary[k, q] * resolvent[k, q, i]
            if i % moments == 0:
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
                for i in range(2 * each):
                    share = (1.0 - u) * rates[0, i] / totals[0] + u * rates[1, i] / totals[1]
                    level = nodes[k] - u * step + (on if i < each else -off)
                    _scatter(exits[k], level, i, each, gone * share, first, step, count)
                still *= math.exp(-expected)
            times[k] += still * times[k - 1]
            for q in range(exits.shape[1]):
                exits[k, q] += still * exits[k - 1, q]
        else:
            times[k] = 1.0 / totals[0]
            for i in range(2 * each):
                level = nodes[k] + (on if i < each else -off)
                _scatter(exits[k], level, i, each, rates[0, i] / totals[0], first, step, count)


@njit(cache=True, nogil=True, error_model="numpy")
def transitions(
    nodes, slopes, omega, stationary_hz, sigma, factors, weights, maps, spread, tails, laws, hidden,
    start_spread, reference, reference_sd, offsets, offset_weights, on, off, draw_weights, resolvents, moved, late,
):  # fmt: skip
    """The Markov chain of events: moved (states, states) and late (states, draws, k), shares that soon reach the next
    event, and that first forget all but the reference.

    A state is (polarity, level of the output, slope, moment of the hidden states) at an event.  reference: (2,) mean of
    the stored reference per output and slope, reference_sd: its standard deviation;  offsets: nodes of the reference;
    on, off, draw_weights: (draws,) pairs of thresholds as they are drawn;  resolvents: (draws, k, 2 m s, 2 m s);
    others as `after_reset`.
    """
    count, m, s = len(nodes), len(slopes), len(start_spread) + 1
    each = m * s
    first, step = nodes[0], nodes[1] - nodes[0]
    expected = np.empty((s, 2 * each))
    stationary = np.zeros(2 * each)
    quick = np.empty(2 * each)
    for i0 in range(2):
        for k0 in range(count):
            for j0 in range(m):
                row = ((i0 * count + k0) * m + j0) * s
                z, w = nodes[k0], slopes[j0] if i0 == 0 else -slopes[j0]
                for g in range(len(offsets)):
                    kept = reference[0] * z + reference[1] * w + reference_sd * offsets[g]
                    kept = min(max(kept, nodes[0]), nodes[count - 1])
                    k, p = place(kept, first, step, count)
                    line = lagrange(p)
                    for a in range(len(draw_weights)):
                        share = offset_weights[g] * draw_weights[a]
                        up, down = kept + on[a], kept - off[a]
                        for j in range(m):
                            stationary[j * s] = stationary_hz * math.exp(-0.5 * (up / sigma) ** 2) * omega[j]
                            stationary[each + j * s] = stationary_hz * math.exp(-0.5 * (down / sigma) ** 2) * omega[j]
                        after_reset(
                            maps, spread, tails, laws, hidden, start_spread, z, w, offsets[g], kept, up, down,
                            slopes, factors, weights, stationary, expected,
                        )  # fmt: skip
                        for b in range(s):
                            quick[:] = 0.0
                            for n in range(4):
                                for q in range(2 * each):
                                    part = line[n] * expected[b, q]
                                    for i in range(2 * each):
                                        quick[i] += part * resolvents[a, k + n, q, i]
                            left = start_spread[b - 1] * offsets[g] if b else 1.0
                            for i in range(2 * each):
                                if i % s == 0:
                                    left -= quick[i]
                                level = up if i < each else down
                                _scatter(moved[row + b], level, i, each, share * quick[i], first, step, count)
                            for n in range(4):
                                late[row + b, a, k + n] += share * left * line[n]
