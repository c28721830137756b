"""Steps of the four-state chain (photoreceptor, follower, amplifier), a block of them at a time in vector form.

Same closed form as `kernels.advance`.  Steps are those of many pixels, or from many samples.  All numbers of a block
stand in one flat work space `w`, row after row: LLVM sees from the constant distances of the rows that a loop's stores
do not touch what it reads later, so that a loop may take many rows without checks at run time.  Each loop does as much
as keeps several of its iterations in flight at once: one loop for everything waits for its own roots and quotients,
and one per row spends its time in loads and stores.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pixelid.dynamics import kernels
from pixelid.dynamics.vector_math import vexp, vsincos

# Steps in a block, and so the length of a row.  A block's calls cost about 1 µs, and what a loop reads has to stay in
# the cache.  Rows 49 cache lines apart: at a multiple of 4 KB, all rows compete for the same few places of the cache.
BLOCK = 392
REORDERED = {"contract", "reassoc", "nsz"}  # with these LLVM sums a loop in vector form; a maximum it does not take so
SHORT, RESOLVED = 0.2, 2.5  # largest |D τ²| for which the propagators are summed as power series, of 7 or 11 terms

# Rows.  BEGIN … + 5, END … + 5: (v, y, s, e, z, d) where the steps begin and end, of which four are read and written;
# light: U0, U1 log radiance and L0, L1 radiance at both ends;  K1, KD: exp(−w1 τ), exp(−wd τ);  R: slope of the light,
# RT: R times the photoreceptor's delay;  A, B2: its ωn² and 2ζωn;  F1, F2, G: its propagators;  P0 … Q1: responses.
BEGIN, END = 0, 6
V0, Y0, S0, D0 = BEGIN, BEGIN + 1, BEGIN + 2, BEGIN + 5
V1, Y1, S1, D1 = END, END + 1, END + 2, END + 5
U0, U1, L0, L1, TAU, K1, KD, R, RT, A, B2, F1, F2, G, P0, P1, Q0, Q1 = range(12, 30)
ROWS = 30


@njit(inline="always", error_model="numpy")
def factors(a, b2, tau):
    """(f1, f2, g) as `kernels.photoreceptor_factors`, without branches."""
    b = 0.5 * b2
    disc = b * b - a
    overdamped = disc > 0.0
    root = np.sqrt(abs(disc)) + 1e-200
    fast = b + root if overdamped else b
    slow = a / fast if overdamped else b
    e_slow = vexp(-slow * tau)
    e_fast = vexp(-fast * tau)
    phase = 0.0 if overdamped else root * tau
    sine, cosine = vsincos(phase)
    half = 0.5 / root
    g_real = (e_slow - e_fast) * half
    g_far = g_real if overdamped else 2.0 * half * e_slow * sine
    f1_far = (fast * e_slow - slow * e_fast) * half if overdamped else e_slow * cosine + b * g_far
    f2_far = (fast * e_fast - slow * e_slow) * half if overdamped else e_slow * cosine - b * g_far
    x = disc * tau * tau
    near = abs(x) < 0.3
    x = x if near else 0.0
    eb = np.sqrt(e_slow * e_fast)
    c = 1.0 + x * (0.5 + x * (1 / 24 + x * (1 / 720 + x * (1 / 40320 + x * (1 / 3628800 + x * (1 / 479001600))))))
    s = 1 / 5040 + x * (1 / 362880 + x * (1 / 39916800 + x * (1 / 6227020800)))
    s = 1.0 + x * (1 / 6 + x * (1 / 120 + x * s))
    g_near = eb * tau * s
    f_near = eb * c
    f1 = f_near + b * g_near if near else f1_far
    f2 = f_near - b * g_near if near else f2_far
    return f1, f2, g_near if near else g_far


@njit(inline="always", error_model="numpy")
def near_coincidence(a, b2, w1, wd, gap_1d):
    """Whether `kernels.advance` would leave the closed form: products of the poles' relative gaps."""
    return _coincide(a, a + w1 * (w1 - b2), a + wd * (wd - b2), w1, wd, gap_1d)


@njit(inline="always", error_model="numpy")
def _coincide(a, product1, productd, w1, wd, gap_1d):
    full1, fulld = w1 * w1 + a, wd * wd + a
    gap1, gapd = min(abs(product1), full1), min(abs(productd), fulld)
    least = kernels.COINCIDENCE
    return gap1 * gapd < least * full1 * fulld or gap1 * gap_1d < least * full1 or gapd * gap_1d < least * fulld


