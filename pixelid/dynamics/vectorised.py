"""The four-state chain (photoreceptor, follower, differencing amplifier): scans, and states between samples.

Same closed form as `kernels.advance`, a block of steps at a time (`blocks.py`).  Steps whose poles nearly coincide are
left to `kernels.advance`.  Real values only; photoreceptor of one or two poles.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pixelid.dynamics import blocks, equations, kernels
from pixelid.dynamics.blocks import (
    B2,
    BLOCK,
    D0,
    D1,
    F1,
    F2,
    K1,
    KD,
    L0,
    L1,
    P0,
    P1,
    Q0,
    Q1,
    RT,
    S0,
    S1,
    TAU,
    U0,
    U1,
    V0,
    V1,
    Y0,
    Y1,
    A,
    G,
    R,
)  # fmt: skip
from pixelid.dynamics.equations import PRESENT_BELOW

_step_two_poles = njit(equations.step_two_poles, inline="always", error_model="numpy")

# Rows of a scan, after those of `blocks`: the step as a linear map of the states less the light,
# y1 = F1 y + G v + Y_1 and so on.
Y_1, V_Y, V_1, S_Y, S_V, S_1, D_Y, D_V, D_S, D_1 = range(blocks.ROWS, blocks.ROWS + 10)
SCAN_ROWS = blocks.ROWS + 10
ALIKE = 1e-4  # largest w (τ − τ') for which exp(−w τ) follows from exp(−w τ') by four terms, to 1e-18


def applicable(dynamics) -> bool:
    """Whether these dynamics have the plain four-state structure this module handles."""
    unlimited = dynamics.beta > PRESENT_BELOW and dynamics.gamma == 0
    if dynamics.extra_pole < PRESENT_BELOW or dynamics.lower_cutoff > 0 or unlimited:
        return False
    return not kernels.cutoffs_coincide(*dynamics[3:7])


@njit(cache=True, nogil=True, error_model="numpy")
def scan(t, u, L, dynamics, midpoint, states):
    """As `kernels.scan`: the steps of a block as linear maps in vector form, then one after the other."""
    w1, wd = dynamics.follower, dynamics.differencing
    n = len(t)
    w = np.zeros(SCAN_ROWS * BLOCK)
    v, y, s, d = 0.0, u[0], u[0], u[0]
    states[0, 0], states[0, 1], states[0, 2], states[0, 3], states[0, 4], states[0, 5] = v, y, s, s, 0.0, d
    for start in range(1, n, BLOCK):
        size = min(BLOCK, n - start)
        _fill(t, u, L, start, size, w)
        _decays_of_steps(w, size, w1, wd)
        if blocks.coefficients(w, size, dynamics, midpoint) > 0.0:
            v, y, s, d = _one_by_one(w, size, dynamics, start, v, y, s, d, states)
        else:
            _maps(w, size, w1, wd)
            v, y, s, d = _recur(w, size, start, v, y, s, d, states)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _fill(t, u, L, start, n, w):
    """The light of n steps, the first of which ends at sample `start`."""
    for i in range(n):
        k = start + i
        tau = t[k] - t[k - 1]
        w[i + TAU * BLOCK] = tau
        w[i + U0 * BLOCK], w[i + U1 * BLOCK], w[i + L0 * BLOCK], w[i + L1 * BLOCK] = u[k - 1], u[k], L[k - 1], L[k]
    for i in range(n):
        tau = w[i + TAU * BLOCK]
        rise = w[i + U1 * BLOCK] - w[i + U0 * BLOCK]
        w[i + R * BLOCK] = rise / tau if tau > 0.0 else 0.0


@njit(cache=True, nogil=True, error_model="numpy", fastmath=blocks.REORDERED)
def _unlike(w, n, tau, most):
    """How many of the steps' lengths differ from tau by more than `most`."""
    count = 0.0
    for i in range(n):
        count += 1.0 if abs(w[i + TAU * BLOCK] - tau) > most else 0.0
    return count


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _decays_of_steps(w, n, w1, wd):
    """Fill K1 and KD; steps of one length, but for rounding, share their exponentials."""
    tau = w[TAU * BLOCK]
    present1, presentd = w1 < PRESENT_BELOW, wd < PRESENT_BELOW
    most = min(ALIKE / w1 if present1 else np.inf, ALIKE / wd if presentd else np.inf)
    if _unlike(w, n, tau, most) > 0.0:
        blocks.decays(w, n, w1, wd)
        return
    k1, kd = np.exp(-w1 * tau), np.exp(-wd * tau)
    rate1, rated = w1 if present1 else 0.0, wd if presentd else 0.0
    for i in range(n):
        x = rate1 * (tau - w[i + TAU * BLOCK])
        w[i + K1 * BLOCK] = k1 * (1.0 + x * (1.0 + x * (0.5 + x * (1.0 / 6.0))))
        x = rated * (tau - w[i + TAU * BLOCK])
        w[i + KD * BLOCK] = kd * (1.0 + x * (1.0 + x * (0.5 + x * (1.0 / 6.0))))


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _maps(w, n, w1, wd):
    """Fill Y_1 … D_1: `equations.modes_of` and `state_of`, collected by the state that each term multiplies."""
    behind_1, behind_d, gain = 1.0 / w1, 1.0 / wd, wd / (wd - w1)
    for i in range(n):
        f1, f2, g = w[i + F1 * BLOCK], w[i + F2 * BLOCK], w[i + G * BLOCK]
        p0, p1, q0, q1 = w[i + P0 * BLOCK], w[i + P1 * BLOCK], w[i + Q0 * BLOCK], w[i + Q1 * BLOCK]
        k1, kd = w[i + K1 * BLOCK], w[i + KD * BLOCK]
        back = -w[i + A * BLOCK] * g
        d_s = gain * (k1 - kd)
        w[i + V_Y * BLOCK] = back
        w[i + S_Y * BLOCK] = p0 * (f1 - k1) + p1 * back
        w[i + S_V * BLOCK] = p1 * (f2 - k1) + p0 * g
        w[i + D_Y * BLOCK] = q0 * (f1 - kd) + q1 * back - d_s * p0
        w[i + D_V * BLOCK] = q1 * (f2 - kd) + q0 * g - d_s * p1
        w[i + D_S * BLOCK] = d_s
    for i in range(n):
        r, delay_y = w[i + R * BLOCK], w[i + RT * BLOCK]
        delay_s = delay_y + r * behind_1
        delay_d = delay_s + r * behind_d
        w[i + Y_1 * BLOCK] = (w[i + F1 * BLOCK] - 1.0) * delay_y - w[i + G * BLOCK] * r
        w[i + V_1 * BLOCK] = (1.0 - w[i + F2 * BLOCK]) * r + w[i + V_Y * BLOCK] * delay_y
        of_s = (w[i + K1 * BLOCK] - 1.0) * delay_s
        w[i + S_1 * BLOCK] = of_s + w[i + S_Y * BLOCK] * delay_y - w[i + S_V * BLOCK] * r
        of_d = (w[i + KD * BLOCK] - 1.0) * delay_d + w[i + D_S * BLOCK] * delay_s
        w[i + D_1 * BLOCK] = of_d + w[i + D_Y * BLOCK] * delay_y - w[i + D_V * BLOCK] * r


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _recur(w, n, start, v, y, s, d, states):
    """Fill the states after each of n steps, the first of which ends at sample `start`; the last of them.

    Carried are v, and the others less the light, from which they differ little.
    """
    y, s, d = y - w[U0 * BLOCK], s - w[U0 * BLOCK], d - w[U0 * BLOCK]
    light = w[U0 * BLOCK]
    for i in range(n):
        light = w[i + U1 * BLOCK]
        if w[i + TAU * BLOCK] > 0.0:
            own = w[i + KD * BLOCK] * d + (w[i + D_V * BLOCK] * v + w[i + D_1 * BLOCK])
            d = own + (w[i + D_Y * BLOCK] * y + w[i + D_S * BLOCK] * s)
            s = w[i + K1 * BLOCK] * s + (w[i + S_Y * BLOCK] * y + (w[i + S_V * BLOCK] * v + w[i + S_1 * BLOCK]))
            after = w[i + F2 * BLOCK] * v + (w[i + V_Y * BLOCK] * y + w[i + V_1 * BLOCK])
            y = w[i + F1 * BLOCK] * y + (w[i + G * BLOCK] * v + w[i + Y_1 * BLOCK])
            v = after
        else:
            jump = light - w[i + U0 * BLOCK]
            y, s, d = y - jump, s - jump, d - jump
        k = start + i
        states[k, 0], states[k, 1], states[k, 2] = v, light + y, light + s
        states[k, 3], states[k, 4], states[k, 5] = light + s, 0.0, light + d
    return v, light + y, light + s, light + d


