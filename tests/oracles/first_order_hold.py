"""The pixel over one step with a linear input (first-order hold), exact for any poles and any step.

    x[k+1] = A x[k] + B u[k] + B̃ u[k+1]

The fast step of `dynamics/kernels.py` divides by differences of poles; here nothing does, at about a hundred times
the cost.

Derivation.  With time in units of the step (λ_i: a pole × Δt, w_i: a cutoff × Δt), what state j sends to state i
is the inverse Laplace transform at 1 of  gain · N(s) / Π (s − λ), over the poles of the stages j … i.  For N = 1
that is the divided difference f[λ_j … λ_i] of the exponential (`lowlight/response.py`), gain Π w of the stages after j.

Zeros.  N(s)/Π(s − λ) is expanded by dropping one pole:  (s − ν) = (s − λ_k) + (λ_k − ν).
    s (slope of y, and passage through the lower cutoff's high-pass):  f[λ∖k] + λ_k f[λ], with k the slowest pole,
        so that the two terms are only comparable where the response really changes sign.
    s + 2b (from y: Y = ((s + 2b) y₀ + v₀ + a U)/((s − λ₁)(s − λ₂)), with λ₁ + λ₂ = −2b):  drop the fast pole λ₁,
        λ₁ + 2b = −λ₂:  f[λ∖1] − λ₂ f[λ]; both terms are positive for real poles.

Input.  u = u[k+1] − (u[k+1] − u[k]) σ counted back from the step's end, so with the impulse response h of the path
from the input, H = gain · N/Π(s − λ),
    B̃ = ∫ h (1 − σ) dσ = ramp response, transform H/s²:   gain f[λ, 0, 0]        (N = s: gain f[λ, 0])
    B  = ∫ σ h dσ, transform −H′/s:                         gain Σ_i f[λ, λ_i, 0]  (N = s: gain (f[λ] − f[λ, 0]))
The sum over the duplicated poles is positive term by term for real poles; the textbook difference of step and
ramp response would lose log10(ωΔt) digits.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from pixelid.dynamics.continuous import present_states
from pixelid.dynamics.equations import photoreceptor_rates
from pixelid.dynamics.trajectory import Dynamics
from pixelid.lowlight.response import difference


class Hold(NamedTuple):
    """One step: state names (n of `STAGES`), A (n, n), B (n,) on the older input, B_next (n,) on the newer."""

    names: tuple[str, ...]
    A: np.ndarray
    B: np.ndarray
    B_next: np.ndarray


def rates(dynamics: Dynamics, radiance: float, names: tuple[str, ...]) -> np.ndarray:
    """(n,) rate of each state: its cutoff in rad/s; for a second-order photoreceptor (2ζωn, ωn²)."""
    second = "photoreceptor_slope" in names
    a, b2 = photoreceptor_rates(dynamics, radiance)
    of = {
        "photoreceptor_slope": b2,
        "photoreceptor": a if second else dynamics.gamma * (radiance + dynamics.floor),
        "source_follower": dynamics.follower,
        "extra_pole": dynamics.extra_pole,
        "lower_cutoff": dynamics.lower_cutoff,
        "differencing": dynamics.differencing,
    }
    return np.array([of[name] for name in names], dtype=np.float64)


def high_pass_index(names: tuple[str, ...]) -> int:
    """Where the lower cutoff's low-pass stands among the states; their number when it is absent."""
    return names.index("lower_cutoff") if "lower_cutoff" in names else len(names)


def first_order_hold(dynamics: Dynamics, radiance: float, dt: float) -> Hold:
    """The coefficients of one step of `dt` seconds, the photoreceptor linearised at `radiance`.

    Any combination of stages: photoreceptor of no, one or two poles, follower, extra pole, lower cutoff,
    differencing amplifier.  Relative error below 1e-11 for real poles and positive coefficients, down to the
    underflow; coefficients that oscillate or change sign are as accurate relative to their envelope, as far as
    float64 can hold the phase ωΔt of an oscillation.
    """
    names = present_states(dynamics)
    n = len(names)
    a, b, b_next = np.empty((n, n)), np.empty(n), np.empty(n)
    fill(rates(dynamics, radiance, names), "photoreceptor_slope" in names, high_pass_index(names), dt, a, b, b_next)
    return Hold(names, a, b, b_next)


@njit(cache=True)
def _poles(rate, second, dt):
    """Poles × dt, complex128 (n,); a second-order photoreceptor's fast one (or conjugate) first, slow one second."""
    z = (-rate * dt).astype(np.complex128)
    if second:
        b, a = 0.5 * rate[0], rate[1]
        disc = b * b - a
        if disc >= 0:
            fast = b + np.sqrt(disc)
            z[0], z[1] = -fast * dt, -(a / fast) * dt
        else:
            z[0], z[1] = complex(-b * dt, np.sqrt(-disc) * dt), complex(-b * dt, -np.sqrt(-disc) * dt)
    return z


@njit(cache=True)
def _without(z, k):
    return np.concatenate((z[:k], z[k + 1 :]))


@njit(cache=True)
def _through_zero(z):
    """Inverse transform of s / Π (s − z)."""
    k = np.argmin(np.abs(z))
    return difference(_without(z, k)) + z[k] * difference(z)


@njit(cache=True)
def _free(z, from_output, through_zero):
    """Inverse transform of N / Π (s − z), N with the factor s + 2b and/or s."""
    response = _through_zero(z) if through_zero else difference(z)
    if from_output:
        rest = _without(z, 0)
        response = (_through_zero(rest) if through_zero else difference(rest)) - z[1] * response
    return response.real


@njit(cache=True)
def _driven(z, through_zero):
    """(B, B̃) / gain of the path with poles z from the input."""
    zero = np.zeros(1, dtype=np.complex128)
    step = np.concatenate((z, zero))
    if through_zero:
        ramp = difference(step).real
        return difference(z).real - ramp, ramp
    older = 0.0
    for i in range(len(z)):
        older += difference(np.concatenate((step, z[i : i + 1]))).real
    return older, difference(np.concatenate((step, zero))).real


@njit(cache=True)
def fill(rate, second, high_pass, dt, A, B, B_next):
    """Compiled `first_order_hold`: rates (n,) as of `rates`; fills A (n, n), B (n,), B_next (n,) in place."""
    n = len(rate)
    A[:] = 0.0
    B[:] = 0.0
    B_next[:] = 0.0
    if dt == 0:
        for i in range(n):
            A[i, i] = 1.0
        return
    z = _poles(rate, second, dt)
    gains = rate * dt  # gains[j]: what the signal is multiplied by on its way into stage j
    if second:
        gains[0], gains[1] = rate[1] * dt * dt, 1.0
    for i in range(n):
        slope = second and i == 0  # this state is v·dt, the output y differentiated
        passes = i > high_pass  # the amplifier, driven through the lower cutoff's high-pass
        last = 1 if slope else i
        gain = 1.0
        for j in range(last, -1, -1):
            path = z[0 if second and j == 1 else j : last + 1]
            if slope and j == 1:
                A[i, j] = -gains[0] * difference(path).real
            elif passes and j == high_pass:
                A[i, j] = -gain * difference(path).real
            else:
                A[i, j] = gain * _free(path, second and j == 1, slope or (passes and j < high_pass))
            if not (passes and j == high_pass):
                gain *= gains[j]
        older, newer = _driven(z[: last + 1], slope or passes)
        B[i], B_next[i] = gain * older, gain * newer
    if second:
        A[0, 1:] /= dt
        A[1:, 0] *= dt
        B[0] /= dt
        B_next[0] /= dt
