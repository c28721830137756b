"""Trajectories of a slew-limited follower in closed form:  d s/dt = clip(ωsf (y − s), −fall, +rise).

Within a step of the light the follower is either free, and the chain linear, or at its limit: then s is a ramp, the
photoreceptor goes on as ever, and the stages behind it answer a ramp.  All three have the closed form of `kernels`;
the moments between them are roots of ωsf (y − s) = limit.  A step that the limit does not touch is one closed form
and a look at its end.  (The simulator integrates the same equation another way, see `slew.py`.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from pixelid.dynamics import kernels, slew
from pixelid.dynamics.equations import (
    ABSENT_DIFFERENCING,
    ABSENT_EXTRA,
    ABSENT_FOLLOWER,
    ABSENT_PHOTORECEPTOR,
    PRESENT_BELOW,
)
from pixelid.dynamics.trajectory import Dynamics, Trajectory
from pixelid.errors import InputError
from pixelid.stages.circuit import Circuit

ROOT = 1e-9  # of a step: how closely a switch is timed; s has no kink there, so its error is the square of this
ROOT_STEPS = 60
RESOLVED = 0.5  # of the shortest time constant of photoreceptor and follower: how far apart switches are looked for
FASTEST = 2 * np.pi * 4e4  # rad/s: what is faster follows the rest


@dataclass(frozen=True)
class SlewedTrajectory(Trajectory):
    """A trajectory, and per step of the light whether the follower is limited, and where that changes.

    mode: (n,) of the step that begins at each sample: 0 free, +1 rising at the limit, −1 falling
    first: (n + 1,) which changes belong to step k: first[k]…first[k+1]
    change_s: (m,) since the beginning of their step;  change_mode, change_states: (m,), (m, 6) from there on
    rates: (w1, w2, wh, wd, rise, fall)
    """

    rates: tuple
    mode: np.ndarray
    first: np.ndarray
    change_s: np.ndarray
    change_mode: np.ndarray
    change_states: np.ndarray

    def at(self, times, step=None) -> np.ndarray:
        """(m, 6) states at `times` (m,) seconds;  step: (m,) the step that holds each, where it is known."""
        times = np.asarray(times, dtype=np.float64)
        if step is None:
            step = np.maximum(np.searchsorted(self.t, times, side="right") - 1, 0)
        out = np.empty((len(times), 6))
        _at(
            times, step, self.t, self.u, self.radiance, tuple(self.dynamics), self.rates, self.midpoint,
            self.states, self.mode, self.first, self.change_s, self.change_mode, self.change_states, out,
        )  # fmt: skip
        return out


def slewed(t, radiance, circuit: Circuit, dynamics: Dynamics) -> SlewedTrajectory:
    """The trajectory of a slew-limited circuit under radiance (n,) at t (n,); dynamics: of it without the limit.

    Steady state at the first sample, log radiance linear between samples.  Raises InputError without source follower or
    differencing pole: the first would have nothing to slew, the second is what the level at an event is read through.
    """
    if not (np.isfinite(np.real(circuit.follower)) and np.isfinite(np.real(circuit.differencing))):
        raise InputError("slew_limit: its likelihood needs source_follower_pole and differencing_pole")
    values = Dynamics(*(float(np.real(value)) for value in dynamics))
    rates = slew.rates_of(circuit, values)
    t, radiance = np.ascontiguousarray(t, np.float64), np.ascontiguousarray(radiance, np.float64)
    u, midpoint = np.log(radiance), circuit.linearisation == "midpoint"
    states, mode, first = np.empty((len(t), 6)), np.zeros(len(t), np.int8), np.zeros(len(t) + 1, np.int64)
    changes = _scan(t, u, radiance, tuple(values), rates, midpoint, states, mode, first)
    return SlewedTrajectory(t, u, radiance, values, midpoint, states, rates, mode, first, *changes)


@njit(cache=True, error_model="numpy")
def _advance(mode, state, u0, r, tau, a, b2, rates, coincide, coincide_behind):
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
def _beyond(mode, state, rates):
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
        safe = -_beyond(mode, state, rates) / rates[0] / (steepest + (rates[4] if mode > 0 else rates[5]))
    fastest = max(rates[0], np.sqrt(a) if b2 < PRESENT_BELOW else 0.0)
    return min(left, max(safe, RESOLVED / min(fastest, FASTEST)))


@njit(cache=True, error_model="numpy")
def _change(mode, state, after, late, u0, r, a, b2, rates, coincide, coincide_behind, width):
    """(moment, state) just after the mode ends, as it has by `late`, in state `after`: regula falsi (Illinois)."""
    low, f_low = 0.0, min(_beyond(mode, state, rates), 0.0)
    high, f_high = late, _beyond(mode, after, rates)
    side = 0
    for i in range(ROOT_STEPS):
        if high - low <= width:
            break
        x = (low * f_high - high * f_low) / (f_high - f_low) if i % 4 < 3 else 0.5 * (low + high)
        x = min(max(x, low + 0.25 * width), high - 0.25 * width)
        there = _advance(mode, state, u0, r, x, a, b2, rates, coincide, coincide_behind)
        f = _beyond(mode, there, rates)
        if f > 0.0:
            high, f_high, after = x, f, there
            f_low = 0.5 * f_low if side > 0 else f_low
            side = 1
        else:
            low, f_low = x, f
            f_high = 0.5 * f_high if side < 0 else f_high
            side = -1
    return high, after


@njit(cache=True, nogil=True, error_model="numpy")
def _scan(t, u, radiance, dynamics, rates, midpoint, states, mode, first):
    """Fill states, modes and the first change of every step; returns the changes' times, modes and states."""
    alpha, beta, gamma = dynamics[0], dynamics[1], dynamics[2]
    w1, w2, wh, wd, _, _ = rates
    coincide = kernels.cutoffs_coincide(w1, w2, wh, wd)
    coincide_behind = kernels.cutoffs_coincide(ABSENT_FOLLOWER, w2, wh, wd)
    change_s, change_mode, change_states, count = np.empty(64), np.empty(64, np.int8), np.empty((64, 6)), 0
    rest = u[0] if wh > 0.0 else 0.0
    state = (0.0, u[0], u[0], u[0], rest, u[0] - rest)
    now = 0
    for k in range(len(t)):
        first[k] = count
        for j in range(6):
            states[k, j] = state[j]
        tau = t[k + 1] - t[k] if k + 1 < len(t) else 0.0
        if tau <= 0.0:
            mode[k] = now
            continue
        if _beyond(now, state, rates) > 0.0:
            now = _next(now, state, rates)
        mode[k] = now
        r = (u[k + 1] - u[k]) / tau
        light = kernels.linearised_at(radiance[k], radiance[k + 1], midpoint)
        a, b2 = alpha * light, beta + gamma * light
        x = 0.0
        while x < tau:
            u0 = u[k] + r * x
            far = _looked_at(now, state, u0, r, tau - x, a, b2, rates)
            end = _advance(now, state, u0, r, far, a, b2, rates, coincide, coincide_behind)
            if _beyond(now, end, rates) <= 0.0:
                state, x = end, x + far if far < tau - x else tau
                continue
            moment, state = _change(now, state, end, far, u0, r, a, b2, rates, coincide, coincide_behind, ROOT * tau)
            now, x = _next(now, state, rates), x + moment
            if count == len(change_s):
                change_s = np.append(change_s, np.empty(count))
                change_mode = np.append(change_mode, np.empty(count, np.int8))
                change_states = np.concatenate((change_states, np.empty((count, 6))))
            change_s[count], change_mode[count] = x, now
            for j in range(6):
                change_states[count, j] = state[j]
            count += 1
    first[len(t)] = count
    return change_s[:count].copy(), change_mode[:count].copy(), change_states[:count].copy()


