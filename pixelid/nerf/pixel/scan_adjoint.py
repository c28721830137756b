"""The gradient of one closed-form step of photoreceptor → follower → differencing amplifier, by hand.

`equations.step_two_poles` read backwards: the gradient λ by the state after a step becomes that by the state before it,
by the inputs at both ends and by (a, b2, ω1, ωd), at the cost of about two steps forwards.  The propagators of the
photoreceptor, with b = b2/2, D = b² − a, E = e^{−bτ}, C = cosh √D τ, S = sinh √D τ / √D, are f1,2 = E (C ± b S),
g = E S, and

    ∂C/∂D = τ S/2,     ∂S/∂D = (τ C − S)/(2 D),     a series in D τ² where that cancels.

Two real poles are differentiated one by one instead, which keeps the digits of the slow one next to a much faster one.
Checked against matrix exponentials (tests/unit/test_nerf_adjoint.py).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pixelid.dynamics import equations, kernels

_responses = njit(equations.responses, inline="always", error_model="numpy")
_modes_of = njit(equations.modes_of, inline="always", error_model="numpy")

VANISHED = 40.0  # e^−40 is nothing beside 1 in float64


@njit(cache=True, error_model="numpy")
def accurate(r, tau, a, b2, w1, wd):
    """Whether no poles nearly coincide, so that the closed form keeps its digits (as `kernels.advance` decides).

    r: slope of the input; that of a unit step of the input, 1/tau, has to pass too, since gradients are by the inputs
    """
    q1, qd, g = kernels.gap_to_photoreceptor(a, b2, w1), kernels.gap_to_photoreceptor(a, b2, wd), kernels.gap(w1, wd)
    steep = max(abs(r), 1.0 / tau) * (b2 / a + 1.0 / w1 + 1.0 / wd) / kernels.STEEP
    return min(q1 * qd, q1 * g, qd * g) >= kernels.COINCIDENCE * max(1.0, steep)


@njit(inline="always", error_model="numpy")
def _by_factors(a, b2, tau, factors, by_f1, by_f2, by_g):
    """(gradient by a, by b2) of the propagators (f1, f2, g) of `kernels.photoreceptor_factors`."""
    f1, f2, g = factors
    b = 0.5 * b2
    disc = b * b - a
    x = disc * tau * tau
    if x > 0.3:
        root = np.sqrt(disc)
        half, fast = 0.5 / root, b + root
        slow = a / fast
        e_slow = f1 - slow * g
        e_fast = f1 - fast * g if fast * tau < VANISHED else 0.0
        by_e_slow = half * (by_g + fast * by_f1 - slow * by_f2)
        by_e_fast = half * (fast * by_f2 - slow * by_f1 - by_g)
        by_slow = -half * (e_fast * by_f1 + e_slow * by_f2) - tau * e_slow * by_e_slow
        by_fast = half * (e_slow * by_f1 + e_fast * by_f2) - tau * e_fast * by_e_fast - by_slow * slow / fast
        by_root = by_fast - 2.0 * half * (f1 * by_f1 + f2 * by_f2 + g * by_g)
        return by_slow / fast - by_root * half, 0.5 * (by_fast + by_root * b / root)
    f, both, odd = 0.5 * (f1 + f2), by_f1 + by_f2, by_f1 - by_f2
    by_g = by_g + b * odd
    if x > -0.3:
        series = 1 / 6 + x * (1 / 60 + x * (1 / 1680 + x * (1 / 90720 + x * (1 / 7983360 + x / 1037836800))))
        change = np.exp(-b * tau) * tau * tau * tau * series
    else:
        change = 0.5 * (tau * f - g) / disc
    by_disc = 0.5 * tau * g * both + change * by_g
    by_b = g * odd - tau * (f * both + g * by_g) + 2.0 * b * by_disc
    return -by_disc, 0.5 * by_b


@njit(cache=True, error_model="numpy")
def step_back(state, u0, r, tau, a, b2, w1, wd, row):
    """(gradient by the state before, by the inputs before and after, by a, b2, ω1 and ωd) of row · the state after.

    state, row: (v, y, s, d);  u0 + r τ: the input
    """
    v, y, s, d = state
    row_v, row_y, row_s, row_d = row
    # the step, as in `equations.step_two_poles`
    ty = b2 / a
    ts = ty + 1.0 / w1
    td = ts + 1.0 / wd
    p0, p1, q0, q1 = _responses(a, b2, w1, wd)
    gain = wd / (wd - w1)
    ey, ev, m, m1, n = _modes_of((v, y, s, d), u0, r, (ty, ts, td), (p0, p1, q0, q1), gain)
    factors = kernels.photoreceptor_factors(a, b2, tau)
    f1, f2, g = factors
    k1, kd = np.exp(-w1 * tau), np.exp(-wd * tau)
    ey1, ev1 = f1 * ey + g * ev, f2 * ev - a * g * ey
    # its end
    by_u1 = row_y + row_s + row_d
    by_r = row_v - row_y * ty - row_s * ts - row_d * td + by_u1 * tau
    by_ty, by_ts, by_td = -r * row_y, -r * row_s, -r * row_d
    by_ey1, by_ev1 = row_y + p0 * row_s + q0 * row_d, row_v + p1 * row_s + q1 * row_d
    by_p0, by_p1, by_q0, by_q1 = row_s * ey1, row_s * ev1, row_d * ey1, row_d * ev1
    by_n = row_d * kd
    by_m1 = row_d * k1 - by_n
    by_m = row_s * k1 + by_m1 * gain
    by_a, by_b2 = _by_factors(a, b2, tau, factors, by_ey1 * ey, by_ev1 * ev, by_ey1 * ev - a * by_ev1 * ey)
    by_a -= g * ey * by_ev1
    # its beginning: modes of the state
    by_ey = f1 * by_ey1 - a * g * by_ev1 - by_n * q0 - by_m * p0
    by_ev = g * by_ey1 + f2 * by_ev1 - by_n * q1 - by_m * p1
    by_r += by_n * td + by_m * ts + by_ey * ty - by_ev
    by_td += by_n * r
    by_ts += by_m * r + by_td
    by_ty += by_ey * r + by_ts
    by_p0 -= by_m * ey
    by_p1 -= by_m * ev
    by_q0 -= by_n * ey
    by_q1 -= by_n * ev
    by_u0 = by_u1 - by_n - by_m - by_ey
    # responses: q from p and Q = ωd/(a + ωd (ωd − b2)), p from P likewise
    under_q, under_p = 1.0 / (a + wd * (wd - b2)), 1.0 / (a + w1 * (w1 - b2))
    q, p = wd * under_q, w1 * under_p
    by_q = by_q0 * (p0 * (wd - b2) + a * p1) + by_q1 * (wd * p1 - p0)
    by_p0 += q * (by_q0 * (wd - b2) - by_q1)
    by_p1 += q * (by_q0 * a + by_q1 * wd)
    by_p = by_p0 * (w1 - b2) - by_p1
    by_a += by_q0 * q * p1 - by_q * q * under_q - by_p * p * under_p - by_ty * ty / a
    by_b2 += by_q * q * q - by_q0 * q * p0 + by_p * p * p - by_p0 * p + by_ty / a
    by_gain = by_m1 * m / (wd - w1)
    by_w1 = by_p0 * p + by_p * under_p * (1.0 - p * (2.0 * w1 - b2)) + by_gain * gain - by_ts / (w1 * w1)
    by_w1 -= tau * k1 * (row_s * m + row_d * m1)
    by_wd = q * (by_q0 * p0 + by_q1 * p1) + by_q * under_q * (1.0 - q * (2.0 * wd - b2)) - by_td / (wd * wd)
    by_wd -= by_gain * w1 / (wd - w1) + tau * kd * row_d * n
    return (by_ev, by_ey, by_m, by_n), by_u0 - by_r / tau, by_r / tau, by_a, by_b2, by_w1, by_wd
