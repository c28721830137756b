"""One step where poles nearly coincide: the exponential of the small matrix of the stages that are present.

The closed form of `equations.py` divides by every difference of poles, so it loses the digits of the product of
their relative gaps.  Here nothing is divided.  Only + − × on the components (and √a, to bring the slope to the
scale of the others), so complex steps pass through as exactly as through the closed form, which divided
differences of conjugate poles would not allow.

Of an ordinary step the power series is summed on the state itself, stage by stage (`_by_series`), in a sixth of the
time or less.  Of a long one exp(M) − 1 is summed at M/2^s and doubled s times as F ← 2F + F²: without the identity in
it, slow stages keep their relative accuracy under many doublings.  About 3 µs a step.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pixelid.dynamics.equations import PRESENT_BELOW

REACH = 4.0  # largest norm of a matrix whose power series is summed
ORDINARY = 24.0  # norm of the step up to which that is cheaper than the matrix's exponential
# 1/k!, k = 1 … 12: the remainder at a norm of 1/4 is 0.25^13/13! = 2e-18.
_C = tuple(1.0 / np.cumprod(np.arange(1.0, 13.0)))


@njit(cache=True, error_model="numpy")
def _product(X, Y, out):
    """out = X Y for matrices whose entries above the first superdiagonal vanish, here and in the product.

    The chain is lower triangular but for the pair (slope, output) of the photoreceptor.
    """
    m = len(X)
    for i in range(m):
        for j in range(min(i + 2, m)):
            total = X[i, 0] * 0.0
            for k in range(max(j - 1, 0), min(i + 2, m)):
                total += X[i, k] * Y[k, j]
            out[i, j] = total


@njit(cache=True, error_model="numpy")
def _exp_minus_one(M):
    """exp(M) − 1, by Paterson & Stockmeyer's arrangement of the twelfth-order series and doubling."""
    norm = 0.0
    for i in range(len(M)):
        norm = max(norm, np.abs(M[i]).sum())
    doublings = max(0, int(np.ceil(np.log2(max(norm, 1e-300)))) + 2)
    M = M * 0.5**doublings
    M2, M3, F, P = np.zeros_like(M), np.zeros_like(M), np.zeros_like(M), np.zeros_like(M)
    _product(M, M, M2)
    _product(M2, M, M3)
    F[:] = _C[11] * M3
    for k in (8, 5, 2):
        F += _C[k] * np.eye(len(M)) + _C[k + 1] * M + _C[k + 2] * M2
        _product(F, M3, P)
        F, P = P, F
    F += _C[0] * M + _C[1] * M2
    for _ in range(doublings):
        _product(F, F, P)
        F = 2.0 * F + P
    return F


@njit(inline="always", error_model="numpy")
def _low_pass(M, x, at, drive, rate, value):
    """Puts a low-pass at index `at` of the system; returns the index."""
    M[at, drive], M[at, at] = rate, -rate
    x[at] = value
    return at


