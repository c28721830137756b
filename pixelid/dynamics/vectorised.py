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

BLOCK = 512  # steps taken together: a block's calls cost about 1 µs, its rows (4 KB each) have to stay in the cache
REORDERED = {"contract", "reassoc", "nsz"}  # with these LLVM sums a loop in vector form; a maximum it does not take so
RESOLVED = 2.5  # largest |D τ²| for which the propagators are summed as power series
_responses = njit(equations.responses, inline="always", error_model="numpy")
_modes_of = njit(equations.modes_of, inline="always", error_model="numpy")
_state_of = njit(equations.state_of, inline="always", error_model="numpy")

COEFFICIENTS = 10  # rows of a block's coefficients: a, b2, f1, f2, g, p0, p1, q0, q1, whether poles nearly coincide
WORK = 7  # rows of scratch space of `advance`


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
def linearise(dynamics, L0, L1, midpoint, a, b2):
    """Fill a = ωn² and b2 = 2ζωn of steps between radiances L0 and L1."""
    if midpoint:
        for k in range(len(a)):
            a[k], b2[k] = kernels.photoreceptor_rates(dynamics, np.sqrt(L0[k] * L1[k]))
    else:
        for k in range(len(a)):
            a[k], b2[k] = kernels.photoreceptor_rates(dynamics, L1[k])


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def fill_factors(a, b2, tau, f1, f2, g):
    """Fill the photoreceptor's propagators."""
    for k in range(len(a)):
        f1[k], f2[k], g[k] = factors(a[k], b2[k], tau[k])


@njit(cache=True, error_model="numpy", fastmath=REORDERED)
def unresolved(a, b2, tau):
    """How many steps have |D τ²| ≥ RESOLVED, D = b² − a: what the propagators' arguments are squares of."""
    count = 0.0
    for k in range(len(a)):
        count += 0.0 if abs(0.25 * b2[k] * b2[k] - a[k]) * tau[k] * tau[k] < RESOLVED else 1.0
    return count


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
        p0[k], p1[k], q0[k], q1[k] = _responses(a[k], b2[k], w1, wd)
        close[k] = 1.0 if near_coincidence(a[k], b2[k], w1, wd, gap_1d) else 0.0


def applicable(dynamics) -> bool:
    """Whether these dynamics have the plain four-state structure this module handles."""
    unlimited = dynamics.beta > PRESENT_BELOW and dynamics.gamma == 0
    if dynamics.extra_pole < PRESENT_BELOW or dynamics.lower_cutoff > 0 or unlimited:
        return False
    return not kernels.cutoffs_coincide(*dynamics[3:7])


@njit(cache=True, nogil=True, error_model="numpy")
def coefficients(dynamics, L0, L1, tau, midpoint, c):
    """Fill c (COEFFICIENTS, n) of the steps of length tau (n,) between radiances L0 and L1 (n,)."""
    a, b2 = c[0], c[1]
    linearise(dynamics, L0, L1, midpoint, a, b2)
    if unresolved(a, b2, tau) == 0.0:
        fill_resolved_factors(a, b2, tau, c[2], c[3], c[4])
    else:
        fill_factors(a, b2, tau, c[2], c[3], c[4])
    fill_responses(a, b2, dynamics.follower, dynamics.differencing, c[5], c[6], c[7], c[8], c[9])


