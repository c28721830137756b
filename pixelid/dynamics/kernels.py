"""The closed-form step of `equations.py`, compiled.

Works on float64 and, for exact derivatives by complex steps (Squire & Trapp, SIAM Review 40, 1998), on
complex128.  A pixel's linear dynamics travel as the tuple (α, β, γ, w1, w2, wh, wd) of `Dynamics`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pixelid.dynamics import equations
from pixelid.dynamics.equations import PRESENT_BELOW

_step_two_poles = njit(equations.step_two_poles, inline="always")
_step_full_chain = njit(equations.step_full_chain, inline="always")

# The closed form divides by differences of poles.  Poles closer than COINCIDENCE (relatively) are stepped
# around: the step is an analytic function of the cutoffs, so it is evaluated at cutoffs moved by ±h, ±2h, ±3h
# (each stage by its own multiple, so that no pair stays together) and interpolated back to zero displacement.
# Error O(h⁶) ≈ 1e-12 of the step's change; the exactly coincident case is covered like any other.
COINCIDENCE = 1e-3
NUDGE = 0.004
NUDGE_WEIGHTS = (0.75, -0.3, 0.05)


@njit(cache=True)
def photoreceptor_factors(a, b2, tau):
    """(f1, f2, g) that propagate (ε_y, ε_v) over `tau`: exp of [[0, 1], [−a, −b2]] τ = [[f1, g], [−a g, f2]].

    With b = b2/2 and the discriminant D = b² − a: g = e^{−bτ} sinh(√D τ)/√D, f1,2 = e^{−bτ} cosh(√D τ) ± b g.
    Small |D τ²| by series (critical damping included), D < 0 by sine and cosine, D > 0 by the two poles
    b + √D and a/(b + √D), which do not cancel.
    """
    b = 0.5 * b2
    disc = b * b - a
    x = disc * tau * tau
    if abs(x.real) < 0.3:
        eb = np.exp(-b * tau)
        c = 1.0 + x / 2.0 * (
            1.0 + x / 12.0 * (1.0 + x / 30.0 * (1.0 + x / 56.0 * (1.0 + x / 90.0 * (1.0 + x / 132.0))))
        )
        s = 1.0 + x / 6.0 * (
            1.0 + x / 20.0 * (1.0 + x / 42.0 * (1.0 + x / 72.0 * (1.0 + x / 110.0 * (1.0 + x / 156.0))))
        )
        g = eb * tau * s
        f = eb * c
        return f + b * g, f - b * g, g
    if disc.real > 0:
        root = np.sqrt(disc)
        fast = b + root
        slow = a / fast
        e_slow = np.exp(-slow * tau)
        e_fast = np.exp(-fast * tau)
        half = 0.5 / root
        return (
            (fast * e_slow - slow * e_fast) * half,
            (fast * e_fast - slow * e_slow) * half,
            (e_slow - e_fast) * half,
        )
    root = np.sqrt(-disc)
    eb = np.exp(-b * tau)
    g = eb * np.sin(root * tau) / root
    f = eb * np.cos(root * tau)
    return f + b * g, f - b * g, g


@njit(cache=True)
def _near(a, b2, w):
    """Whether the low-pass at `w` nearly coincides with a photoreceptor pole."""
    return abs((a + w * (w - b2)).real) < COINCIDENCE * (w * w + a).real


@njit(cache=True)
def _near_pair(w, other):
    return abs((w - other).real) < COINCIDENCE * (w + other).real


@njit(cache=True)
def cutoffs_coincide(w1, w2, wh, wd):
    """Whether two of the first-order stages nearly coincide (this does not depend on the light)."""
    close = _near_pair(w1, wd) or _near_pair(w1, w2) or _near_pair(w2, wd)
    if wh.real > 0:
        close = close or _near_pair(wh, w1) or _near_pair(wh, w2) or _near_pair(wh, wd)
    return close


@njit(cache=True)
def _closed_form(v, y, s, e, z, d, u0, r, tau, a, b2, w1, w2, wh, wd, pr):
    k1 = np.exp(-w1 * tau)
    kd = np.exp(-wd * tau)
    if w2.real > PRESENT_BELOW and wh.real == 0:
        v, y, s, d = _step_two_poles((v, y, s, d), u0, r, tau, a, b2, w1, wd, pr, k1, kd)
        return v, y, s, s, z, d
    return _step_full_chain(
        (v, y, s, e, z, d), u0, r, tau, a, b2, w1, w2, wh, wd, pr, k1, np.exp(-w2 * tau), np.exp(-wh * tau), kd
    )


@njit(cache=True)
def _stepped_around(v, y, s, e, z, d, u0, r, tau, a, b2, w1, w2, wh, wd, pr):
    zero = v * 0.0
    v1, y1, s1, e1, z1, d1 = zero, zero, zero, zero, zero, zero
    for j in range(3):
        for sign in (-1.0, 1.0):
            h = sign * (j + 1) * NUDGE
            weight = NUDGE_WEIGHTS[j]
            nv, ny, ns, ne, nz, nd = _closed_form(
                v, y, s, e, z, d, u0, r, tau, a, b2,
                w1 * (1.0 + h), w2 * (1.0 - 1.5 * h), wh * (1.0 + 2.0 * h), wd * (1.0 - h), pr,
            )  # fmt: skip
            v1 += weight * nv
            y1 += weight * ny
            s1 += weight * ns
            e1 += weight * ne
            z1 += weight * nz
            d1 += weight * nd
    return v1, y1, s1, e1, z1, d1


@njit(cache=True)
def advance(state, u0, r, tau, a, b2, w1, w2, wh, wd, coincide):
    """The six-component state after `tau` of the input ramp u0 + r τ; `coincide` from `cutoffs_coincide`."""
    v, y, s, e, z, d = state
    pr = photoreceptor_factors(a, b2, tau)
    if (
        coincide
        or _near(a, b2, w1)
        or _near(a, b2, wd)
        or (w2.real < PRESENT_BELOW and _near(a, b2, w2))
        or (wh.real > 0 and _near(a, b2, wh))
    ):
        return _stepped_around(v, y, s, e, z, d, u0, r, tau, a, b2, w1, w2, wh, wd, pr)
    return _closed_form(v, y, s, e, z, d, u0, r, tau, a, b2, w1, w2, wh, wd, pr)


@njit(cache=True)
def linearised_at(L0, L1, midpoint):
    """The radiance at which a step's photoreceptor is linearised: geometric midpoint, or the newer sample."""
    return np.sqrt(L0 * L1) if midpoint else L1


