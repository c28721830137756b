"""One step of the four-state chain for a tile of pixels: `dynamics.blocks`, and how far outputs can swing."""

from __future__ import annotations

import numpy as np
from numba import njit

from pixelid.dynamics import blocks
from pixelid.dynamics.blocks import B2, BLOCK, D0, K1, KD, RT, S0, TAU, U0, U1, V0, Y0, A, R
from pixelid.dynamics.equations import PRESENT_BELOW

SPARE = blocks.ROWS  # the row after those of `blocks`: how far d can be from the mean of its ends


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _spare(w, n, one_pole, w1, wd, half_tau):
    """`step.slope_bound`, times half a step; w1, wd: 0 where absent."""
    if one_pole:
        for i in range(n):
            r = w[i + R * BLOCK]
            deviation = w[i + Y0 * BLOCK] - w[i + U0 * BLOCK] + w[i + RT * BLOCK]
            w[i + SPARE * BLOCK] = abs(r) + w[i + A * BLOCK] / w[i + B2 * BLOCK] * abs(deviation)
    else:
        for i in range(n):
            r = w[i + R * BLOCK]
            ey, ev = w[i + Y0 * BLOCK] - w[i + U0 * BLOCK] + w[i + RT * BLOCK], w[i + V0 * BLOCK] - r
            w[i + SPARE * BLOCK] = abs(r) + np.sqrt(ev * ev + w[i + A * BLOCK] * ey * ey)
    for i in range(n):
        s = w[i + S0 * BLOCK]
        behind = max(w1 * abs(w[i + Y0 * BLOCK] - s), wd * abs(s - w[i + D0 * BLOCK]))
        w[i + SPARE * BLOCK] = half_tau * max(w[i + SPARE * BLOCK], behind)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _same_step(w, n, tau, k1, kd):
    """One length of step for all, and the slopes of its light."""
    inverse = 1.0 / tau
    for i in range(n):
        w[i + TAU * BLOCK], w[i + K1 * BLOCK], w[i + KD * BLOCK] = tau, k1, kd
        w[i + R * BLOCK] = (w[i + U1 * BLOCK] - w[i + U0 * BLOCK]) * inverse


@njit(cache=True, nogil=True, error_model="numpy")
def advance(w, n, tau, dynamics, midpoint):
    """Take n ≤ BLOCK pixels a step of length tau on: fills the states at its end, the rows of `blocks.coefficients`, R
    and SPARE from the states at its beginning and from U0, U1, L0 and L1.

    The states e and z (extra pole, lower cutoff) are not touched: these stages are absent.

    Returns whether any step may be `blocks.delicate`.
    """
    w1, wd = dynamics.follower, dynamics.differencing
    _same_step(w, n, tau, np.exp(-w1 * tau), np.exp(-wd * tau))
    any_delicate = blocks.coefficients(w, n, dynamics, midpoint) > 0.0
    blocks.advance(w, n, dynamics, any_delicate)
    _spare(
        w, n, dynamics.beta > PRESENT_BELOW, w1 if w1 < PRESENT_BELOW else 0.0, wd if wd < PRESENT_BELOW else 0.0,
        0.5 * tau,
    )  # fmt: skip
    return any_delicate