@njit(inline="always", error_model="numpy")
def _delicate(close, r, a, b2, behind):
    """Whether `kernels.advance` has to choose how to take a step: poles nearly coincide, or the ramp is steep."""
    return close > 0.0 or abs(r) * (b2 / a + behind) > kernels.STEEP


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def scan(t, u, L, dynamics, midpoint, states):
    """As `kernels.scan`: coefficients of a block of steps in vector form, then the recurrence through the block."""
    w1, w2, wh, wd = dynamics.follower, dynamics.extra_pole, dynamics.lower_cutoff, dynamics.differencing
    n = len(t)
    tau_, c_ = np.empty(BLOCK), np.empty((COEFFICIENTS, BLOCK))
    v, y, s, d = 0.0, u[0], u[0], u[0]
    states[0, 0], states[0, 1], states[0, 2], states[0, 3], states[0, 4], states[0, 5] = v, y, s, s, 0.0, d
    inv1, invd, gain = 1.0 / w1, 1.0 / wd, wd / (wd - w1)
    tau_before, k1, kd = -1.0, 0.0, 0.0
    for start in range(1, n, BLOCK):
        size = min(BLOCK, n - start)
        before, after = t[start - 1 : start - 1 + size], t[start : start + size]
        c = c_ if size == BLOCK else np.empty((COEFFICIENTS, size))
        for j in range(size):
            tau_[j] = after[j] - before[j]
        coefficients(dynamics, L[start - 1 : start - 1 + size], L[start : start + size], tau_[:size], midpoint, c)
        for j in range(size):
            k = start + j
            tau = tau_[j]
            if tau > 0.0:
                u0, a, b2 = u[k - 1], c[0, j], c[1, j]
                r = (u[k] - u0) / tau
                if _delicate(c[9, j], r, a, b2, inv1 + invd):
                    v, y, s, _, _, d = kernels.advance((v, y, s, s, 0.0, d), u0, r, tau, a, b2, w1, w2, wh, wd, False)
                else:
                    if abs(tau - tau_before) > 1e-13 * tau:
                        k1, kd = np.exp(-w1 * tau), np.exp(-wd * tau)
                        tau_before = tau
                    ty = b2 / a
                    delays, pq = (ty, ty + inv1, ty + inv1 + invd), (c[5, j], c[6, j], c[7, j], c[8, j])
                    modes = _modes_of((v, y, s, d), u0, r, delays, pq, gain)
                    pr = (c[2, j], c[3, j], c[4, j])
                    v, y, s, d = _state_of(modes, u0 + r * tau, r, a, pr, delays, pq, k1, kd)
            states[k, 0] = v
            states[k, 1] = y
            states[k, 2] = s
            states[k, 3] = s
            states[k, 4] = 0.0
            states[k, 5] = d


# One step of many pixels, or from many samples, in the form of `equations.modes_of` and `state_of`: each loop writes
# one array and reads few.


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _deviations(v, y, u0, r, a, b2, ey, ev, ramp):
    for i in range(len(y)):
        ramp[i] = u0[i] - r[i] * b2[i] / a[i]
    for i in range(len(y)):
        ey[i] = y[i] - ramp[i]
    for i in range(len(y)):
        ev[i] = v[i] - r[i]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _modes(s, d, ramp, r, ey, ev, p0, p1, q0, q1, delay_s, delay_d, gain, m, n):
    for i in range(len(s)):
        m[i] = s[i] - ramp[i] + r[i] * delay_s - p0[i] * ey[i] - p1[i] * ev[i]
    for i in range(len(s)):
        n[i] = d[i] - ramp[i] - q0[i] * ey[i] - q1[i] * ev[i]
    for i in range(len(s)):
        n[i] = n[i] + r[i] * delay_d - m[i] * gain


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _propagate(a, f1, f2, g, ey, ev, ey1, ev1):
    for i in range(len(a)):
        ey1[i] = f1[i] * ey[i] + g[i] * ev[i]
    for i in range(len(a)):
        ev1[i] = f2[i] * ev[i] - a[i] * g[i] * ey[i]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _outputs(ramp, r, tau, ey, ev, p0, p1, q0, q1, m, n, delay_s, delay_d, k1, kd, gain, v, y, s, d):
    for i in range(len(v)):
        v[i] = r[i] + ev[i]
    for i in range(len(y)):
        y[i] = ramp[i] + r[i] * tau[i] + ey[i]
    for i in range(len(ramp)):
        s[i] = ramp[i] + r[i] * (tau[i] - delay_s) + p0[i] * ey[i] + p1[i] * ev[i] + m[i] * k1[i]
    for i in range(len(ramp)):
        d[i] = ramp[i] + r[i] * (tau[i] - delay_d) + q0[i] * ey[i] + q1[i] * ev[i]
    for i in range(len(ramp)):
        d[i] = d[i] + gain * m[i] * k1[i] + n[i] * kd[i]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=REORDERED)
