"""Teacher-forced changes: what the differencing amplifier showed at each event, given the previous event.

For an interval released at tr (previous event + dead time), DESIGN §1:

    change(t) = d(t) − h(tr) − (d(tr) − h(tr)) exp(−ωd (t − tr)) + C_on (leak (t − tr) + parasitic ∫ L dt)

with d the never-reset amplifier output and h what it is reset to.  The leak part is kept apart (`drift`, in
units of C_on) because it is the only part that depends on a threshold.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from pixelid.dynamics import kernels
from pixelid.dynamics.equations import PRESENT_BELOW
from pixelid.dynamics.of_circuit import dynamics_of
from pixelid.dynamics.trajectory import Trajectory, integrate
from pixelid.likelihood.sequences import Sequences
from pixelid.recordings.recording import Recording
from pixelid.stages.circuit import Circuit
from pixelid.stimuli.drive import drive


@dataclass(frozen=True)
class Changes:
    """Per interval, in log radiance units (leak excluded) and units of C_on (drift).

    change, slope: (n,) at the event;  drift, drift_slope: (n,) leak at the event, in C_on and C_on/s
    opposite: (n,) extreme of −sign·change before the event, and opposite_drift there
    rise, rise_drift, fall, fall_drift: (m,) extremes of +change and −change over the censored last intervals
    valid: whether every event comes after its pixel's release
    """

    change: np.ndarray
    slope: np.ndarray
    drift: np.ndarray
    drift_slope: np.ndarray
    opposite: np.ndarray
    opposite_drift: np.ndarray
    rise: np.ndarray
    rise_drift: np.ndarray
    fall: np.ndarray
    fall_drift: np.ndarray
    valid: bool


@njit(cache=True, error_model="numpy")
def _locate(t, time, hint):
    """Index k with t[k] ≤ time < t[k+1], walking from a hint."""
    k = hint
    last = len(t) - 1
    if k > last or k < 0:
        k = 0
    if time < t[k] or (k + 16 < last and time > t[k + 16]):
        k = max(np.searchsorted(t, time, side="right") - 1, 0)
    while k < last and t[k + 1] <= time:
        k += 1
    return k


@njit(cache=True, error_model="numpy")
def _light_integral(tau, k, t, u, L):
    """∫ L dt over the first `tau` of step k, log radiance linear."""
    if k + 1 >= len(t):
        return L[k] * tau
    step = t[k + 1] - t[k]
    if step <= 0:
        return L[k] * 0.0
    x = (u[k + 1] - u[k]) / step * tau
    if abs(x.real) < 1e-4:
        return L[k] * tau * (1.0 + x / 2.0 + x * x / 6.0)
    return L[k] * tau * (np.exp(x) - 1.0) / x


@njit(cache=True, nogil=True, error_model="numpy")
def _cumulative_light(t, u, L, out):
    out[0] = L[0] * 0.0
    for k in range(1, len(t)):
        out[k] = out[k - 1] + _light_integral(t[k] - t[k - 1], k - 1, t, u, L)


@njit(cache=True, error_model="numpy")
def _release(tr, kr, t, u, L, dynamics, coincide, midpoint, states):
    state = kernels.within_step(tr, kr, t, u, L, dynamics, coincide, midpoint, states)
    level, d, _ = kernels.reference_and_slopes(state, dynamics, u[0] * 0.0)
    offset = d - level if dynamics[6].real < PRESENT_BELOW else level * 0.0
    return level, offset


@njit(cache=True, error_model="numpy")
def _at_sample(k, tr, level, offset, lights, light_r, t, dynamics, states, leak, parasitic, single):
    """(change, drift) at stimulus sample k."""
    wd = dynamics[6]
    if wd.real < PRESENT_BELOW:
        change = states[k, 5] - level
        x = wd * (t[k] - tr)
        if x.real < 40.0:
            change = change - offset * np.exp(-x)
    else:
        change = states[k, 3] - states[k, 4] - level
    drift = leak * (t[k] - tr)
    if single:
        drift = drift + parasitic * (lights[k] - light_r)
    return change, drift


@njit(cache=True, nogil=True, error_model="numpy")
def _events(
    previous, time, sign, hint_previous, hint_time, extreme_at, find_extremes,
    t, u, L, lights, dynamics, midpoint, states, leak, parasitic, on_scale, refractory, delay,
    change, slope, drift, drift_slope, opposite, opposite_drift,
):  # fmt: skip
    """Fill the per-interval arrays; returns the number of events that precede their release."""
    coincide = kernels.cutoffs_coincide(dynamics[3], dynamics[4], dynamics[5], dynamics[6])
    wd = dynamics[6]
    finite = wd.real < PRESENT_BELOW
    with_light = parasitic.real != 0
    early = 0
    for i in range(len(time)):
        tr = previous[i] + refractory - delay
        te = time[i] - delay
        if te.real <= tr.real:
            early += 1
        kr = _locate(t, tr.real, hint_previous[i])
        ke = _locate(t, te.real, hint_time[i])
        level, offset = _release(tr, kr, t, u, L, dynamics, coincide, midpoint, states)
        state = kernels.within_step(te, ke, t, u, L, dynamics, coincide, midpoint, states)
        u_slope = (u[ke + 1] - u[ke]) / (t[ke + 1] - t[ke]) if ke + 1 < len(t) else u[0] * 0.0
        _, d, ds = kernels.reference_and_slopes(state, dynamics, u_slope)
        c = d - level
        if finite:
            decay = offset * np.exp(-wd * (te - tr))
            c = c - decay
            ds = ds + wd * decay
        dr = leak * (te - tr)
        drs = leak
        light_r = u[0] * 0.0
        if with_light:
            light_r = lights[kr] + _light_integral(tr - t[kr], kr, t, u, L)
            dr = dr + parasitic * (lights[ke] + _light_integral(te - t[ke], ke, t, u, L) - light_r)
            drs = drs + parasitic * np.exp(u[ke] + u_slope * (te - t[ke]))
        change[i] = c
        slope[i] = ds
        drift[i] = dr
        drift_slope[i] = drs
        # the other polarity's extreme: 0 at release, the stimulus samples in between
        if find_extremes:
            best = 0.0
            where = -1
            if kr < ke:
                for k in range(kr + 1, ke + 1):
                    ck, dk = _at_sample(
                        k, tr, level, offset, lights, light_r, t, dynamics, states, leak, parasitic, with_light
                    )
                    value = -sign[i] * (ck + on_scale * dk).real
                    if value > best:
                        best = value
                        where = k
            extreme_at[i] = where
        where = extreme_at[i]
        if where >= 0:
            ck, dk = _at_sample(
                where, tr, level, offset, lights, light_r, t, dynamics, states, leak, parasitic, with_light
            )
            opposite[i] = -sign[i] * ck
            opposite_drift[i] = -sign[i] * dk
        else:
            opposite[i] = u[0] * 0.0
            opposite_drift[i] = u[0] * 0.0
    return early


@njit(cache=True, nogil=True, error_model="numpy")
def _censored(
    last, end, hints, rise_at, fall_at, find_extremes,
    t, u, L, lights, dynamics, midpoint, states, leak, parasitic, on_scale, refractory, delay,
    rise, rise_drift, fall, fall_drift,
):  # fmt: skip
    coincide = kernels.cutoffs_coincide(dynamics[3], dynamics[4], dynamics[5], dynamics[6])
    with_light = parasitic.real != 0
    zero = u[0] * 0.0
    for i in range(len(last)):
        tr = last[i] + refractory - delay
        kr = _locate(t, tr.real, hints[i])
        level, offset = _release(tr, kr, t, u, L, dynamics, coincide, midpoint, states)
        light_r = zero
        if with_light:
            light_r = lights[kr] + _light_integral(tr - t[kr], kr, t, u, L)
        if find_extremes:
            high, low = 0.0, 0.0
            rise_at[i], fall_at[i] = -1, -1
            for k in range(kr + 1, len(t)):
                if t[k] > end:
                    break
                ck, dk = _at_sample(
                    k, tr, level, offset, lights, light_r, t, dynamics, states, leak, parasitic, with_light
                )
                value = (ck + on_scale * dk).real
                if value > high:
                    high = value
                    rise_at[i] = k
                if value < low:
                    low = value
                    fall_at[i] = k
        rise[i], rise_drift[i], fall[i], fall_drift[i] = zero, zero, zero, zero
        if rise_at[i] >= 0:
            rise[i], rise_drift[i] = _at_sample(
                rise_at[i], tr, level, offset, lights, light_r, t, dynamics, states, leak, parasitic, with_light
            )
        if fall_at[i] >= 0:
            ck, dk = _at_sample(
                fall_at[i], tr, level, offset, lights, light_r, t, dynamics, states, leak, parasitic, with_light
            )
            fall[i], fall_drift[i] = -ck, -dk


class ChangeEvaluator:
    """Evaluates `Changes` of one recording for many circuits, remembering where samples and extremes lie.

    The positions of the extremes come from the latest real-valued evaluation; a complex-step evaluation reuses
    them (at an extreme the derivative does not see the position: envelope theorem).
    """

    def __init__(self, recording: Recording, intervals: Sequences) -> None:
        recording.check_stimulus_covers_events()
        self.recording = recording
        self.intervals = intervals
        t = recording.stimulus.t
        self._hints = tuple(
            np.maximum(np.searchsorted(t, when, side="right") - 1, 0)
            for when in (intervals.previous_s, intervals.time_s, intervals.last_s)
        )
        self._extreme_at = np.full(len(intervals), -1)
        self._rise_at = np.full(len(intervals.last_s), -1)
        self._fall_at = np.full(len(intervals.last_s), -1)

    def trajectory(self, circuit: Circuit) -> Trajectory:
        """The pixel's trajectory under this recording's stimulus."""
        light = drive(self.recording.stimulus, circuit, self.intervals.end_s)
        return integrate(light.t, light.radiance, dynamics_of(circuit), linearisation=circuit.linearisation)

    def __call__(self, circuit: Circuit) -> Changes:
        """The changes of every interval under `circuit`, whose values may be complex."""
        trajectory = self.trajectory(circuit)
        scalars = [
            circuit.leak_hz,
            circuit.leak_hz_per_radiance,
            circuit.on_threshold,
            circuit.refractory,
            circuit.delay,
        ]
        complex_step = np.iscomplexobj(trajectory.states) or any(isinstance(s, complex) for s in scalars)
        dtype = np.complex128 if complex_step else np.float64
        leak, parasitic, on_scale, refractory, delay = (dtype(s) for s in scalars)
        states = trajectory.states.astype(dtype, copy=False)
        u = trajectory.u.astype(dtype, copy=False)
        radiance = trajectory.radiance.astype(dtype, copy=False)
        dynamics = tuple(dtype(value) for value in trajectory.dynamics)
        lights = np.empty(len(u) if circuit.leak_hz_per_radiance != 0 else 1, dtype)
        if len(lights) > 1:
            _cumulative_light(trajectory.t, u, radiance, lights)
        n, m = len(self.intervals), len(self.intervals.last_s)
        per_event = np.empty((6, n), dtype)
        per_pixel = np.empty((4, m), dtype)
        common = (
            trajectory.t, u, radiance, lights, dynamics, trajectory.midpoint, states,
            leak, parasitic, on_scale, refractory, delay,
        )  # fmt: skip
        iv = self.intervals
        early = _events(
            iv.previous_s, iv.time_s, iv.sign, self._hints[0], self._hints[1], self._extreme_at, not complex_step,
            *common, *per_event,
        )  # fmt: skip
        _censored(
            iv.last_s, iv.end_s, self._hints[2], self._rise_at, self._fall_at, not complex_step, *common, *per_pixel
        )
        return Changes(*per_event, *per_pixel, valid=early == 0)
