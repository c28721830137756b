"""The slew-limited follower by Runge-Kutta steps of fourth order: d s/dt = clip(ωsf (y − s), −fall, +rise).

The photoreceptor takes its closed form, the stages behind it classical steps.  The light must come in steps that
resolve every pole after the photoreceptor.
"""

from __future__ import annotations

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

_low_pass = njit(derivative_low_pass, error_model="numpy")


@njit(error_model="numpy")
def _derivatives(y, s, e, z, d, rates):
    """Slopes of the stages behind the photoreceptor; an absent stage's output is its input and has no slope."""
    w1, w2, wh, wd, rise, fall = rates
    ds = min(max(_low_pass(s, y, w1), -fall), rise)
    de = _low_pass(e, s, w2) if w2 < PRESENT_BELOW else 0.0
    e = e if w2 < PRESENT_BELOW else s
    dz = _low_pass(z, e, wh)
    dd = _low_pass(d, e - z, wd) if wd < PRESENT_BELOW else 0.0
    return ds, de, dz, dd


@njit(error_model="numpy")
def _step(state, u0, r, tau, a, b2, rates):
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


def slewed_outputs(t, radiance, dynamics, rates, at: float | None = None) -> tuple[np.ndarray, np.ndarray]:
    """(h, d), (n,) each, at t (n,) under radiance (n,): what the amplifier is driven by, and its output.

    at: the light that the photoreceptor is linearised at throughout; None: that of each step
    """
    states = np.empty((len(t), 6))
    light = np.sqrt(radiance[:-1] * radiance[1:]) if at is None else np.full(len(t) - 1, at)
    _run(t, radiance, light, dynamics, rates, states)
    return states[:, 3] - states[:, 4], states[:, 5]


@njit(error_model="numpy")
def _run(t, radiance, lights, dynamics, rates, states):
    u = np.log(radiance[0])
    rest = u if rates[2] > 0.0 else 0.0
    state = (0.0, u, u, u, rest, u - rest)
    for k in range(len(t)):
        if k > 0 and t[k] > t[k - 1]:
            tau, u0 = t[k] - t[k - 1], np.log(radiance[k - 1])
            light = lights[k - 1]
            r = (np.log(radiance[k]) - u0) / tau
            state = _step(state, u0, r, tau, dynamics.alpha * light, dynamics.beta + dynamics.gamma * light, rates)
        for j in range(6):
            states[k, j] = state[j]