def _any_delicate(close, r, u0, ramp, behind):
    """Whether any step is `_delicate`; at most a few are falsely said to be."""
    count = 0.0
    for i in range(len(r)):
        count += 1.0 if abs(u0[i] - ramp[i]) + abs(r[i]) * behind > 0.99 * kernels.STEEP else close[i]
    return count > 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def advance(begin, end, u0, r, tau, k1, kd, c, dynamics, work):
    """Fill `end` with the states after tau (n,) of the ramps u0 + r τ (n,), from `begin`; both (v, y, s, d) of (n,).

    k1, kd: (n,) exp(−w1 τ), exp(−wd τ);  c: of `coefficients`;  work: (WORK, n), whose first rows (ε_y, ε_v) are left
    as at the beginning.  `begin` and `end` must not share memory; the v and y of `end` may be empty, where nobody reads
    them.
    """
    w1, w2, wh, wd = dynamics.follower, dynamics.extra_pole, dynamics.lower_cutoff, dynamics.differencing
    v, y, s, d = begin
    a, b2, f1, f2, g, p0, p1, q0, q1, close = c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8], c[9]
    ey, ev, ey1, ev1, m, n, ramp = work[0], work[1], work[2], work[3], work[4], work[5], work[6]
    delay_s = 1.0 / w1
    delay_d = delay_s + 1.0 / wd
    gain = wd / (wd - w1)
    _deviations(v, y, u0, r, a, b2, ey, ev, ramp)
    _modes(s, d, ramp, r, ey, ev, p0, p1, q0, q1, delay_s, delay_d, gain, m, n)
    _propagate(a, f1, f2, g, ey, ev, ey1, ev1)
    _outputs(ramp, r, tau, ey1, ev1, p0, p1, q0, q1, m, n, delay_s, delay_d, k1, kd, gain, *end)
    if not _any_delicate(close, r, u0, ramp, delay_d):
        return
    for i in range(len(a)):
        if _delicate(close[i], r[i], a[i], b2[i], delay_d):
            slope, output, end[2][i], _, _, end[3][i] = kernels.advance(
                (v[i], y[i], s[i], s[i], 0.0, d[i]), u0[i], r[i], tau[i], a[i], b2[i], w1, w2, wh, wd, False
            )
            if len(end[0]) > 0:
                end[0][i], end[1][i] = slope, output


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _decay(rate, tau, out):
    for k in range(len(out)):
        out[k] = vexp(-rate * tau[k])


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _gather(times, step, t, u, L, states, tau, r, u0, L0, L1, v, y, s, d):
    """Where in its step each time lies, the light there, and the state the step begins with."""
    for j in range(len(times)):
        k = step[j]
        after = min(k + 1, len(t) - 1)
        tau[j] = max(times[j] - t[k], 0.0)
        width = t[after] - t[k]
        u0[j] = u[k]
        r[j] = (u[after] - u[k]) / width if width > 0.0 else 0.0
        L0[j], L1[j] = L[k], L[after]
        v[j], y[j], s[j], d[j] = states[k, 0], states[k, 1], states[k, 2], states[k, 5]


@njit(cache=True, nogil=True, error_model="numpy")
def stages_at(times, step, t, u, L, dynamics, midpoint, states, v, y, s, d):
    """Fill (v, y, s, d), (m,) each, at `times` (m,), each in the step that begins at sample step[i].

    v and y may be empty: not wanted.
    """
    table_, c_, work_ = np.empty((11, BLOCK)), np.empty((COEFFICIENTS, BLOCK)), np.empty((WORK, BLOCK))
    for start in range(0, len(times), BLOCK):
        size = min(BLOCK, len(times) - start)
        place = slice(start, start + size)
        table, c, work = table_, c_, work_
        if size < BLOCK:
            table, c, work = np.empty((11, size)), np.empty((COEFFICIENTS, size)), np.empty((WORK, size))
        tau, r, u0, L0, L1, k1, kd = table[0], table[1], table[2], table[3], table[4], table[5], table[6]
        begin = (table[7], table[8], table[9], table[10])
        _gather(times[place], step[place], t, u, L, states, tau, r, u0, L0, L1, begin[0], begin[1], begin[2], begin[3])
        coefficients(dynamics, L0, L1, tau, midpoint, c)
        _decay(dynamics.follower, tau, k1)
        _decay(dynamics.differencing, tau, kd)
        end = (v[place], y[place], s[place], d[place])
        advance(begin, end, u0, r, tau, k1, kd, c, dynamics, work)


def states_at(times, step, t, u, L, dynamics, midpoint, states, out) -> None:
    """As `kernels.states_at`."""
    v, y, s, d = np.empty((4, len(times)))
    stages_at(times, step, t, u, L, dynamics, midpoint, states, v, y, s, d)
    for column, values in enumerate((v, y, s, s, 0.0, d)):
        out[:, column] = values