@njit(cache=True, nogil=True, error_model="numpy")
def _one_by_one(w, n, dynamics, start, v, y, s, d, states):
    """As `_recur`, each step by whatever form suits it."""
    w1, w2, wh, wd = dynamics.follower, dynamics.extra_pole, dynamics.lower_cutoff, dynamics.differencing
    for i in range(n):
        tau = w[i + TAU * BLOCK]
        if tau > 0.0:
            u0, r, a, b2 = w[i + U0 * BLOCK], w[i + R * BLOCK], w[i + A * BLOCK], w[i + B2 * BLOCK]
            if blocks.delicate(a, b2, r, w1, wd):
                v, y, s, _, _, d = kernels.advance((v, y, s, s, 0.0, d), u0, r, tau, a, b2, w1, w2, wh, wd, False)
            else:
                pr = (w[i + F1 * BLOCK], w[i + F2 * BLOCK], w[i + G * BLOCK])
                k1, kd = w[i + K1 * BLOCK], w[i + KD * BLOCK]
                v, y, s, d = _step_two_poles((v, y, s, d), u0, r, tau, a, b2, w1, wd, pr, k1, kd)
        k = start + i
        states[k, 0], states[k, 1], states[k, 2], states[k, 3], states[k, 4], states[k, 5] = v, y, s, s, 0.0, d
    return v, y, s, d


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _gather(times, step, start, n, t, u, L, states, w):
    """Where in its step each of the times start … start + n − 1 lies, the light there, and the state it begins with."""
    last = len(t) - 1
    for i in range(n):
        k = step[start + i]
        after = min(k + 1, last)
        w[i + TAU * BLOCK] = max(times[start + i] - t[k], 0.0)
        w[i + U1 * BLOCK] = t[after] - t[k]
        w[i + U0 * BLOCK], w[i + R * BLOCK] = u[k], u[after] - u[k]
        w[i + L0 * BLOCK], w[i + L1 * BLOCK] = L[k], L[after]
        w[i + V0 * BLOCK], w[i + Y0 * BLOCK] = states[k, 0], states[k, 1]
        w[i + S0 * BLOCK], w[i + D0 * BLOCK] = states[k, 2], states[k, 5]
    for i in range(n):
        width = w[i + U1 * BLOCK]
        w[i + R * BLOCK] = w[i + R * BLOCK] / width if width > 0.0 else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def stages_at(times, step, t, u, L, dynamics, midpoint, states, v, y, s, d):
    """Fill (v, y, s, d), (m,) each, at `times` (m,), each in the step that begins at sample step[i].

    v and y may be empty: not wanted.
    """
    w = np.zeros(blocks.ROWS * BLOCK)
    for start in range(0, len(times), BLOCK):
        size = min(BLOCK, len(times) - start)
        _gather(times, step, start, size, t, u, L, states, w)
        any_delicate = blocks.coefficients(w, size, dynamics, midpoint) > 0.0
        blocks.decays(w, size, dynamics.follower, dynamics.differencing)
        blocks.advance(w, size, dynamics, any_delicate)
        for i in range(size):
            s[start + i] = w[i + S1 * BLOCK]
        for i in range(size):
            d[start + i] = w[i + D1 * BLOCK]
        if len(v) > 0:
            for i in range(size):
                v[start + i], y[start + i] = w[i + V1 * BLOCK], w[i + Y1 * BLOCK]


def states_at(times, step, t, u, L, dynamics, midpoint, states, out) -> None:
    """As `kernels.states_at`."""
    v, y, s, d = np.empty((4, len(times)))
    stages_at(times, step, t, u, L, dynamics, midpoint, states, v, y, s, d)
    for column, values in enumerate((v, y, s, s, 0.0, d)):
        out[:, column] = values
