"""One step of the four-state chain for a tile of pixels: `dynamics.vectorised`, and how far outputs can swing."""

from __future__ import annotations

import numpy as np
from numba import njit

from pixelid.dynamics import vectorised
from pixelid.dynamics.equations import PRESENT_BELOW

WORK_ROWS = vectorised.WORK + 3


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


@njit(cache=True, nogil=True, error_model="numpy")
def advance(u0, u1, L0, L1, tau, dynamics, midpoint, begin, end, c, r, spare, work):
    """Fill `end` (6, n), c (`vectorised.COEFFICIENTS`, n), r (n,) and spare (n,), how far d can be from the mean of
    its ends.

    u0, u1, L0, L1: (n,) log radiance and radiance at both ends;  begin: (6, n);  work: (WORK_ROWS, n).
    Rows 3 and 4 (extra pole, lower cutoff) are not touched: these stages are absent.
    """
    w1, wd = dynamics.follower, dynamics.differencing
    tau_, k1, kd = work[vectorised.WORK], work[vectorised.WORK + 1], work[vectorised.WORK + 2]
    tau_[:], k1[:], kd[:] = tau, np.exp(-w1 * tau), np.exp(-wd * tau)
    _slopes(u0, u1, tau, r)
    vectorised.coefficients(dynamics, L0, L1, tau_, midpoint, c)
    vectorised.advance(
        (begin[0], begin[1], begin[2], begin[5]), (end[0], end[1], end[2], end[5]),
        u0, r, tau_, k1, kd, c, dynamics, work[: vectorised.WORK],
    )  # fmt: skip
    _bounds(
        r, work[0], work[1], c[0], c[1], dynamics.beta > PRESENT_BELOW, begin[1], begin[2], begin[5],
        w1 if w1 < PRESENT_BELOW else 0.0, wd if wd < PRESENT_BELOW else 0.0, 0.5 * tau, spare,
    )  # fmt: skip