@njit(cache=True, nogil=True, error_model="numpy")
def _at(
    times, step, t, u, radiance, dynamics, rates, midpoint, states, mode, first,
    change_s, change_mode, change_states, out,
):  # fmt: skip
    alpha, beta, gamma = dynamics[0], dynamics[1], dynamics[2]
    w1, w2, wh, wd, _, _ = rates
    coincide = kernels.cutoffs_coincide(w1, w2, wh, wd)
    coincide_behind = kernels.cutoffs_coincide(ABSENT_FOLLOWER, w2, wh, wd)
    for i in range(len(times)):
        k = step[i]
        x = max(times[i] - t[k], 0.0)
        state = (states[k, 0], states[k, 1], states[k, 2], states[k, 3], states[k, 4], states[k, 5])
        now, since, r, light = mode[k], 0.0, 0.0, radiance[k]
        if k + 1 < len(t):
            r = (u[k + 1] - u[k]) / (t[k + 1] - t[k])
            light = kernels.linearised_at(radiance[k], radiance[k + 1], midpoint)
        for j in range(first[k], first[k + 1]):
            if change_s[j] > x:
                break
            now, since = change_mode[j], change_s[j]
            state = (
                change_states[j, 0], change_states[j, 1], change_states[j, 2],
                change_states[j, 3], change_states[j, 4], change_states[j, 5],
            )  # fmt: skip
        if x > since:
            a, b2 = alpha * light, beta + gamma * light
            state = _advance(now, state, u[k] + r * since, r, x - since, a, b2, rates, coincide, coincide_behind)
        for j in range(6):
            out[i, j] = state[j]
