"""The slew-limited follower in closed form:  d s/dt = clip(ωsf (y − s), −fall, +rise).

Within a step of the light the follower is either free, and the chain linear, or at its limit: then s is a ramp, the
photoreceptor goes on as before, and the stages behind it answer a ramp.  All three have the closed form of `kernels`;
the moments between them are roots of ωsf (y − s) = limit.  A step that the limit does not touch is one closed form
and a look at its end.

rates: (w1, w2, wh, wd, rise, fall);  mode: 0 free, +1 rising at the limit, −1 falling
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from pixelid.dynamics import kernels
from pixelid.dynamics.equations import (
    ABSENT_DIFFERENCING,
    ABSENT_EXTRA,
    ABSENT_FOLLOWER,
    ABSENT_PHOTORECEPTOR,
    PRESENT_BELOW,
    derivative_low_pass,
)
from pixelid.errors import InputError
from pixelid.stages.circuit import Circuit

STEPS_PER_TIME_CONSTANT = 10.0  # of the fastest stage: the cubics between knots (`smooth_state`) err by 1e-7 there
# Light that is noisy runs straight over steps far shorter than the photoreceptor's time constant, so that it excites no
# fast stage: the cubics err by at most 6e-6 of ln L then, a threshold's noise being 4e-3 (`tests/unit/test_slewed.py`).
STEPS_PER_TIME_CONSTANT_UNDER_NOISE = 0.5
MOST_STEPS = 500_000_000
ROOT = 1e-9  # of a step: how closely a switch is timed; s has no kink there, so its error is the square of this
ROOT_STEPS = 60
RESOLVED = 0.5  # of the shortest time constant of photoreceptor and follower: how far apart switches are looked for
FASTEST_RAD_S = 2 * np.pi * 4e4  # rad/s: what is faster follows the rest within a time constant of 4 µs
_low_pass = njit(derivative_low_pass, inline="always", error_model="numpy")


def slews(circuit: Circuit) -> bool:
    """Whether the follower of a circuit is slew limited."""
    return math.isfinite(circuit.slew_rise) or math.isfinite(circuit.slew_fall)


def without_slew_limit(circuit: Circuit) -> Circuit:
    """The circuit whose follower is as fast as its pole, whatever the step."""
    return circuit.with_(slew_rise=math.inf, slew_fall=math.inf)


def rates_of(circuit: Circuit, dynamics) -> tuple:
    """(w1, w2, wh, wd, rise, fall) of a circuit; dynamics: of it without the limit."""
    return (*tuple(dynamics)[3:7], float(circuit.slew_rise), float(circuit.slew_fall))


def longest_step(cutoffs, duration_s: float, steps_per_time_constant: float = STEPS_PER_TIME_CONSTANT) -> float:
    """The longest step [s] that resolves these cutoffs (rad/s).  Raises InputError when that needs too many.

    A cutoff beyond `FASTEST_RAD_S` need not be resolved: where a fit lets a pole run off, its steps have no end.
    """
    fastest = min(max(w for w in cutoffs if w < PRESENT_BELOW), FASTEST_RAD_S)
    if duration_s * fastest * steps_per_time_constant > MOST_STEPS:
        raise InputError(
            f"slew_limit: {duration_s:g} s with a pole at {fastest / (2 * np.pi):.3g} Hz needs more than "
            f"{MOST_STEPS:g} steps; shorten the stimulus or lower the cutoff"
        )
    return 1.0 / (steps_per_time_constant * fastest)


@njit(cache=True, error_model="numpy")
def advance(mode, state, u0, r, tau, a, b2, rates, coincide, coincide_behind):
    """The state after `tau` of the input ramp u0 + r τ in one mode."""
    w1, w2, wh, wd, rise, fall = rates
    if mode == 0:
        return kernels.advance(state, u0, r, tau, a, b2, w1, w2, wh, wd, coincide)
    v, y, s, e, z, d = state
    rate = rise if mode > 0 else -fall
    v, y, _, _, _, _ = kernels.advance(
        (v, y, y, y, 0.0, y), u0, r, tau, a, b2, ABSENT_FOLLOWER, ABSENT_EXTRA, 0.0, ABSENT_DIFFERENCING, False
    )
    far = ABSENT_PHOTORECEPTOR
    _, _, _, e, z, d = kernels.advance(
        (rate, s, s, e, z, d), s, rate, tau, 0.1 * far * far, far, ABSENT_FOLLOWER, w2, wh, wd, coincide_behind
    )
    s += rate * tau
    return v, y, s, e if w2 < PRESENT_BELOW else s, z, d


@njit(forceinline=True, error_model="numpy")
def beyond(mode, state, rates):
    """How far the follower is beyond where its mode holds [1/s]; positive: another mode holds."""
    wanted = rates[0] * (state[1] - state[2])
    if mode == 0:
        return max(wanted - rates[4], -rates[5] - wanted)
    return rates[4] - wanted if mode > 0 else wanted + rates[5]


@njit(forceinline=True, error_model="numpy")
def _next(mode, state, rates):
    """The mode that follows where `mode` ends."""
    if mode != 0:
        return 0
    return 1 if rates[0] * (state[1] - state[2]) > 0.0 else -1


@njit(cache=True, error_model="numpy")
def _looked_at(mode, state, u0, r, left, a, b2, rates):
    """How much of what is `left` of a step may be looked at by its end alone.

    Free: all of it where the follower can nowhere want more than its limit.  Limited: as long as it cannot have caught
    up.  Else what resolves the poles before it.
    """
    steepest = kernels.photoreceptor_slope_bound(state[0], state[1], u0, r, a, b2)
    safe = 0.0
    if mode == 0:
        if max(rates[0] * abs(state[1] - state[2]), steepest) < min(rates[4], rates[5]):
            return left
    else:
        safe = -beyond(mode, state, rates) / rates[0] / (steepest + (rates[4] if mode > 0 else rates[5]))
    fastest = max(rates[0], np.sqrt(a) if b2 < PRESENT_BELOW else 0.0)
    return min(left, max(safe, RESOLVED / min(fastest, FASTEST_RAD_S)))


@njit(cache=True, error_model="numpy")
def _change(mode, state, after, late, u0, r, a, b2, rates, coincide, coincide_behind, width):
    """(moment, state) just after the mode ends, as it has by `late`, in state `after`: regula falsi (Illinois)."""
    low, f_low = 0.0, min(beyond(mode, state, rates), 0.0)
    high, f_high = late, beyond(mode, after, rates)
    side = 0
    for i in range(ROOT_STEPS):
        if high - low <= width:
            break
        x = (low * f_high - high * f_low) / (f_high - f_low) if i % 4 < 3 else 0.5 * (low + high)
        x = min(max(x, low + 0.25 * width), high - 0.25 * width)
        there = advance(mode, state, u0, r, x, a, b2, rates, coincide, coincide_behind)
        f = beyond(mode, there, rates)
        if f > 0.0:
            high, f_high, after = x, f, there
            f_low = 0.5 * f_low if side > 0 else f_low
            side = 1
        else:
            low, f_low = x, f
            f_high = 0.5 * f_high if side < 0 else f_high
            side = -1
    return high, after


@njit(cache=True, error_model="numpy")
def mode_of(state, rates):
    """The mode in which a state goes on."""
    wanted = rates[0] * (state[1] - state[2])
    return 1 if wanted > rates[4] else (-1 if wanted < -rates[5] else 0)


@njit(cache=True, error_model="numpy")
def until_change(mode, state, u0, r, left, a, b2, rates, coincide, coincide_behind, width):
    """(moment, mode, state) where the mode next changes, timed to `width`, or after what is `left` of a step."""
    x = 0.0
    while x < left:
        from_here = u0 + r * x
        far = _looked_at(mode, state, from_here, r, left - x, a, b2, rates)
        end = advance(mode, state, from_here, r, far, a, b2, rates, coincide, coincide_behind)
        if beyond(mode, end, rates) > 0.0:
            moment, state = _change(mode, state, end, far, from_here, r, a, b2, rates, coincide, coincide_behind, width)
            return x + moment, _next(mode, state, rates), state
        state, x = end, x + far if far < left - x else left
    return left, mode, state


@njit(cache=True, error_model="numpy")
def slewed_step(state, u0, r, tau, a, b2, rates, coincide, coincide_behind):
    """The six-component state after `tau` of the input ramp u0 + r τ."""
    x, mode = 0.0, mode_of(state, rates)
    while True:
        before = mode
        moment, mode, state = until_change(
            mode, state, u0 + r * x, r, tau - x, a, b2, rates, coincide, coincide_behind, ROOT * tau
        )
        x += moment
        if mode == before or x >= tau:
            return state


@njit(forceinline=True, error_model="numpy")
def smooth_state(state, rates):
    """(dh/dt, 0, h, h, 0, d) with h = e − z: what the amplifier is driven by and reset to."""
    w1, w2, wh, _, rise, fall = rates
    _, y, s, e, z, d = state
    slope = _low_pass(e, s, w2) if w2 < PRESENT_BELOW else min(max(_low_pass(s, y, w1), -fall), rise)
    return slope - _low_pass(z, e, wh), 0.0, e - z, e - z, 0.0, d


def slewed_states(t, radiance, dynamics, rates, midpoint: bool, log_radiance: np.ndarray | None = None) -> np.ndarray:
    """(n, 6) `smooth_state` at knots t (n,) under radiance (n,), from steady state at the first.

    dynamics: of the circuit without its slew limit;  rates: `rates_of` it;  log_radiance: as of `trajectory.integrate`
    """
    u = np.log(radiance) if log_radiance is None else log_radiance
    states = np.empty((len(t), 6))
    _slewed(t, u, radiance, dynamics, rates, midpoint, states)
    return states


@njit(cache=True, nogil=True, error_model="numpy")
def _slewed(t, u, radiance, dynamics, rates, midpoint, states):
    coincide = kernels.cutoffs_coincide(rates[0], rates[1], rates[2], rates[3])
    coincide_behind = kernels.cutoffs_coincide(ABSENT_FOLLOWER, rates[1], rates[2], rates[3])
    state = kernels.steady_state(u[0], rates[2])
    for k in range(len(t)):
        if k > 0 and t[k] > t[k - 1]:
            tau = t[k] - t[k - 1]
            a, b2 = kernels.photoreceptor_rates(dynamics, kernels.linearised_at(radiance[k - 1], radiance[k], midpoint))
            r = (u[k] - u[k - 1]) / tau
            state = slewed_step(state, u[k - 1], r, tau, a, b2, rates, coincide, coincide_behind)
        view = smooth_state(state, rates)
        for j in range(6):
            states[k, j] = view[j]
