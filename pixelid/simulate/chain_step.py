"""One step of the four-state chain for a tile of pixels, in vector form.

The closed form of `equations.step_two_poles`, its coefficients by `vectorised`, spread over loops that each write one
array and read few: LLVM vectorises those (see `vectorised`).  Pixels whose poles nearly coincide are redone by
`kernels.advance`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pixelid.dynamics import kernels, vectorised
from pixelid.dynamics.equations import PRESENT_BELOW

WORK_ROWS = 16


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _deviations(y, v, u0, r, a, b2, ey, ev, ramp):
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
def _outputs(ramp, r, tau, ey, ev, p0, p1, q0, q1, m, n, delay_s, delay_d, k1, kd, gain_k1, v, y, s, d):
    for i in range(len(ramp)):
        v[i] = r[i] + ev[i]
    for i in range(len(ramp)):
        y[i] = ramp[i] + r[i] * tau + ey[i]
    for i in range(len(ramp)):
        s[i] = ramp[i] + r[i] * (tau - delay_s) + p0[i] * ey[i] + p1[i] * ev[i] + m[i] * k1
    for i in range(len(ramp)):
        d[i] = ramp[i] + r[i] * (tau - delay_d) + q0[i] * ey[i] + q1[i] * ev[i]
    for i in range(len(ramp)):
        d[i] = d[i] + m[i] * gain_k1 + n[i] * kd


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _bounds(r, ey, ev, a, b2, one_pole, y, s, d, w1, wd, half_tau, spare):
    """`step.slope_bound`, times half a step; w1, wd: 0 where absent."""
    if one_pole:
        for i in range(len(r)):
            corner = a[i] / b2[i]
            spare[i] = abs(r[i]) + corner * abs(ey[i])
    else:
        for i in range(len(r)):
            spare[i] = abs(r[i]) + np.sqrt(ev[i] * ev[i] + a[i] * ey[i] * ey[i])
    for i in range(len(r)):
        spare[i] = half_tau * max(spare[i], max(w1 * abs(y[i] - s[i]), wd * abs(s[i] - d[i])))


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _slopes(u0, u1, tau, r):
    inverse = 1.0 / tau
    for i in range(len(r)):
        r[i] = (u1[i] - u0[i]) * inverse


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def advance(u0, u1, L0, L1, tau, dynamics, midpoint, begin, end, a, b2, r, spare, work):
    """Fill `end` (6, n), a, b2, r (n,) and spare (n,), how far d can stray from the mean of its ends.

    u0, u1, L0, L1: (n,) log radiance and radiance at both ends;  begin: (6, n);  work: (WORK_ROWS, n).
    Rows 3 and 4 (extra pole, lower cutoff) are not touched: these stages are absent.
    """
    alpha, beta, gamma, w1, _, _, wd = dynamics
    f1, f2, g, p0, p1, q0, q1 = work[0], work[1], work[2], work[3], work[4], work[5], work[6]
    close, tau_, ey, ev, ey1, ev1 = work[7], work[8], work[9], work[10], work[11], work[12]
    m, n, ramp = work[13], work[14], work[15]
    for i in range(len(tau_)):
        tau_[i] = tau
    delay_s = 1.0 / w1
    delay_d = delay_s + 1.0 / wd
    gain = wd / (wd - w1)
    k1, kd = np.exp(-w1 * tau), np.exp(-wd * tau)
    _slopes(u0, u1, tau, r)
    vectorised.linearise(alpha, beta, gamma, L0, L1, midpoint, a, b2)
    if vectorised.largest_phase(a, b2, tau_) < vectorised.RESOLVED:
        vectorised.fill_resolved_factors(a, b2, tau_, f1, f2, g)
    else:
        vectorised.fill_factors(a, b2, tau_, f1, f2, g)
    vectorised.fill_responses(a, b2, w1, wd, p0, p1, q0, q1, close)
    _deviations(begin[1], begin[0], u0, r, a, b2, ey, ev, ramp)
    _modes(begin[2], begin[5], ramp, r, ey, ev, p0, p1, q0, q1, delay_s, delay_d, gain, m, n)
    _propagate(a, f1, f2, g, ey, ev, ey1, ev1)
    _outputs(
        ramp, r, tau, ey1, ev1, p0, p1, q0, q1, m, n, delay_s, delay_d, k1, kd, gain * k1,
        end[0], end[1], end[2], end[5],
    )  # fmt: skip
    _bounds(
        r, ey, ev, a, b2, beta > PRESENT_BELOW, begin[1], begin[2], begin[5],
        w1 if w1 < PRESENT_BELOW else 0.0, wd if wd < PRESENT_BELOW else 0.0, 0.5 * tau, spare,
    )  # fmt: skip
    for i in range(len(a)):
        steep = abs(r[i]) * (b2[i] / a[i] + delay_d) > kernels.STEEP
        if close[i] > 0.0 or steep:
            v, y, s, _, _, d = kernels.advance(
                (begin[0, i], begin[1, i], begin[2, i], begin[2, i], 0.0, begin[5, i]),
                u0[i], r[i], tau, a[i], b2[i], w1, dynamics[4], 0.0, wd, False,
            )  # fmt: skip
            end[0, i], end[1, i], end[2, i], end[5, i] = v, y, s, d
