"""The closed-form step of `equations.py`, compiled.

Works on float64 and, for exact derivatives by complex steps (Squire & Trapp, SIAM Review 40, 1998), on
complex128 (the gradient of `nerf` takes them).  A pixel's linear dynamics travel as a `Dynamics`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pixelid.dynamics import coincident, equations
from pixelid.dynamics.equations import PRESENT_BELOW

photoreceptor_rates = njit(equations.photoreceptor_rates, inline="always", error_model="numpy")
_step_two_poles = njit(equations.step_two_poles, inline="always", error_model="numpy")
_step_full_chain = njit(equations.step_full_chain, inline="always", error_model="numpy")

# The closed form divides by differences of poles and loses the digits of the product of a pole's relative gaps to
# all others; and it subtracts the ramp's delay r/ω, which for a steep ramp and a slow stage exceeds everything else.
# Where the gaps multiply to less than COINCIDENCE × (1 or the delays / STEEP, whichever is larger), error about
# 2e-10, the step is taken by the exponential of the small matrix instead (`coincident.py`): some ten times slower,
# indifferent to both.
COINCIDENCE = 1e-3
STEEP = 1e3


@njit(cache=True, error_model="numpy")
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
        c = 1.0 + x * (0.5 + x * (1 / 24 + x * (1 / 720 + x * (1 / 40320 + x * (1 / 3628800 + x / 479001600)))))
        s = 1.0 + x * (1 / 6 + x * (1 / 120 + x * (1 / 5040 + x * (1 / 362880 + x * (1 / 39916800 + x / 6227020800)))))
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


@njit(inline="always", error_model="numpy")
def gap_to_photoreceptor(a, b2, w):
    """Relative gap of the low-pass at `w` to the photoreceptor poles (their product), at most 1."""
    return min(abs((a + w * (w - b2)).real) / (w * w + a).real, 1.0)


@njit(inline="always", error_model="numpy")
def gap(w, other):
    """Relative gap of two cutoffs, at most 1."""
    return abs((w - other).real) / (w + other).real


@njit(cache=True, error_model="numpy")
def cutoffs_coincide(w1, w2, wh, wd):
    """Whether first-order stages nearly coincide among themselves (this does not depend on the light)."""
    return _smallest_gap(1.0, 1.0, 1.0, 1.0, w1, w2, wh, wd) < COINCIDENCE


@njit(cache=True, error_model="numpy")
def _smallest_gap(q1, q2, qh, qd, w1, w2, wh, wd):
    """The smallest product of one pole's gaps to the others; q: the gaps to the photoreceptor."""
    g12, g1d, g2d = gap(w1, w2), gap(w1, wd), gap(w2, wd)
    g1h, g2h, ghd = 1.0, 1.0, 1.0
    if wh.real > 0:
        g1h, g2h, ghd = gap(w1, wh), gap(w2, wh), gap(wh, wd)
    return min(
        q1 * q2 * qh * qd, q1 * g12 * g1d * g1h, q2 * g12 * g2d * g2h, qd * g1d * g2d * ghd, qh * g1h * g2h * ghd
    )


@njit(cache=True, error_model="numpy")
def _closed_form(v, y, s, e, z, d, u0, r, tau, a, b2, w1, w2, wh, wd, pr):
    k1 = np.exp(-w1 * tau)
    kd = np.exp(-wd * tau)
    if w2.real > PRESENT_BELOW and wh.real == 0:
        v, y, s, d = _step_two_poles((v, y, s, d), u0, r, tau, a, b2, w1, wd, pr, k1, kd)
        return v, y, s, s, z, d
    return _step_full_chain(
        (v, y, s, e, z, d), u0, r, tau, a, b2, w1, w2, wh, wd, pr, k1, np.exp(-w2 * tau), np.exp(-wh * tau), kd
    )


@njit(cache=True, error_model="numpy")
def advance(state, u0, r, tau, a, b2, w1, w2, wh, wd, coincide):
    """The six-component state after `tau` of the input ramp u0 + r τ; `coincide` from `cutoffs_coincide`."""
    if coincide:
        return coincident.advance(state, u0, r, tau, a, b2, w1, w2, wh, wd)
    q1, qd = gap_to_photoreceptor(a, b2, w1), gap_to_photoreceptor(a, b2, wd)
    delay = b2 / a + 1.0 / w1 + 1.0 / wd
    if w2.real > PRESENT_BELOW and wh.real == 0:
        g = gap(w1, wd)
        smallest = min(q1 * qd, q1 * g, qd * g)
    else:
        delay += 1.0 / w2
        qh = 1.0
        if wh.real > 0:
            delay += 1.0 / wh
            qh = gap_to_photoreceptor(a, b2, wh)
        smallest = _smallest_gap(q1, gap_to_photoreceptor(a, b2, w2), qh, qd, w1, w2, wh, wd)
    if smallest < COINCIDENCE * max(1.0, abs((r * delay).real) / STEEP):
        return coincident.advance(state, u0, r, tau, a, b2, w1, w2, wh, wd)
    v, y, s, e, z, d = state
    pr = photoreceptor_factors(a, b2, tau)
    return _closed_form(v, y, s, e, z, d, u0, r, tau, a, b2, w1, w2, wh, wd, pr)


