"""The four-state step (photoreceptor, follower, differencing amplifier) in vector form.

Same closed form as `kernels.advance`, arranged so that LLVM runs four steps or pixels at a time: transcendental
functions from `vector_math`, selections instead of branches.  Steps whose poles nearly coincide are flagged for
`kernels.advance`.  Real values only; photoreceptor of one or two poles.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pixelid.dynamics import equations, kernels
from pixelid.dynamics.equations import PRESENT_BELOW
from pixelid.dynamics.vector_math import vexp, vsincos

BLOCK = 256
RESOLVED = 2.5  # largest |D τ²| for which the propagators are summed as power series
_low_pass_response = njit(equations.low_pass_response, inline="always", error_model="numpy")


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
    c = 1.0 + x * (0.5 + x * (1 / 24 + x * (1 / 720 + x * (1 / 40320 + x * (1 / 3628800 + x / 479001600)))))
    s = 1.0 + x * (1 / 6 + x * (1 / 120 + x * (1 / 5040 + x * (1 / 362880 + x * (1 / 39916800 + x / 6227020800)))))
    g_near = eb * tau * s
    f_near = eb * c
    f1 = f_near + b * g_near if near else f1_far
    f2 = f_near - b * g_near if near else f2_far
    return f1, f2, g_near if near else g_far


@njit(inline="always", error_model="numpy")
def near_coincidence(a, b2, w1, wd, gap_1d):
    """Whether `kernels.advance` would leave the closed form: products of the poles' relative gaps."""
    full1, fulld = w1 * w1 + a, wd * wd + a
    gap1, gapd = min(abs(a + w1 * (w1 - b2)), full1), min(abs(a + wd * (wd - b2)), fulld)
    least = kernels.COINCIDENCE
    return gap1 * gapd < least * full1 * fulld or gap1 * gap_1d < least * full1 or gapd * gap_1d < least * fulld


# The loops below are kept apart, few arrays each: LLVM gives up on vectorising a loop that would need too many
# run-time checks for overlapping arrays, or an index such as k − 1.


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def linearise(alpha, beta, gamma, L0, L1, midpoint, a, b2):
    """Fill a = ωn² and b2 = 2ζωn of steps between radiances L0 and L1."""
    if midpoint:
        for k in range(len(a)):
            lin = np.sqrt(L0[k] * L1[k])
            a[k] = alpha * lin
            b2[k] = beta + gamma * lin
    else:
        for k in range(len(a)):
            a[k] = alpha * L1[k]
            b2[k] = beta + gamma * L1[k]


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def fill_factors(a, b2, tau, f1, f2, g):
    """Fill the photoreceptor's propagators."""
    for k in range(len(a)):
        f1[k], f2[k], g[k] = factors(a[k], b2[k], tau[k])


@njit(cache=True, error_model="numpy", fastmath={"contract", "nnan"})
def largest_phase(a, b2, tau):
    """The largest |D τ²| of the steps, D = b² − a: what the propagators' arguments are squares of."""
    largest = 0.0
    for k in range(len(a)):
        largest = max(largest, abs(0.25 * b2[k] * b2[k] - a[k]) * tau[k] * tau[k])
    return largest


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def fill_resolved_factors(a, b2, tau, f1, f2, g):
    """As `fill_factors` for |D τ²| ≤ RESOLVED: power series of cosh √x and sinh √x / √x, to 2e-16."""
    for k in range(len(a)):
        b = 0.5 * b2[k]
        x = (b * b - a[k]) * tau[k] * tau[k]
        eb = vexp(-b * tau[k])
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
        f2[k] = eb * c
        g[k] = eb * s * tau[k]
    for k in range(len(a)):
        f1[k] = f2[k] + 0.5 * b2[k] * g[k]
    for k in range(len(a)):
        f2[k] = f2[k] - 0.5 * b2[k] * g[k]


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def fill_responses(a, b2, w1, wd, p0, p1, q0, q1, close):
    """Fill the follower's and the amplifier's response coefficients, and where poles nearly coincide."""
    gap_1d = abs(w1 - wd) / (w1 + wd)
    for k in range(len(a)):
        x0, x1 = _low_pass_response(1.0, 0.0, a[k], b2[k], w1)
        p0[k] = x0
        p1[k] = x1
        q0[k], q1[k] = _low_pass_response(x0, x1, a[k], b2[k], wd)
        close[k] = 1.0 if near_coincidence(a[k], b2[k], w1, wd, gap_1d) else 0.0


