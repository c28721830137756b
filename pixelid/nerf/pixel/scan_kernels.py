"""The pixel over irregular samples of light, and its gradient: one scan forwards, one backwards, compiled.

A run is a sorted sequence of samples of one pixel's light u = ln L; the pixel is in steady state at its first sample.
The state x of `dynamics.equations` advances by closed-form steps with u linear in between (first-order hold),

    x[k+1] = A x[k] + B u[k] + B̃ u[k+1],     A, B, B̃ functions of (a, 2ζωn, ω1, ωd) at the step's radiance.

Every run has numbers of its own (pixels differ).  The bandwidth floor is added to the radiance that sets a and 2ζωn.

Gradients.  With λ the gradient by the state after a step, the gradient by the state before it is Aᵀλ, by the two
inputs B·λ and B̃·λ.  The coefficients depend on the light through the linearisation: λ · ∂x[k+1]/∂(a, b2, ω1, ωd), and
from there by the chain rule to u, α, β, γ, ω1, ωd.  For the chain of four states the closed form is differentiated by
hand (`scan_adjoint`); for others, and where poles nearly coincide, by unit vectors and complex steps (exact).
Source of the weighted form: Low & Lee, arXiv 2409.17988, supplement; here the weights are never formed.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pixelid.dynamics import kernels
from pixelid.dynamics.kernels import linearised_at
from pixelid.nerf.pixel import scan_adjoint

STATES = 6  # v, y, s, e, z, d, see `dynamics.equations`
TINY = 1e-30  # complex step
PARAMETERS = 8  # (α, β, γ, ω1, ω2, ωh, ωd, floor); gradients by all but ω2 and ωh


@njit(cache=True, nogil=True, error_model="numpy")
def forward(first, t, u, dynamics, midpoint, states):
    """Fill states (n, 6) of runs that begin at the samples first (runs + 1,), times t (n,), log radiance u (n,).

    dynamics: (runs, 8)
    """
    for run in range(len(first) - 1):
        k = first[run]
        if k == first[run + 1]:
            continue
        alpha, beta, gamma, w1, w2, wh, wd, floor = _row(dynamics, run)
        coincide = kernels.cutoffs_coincide(w1, w2, wh, wd)
        high = 0.0 if wh == 0.0 else u[k]
        level = u[k] - high
        state = (0.0, u[k], u[k], u[k], u[k] if wh == 0.0 else high, level)
        _store(states, k, state)
        for k in range(first[run] + 1, first[run + 1]):
            tau = t[k] - t[k - 1]
            if tau > 0.0:
                light = linearised_at(np.exp(u[k - 1]), np.exp(u[k]), midpoint) + floor
                state = kernels.advance(
                    state, u[k - 1], (u[k] - u[k - 1]) / tau, tau, alpha * light, beta + gamma * light,
                    w1, w2, wh, wd, coincide,
                )  # fmt: skip
            _store(states, k, state)


@njit(inline="always", error_model="numpy")
def _row(dynamics, run):
    """The numbers of one run."""
    return (
        dynamics[run, 0], dynamics[run, 1], dynamics[run, 2], dynamics[run, 3], dynamics[run, 4], dynamics[run, 5],
        dynamics[run, 6], dynamics[run, 7],
    )  # fmt: skip


@njit(inline="always", error_model="numpy")
def _store(states, k, state):
    states[k, 0], states[k, 1], states[k, 2] = state[0], state[1], state[2]
    states[k, 3], states[k, 4], states[k, 5] = state[3], state[4], state[5]


@njit(inline="always", error_model="numpy")
def _dot(row, state):
    return (
        row[0] * state[0] + row[1] * state[1] + row[2] * state[2]
        + row[3] * state[3] + row[4] * state[4] + row[5] * state[5]
    )  # fmt: skip


@njit(inline="always", error_model="numpy")
def _slope(row, state):
    """row · Im(state) / TINY: the derivative that a complex step has carried."""
    return (
        row[0] * state[0].imag + row[1] * state[1].imag + row[2] * state[2].imag
        + row[3] * state[3].imag + row[4] * state[4].imag + row[5] * state[5].imag
    ) / TINY  # fmt: skip


@njit(inline="always", error_model="numpy")
def _unit(j):
    return (
        1.0 if j == 0 else 0.0, 1.0 if j == 1 else 0.0, 1.0 if j == 2 else 0.0,
        1.0 if j == 3 else 0.0, 1.0 if j == 4 else 0.0, 1.0 if j == 5 else 0.0,
    )  # fmt: skip


@njit(inline="always", error_model="numpy")
def _directional(state, u0, r, tau, a, b2, w1, w2, wh, wd, coincide, da, db, d1, dd, row):
    """row · derivative of the step in the direction (da, db, d1, dd) of (a, b2, ω1, ωd)."""
    still = 0.0 * 1j
    at = (
        state[0] + still, state[1] + still, state[2] + still, state[3] + still, state[4] + still, state[5] + still
    )  # fmt: skip
    return _slope(
        row,
        kernels.advance(
            at, u0 + still, r + still, tau, a + da * TINY * 1j, b2 + db * TINY * 1j, w1 + d1 * TINY * 1j, w2 + still,
            wh + still, wd + dd * TINY * 1j, coincide,
        ),
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def backward(first, t, u, dynamics, midpoint, states, by_level, by_output, parameters, by_u, by_dynamics):
    """Add to by_u (n,), and to by_dynamics (runs, 8) where `parameters`, the gradient of a function of the scan.

    by_level, by_output: (n,) its gradient by the reset level (follower output, or e − z) and by the never-reset
    amplifier output at every sample;  states: of `forward`
    """
    row, before = np.zeros(STATES), np.zeros(STATES)
    for run in range(len(first) - 1):
        alpha, beta, gamma, w1, w2, wh, wd, floor = _row(dynamics, run)
        coincide = kernels.cutoffs_coincide(w1, w2, wh, wd)
        plain = w2 > kernels.PRESENT_BELOW and wh == 0.0
        unlimited = gamma == 0.0 and beta > kernels.PRESENT_BELOW  # `Dynamics.unlimited`
        by_hand = plain and not coincide and beta < kernels.PRESENT_BELOW
        row[:] = 0.0
        for k in range(first[run + 1] - 1, first[run], -1):
            row[3] += by_level[k]
            row[4] -= by_level[k] if wh > 0.0 else 0.0
            row[5] += by_output[k]
            tau = t[k] - t[k - 1]
            if tau <= 0.0:
                continue
            light = linearised_at(np.exp(u[k - 1]), np.exp(u[k]), midpoint)
            a, b2 = alpha * (light + floor), beta + gamma * (light + floor)
            if plain:  # e repeats s
                row[2] += row[3]
                row[3] = 0.0
            r = (u[k] - u[k - 1]) / tau
            if by_hand and scan_adjoint.accurate(r, tau, a, b2, w1, wd):
                at = (states[k - 1, 0], states[k - 1, 1], states[k - 1, 2], states[k - 1, 5])
                earlier, older, newer, by_a, by_b, by_1, by_d = scan_adjoint.step_back(
                    at, u[k - 1], r, tau, a, b2, w1, wd, (row[0], row[1], row[2], row[5])
                )
                by_light = light * (alpha * by_a + gamma * by_b)
                by_u[k] += newer + (0.5 * by_light if midpoint else by_light)
                by_u[k - 1] += older + (0.5 * by_light if midpoint else 0.0)
                if parameters:
                    by_dynamics[run, 0] += by_a * (light + floor)
                    by_dynamics[run, 1] += by_b
                    by_dynamics[run, 2] += by_b * (light + floor)
                    by_dynamics[run, 3] += by_1 if w1 < kernels.PRESENT_BELOW else 0.0
                    by_dynamics[run, 6] += by_d if wd < kernels.PRESENT_BELOW else 0.0
                    by_dynamics[run, 7] += alpha * by_a + gamma * by_b
                row[0], row[1], row[2], row[5] = earlier
                continue
            for j in range(STATES):
                before[j] = 0.0
                if plain and (j == 3 or j == 4):
                    continue
                after = kernels.advance(_unit(j), 0.0, 0.0, tau, a, b2, w1, w2, wh, wd, coincide)
                if plain:
                    before[j] = row[0] * after[0] + row[1] * after[1] + row[2] * after[2] + row[5] * after[5]
                else:
                    before[j] = _dot(row, after)
            state = (
                states[k - 1, 0], states[k - 1, 1], states[k - 1, 2], states[k - 1, 3], states[k - 1, 4],
                states[k - 1, 5],
            )  # fmt: skip
            at_rest = _unit(9)
            newer = kernels.advance(at_rest, 0.0, 1.0 / tau, tau, a, b2, w1, w2, wh, wd, coincide)
            older = kernels.advance(at_rest, 1.0, -1.0 / tau, tau, a, b2, w1, w2, wh, wd, coincide)
            by_u[k] += _dot(row, newer)
            by_u[k - 1] += _dot(row, older)
            if parameters and w1 < kernels.PRESENT_BELOW:
                by_dynamics[run, 3] += (
                    _directional(state, u[k - 1], r, tau, a, b2, w1, w2, wh, wd, coincide, 0.0, 0.0, w1, 0.0, row) / w1
                )
            if parameters and wd < kernels.PRESENT_BELOW:
                by_dynamics[run, 6] += (
                    _directional(state, u[k - 1], r, tau, a, b2, w1, w2, wh, wd, coincide, 0.0, 0.0, 0.0, wd, row) / wd
                )
            if unlimited:  # no photoreceptor whose coefficients the light could move; its complex step would overflow
                by_light = 0.0
            elif parameters:
                by_a = _directional(state, u[k - 1], r, tau, a, b2, w1, w2, wh, wd, coincide, a, 0.0, 0.0, 0.0, row) / a
                by_b = (
                    _directional(state, u[k - 1], r, tau, a, b2, w1, w2, wh, wd, coincide, 0.0, b2, 0.0, 0.0, row) / b2
                )
                by_seen = alpha * by_a + gamma * by_b
                by_light = light * by_seen
                by_dynamics[run, 0] += by_a * (light + floor)
                by_dynamics[run, 1] += by_b
                by_dynamics[run, 2] += by_b * (light + floor)
                by_dynamics[run, 7] += by_seen
            else:
                by_light = _directional(
                    state, u[k - 1], r, tau, a, b2, w1, w2, wh, wd, coincide, alpha * light, gamma * light, 0.0, 0.0,
                    row,
                )  # fmt: skip
            if midpoint:
                by_u[k] += 0.5 * by_light
                by_u[k - 1] += 0.5 * by_light
            else:
                by_u[k] += by_light
            for j in range(STATES):
                row[j] = before[j]
        if first[run + 1] > first[run]:
            k = first[run]
            row[3] += by_level[k]
            row[4] -= by_level[k] if wh > 0.0 else 0.0
            row[5] += by_output[k]
            by_u[k] += row[1] + row[2] + row[3] + (row[4] if wh > 0.0 else row[5])