@njit(forceinline=True, error_model="numpy")
def photoreceptor_slope_bound(v, y, u, r, a, b2):
    """A bound on |dy/dt| from here on, under the ramp u + r τ.

    About the delayed ramp the deviation ε obeys ε'' + b2 ε' + a ε = 0, so ε'² + a ε² never grows:
    |y'| ≤ |r| + √((v − r)² + a ε²).
    """
    corner = a / b2
    if b2 < PRESENT_BELOW:
        deviation = y - u + r * b2 / a
        return abs(r) + np.sqrt((v - r) * (v - r) + a * deviation * deviation)
    if corner < PRESENT_BELOW:
        return abs(r) + abs(corner * (y - u) + r)
    return abs(r)


@njit(cache=True, error_model="numpy")
def linearised_at(L0, L1, midpoint):
    """The radiance at which a step's photoreceptor is linearised: geometric midpoint, or the newer sample."""
    return np.sqrt(L0 * L1) if midpoint else L1


@njit(cache=True, nogil=True, error_model="numpy")
def scan(t, u, L, dynamics, midpoint, states):
    """Run the chain from steady state at the first sample; fills `states` (n, 6) in place."""
    w1, w2, wh, wd = dynamics.follower, dynamics.extra_pole, dynamics.lower_cutoff, dynamics.differencing
    coincide = cutoffs_coincide(w1, w2, wh, wd)
    state = steady_state(u[0], wh)
    for k in range(len(t)):
        if k > 0:
            tau = t[k] - t[k - 1]
            if tau > 0:
                a, b2 = photoreceptor_rates(dynamics, linearised_at(L[k - 1], L[k], midpoint))
                state = advance(state, u[k - 1], (u[k] - u[k - 1]) / tau, tau, a, b2, w1, w2, wh, wd, coincide)
        states[k, 0], states[k, 1], states[k, 2], states[k, 3], states[k, 4], states[k, 5] = state


@njit(inline="always", error_model="numpy")
def steady_state(u, wh):
    """The six components under constant log radiance `u`."""
    if wh > 0:
        return 0.0, u, u, u, u, 0.0
    return 0.0, u, u, u, 0.0, u


@njit(cache=True, nogil=True, error_model="numpy")
def states_at(times, step, t, u, L, dynamics, midpoint, states, out):
    """Fill out (m, 6) with the states at `times`, each in the step that begins at sample step[i].

    Past the last sample the light is held.
    """
    w1, w2, wh, wd = dynamics.follower, dynamics.extra_pole, dynamics.lower_cutoff, dynamics.differencing
    coincide = cutoffs_coincide(w1, w2, wh, wd)
    for i in range(len(times)):
        k = step[i]
        state = (states[k, 0], states[k, 1], states[k, 2], states[k, 3], states[k, 4], states[k, 5])
        tau = times[i] - t[k]
        if tau > 0:
            after = min(k + 1, len(t) - 1)
            r = (u[after] - u[k]) / (t[after] - t[k]) if after > k else 0.0
            a, b2 = photoreceptor_rates(dynamics, linearised_at(L[k], L[after], midpoint))
            state = advance(state, u[k], r, tau, a, b2, w1, w2, wh, wd, coincide)
        out[i, 0], out[i, 1], out[i, 2], out[i, 3], out[i, 4], out[i, 5] = state


@njit(cache=True, error_model="numpy")
def reference_and_slopes(state, dynamics, u_slope):
    """(reset level, amplifier output, its slope) of a state.

    The reset level is what the amplifier restarts from: the follower output, or behind a lower cutoff h = e − z.
    Where the amplifier has no pole its output is that level itself.
    """
    w1, w2, wh, wd = dynamics.follower, dynamics.extra_pole, dynamics.lower_cutoff, dynamics.differencing
    v, y, s, e, z, d = state
    level = e - z
    if wd < PRESENT_BELOW:
        return level, d, wd * (level - d)
    if w2 < PRESENT_BELOW:
        slope = w2 * (s - e)
    elif w1 < PRESENT_BELOW:
        slope = w1 * (y - s)
    elif dynamics.beta < PRESENT_BELOW or dynamics.gamma > 0:  # two poles or one: y' = v
        slope = v
    else:
        slope = u_slope
    if wh > 0:
        slope = slope - wh * (e - z)
    return level, d, slope


@njit(cache=True, nogil=True, error_model="numpy")
def outputs_of(states, step, t, u, dynamics, level, output, slope):
    """Fill `reference_and_slopes` of states (m, 6), each in the step that begins at sample step[i]."""
    for i in range(len(step)):
        k = step[i]
        rate = (u[k + 1] - u[k]) / (t[k + 1] - t[k]) if k + 1 < len(t) and t[k + 1] > t[k] else 0.0
        state = (states[i, 0], states[i, 1], states[i, 2], states[i, 3], states[i, 4], states[i, 5])
        level[i], output[i], slope[i] = reference_and_slopes(state, dynamics, rate)
