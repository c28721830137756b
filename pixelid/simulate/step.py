"""One stimulus step as the comparator sees it: the amplifier at any time inside, and bounds on what it can do.

Compiled helpers pass three tuples:

    step   (state, end, u0, r, tau, a, b2, light, light_r, modes)
           six-component states at both ends, input ramp u0 + r τ of length tau, photoreceptor coefficients
           (αL, β + γL) of the step, the radiance light · exp(light_r τ), and `modes`
    modes  the amplitudes of the step's exponentials, for chains of four states (`equations.modes_of`): a step is
           probed several times
    chain  (w1, w2, wh, wd, coincide, smooth)
           the cutoffs; `smooth`: no closed form (slew limit), interpolate h and d by cubics instead; the states are
           then (dh/dt, 0, h, h, 0, d)
    reset  (level, decay, x0, leak, parasitic)
           since the position x0 in the step:  change = d − level − decay e^{−ωd (x − x0)} + ∫ (leak + parasitic L)
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pixelid.dynamics import blocks, equations, kernels
from pixelid.dynamics.equations import PRESENT_BELOW

_responses = njit(equations.responses, inline="always", error_model="numpy")
_modes_of = njit(equations.modes_of, inline="always", error_model="numpy")
_state_of = njit(equations.state_of, inline="always", error_model="numpy")
light_integral = njit(equations.light_integral, inline="always", error_model="numpy")


@njit(forceinline=True, error_model="numpy")
def after_jump(state, u, r, a, b2, w1, w2, wh, wd):
    """The state just after a jump of the input to u + r τ: stages without a pole follow at once."""
    v, y, s, e, z, d = state
    corner = a / b2
    if corner > PRESENT_BELOW:
        v, y = r, u
    elif b2 > PRESENT_BELOW:
        v = corner * (u - y)
    s = y if w1 > PRESENT_BELOW else s
    e = s if w2 > PRESENT_BELOW else e
    d = e - z if wd > PRESENT_BELOW else d
    return v, y, s, e, z, d


@njit(forceinline=True, error_model="numpy")
def slope_bound(state, u, r, a, b2, w1, w2, wh, wd):
    """A bound on |dd/dt| from here to the end of the step.

    A low-pass output's slope is a weighted mean of its own initial slope and the past slopes of its input, so it is
    bounded by the larger of the two.
    """
    v, y, s, e, z, d = state
    bound = kernels.photoreceptor_slope_bound(v, y, u, r, a, b2)
    if w1 < PRESENT_BELOW:
        bound = max(bound, w1 * abs(y - s))
    if w2 < PRESENT_BELOW:
        bound = max(bound, w2 * abs(s - e))
    if wh > 0.0:
        bound += max(bound, wh * abs(e - z))
    if wd < PRESENT_BELOW:
        bound = max(bound, wd * abs(e - z - d))
    return bound


@njit(forceinline=True, error_model="numpy")
def cubic(p, h, f0, f1, s0, s1):
    """(value, slope) at the fraction p of a cubic over length h with these end values and slopes."""
    q = 1.0 - p
    value = f0 * (1.0 + 2.0 * p) * q * q + f1 * (1.0 + 2.0 * q) * p * p + h * p * q * (s0 * q - s1 * p)
    slope = 6.0 * p * q * (f1 - f0) / h + s0 * q * (q - 2.0 * p) + s1 * p * (p - 2.0 * q)
    return value, slope


@njit(forceinline=True, error_model="numpy")
def modes(state, u0, r, a, b2, chain):
    """(whether to use them, delays, responses, modes) of `equations.modes_of`.

    Not to be used: other chains, and steps that `kernels.advance` takes another way.
    """
    w1, w2, wh, wd, coincide, smooth = chain
    v, y, s, _, _, d = state
    ty = b2 / a
    ts = ty + 1.0 / w1
    td = ts + 1.0 / wd
    apart = not blocks.near_coincidence(a, b2, w1, wd, kernels.gap(w1, wd))
    plain = not smooth and not coincide and w2 > PRESENT_BELOW and wh == 0.0 and b2 < PRESENT_BELOW
    plain = plain and wd < PRESENT_BELOW and apart and abs(r * td) < kernels.STEEP
    delays, pq = (ty, ts, td), _responses(a, b2, w1, wd)
    return plain, delays, pq, _modes_of((v, y, s, d), u0, r, delays, pq, wd / (wd - w1))


@njit(cache=True, error_model="numpy")
def probe(x, step, chain):
    """(reset level, d, dd/dt, bound on |dd/dt| from here on) at x in [0, tau] of the step."""
    state, end, u0, r, tau, a, b2, _, _, amplitudes = step
    w1, w2, wh, wd, coincide, smooth = chain
    usable, delays, pq, own = amplitudes
    if usable and 0.0 < x < tau:
        pr, here = kernels.photoreceptor_factors(a, b2, x), u0 + r * x
        v, y, s, d = _state_of(own, here, r, a, pr, delays, pq, np.exp(-w1 * x), np.exp(-wd * x))
        slope = wd * (s - d)
        bound = max(kernels.photoreceptor_slope_bound(v, y, here, r, a, b2), abs(slope))
        if w1 < PRESENT_BELOW:
            bound = max(bound, w1 * abs(y - s))
        return s, d, slope, bound
    if smooth:
        h0, h1, d0, d1 = state[3] - state[4], end[3] - end[4], state[5], end[5]
        level, level_slope = cubic(x / tau, tau, h0, h1, state[0], end[0])
        if wd < PRESENT_BELOW:
            d, slope = cubic(x / tau, tau, d0, d1, wd * (h0 - d0), wd * (h1 - d1))
        else:
            d, slope = level, level_slope
        return level, d, slope, np.inf
    if x >= tau:
        state = end
    elif x > 0.0:
        state = kernels.advance(state, u0, r, x, a, b2, w1, w2, wh, wd, coincide)
    v, y, s, e, z, d = state
    level = e - z
    if wd < PRESENT_BELOW:
        slope = wd * (level - d)
    elif w2 < PRESENT_BELOW:
        slope = w2 * (s - e)
    elif w1 < PRESENT_BELOW:
        slope = w1 * (y - s)
    elif a / b2 < PRESENT_BELOW:
        slope = v
    else:
        slope = r
    if wd > PRESENT_BELOW and wh > 0.0:
        slope -= wh * level
    return level, d, slope, slope_bound(state, u0 + r * x, r, a, b2, w1, w2, wh, wd)


@njit(forceinline=True, error_model="numpy")
def change(x, d, slope, step, wd, reset):
    """(change, its slope, decaying part, drift) at x, where the amplifier is at d with that slope."""
    level, decay, x0, leak, parasitic = reset
    fading, fading_slope = 0.0, 0.0
    if decay != 0.0:
        fading = decay * np.exp(-wd * (x - x0))
        fading_slope = wd * fading
    drift = leak * (x - x0)
    drift_slope = leak
    if parasitic > 0.0:
        drift += parasitic * light_integral(step[7] * np.exp(step[8] * x0), step[8], x - x0)
        drift_slope += parasitic * step[7] * np.exp(step[8] * x)
    return d - level - fading + drift, slope + fading_slope + drift_slope, fading, drift