def applicable(dynamics) -> bool:
    """Whether these dynamics (real tuple) have the plain four-state structure this module handles."""
    alpha, beta, gamma, w1, w2, wh, wd = dynamics
    if isinstance(alpha, complex) or w2 < PRESENT_BELOW or wh > 0 or (beta > PRESENT_BELOW and gamma == 0):
        return False
    return not kernels.cutoffs_coincide(w1, w2, wh, wd)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def scan(t, u, L, dynamics, midpoint, states):
    """As `kernels.scan`: coefficients of a block of steps in vector form, then the recurrence through the block."""
    alpha, beta, gamma, w1, w2, wh, wd = dynamics
    n = len(t)
    tau_, a_, b2_, close = np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    f1_, f2_, g_ = np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    p0_, p1_, q0_, q1_ = np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    v, y, s, d = 0.0, u[0], u[0], u[0]
    states[0, 0], states[0, 1], states[0, 2], states[0, 3], states[0, 4], states[0, 5] = v, y, s, s, 0.0, d
    inv1, invd, gain = 1.0 / w1, 1.0 / wd, wd / (wd - w1)
    tau_before, k1, kd = -1.0, 0.0, 0.0
    for start in range(1, n, BLOCK):
        size = min(BLOCK, n - start)
        before, after = t[start - 1 : start - 1 + size], t[start : start + size]
        for j in range(size):
            tau_[j] = after[j] - before[j]
        linearise(
            alpha, beta, gamma, L[start - 1 : start - 1 + size], L[start : start + size], midpoint,
            a_[:size], b2_[:size],
        )  # fmt: skip
        if largest_phase(a_[:size], b2_[:size], tau_[:size]) < RESOLVED:
            fill_resolved_factors(a_[:size], b2_[:size], tau_[:size], f1_, f2_, g_)
        else:
            fill_factors(a_[:size], b2_[:size], tau_[:size], f1_, f2_, g_)
        fill_responses(a_[:size], b2_[:size], w1, wd, p0_, p1_, q0_, q1_, close)
        for j in range(size):
            k = start + j
            tau = tau_[j]
            if tau > 0.0:
                r = (u[k] - u[k - 1]) / tau
                if close[j] > 0.0:
                    v, y, s, _, _, d = kernels.advance(
                        (v, y, s, s, 0.0, d), u[k - 1], r, tau, a_[j], b2_[j], w1, w2, wh, wd, False
                    )
                else:
                    if abs(tau - tau_before) > 1e-13 * tau:
                        k1, kd = np.exp(-w1 * tau), np.exp(-wd * tau)
                        tau_before = tau
                    ramp_y = u[k - 1] - r * b2_[j] / a_[j]
                    ramp_s = ramp_y - r * inv1
                    ramp_d = ramp_s - r * invd
                    grown = r * tau
                    ev = v - r
                    ey = y - ramp_y
                    m = s - ramp_s - p0_[j] * ey - p1_[j] * ev
                    m1 = m * gain
                    rest = d - ramp_d - q0_[j] * ey - q1_[j] * ev - m1
                    ey1 = f1_[j] * ey + g_[j] * ev
                    ev1 = f2_[j] * ev - a_[j] * g_[j] * ey
                    v = r + ev1
                    y = ramp_y + grown + ey1
                    s = ramp_s + grown + p0_[j] * ey1 + p1_[j] * ev1 + m * k1
                    d = ramp_d + grown + q0_[j] * ey1 + q1_[j] * ev1 + m1 * k1 + rest * kd
            states[k, 0] = v
            states[k, 1] = y
            states[k, 2] = s
            states[k, 3] = s
            states[k, 4] = 0.0
            states[k, 5] = d


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _decay(rate, tau, out):
    for k in range(len(out)):
        out[k] = vexp(-rate * tau[k])


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _advance_photoreceptor(v, y, r, a, b2, f1, f2, g, ev, ey):
    """In: slope v and output deviation y of the block; out: their deviations before (v, y) and after (ev, ey)."""
    for k in range(len(v)):
        before_v = v[k] - r[k]
        before_y = y[k] + r[k] * b2[k] / a[k]
        v[k] = before_v
        y[k] = before_y
        ey[k] = f1[k] * before_y + g[k] * before_v
        ev[k] = f2[k] * before_v - a[k] * g[k] * before_y


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _advance_follower(s, v, y, ev, ey, p0, p1, k1, m):
    """In: s relative to its ramp; out: s after, and m, the amplitude of its own exponential."""
    for k in range(len(s)):
        m[k] = s[k] - p0[k] * y[k] - p1[k] * v[k]
        s[k] = p0[k] * ey[k] + p1[k] * ev[k] + m[k] * k1[k]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _gather(times, step, t, u, L, states, tau, r, u0, L0, L1, v, y, s, d):
    """Where in its step each time lies, the light there, and the state the step begins with; y relative to u0."""
    for j in range(len(times)):
        k = step[j]
        after = min(k + 1, len(t) - 1)
        tau[j] = max(times[j] - t[k], 0.0)
        width = t[after] - t[k]
        u0[j] = u[k]
        r[j] = (u[after] - u[k]) / width if width > 0.0 else 0.0
        L0[j], L1[j] = L[k], L[after]
        v[j], y[j], s[j], d[j] = states[k, 0], states[k, 1] - u[k], states[k, 2], states[k, 5]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def states_at(times, step, t, u, L, dynamics, midpoint, states, out):
    """Fill out (m, 6) with the states at `times`, each inside the step that begins at sample step[i].

    As `kernels.within_step`, in vector form over blocks of times.
    """
    alpha, beta, gamma, w1, w2, wh, wd = dynamics
    inv1, invd, gain = 1.0 / w1, 1.0 / wd, wd / (wd - w1)
    table = np.empty((20, BLOCK))
    for start in range(0, len(times), BLOCK):
        size = min(BLOCK, len(times) - start)
        tau, r, u0, L0, L1 = table[0, :size], table[1, :size], table[2, :size], table[3, :size], table[4, :size]
        v, y, s, d = table[5, :size], table[6, :size], table[7, :size], table[8, :size]
        a, b2, f1, f2, g = table[9, :size], table[10, :size], table[11, :size], table[12, :size], table[13, :size]
        p0, p1, q0, q1 = table[14, :size], table[15, :size], table[16, :size], table[17, :size]
        close, k1 = table[18, :size], table[19, :size]
        place = slice(start, start + size)
        _gather(times[place], step[place], t, u, L, states, tau, r, u0, L0, L1, v, y, s, d)
        linearise(alpha, beta, gamma, L0, L1, midpoint, a, b2)
        if largest_phase(a, b2, tau) < RESOLVED:
            fill_resolved_factors(a, b2, tau, f1, f2, g)
        else:
            fill_factors(a, b2, tau, f1, f2, g)
        fill_responses(a, b2, w1, wd, p0, p1, q0, q1, close)
        _decay(w1, tau, k1)
        ev, ey, kd = L0, L1, g  # reused: no longer needed under their names
        _advance_photoreceptor(v, y, r, a, b2, f1, f2, g, ev, ey)
        _decay(wd, tau, kd)
        m = f1
        for j in range(size):
            delay = b2[j] / a[j] + inv1
            f2[j] = delay
            s[j] = s[j] - u0[j] + r[j] * delay
        _advance_follower(s, v, y, ev, ey, p0, p1, k1, m)
        for j in range(size):
            i = start + j
            if close[j] > 0.0:
                k = step[i]
                lv, ly, ls, _, _, ld = kernels.advance(
                    (states[k, 0], states[k, 1], states[k, 2], states[k, 3], 0.0, states[k, 5]),
                    u0[j], r[j], tau[j], a[j], b2[j], w1, w2, wh, wd, False,
                )  # fmt: skip
                out[i, 0], out[i, 1], out[i, 2], out[i, 3], out[i, 4], out[i, 5] = lv, ly, ls, ls, 0.0, ld
                continue
            delay = f2[j]
            m1 = m[j] * gain
            rest = d[j] - u0[j] + r[j] * (delay + invd) - q0[j] * y[j] - q1[j] * v[j] - m1
            here = u0[j] + r[j] * tau[j]
            out[i, 0] = r[j] + ev[j]
            out[i, 1] = here - r[j] * (delay - inv1) + ey[j]
            out[i, 2] = here - r[j] * delay + s[j]
            out[i, 3] = out[i, 2]
            out[i, 4] = 0.0
            out[i, 5] = here - r[j] * (delay + invd) + q0[j] * ey[j] + q1[j] * ev[j] + m1 * k1[j] + rest * kd[j]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _relative_to_ramp(s, u0, r, a, b2, inv1, delay):
    """Fill the delay of the follower's ramp, and take s relative to it."""
    for k in range(len(s)):
        delay[k] = b2[k] / a[k] + inv1
    for k in range(len(s)):
        s[k] = s[k] - u0[k] + r[k] * delay[k]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _advance_amplifier(s, d, u0, r, tau, delay, invd, y, v, ey, ev, q0, q1, m, gain, k1, kd):
    """In: s after (relative to its ramp), d before; out: follower s and amplifier d after."""
    for k in range(len(d)):
        m[k] = m[k] * gain
    for k in range(len(d)):
        d[k] = d[k] - u0[k] + r[k] * (delay[k] + invd) - q0[k] * y[k] - q1[k] * v[k] - m[k]
    for k in range(len(d)):
        d[k] = q0[k] * ey[k] + q1[k] * ev[k] + m[k] * k1[k] + d[k] * kd[k]
    for k in range(len(d)):
        s[k] = s[k] + u0[k] + r[k] * (tau[k] - delay[k])
    for k in range(len(d)):
        d[k] = d[k] + u0[k] + r[k] * (tau[k] - delay[k] - invd)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def outputs_at(times, step, t, u, L, dynamics, midpoint, states, follower, amplifier):
    """Fill the follower's and the amplifier's outputs (m,) at `times`; otherwise as `states_at`."""
    alpha, beta, gamma, w1, w2, wh, wd = dynamics
    inv1, invd, gain = 1.0 / w1, 1.0 / wd, wd / (wd - w1)
    table = np.empty((19, BLOCK))
    for start in range(0, len(times), BLOCK):
        size = min(BLOCK, len(times) - start)
        place = slice(start, start + size)
        tau, r, u0, L0, L1 = table[0, :size], table[1, :size], table[2, :size], table[3, :size], table[4, :size]
        v, y, delay, m, close = table[5, :size], table[6, :size], table[7, :size], table[8, :size], table[9, :size]
        a, b2, f1, f2, g = table[10, :size], table[11, :size], table[12, :size], table[13, :size], table[14, :size]
        p0, p1, q0, q1 = table[15, :size], table[16, :size], table[17, :size], table[18, :size]
        s, d = follower[place], amplifier[place]
        _gather(times[place], step[place], t, u, L, states, tau, r, u0, L0, L1, v, y, s, d)
        linearise(alpha, beta, gamma, L0, L1, midpoint, a, b2)
        if largest_phase(a, b2, tau) < RESOLVED:
            fill_resolved_factors(a, b2, tau, f1, f2, g)
        else:
            fill_factors(a, b2, tau, f1, f2, g)
        fill_responses(a, b2, w1, wd, p0, p1, q0, q1, close)
        ev, ey, k1, kd = L0, L1, f1, f2  # reused: no longer needed under their names
        _advance_photoreceptor(v, y, r, a, b2, f1, f2, g, ev, ey)
        _decay(w1, tau, k1)
        _decay(wd, tau, kd)
        _relative_to_ramp(s, u0, r, a, b2, inv1, delay)
        _advance_follower(s, v, y, ev, ey, p0, p1, k1, m)
        _advance_amplifier(s, d, u0, r, tau, delay, invd, y, v, ey, ev, q0, q1, m, gain, k1, kd)
        for j in range(size):
            if close[j] > 0.0:
                k = step[start + j]
                _, _, s[j], _, _, d[j] = kernels.advance(
                    (states[k, 0], states[k, 1], states[k, 2], states[k, 3], 0.0, states[k, 5]),
                    u0[j], r[j], tau[j], a[j], b2[j], w1, w2, wh, wd, False,
                )  # fmt: skip
