"""First passages over time, as compiled sums: the renewal equation of `first_passage.py` on a grid of lags."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from pixelid.tables.noise.crossings import add_at_lag, lagrange, means_after_crossing, means_after_reset, place


@njit(cache=True, nogil=True, error_model="numpy")
def crossings_after_events(
    share, states, nodes, slopes, factors, maps, spread, tails, laws, hidden, start_spread, reference, reference_sd,
    offsets, offset_weights, on, off, draw_weights, crossed, begun,
):  # fmt: skip
    """crossed (2, draws, k, lags, 2 m s): intensities after an ON or OFF event, by reference;  begun: their mass.

    share: (states,) of the events;  states: (2, k);  others as `crossings.transitions`.
    """
    count, m, h, lags = len(nodes), len(slopes), len(start_spread), maps.shape[2]
    s = h + 1
    first, step = nodes[0], nodes[1] - nodes[0]
    signs = (1.0, -1.0)
    mean, after, found = np.empty((2, lags)), np.empty((h, lags)), np.empty((s, 2 * m * s))
    for i0 in range(2):
        for k0 in range(count):
            if states[i0, k0] < 0:
                continue
            for j0 in range(m):
                row = states[i0, k0] + j0 * s
                if abs(share[row]) < 1e-9:
                    continue
                z, w = nodes[k0], signs[i0] * slopes[j0]
                for g in range(len(offsets)):
                    kept = reference[0] * z + reference[1] * w + reference_sd * offsets[g]
                    kept = min(max(kept, nodes[0]), nodes[count - 1])
                    k, p = place(kept, first, step, count)
                    line = lagrange(p)
                    before = start_spread * offsets[g]
                    means_after_reset(maps, spread, tails, hidden, z, w, offsets[g], kept, mean, after)
                    mass = share[row]
                    for b in range(h):
                        mass += share[row + 1 + b] * before[b]
                    for a in range(len(draw_weights)):
                        weight = offset_weights[g] * draw_weights[a]
                        for n in range(4):
                            begun[i0, a, k + n] += weight * mass * line[n]
                        levels = (kept + on[a], kept - off[a])
                        for t in range(lags):
                            found[:] = 0.0
                            add_at_lag(found, weight, t, mean, laws, hidden, before, after, levels, slopes, factors)
                            for i in range(2 * m * s):
                                part = 0.0
                                for b in range(s):
                                    part += share[row + b] * found[b, i]
                                for n in range(4):
                                    crossed[i0, a, k + n, t, i] += line[n] * part


@njit(cache=True, nogil=True, error_model="numpy")
def crossings_between(means, laws, hidden, on, off, slopes, factors, found):
    """found (lags, 2 m s, 2 m s): intensities a lag after a crossing, see `crossings.between_crossings`."""
    m, n, lags = len(slopes), hidden[0].shape[0], means.shape[2]
    s = n + 1
    levels = (on, off)
    signs = (1.0, -1.0)
    before, mean, after = np.zeros(n), np.empty((2, lags)), np.empty((n, lags))
    for i0 in range(2):
        for j0 in range(m):
            row = (i0 * m + j0) * s
            means_after_crossing(means, hidden, levels[i0], signs[i0] * slopes[j0], mean, after)
            for t in range(lags):
                into = found[t, row : row + s]
                into[:] = 0.0
                add_at_lag(into, 1.0, t, mean, laws, hidden, before, after, levels, slopes, factors)


@njit(cache=True, nogil=True, error_model="numpy")
def first_passages(lags, crossed, between, passed):
    """passed (sources, lags, 2 m s): first passages until each lag.

    crossed: (sources, lags, 2 m s) intensities;  between: (lags, 2 m s, 2 m s).  Both are summed over ln t first: then
    the renewal equation N = Q + ∫ dQ I has no singular term, and Q is explicit but for the cell in progress.
    """
    count, size = len(lags), between.shape[1]
    ratio = math.log(lags[1] / lags[0])
    cumulative = np.zeros_like(between)
    for t in range(1, count):
        cumulative[t] = cumulative[t - 1] + 0.5 * ratio * (lags[t] * between[t] + lags[t - 1] * between[t - 1])
    sources = crossed.shape[0]
    gained = np.empty((sources, size))
    weights = np.empty((size, size))
    total = np.zeros((sources, size))
    for t in range(1, count):
        for s in range(sources):
            for i in range(size):
                total[s, i] += 0.5 * ratio * (lags[t] * crossed[s, t, i] + lags[t - 1] * crossed[s, t - 1, i])
                gained[s, i] = total[s, i]
        for r in range(1, t):
            # mean crossings that a first passage in cell r has been followed by until lag t
            _at(lags[t] - 0.5 * (lags[r] + lags[r - 1]), lags, cumulative, weights)
            for s in range(sources):
                for q in range(size):
                    part = passed[s, r, q] - passed[s, r - 1, q]
                    if part != 0.0:
                        for i in range(size):
                            gained[s, i] -= part * weights[q, i]
        _at(0.5 * (lags[t] - lags[t - 1]), lags, cumulative, weights)
        for s in range(sources):
            for i in range(size):
                passed[s, t, i] = gained[s, i]
            # crossings that follow within the cell in progress: one correction, they are few
            for i in range(size):
                for q in range(size):
                    passed[s, t, i] -= (gained[s, q] - passed[s, t - 1, q]) * weights[q, i]


@njit(forceinline=True, error_model="numpy")
def _at(lag, lags, cumulative, found):
    """Linear in ln t between the lags, 0 before the first."""
    u = math.log(lag / lags[0]) / math.log(lags[1] / lags[0])
    if u <= 0.0:
        found[:] = 0.0
        return
    k = min(int(u), len(lags) - 2)
    p = u - k
    for i in range(found.shape[0]):
        for j in range(found.shape[1]):
            found[i, j] = (1.0 - p) * cumulative[k, i, j] + p * cumulative[k + 1, i, j]