@njit(cache=True, nogil=True)
def scan(t, u, L, dynamics, midpoint, states):
    """Run the chain from steady state at the first sample; fills `states` (n, 6) in place."""
    alpha, beta, gamma, w1, w2, wh, wd = dynamics
    coincide = cutoffs_coincide(w1, w2, wh, wd)
    u0 = u[0]
    zero = u0 * 0.0
    if wh.real > 0:
        state = (zero, u0, u0, u0, u0, zero)
    else:
        state = (zero, u0, u0, u0, zero, u0)
    n = len(t)
    for k in range(n):
        if k > 0:
            tau = t[k] - t[k - 1]
            if tau > 0:
                lin = linearised_at(L[k - 1], L[k], midpoint)
                state = advance(
                    state, u[k - 1], (u[k] - u[k - 1]) / tau, tau,
                    alpha * lin, beta + gamma * lin, w1, w2, wh, wd, coincide,
                )  # fmt: skip
        states[k, 0], states[k, 1], states[k, 2], states[k, 3], states[k, 4], states[k, 5] = state


@njit(cache=True)
def within_step(tq, k, t, u, L, dynamics, coincide, midpoint, states):
    """State at time tq inside step k (t[k] ≤ tq ≤ t[k+1]); past the last sample the input is held."""
    alpha, beta, gamma, w1, w2, wh, wd = dynamics
    state = (states[k, 0], states[k, 1], states[k, 2], states[k, 3], states[k, 4], states[k, 5])
    if k + 1 < len(t):
        step = t[k + 1] - t[k]
        r = (u[k + 1] - u[k]) / step
        lin = linearised_at(L[k], L[k + 1], midpoint)
    else:
        r = u[k] * 0.0
        lin = L[k]
    tau = tq - t[k]
    if tau.real <= 0:
        return state
    return advance(state, u[k], r, tau, alpha * lin, beta + gamma * lin, w1, w2, wh, wd, coincide)


@njit(cache=True)
def reference_and_slopes(state, dynamics, u_slope):
    """(reset level, amplifier output, its slope) of a state.

    The reset level is what the amplifier restarts from: the follower output, or behind a lower cutoff h = e − z.
    Where the amplifier has no pole its output is that level itself.
    """
    alpha, beta, gamma, w1, w2, wh, wd = dynamics
    v, y, s, e, z, d = state
    level = e - z
    if wd.real < PRESENT_BELOW:
        return level, d, wd * (level - d)
    if w2.real < PRESENT_BELOW:
        slope = w2 * (s - e)
    elif w1.real < PRESENT_BELOW:
        slope = w1 * (y - s)
    elif beta.real < PRESENT_BELOW:
        slope = v
    elif gamma.real > 0:  # one-pole photoreceptor: y' = v
        slope = v
    else:
        slope = u_slope
    if wh.real > 0:
        slope = slope - wh * (e - z)
    return level, d, slope