@njit(inline="always", error_model="numpy")
def delicate(a, b2, r, w1, wd):
    """Whether `kernels.advance` has to choose how to take a step: poles nearly coincide, or the ramp is steep."""
    steep = abs(r) * (b2 / a + 1.0 / w1 + 1.0 / wd) > kernels.STEEP
    return steep or near_coincidence(a, b2, w1, wd, abs(w1 - wd) / (w1 + wd))


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _linearise(w, n, dynamics, midpoint):
    """Fill A and B2 of steps between radiances L0 and L1."""
    if midpoint:
        for i in range(n):
            light = np.sqrt(w[i + L0 * BLOCK] * w[i + L1 * BLOCK])
            w[i + A * BLOCK], w[i + B2 * BLOCK] = kernels.photoreceptor_rates(dynamics, light)
    else:
        for i in range(n):
            w[i + A * BLOCK], w[i + B2 * BLOCK] = kernels.photoreceptor_rates(dynamics, w[i + L1 * BLOCK])


@njit(cache=True, nogil=True, error_model="numpy", fastmath=REORDERED)
def _beyond(w, n, most):
    """How many steps have |D τ²| ≥ `most`, D = b² − a: what the propagators' arguments are squares of."""
    count = 0.0
    for i in range(n):
        a, b, tau = w[i + A * BLOCK], 0.5 * w[i + B2 * BLOCK], w[i + TAU * BLOCK]
        count += 0.0 if abs(b * b - a) * (tau * tau) < most else 1.0
    return count


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _far_factors(w, n):
    for i in range(n):
        f1, f2, g = factors(w[i + A * BLOCK], w[i + B2 * BLOCK], w[i + TAU * BLOCK])
        w[i + F1 * BLOCK], w[i + F2 * BLOCK], w[i + G * BLOCK] = f1, f2, g


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _long_factors(w, n):
    """For |D τ²| ≤ RESOLVED: power series of cosh √x and sinh √x / √x, to 2e-16."""
    for i in range(n):
        tau, b = w[i + TAU * BLOCK], 0.5 * w[i + B2 * BLOCK]
        x = (b * b - w[i + A * BLOCK]) * tau * tau
        eb = vexp(-b * tau)
        c = 1.0 / 2432902008176640000.0
        c = c * x + 1.0 / 6402373705728000.0
        c = c * x + 1.0 / 20922789888000.0
        c = c * x + 1.0 / 87178291200.0
        c = c * x + 1.0 / 479001600.0
        c = c * x + 1.0 / 3628800.0
        c = c * x + 1.0 / 40320.0
        c = c * x + 1.0 / 720.0
        c = c * x + 1.0 / 24.0
        c = c * x + 0.5
        c = c * x + 1.0
        s = 1.0 / 51090942171709440000.0
        s = s * x + 1.0 / 121645100408832000.0
        s = s * x + 1.0 / 355687428096000.0
        s = s * x + 1.0 / 1307674368000.0
        s = s * x + 1.0 / 6227020800.0
        s = s * x + 1.0 / 39916800.0
        s = s * x + 1.0 / 362880.0
        s = s * x + 1.0 / 5040.0
        s = s * x + 1.0 / 120.0
        s = s * x + 1.0 / 6.0
        s = s * x + 1.0
        g = eb * s * tau
        w[i + F1 * BLOCK], w[i + F2 * BLOCK], w[i + G * BLOCK] = eb * c + b * g, eb * c - b * g, g


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _short_factors(w, n):
    """As `_long_factors` for |D τ²| ≤ SHORT."""
    for i in range(n):
        tau, b = w[i + TAU * BLOCK], 0.5 * w[i + B2 * BLOCK]
        x = (b * b - w[i + A * BLOCK]) * tau * tau
        eb = vexp(-b * tau)
        c = 1.0 / 40320.0 + x * (1.0 / 3628800.0 + x * (1.0 / 479001600.0))
        c = 1.0 + x * (0.5 + x * (1.0 / 24.0 + x * (1.0 / 720.0 + x * c)))
        s = 1.0 / 362880.0 + x * (1.0 / 39916800.0 + x * (1.0 / 6227020800.0))
        s = 1.0 + x * (1.0 / 6.0 + x * (1.0 / 120.0 + x * (1.0 / 5040.0 + x * s)))
        g = eb * s * tau
        w[i + F1 * BLOCK], w[i + F2 * BLOCK], w[i + G * BLOCK] = eb * c + b * g, eb * c - b * g, g