@njit(cache=True, error_model="numpy")
def _by_series(state, u0, r, tau, a, b2, w1, w2, wh, wd, norm):
    """As `advance`, by power series over parts of the step whose norm is at most `REACH`.

    Rounding errors grow by e^REACH, to some 1e-14 of the deviation from steady state.
    """
    v, y, s, e, z, d = state
    parts = int(norm / REACH) + 1
    h = tau / parts
    terms, rest = 3, 1.0  # the derivative that a complex step carries lags behind by a term
    while rest > 1e-18:
        terms += 1
        rest *= norm / parts / (terms - 3)
    wn, corner, ramp = np.sqrt(a), a / b2, r * h
    two, one = b2.real < PRESENT_BELOW, corner.real < PRESENT_BELOW
    has_1, has_2, has_h, has_d = w1.real < PRESENT_BELOW, w2.real < PRESENT_BELOW, wh.real > 0, wd.real < PRESENT_BELOW
    an, bn, cn, k1, k2, kh, kd = wn * h, b2 * h, corner * h, w1 * h, w2 * h, wh * h, wd * h
    zero = (v + r + a + w1 + w2 + wh + wd) * 0.0
    U, P, Y, Z = zero, zero + v / wn, zero + y - u0 if two or one else zero, zero + z - u0 if has_h else zero
    S = zero + s - u0 if has_1 else Y
    E = zero + e - u0 if has_2 else S
    D = zero + d - (zero if has_h else u0) if has_d else E - Z
    for _ in range(parts):
        u, p, y, s, e, z, d = U, P, Y, S, E, Z, D
        for k in range(1, terms + 1):
            share = 1.0 / k
            du = ramp + zero if k == 1 else zero
            dp = share * (an * (u - y) - bn * p) if two else zero
            dy = share * an * p if two else (share * cn * (u - y) if one else du)
            ds = share * k1 * (y - s) if has_1 else dy
            de = share * k2 * (s - e) if has_2 else ds
            dz = share * kh * (e - z) if has_h else zero
            d = share * kd * (e - z - d) if has_d else de - dz
            u, p, y, s, e, z = du, dp, dy, ds, de, dz
            U, P, Y, S, E, Z, D = U + u, P + p, Y + y, S + s, E + e, Z + z, D + d
    v = wn * P if two else (corner * (U - Y) if one else r + zero)
    return v, Y + u0, S + u0, E + u0, Z + u0 if has_h else state[4] + zero, D if has_h else D + u0


@njit(cache=True, error_model="numpy")
def advance(state, u0, r, tau, a, b2, w1, w2, wh, wd):
    """As `kernels.advance`: the six-component state after `tau` of the input ramp u0 + r τ.

    Components: the input's rate and the input first, then the states in signal order, all relative to u0, so
    that the error is eps times the deviation from steady state.
    """
    fastest = 2.0 * np.sqrt(a.real) + b2.real if b2.real < PRESENT_BELOW else 0.0
    corner = a / b2
    for rate in (2.0 * corner.real, 2.0 * w1.real, 2.0 * w2.real, 2.0 * wh.real, 3.0 * wd.real):
        if rate < PRESENT_BELOW:
            fastest = max(fastest, rate)
    if fastest * tau.real < ORDINARY:
        return _by_series(state, u0, r, tau, a, b2, w1, w2, wh, wd, fastest * tau.real)
    v, y, s, e, z, d = state
    M = np.zeros((8, 8), dtype=np.array([v]).dtype)
    x = np.zeros(8, dtype=M.dtype)
    x[0] = r * tau
    M[1, 0] = 1.0
    signal = 1  # where the signal stands that drives the next stage
    wn = np.sqrt(a)
    if b2.real < PRESENT_BELOW:
        M[2, 1], M[2, 2], M[2, 3], M[3, 2] = wn * tau, -b2 * tau, -wn * tau, wn * tau
        x[2], x[3] = v / wn, y - u0
        signal = 3
    elif corner.real < PRESENT_BELOW:
        signal = _low_pass(M, x, 2, signal, corner * tau, y - u0)
    at_y = signal
    if w1.real < PRESENT_BELOW:
        signal = _low_pass(M, x, signal + 1, signal, w1 * tau, s - u0)
    at_s = signal
    if w2.real < PRESENT_BELOW:
        signal = _low_pass(M, x, signal + 1, signal, w2 * tau, e - u0)
    at_e = at_z = last = signal
    if wh.real > 0:
        at_z = last = _low_pass(M, x, last + 1, at_e, wh * tau, z - u0)
    if wd.real < PRESENT_BELOW:
        last = _low_pass(M, x, last + 1, at_e, wd * tau, d - u0)
        if wh.real > 0:
            x[last] = d
            M[last, at_z] = -wd * tau
    size = last + 1
    x = x[:size] + _exp_minus_one(M[:size, :size]) @ x[:size]

    if at_y == 1:
        v = r
    elif b2.real < PRESENT_BELOW:
        v = wn * x[2]
    else:
        v = corner * (x[1] - x[2])
    level = x[at_e]
    if wh.real > 0:
        level, z = x[at_e] - x[at_z] - u0, x[at_z] + u0
    if wd.real < PRESENT_BELOW:
        level = x[last] if wh.real == 0 else x[last] - u0
    return v, x[at_y] + u0, x[at_s] + u0, x[at_e] + u0, z, level + u0
