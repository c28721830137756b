"""Expected crossings after a known crossing, or after a reset, as compiled sums over lags (see `first_passage.py`).

Sums take nearly all of the time.  They store nothing, may add in any order and have an exponential of multiplications
alone, so that compilers make several lags at once of them; whatever depends on the lag has it as its last axis.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

FARTHEST = 100.0  # squared standard deviations from a mean: e⁻⁵⁰ of a density is nothing beside rates of e⁻⁴⁰
PARTS = 8  # of a grid step that a leaking reference passes; the hazard is log-linear between them
ANY_ORDER = {"reassoc", "contract", "nsz"}  # of a sum's terms


@njit(inline="always")
def exp_of_minus(x):
    """e⁻ˣ for 0 ≤ x ≤ 50, to 1e-10 of itself: ten terms of e^(−x/64) about its middle, squared six times."""
    y = 0.390625 - x / 64.0
    tail = 1.0 / 720.0 + y * (1.0 / 5040.0 + y * (1.0 / 40320.0 + y * (1.0 / 362880.0 + y / 3628800.0)))
    root = 0.676633846161729 * (
        1.0 + y * (1.0 + y * (0.5 + y * (1.0 / 6.0 + y * (1.0 / 24.0 + y * (1.0 / 120.0 + y * tail)))))
    )
    second = root * root
    fourth = second * second
    eighth = fourth * fourth
    sixteenth = eighth * eighth
    half = sixteenth * sixteenth
    return half * half


@njit(inline="always")
def _intensity(laws, t, d0, d1):
    """Density of output and slope at d0 and d1 from their means."""
    q = (laws[1, t] * d0 + 2.0 * laws[2, t] * d1) * d0 + laws[3, t] * d1 * d1
    return laws[4, t] * exp_of_minus(0.5 * q) if q < FARTHEST else 0.0


@njit(inline="always")
def _moved(gain, t, known, d0, d1):
    """Mean of a hidden state at d0 and d1; known: its mean at the means of output and slope."""
    return known + gain[0, t] * d0 + gain[1, t] * d1


@njit(nogil=True, error_model="numpy", fastmath=ANY_ORDER)
def _is_within_reach(mean, laws, level):
    reached = 0.0
    for t in range(mean.shape[1]):
        reached += 1.0 if (level - mean[0, t]) ** 2 <= FARTHEST * laws[0, t] else 0.0
    return reached > 0.0


@njit(nogil=True, error_model="numpy", fastmath=ANY_ORDER)
def _summed(weights, laws, mean, level, slope):
    """Crossings of a level with a slope, over all lags."""
    found = 0.0
    for t in range(len(weights)):
        found += weights[t] * _intensity(laws, t, level - mean[0, t], slope - mean[1, t])
    return found


@njit(nogil=True, error_model="numpy", fastmath=ANY_ORDER)
def _summed_moments(weights, laws, mean, level, slope, start_gain, end_gain, cross, before, after):
    """The same, and their moments by a hidden state at the start, by one at the end, and by both."""
    found, by_start, by_end, by_both = 0.0, 0.0, 0.0, 0.0
    for t in range(len(weights)):
        d0, d1 = level - mean[0, t], slope - mean[1, t]
        f = weights[t] * _intensity(laws, t, d0, d1)
        start, end = _moved(start_gain, t, before, d0, d1), _moved(end_gain, t, after[t], d0, d1)
        found += f
        by_start += f * start
        by_end += f * end
        by_both += f * (start * end + cross[t])
    return found, by_start, by_end, by_both


@njit(nogil=True, error_model="numpy")
def add_sums(into, weights, mean, laws, hidden, before, after, level, sign, slopes, factors):
    """Add to into (s, m s) the intensities of crossings of a level over all lags, by slope and moment.

    Rows are moments of the start, columns those of the end.
    weights: (lags,);  mean: (2, lags) of output and slope;  laws: `hidden.normal_laws`;  before: (n,) and
    after: (n, lags) means of the hidden states at start and end;  sign: of the slopes;  others as `between_crossings`.
    """
    start_gain, end_gain, cross = hidden[0], hidden[1], hidden[2]
    n = len(before)
    if not _is_within_reach(mean, laws, level):
        return
    for j in range(len(slopes)):
        slope, first = sign * slopes[j], j * (n + 1)
        if n == 0:
            into[0, first] += factors[j] * _summed(weights, laws, mean, level, slope)
        for b in range(n):
            for e in range(n):
                found, by_start, by_end, by_both = _summed_moments(
                    weights, laws, mean, level, slope, start_gain[b], end_gain[e], cross[e, b], before[b], after[e]
                )
                if b == 0 and e == 0:
                    into[0, first] += factors[j] * found
                if e == 0:
                    into[1 + b, first] += factors[j] * by_start
                if b == 0:
                    into[0, first + 1 + e] += factors[j] * by_end
                into[1 + b, first + 1 + e] += factors[j] * by_both


@njit(nogil=True, error_model="numpy")
def add_at_lag(into, weight, t, mean, laws, hidden, before, after, levels, slopes, factors):
    """The same at one lag, times a weight."""
    start_gain, end_gain, cross = hidden[0], hidden[1], hidden[2]
    m, n = len(slopes), len(before)
    for i in range(2):
        d0 = levels[i] - mean[0, t]
        if d0 * d0 > FARTHEST * laws[0, t]:
            continue
        for j in range(m):
            d1, first = (slopes[j] if i == 0 else -slopes[j]) - mean[1, t], (i * m + j) * (n + 1)
            f = weight * factors[j] * _intensity(laws, t, d0, d1)
            for b in range(n + 1):
                start = _moved(start_gain[b - 1], t, before[b - 1], d0, d1) if b else 1.0
                into[b, first] += f * start
                for e in range(n):
                    end = _moved(end_gain[e], t, after[e, t], d0, d1)
                    into[b, first + 1 + e] += f * (start * end + (cross[e, b - 1, t] if b else 0.0))


@njit(nogil=True, error_model="numpy")
def means_after_crossing(means, hidden, z, w, mean, after):
    """Fill mean (2, lags), of output and slope, and after (n, lags), of the hidden states, a lag after z and w."""
    for r in range(2):
        for t in range(mean.shape[1]):
            mean[r, t] = means[r, 0, t] * z + means[r, 1, t] * w
    for e in range(len(after)):
        for t in range(mean.shape[1]):
            after[e, t] = hidden[3][e, 0, t] * z + hidden[3][e, 1, t] * w


@njit(nogil=True, error_model="numpy")
def means_after_reset(maps, spread, tails, hidden, z, w, offset, kept, mean, after):
    """The same a lag after a reset, whose reference `kept` lies `offset` standard deviations from its mean."""
    means_after_crossing(maps, hidden, z, w, mean, after)
    for r in range(2):
        for t in range(mean.shape[1]):
            mean[r, t] += spread[r, t] * offset + tails[r, t] * kept
    for e in range(len(after)):
        for t in range(mean.shape[1]):
            after[e, t] += hidden[4][e, t] * offset


@njit(cache=True, nogil=True, error_model="numpy")
def between_crossings(means, laws, hidden, up, down, slopes, factors, weights, stationary, found):
    """found (k, 2 m s, 2 m s): ∫ (intensity of crossings of one level and slope, a lag after another) − stationary.

    Per slope there are s moments: 1 and the mean of each hidden state.
    means: (2, 2, lags) of output and slope, per output and slope at lag 0;  laws: (5, lags) `hidden.normal_laws`;
    hidden: arrays of `hidden.Hidden`;  up, down: (k,) the two levels;  slopes: (m,) of nodes;  factors: (m,) what
    turns a density at a node into an intensity;  weights: (lags,) of the integral;  stationary: (k, 2 m s).
    """
    m, n, lags = len(slopes), hidden[0].shape[0], len(weights)
    s = n + 1
    total = weights.sum()
    before, mean, after = np.zeros(n), np.empty((2, lags)), np.empty((n, lags))
    for k in range(len(up)):
        levels = (up[k], down[k])
        for i0 in range(2):
            for j0 in range(m):
                row = (i0 * m + j0) * s
                into = found[k, row : row + s]
                into[:] = 0.0
                for i in range(2 * m * s):
                    into[0, i] = -total * stationary[k, i]
                slope = slopes[j0] if i0 == 0 else -slopes[j0]
                means_after_crossing(means, hidden, levels[i0], slope, mean, after)
                for i in range(2):
                    part = into[:, i * m * s : (i + 1) * m * s]
                    sign = 1.0 if i == 0 else -1.0
                    add_sums(part, weights, mean, laws, hidden, before, after, levels[i], sign, slopes, factors)


@njit(cache=True, nogil=True, error_model="numpy")
def after_resets(
    nodes, slopes, omega, stationary_hz, sigma, factors, weights, maps, spread, tails, laws, hidden, start_spread,
    reference, reference_sd, offsets, states, sign, thresholds, found,
):  # fmt: skip
    """found (2, k, m, offsets, thresholds, s, m s): ∫ (intensity of crossings a lag after a reset) − stationary.

    By polarity, output and slope of the event, reference that was then stored, and the threshold above (sign 1) or
    below it (−1) that is crossed.
    nodes: (k,) outputs at events;  omega: (m,) weights of slopes, stationary_hz: crossings of 0 (Rice);
    maps: (2, 2, lags) of output and slope per those at the event;  spread: (2, lags) per offset;  tails: (2, lags) per
    reference;  start_spread: (n,) mean of the hidden states at the event per offset;  reference: (2,) mean of the
    stored reference per output and slope, reference_sd: its standard deviation;  offsets: nodes of the reference, in
    these;  states: of `transitions`;  others as `between_crossings`.
    """
    count, m, n, lags = len(nodes), len(slopes), len(start_spread), len(weights)
    s, total = n + 1, weights.sum()
    mean, after = np.empty((2, lags)), np.empty((n, lags))
    for i0 in range(2):
        for k0 in range(count):
            if states[i0, k0] < 0:
                continue
            for j0 in range(m):
                z, w = nodes[k0], slopes[j0] if i0 == 0 else -slopes[j0]
                for g in range(len(offsets)):
                    kept = reference[0] * z + reference[1] * w + reference_sd * offsets[g]
                    kept = min(max(kept, nodes[0]), nodes[count - 1])
                    means_after_reset(maps, spread, tails, hidden, z, w, offsets[g], kept, mean, after)
                    before = start_spread * offsets[g]
                    for c in range(len(thresholds)):
                        into = found[i0, k0, j0, g, c]
                        level = kept + sign * thresholds[c]
                        rice = stationary_hz * math.exp(-0.5 * (level / sigma) ** 2)
                        for j in range(m):
                            into[0, j * s] = -total * rice * omega[j]
                            for b in range(n):
                                into[1 + b, j * s] = into[0, j * s] * before[b]
                        add_sums(into, weights, mean, laws, hidden, before, after, level, sign, slopes, factors)


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
def _scatter(into, states, level, shares, weight, first, step, count):
    """Add to into (…) weight · shares (m s,) of exits at a level, to the states around it; states: (k,)."""
    k, p = place(level, first, step, count)
    line = lagrange(p)
    for n in range(4):
        if states[k + n] >= 0:
            for q in range(len(shares)):
                into[states[k + n] + q] += weight * line[n] * shares[q]


@njit(cache=True, nogil=True, error_model="numpy")
def exits_long_after(nodes, states, on, off, moments, stationary, resolvent, drift, exits, times):
    """Where a pixel exits that has forgotten its last event but its reference, which falls at the rate `drift`.

    nodes: (k,) references;  states: (2, k) of `transitions`;  on, off: thresholds;  moments: s, the first of which is
    the share itself;
    stationary: (k, 2 m s);  resolvent: (k, 2 m s, 2 m s).
    exits: (k, states) filled with shares of the exit states;  times: (k,) with mean times.
    """
    count, each = len(nodes), stationary.shape[1] // 2
    first, step = nodes[0], nodes[1] - nodes[0]
    rates = np.zeros((2, 2 * each))  # at this reference, and at the one below
    totals, shares = np.zeros(2), np.empty(2 * each)
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
                level = nodes[k] - u * step
                for i in range(2 * each):
                    shares[i] = (1.0 - u) * rates[0, i] / totals[0] + u * rates[1, i] / totals[1]
                _scatter(exits[k], states[0], level + on, shares[:each], gone, first, step, count)
                _scatter(exits[k], states[1], level - off, shares[each:], gone, first, step, count)
                still *= math.exp(-expected)
            times[k] += still * times[k - 1]
            for q in range(exits.shape[1]):
                exits[k, q] += still * exits[k - 1, q]
        else:
            times[k] = 1.0 / totals[0]
            _scatter(exits[k], states[0], nodes[k] + on, rates[0, :each], times[k], first, step, count)
            _scatter(exits[k], states[1], nodes[k] - off, rates[0, each:], times[k], first, step, count)


@njit(cache=True, nogil=True, error_model="numpy")
def transitions(
    nodes, states, slopes, start_spread, reference, reference_sd, offsets, offset_weights, on, off, draw_weights,
    soon_on, soon_off, at_on, at_off, resolvents, moved, late,
):  # fmt: skip
    """The Markov chain of events: moved (states, states) and late (states, draws, k), shares that soon reach the next
    event, and that first forget all but the reference.

    A state is (polarity, level of the output, slope, moment of the hidden states) at an event.
    states: (2, k) first of those of a polarity and level, −1 where there are none;
    on, off, draw_weights: (draws,) pairs of thresholds as they are drawn;  soon_on, soon_off: of `after_resets`;
    at_on, at_off: (draws, thresholds) what these contribute to a draw's;  resolvents: (draws, k, 2 m s, 2 m s);
    others as `after_resets`.
    """
    count, m, s = len(nodes), len(slopes), len(start_spread) + 1
    each = m * s
    first, step = nodes[0], nodes[1] - nodes[0]
    expected, quick = np.empty((2, each)), np.empty(2 * each)
    for i0 in range(2):
        for k0 in range(count):
            if states[i0, k0] < 0:
                continue
            for j0 in range(m):
                row = states[i0, k0] + j0 * s
                w = slopes[j0] if i0 == 0 else -slopes[j0]
                for g in range(len(offsets)):
                    kept = reference[0] * nodes[k0] + reference[1] * w + reference_sd * offsets[g]
                    kept = min(max(kept, nodes[0]), nodes[count - 1])
                    k, p = place(kept, first, step, count)
                    line = lagrange(p)
                    for a in range(len(draw_weights)):
                        share = offset_weights[g] * draw_weights[a]
                        for b in range(s):
                            expected[:] = 0.0
                            quick[:] = 0.0
                            for c in range(at_on.shape[1]):
                                if at_on[a, c] != 0.0:
                                    for q in range(each):
                                        expected[0, q] += at_on[a, c] * soon_on[i0, k0, j0, g, c, b, q]
                            for c in range(at_off.shape[1]):
                                if at_off[a, c] != 0.0:
                                    for q in range(each):
                                        expected[1, q] += at_off[a, c] * soon_off[i0, k0, j0, g, c, b, q]
                            for n in range(4):
                                for q in range(2 * each):
                                    part = line[n] * expected[q // each, q % each]
                                    for i in range(2 * each):
                                        quick[i] += part * resolvents[a, k + n, q, i]
                            left = start_spread[b - 1] * offsets[g] if b else 1.0
                            for i in range(2 * each):
                                if i % s == 0:
                                    left -= quick[i]
                            into = moved[row + b]
                            _scatter(into, states[0], kept + on[a], quick[:each], share, first, step, count)
                            _scatter(into, states[1], kept - off[a], quick[each:], share, first, step, count)
                            for n in range(4):
                                late[row + b, a, k + n] += share * left * line[n]