@njit(cache=True, nogil=True, error_model="numpy", fastmath=REORDERED)
def _responses(w, n, w1, wd):
    """Fill P0 … Q1 (`equations.responses`, one quotient for all three) and RT; how many steps are `delicate`, at most
    a few falsely."""
    behind, gap_1d = 1.0 / w1 + 1.0 / wd, abs(w1 - wd) / (w1 + wd)
    count = 0.0
    for i in range(n):
        a, b2, r = w[i + A * BLOCK], w[i + B2 * BLOCK], w[i + R * BLOCK]
        past1, pastd = w1 - b2, wd - b2
        product1, productd = a + w1 * past1, a + wd * pastd
        both = product1 * productd
        inverse = 1.0 / (both * a)
        delay = r * b2 * (inverse * both)
        q1, qd = w1 * (inverse * a) * productd, wd * (inverse * a) * product1
        p0, p1 = q1 * past1, -q1
        w[i + P0 * BLOCK], w[i + P1 * BLOCK] = p0, p1
        w[i + Q0 * BLOCK], w[i + Q1 * BLOCK] = qd * (p0 * pastd + a * p1), qd * (wd * p1 - p0)
        w[i + RT * BLOCK] = delay
        close = _coincide(a, product1, productd, w1, wd, gap_1d)
        count += 1.0 if close or abs(delay) + abs(r) * behind > 0.99 * kernels.STEEP else 0.0
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def _propagators(w, n):
    """Fill F1, F2 and G."""
    if _beyond(w, n, SHORT) == 0.0:
        _short_factors(w, n)
    elif _beyond(w, n, RESOLVED) == 0.0:
        _long_factors(w, n)
    else:
        _far_factors(w, n)


@njit(cache=True, nogil=True, error_model="numpy")
def coefficients(w, n, dynamics, midpoint):
    """Fill A … Q1 and RT of n ≤ BLOCK steps from L0, L1, TAU and R; how many of them may be `delicate`."""
    _linearise(w, n, dynamics, midpoint)
    _propagators(w, n)
    return _responses(w, n, dynamics.follower, dynamics.differencing)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def decays(w, n, w1, wd):
    """Fill K1 and KD."""
    for i in range(n):
        w[i + K1 * BLOCK] = vexp(-w1 * w[i + TAU * BLOCK])
    for i in range(n):
        w[i + KD * BLOCK] = vexp(-wd * w[i + TAU * BLOCK])


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _step(w, n, w1, wd):
    """Fill the states at END of steps that begin at BEGIN: `equations.modes_of` and `state_of`."""
    behind_1, behind_d, gain = 1.0 / w1, 1.0 / wd, wd / (wd - w1)
    for i in range(n):
        u0, r, delay_y = w[i + U0 * BLOCK], w[i + R * BLOCK], w[i + RT * BLOCK]
        p0, p1, q0, q1 = w[i + P0 * BLOCK], w[i + P1 * BLOCK], w[i + Q0 * BLOCK], w[i + Q1 * BLOCK]
        g = w[i + G * BLOCK]
        delay_s = delay_y + r * behind_1
        delay_d = delay_s + r * behind_d
        ey, ev = w[i + Y0 * BLOCK] - u0 + delay_y, w[i + V0 * BLOCK] - r
        m = w[i + S0 * BLOCK] - u0 + delay_s - p0 * ey - p1 * ev
        rest = w[i + D0 * BLOCK] - u0 + delay_d - q0 * ey - q1 * ev - gain * m
        after_y = w[i + F1 * BLOCK] * ey + g * ev
        after_v = w[i + F2 * BLOCK] * ev - w[i + A * BLOCK] * g * ey
        u1 = u0 + r * w[i + TAU * BLOCK]
        m = m * w[i + K1 * BLOCK]
        w[i + V1 * BLOCK] = r + after_v
        w[i + Y1 * BLOCK] = u1 - delay_y + after_y
        w[i + S1 * BLOCK] = u1 - delay_s + p0 * after_y + p1 * after_v + m
        w[i + D1 * BLOCK] = u1 - delay_d + q0 * after_y + q1 * after_v + gain * m + rest * w[i + KD * BLOCK]


@njit(cache=True, nogil=True, error_model="numpy")
def states_after(w, n, w1, wd):
    """Fill the states at END after other times TAU of steps whose other coefficients are known, none of them
    `delicate`; w1, wd: cutoffs of follower and amplifier."""
    _propagators(w, n)
    decays(w, n, w1, wd)
    _step(w, n, w1, wd)


@njit(cache=True, nogil=True, error_model="numpy")
def advance(w, n, dynamics, any_delicate):
    """Fill the states at END after TAU of the ramps U0 + R τ, from those at BEGIN, by the `coefficients`."""
    w1, w2, wh, wd = dynamics.follower, dynamics.extra_pole, dynamics.lower_cutoff, dynamics.differencing
    _step(w, n, w1, wd)
    if not any_delicate:
        return
    for i in range(n):
        a, b2, r = w[i + A * BLOCK], w[i + B2 * BLOCK], w[i + R * BLOCK]
        if delicate(a, b2, r, w1, wd):
            v, y, s, d = w[i + V0 * BLOCK], w[i + Y0 * BLOCK], w[i + S0 * BLOCK], w[i + D0 * BLOCK]
            v, y, s, _, _, d = kernels.advance(
                (v, y, s, s, 0.0, d), w[i + U0 * BLOCK], r, w[i + TAU * BLOCK], a, b2, w1, w2, wh, wd, False
            )
            w[i + V1 * BLOCK], w[i + Y1 * BLOCK], w[i + S1 * BLOCK], w[i + D1 * BLOCK] = v, y, s, d
