"""The slew-limited follower:  d s/dt = clip(ωsf (y − s), −fall, +rise).

It has no closed form.  The light is refined until every pole after the photoreceptor is resolved (`longest_step`);
the photoreceptor takes its closed form, the stages behind it a classical Runge-Kutta step of fourth order.  Between
these steps h and d are cubics, which is what `step.probe` reads from `smooth_state`.
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
    PRESENT_BELOW,
    derivative_low_pass,
)
from pixelid.errors import InputError
from pixelid.stages.circuit import Circuit

RESOLUTION = 0.1  # steps per time constant of the fastest stage: local error (ω Δt)^5/120 = 1e-7
MOST_STEPS = 500_000_000
_low_pass = njit(derivative_low_pass, inline="always", error_model="numpy")


def longest_step(cutoffs, duration_s: float, resolution: float = RESOLUTION) -> float:
    """The longest step [s] that resolves these cutoffs (rad/s).  Raises InputError when that needs too many."""
    fastest = max(w for w in cutoffs if w < PRESENT_BELOW)
    if duration_s * fastest / resolution > MOST_STEPS:
        raise InputError(
            f"slew_limit: {duration_s:g} s with a pole at {fastest / (2 * np.pi):.3g} Hz needs more than "
            f"{MOST_STEPS:g} steps; shorten the stimulus or lower the cutoff"
        )
    return resolution / fastest


@njit(forceinline=True, error_model="numpy")
def _derivatives(y, s, e, z, d, rates):
    """Slopes of the stages behind the photoreceptor; an absent stage's output is its input and has no slope."""
    w1, w2, wh, wd, rise, fall = rates
    ds = min(max(_low_pass(s, y, w1), -fall), rise)
    de = _low_pass(e, s, w2) if w2 < PRESENT_BELOW else 0.0
    e = e if w2 < PRESENT_BELOW else s
    dz = _low_pass(z, e, wh)
    dd = _low_pass(d, e - z, wd) if wd < PRESENT_BELOW else 0.0
    return ds, de, dz, dd


@njit(cache=True, error_model="numpy")
def slewed_step(state, u0, r, tau, a, b2, rates):
    """The six-component state after a step; rates: (w1, w2, wh, wd, rise, fall)."""
    v, y, s, e, z, d = state
    lens = (v, y, y, y, 0.0, y)
    far = (ABSENT_FOLLOWER, ABSENT_EXTRA, 0.0, ABSENT_DIFFERENCING)
    _, y_mid, _, _, _, _ = kernels.advance(lens, u0, r, 0.5 * tau, a, b2, far[0], far[1], far[2], far[3], False)
    v1, y1, _, _, _, _ = kernels.advance(lens, u0, r, tau, a, b2, far[0], far[1], far[2], far[3], False)
    half = 0.5 * tau
    s1, e1, z1, d1 = _derivatives(y, s, e, z, d, rates)
    s2, e2, z2, d2 = _derivatives(y_mid, s + half * s1, e + half * e1, z + half * z1, d + half * d1, rates)
    s3, e3, z3, d3 = _derivatives(y_mid, s + half * s2, e + half * e2, z + half * z2, d + half * d2, rates)
    s4, e4, z4, d4 = _derivatives(y1, s + tau * s3, e + tau * e3, z + tau * z3, d + tau * d3, rates)
    s += tau / 6.0 * (s1 + 2.0 * s2 + 2.0 * s3 + s4)
    e += tau / 6.0 * (e1 + 2.0 * e2 + 2.0 * e3 + e4)
    z += tau / 6.0 * (z1 + 2.0 * z2 + 2.0 * z3 + z4)
    d += tau / 6.0 * (d1 + 2.0 * d2 + 2.0 * d3 + d4)
    e = e if rates[1] < PRESENT_BELOW else s
    d = d if rates[3] < PRESENT_BELOW else e - z
    return v1, y1, s, e, z, d


@njit(forceinline=True, error_model="numpy")
def smooth_state(state, rates):
    """(dh/dt, 0, h, h, 0, d) with h = e − z: what the amplifier is driven by and reset to."""
    _, y, s, e, z, d = state
    ds, de, dz, _ = _derivatives(y, s, e, z, d, rates)
    slope = de if rates[1] < PRESENT_BELOW else ds
    return slope - dz, 0.0, e - z, e - z, 0.0, d


def slewed_states(t, radiance, dynamics, rates, midpoint: bool) -> np.ndarray:
    """(n, 6) `smooth_state` at knots t (n,) under radiance (n,), from steady state at the first.

    dynamics: of the circuit without its slew limit;  rates: `rates_of` it
    """
    states = np.empty((len(t), 6))
    _slewed(t, radiance, tuple(dynamics), rates, midpoint, states)
    return states


def slews(circuit: Circuit) -> bool:
    """Whether the follower of a circuit is slew limited."""
    return math.isfinite(np.real(circuit.slew_rise)) or math.isfinite(np.real(circuit.slew_fall))


def rates_of(circuit: Circuit, dynamics) -> tuple:
    """(w1, w2, wh, wd, rise, fall) as `slewed_step` wants them."""
    return (*tuple(dynamics)[3:], float(circuit.slew_rise), float(circuit.slew_fall))


@njit(cache=True, nogil=True, error_model="numpy")
def _slewed(t, radiance, dynamics, rates, midpoint, states):
    u = np.log(radiance[0])
    rest = u if rates[2] > 0.0 else 0.0
    state = (0.0, u, u, u, rest, u - rest)
    for k in range(len(t)):
        if k > 0 and t[k] > t[k - 1]:
            tau, u0 = t[k] - t[k - 1], np.log(radiance[k - 1])
            light = kernels.linearised_at(radiance[k - 1], radiance[k], midpoint)
            r = (np.log(radiance[k]) - u0) / tau
            state = slewed_step(state, u0, r, tau, dynamics[0] * light, dynamics[1] + dynamics[2] * light, rates)
        view = smooth_state(state, rates)
        for j in range(6):
            states[k, j] = view[j]
