"""Trajectories of a slew-limited follower (`slew.py`), and where in each step of the light its limit acts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numba import njit

from pixelid.dynamics import kernels, slew
from pixelid.dynamics.equations import ABSENT_FOLLOWER
from pixelid.dynamics.slew import ROOT, advance, mode_of, until_change
from pixelid.dynamics.trajectory import Dynamics, Trajectory
from pixelid.errors import InputError
from pixelid.stages.circuit import Circuit


@dataclass(frozen=True)
class SlewedTrajectory(Trajectory):
    """A trajectory, and per step of the light whether the follower is limited, and where that changes.

    mode: (n,) of the step that begins at each sample: 0 free, +1 rising at the limit, −1 falling
    first: (n + 1,) which changes belong to step k: first[k]…first[k+1]
    change_s: (m,) since the beginning of their step;  change_mode, change_states: (m,), (m, 6) from there on
    rates: (w1, w2, wh, wd, rise, fall)
    """

    linear = False

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
            times, step, self.t, self.u, self.radiance, self.dynamics, self.rates, self.midpoint,
            self.states, self.mode, self.first, self.change_s, self.change_mode, self.change_states, out,
        )  # fmt: skip
        return out


def slewed(
    t,
    radiance,
    circuit: Circuit,
    dynamics: Dynamics,
    first: Sequence[int] | np.ndarray | None = None,
    log_radiance: np.ndarray | None = None,
) -> SlewedTrajectory:
    """The trajectory of a slew-limited circuit under radiance (n,) at t (n,); dynamics: of it without the limit.

    `first`, `log_radiance`: as of `trajectory.integrate`.  Steady state at the first sample, log radiance linear
    between samples.
    Raises InputError without source follower or differencing pole: the first would have nothing to slew, the second is
    what the level at an event is read through.
    """
    if not (np.isfinite(circuit.follower) and np.isfinite(circuit.differencing)):
        raise InputError("slew_limit: its likelihood needs source_follower_pole and differencing_pole")
    values = dynamics.uniform()
    rates = slew.rates_of(circuit, values)
    t, radiance = np.ascontiguousarray(t, np.float64), np.ascontiguousarray(radiance, np.float64)
    u = np.log(radiance) if log_radiance is None else log_radiance
    midpoint = circuit.linearisation == "midpoint"
    states, mode, change = np.empty((len(t), 6)), np.zeros(len(t), np.int8), np.zeros(len(t) + 1, np.int64)
    parts, count = [], 0
    for begin, end in pairwise((0, len(t)) if first is None else first):
        one, to = slice(begin, end), change[begin : end + 1]
        parts.append(_scan(t[one], u[one], radiance[one], values, rates, midpoint, states[one], mode[one], to))
        to += count
        count = int(to[-1])
    changes = parts[0] if len(parts) == 1 else tuple(map(np.concatenate, zip(*parts, strict=True)))
    return SlewedTrajectory(t, u, radiance, values, midpoint, states, rates, mode, change, *changes)


@njit(cache=True, nogil=True, error_model="numpy")
def _scan(t, u, radiance, dynamics, rates, midpoint, states, mode, first):
    """Fill states, modes and the first change of every step; returns the changes' times, modes and states."""
    w1, w2, wh, wd, _, _ = rates
    coincide = kernels.cutoffs_coincide(w1, w2, wh, wd)
    coincide_behind = kernels.cutoffs_coincide(ABSENT_FOLLOWER, w2, wh, wd)
    change_s, change_mode, change_states, count = np.empty(64), np.empty(64, np.int8), np.empty((64, 6)), 0
    state = kernels.steady_state(u[0], wh)
    for k in range(len(t)):
        first[k] = count
        for j in range(6):
            states[k, j] = state[j]
        tau = t[k + 1] - t[k] if k + 1 < len(t) else 0.0
        now = mode_of(state, rates)
        mode[k] = now
        if tau <= 0.0:
            continue
        r = (u[k + 1] - u[k]) / tau
        a, b2 = kernels.photoreceptor_rates(dynamics, kernels.linearised_at(radiance[k], radiance[k + 1], midpoint))
        x = 0.0
        while x < tau:
            before = now
            moment, now, state = until_change(
                now, state, u[k] + r * x, r, tau - x, a, b2, rates, coincide, coincide_behind, ROOT * tau
            )
            x += moment
            if now == before:
                break
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
            a, b2 = kernels.photoreceptor_rates(dynamics, light)
            state = advance(now, state, u[k] + r * since, r, x - since, a, b2, rates, coincide, coincide_behind)
        for j in range(6):
            out[i, j] = state[j]
