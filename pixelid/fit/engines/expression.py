"""The event-time log-likelihood as one expression, for any engine with vectors and elementary functions.

The same mathematics as `likelihood/{changes,density}.py`, written over whole vectors without branches, from the
same closed-form step (`dynamics/equations.py`).  An engine brings its `Operations`; CasADi symbols and torch tensors
both fit.  Inside a step all levels are relative to the log radiance at its beginning, which loses no digits to the DC
level.  Poles closer than the closed form can divide by are left to the compiled engine.
"""

from __future__ import annotations

import math
from typing import Any, Protocol

import numpy as np

from pixelid.dynamics import equations
from pixelid.dynamics.equations import PRESENT_BELOW
from pixelid.dynamics.of_circuit import dynamics_of
from pixelid.dynamics.trajectory import Dynamics
from pixelid.fit.engines.frozen import Frozen, FrozenRecording
from pixelid.likelihood.clocks import Clock, clock_in
from pixelid.likelihood.losses import BACKGROUND_HZ, MISSED
from pixelid.stages.comparator import memory_factor


class Operations(Protocol):
    """What an engine provides: elementwise functions of vectors, and four operations on whole vectors."""

    def constant(self, values: np.ndarray, /) -> Any: ...
    def exp(self, x: Any, /) -> Any: ...
    def log(self, x: Any, /) -> Any: ...
    def sqrt(self, x: Any, /) -> Any: ...
    def sin(self, x: Any, /) -> Any: ...
    def cos(self, x: Any, /) -> Any: ...
    def abs(self, x: Any, /) -> Any: ...
    def normal_cdf(self, x: Any, /) -> Any: ...
    def where(self, condition: Any, a: Any, b: Any, /) -> Any: ...
    def take(self, x: Any, index: np.ndarray, /) -> Any: ...
    def join(self, parts: list, /) -> Any: ...
    def sum_by(self, index: np.ndarray, x: Any, size: int, /) -> Any: ...
    def spread(self, x: Any, at: np.ndarray, size: int, /) -> Any: ...
    def total(self, x: Any, /) -> Any: ...
    def cumulate(self, x: Any, /) -> Any: ...

    def recur(self, A: list[list[Any]], c: list[Any], /) -> list[Any]:
        """Four vectors (n + 1,) of x[0] = 0, x[k+1] = A[k] x[k] + c[k]; A: 4 × 4 of vectors (n,), or 0.0."""
        ...


def step(op: Operations, state, r, tau, light, dynamics: Dynamics):
    """States (v, y, s, d) after `tau` of the ramp r τ, from `state` relative to its foot."""
    a, b2 = equations.photoreceptor_rates(dynamics, light)
    k1, kd = op.exp(-dynamics.follower * tau), op.exp(-dynamics.differencing * tau)
    pr = equations.selected_factors(op, a, b2, tau)
    return equations.step_two_poles(state, 0.0, r, tau, a, b2, dynamics.follower, dynamics.differencing, pr, k1, kd)


class Light:
    """A recording's light as the photoreceptor gets it: vectors over samples (n,) and steps (n − 1,)."""

    def __init__(self, op: Operations, frozen: FrozenRecording, circuit, midpoint: bool) -> None:
        n = len(frozen.t)
        gaps = np.diff(frozen.t)
        before, after = np.arange(n - 1), np.arange(1, n)
        self.tau = op.constant(gaps)
        self.radiance = op.constant(frozen.radiance) + circuit.dark
        self.u = op.log(self.radiance)
        self.rise = op.take(self.u, after) - op.take(self.u, before)
        self.slope = self.rise * op.constant(np.where(gaps > 0, 1.0 / np.where(gaps > 0, gaps, 1.0), 0.0))
        newer = op.take(self.radiance, after)
        self.linearised = op.sqrt(op.take(self.radiance, before) * newer) if midpoint else newer

    def at(self, op: Operations, index: np.ndarray):
        """(slope, linearised radiance) of the steps `index`; past the last sample the light is held."""
        last = np.minimum(index, len_of(self) - 1)
        held = op.constant((index < len_of(self)).astype(float))
        return op.take(self.slope, last) * held, op.take(self.linearised, last) * held + op.take(
            self.radiance, index
        ) * (1.0 - held)


def len_of(light: Light) -> int:
    """Number of steps of a light."""
    return int(light.tau.shape[0])


def trajectory(op: Operations, light: Light, dynamics: Dynamics) -> list[Any]:
    """Four vectors (n,): v and y, s, d relative to u, at every sample."""
    zero = 0.0 * light.tau
    columns = []
    a, b2 = equations.photoreceptor_rates(dynamics, light.linearised)
    k1, kd = op.exp(-dynamics.follower * light.tau), op.exp(-dynamics.differencing * light.tau)
    pr = equations.selected_factors(op, a, b2, light.tau)

    def stepped(state, r):
        w1, wd = dynamics.follower, dynamics.differencing
        return equations.step_two_poles(state, 0.0, r, light.tau, a, b2, w1, wd, pr, k1, kd)

    for j in range(4):
        unit = [1.0 + zero if i == j else zero for i in range(4)]
        columns.append(stepped(tuple(unit), zero))
    driven = stepped((zero, zero, zero, zero), light.slope)
    A: list[list[Any]] = [[columns[j][i] if j <= max(i, 1) else 0.0 for j in range(4)] for i in range(4)]
    return op.recur(A, [driven[0], *(driven[i] - light.rise for i in (1, 2, 3))])


def changes(
    op: Operations, frozen: FrozenRecording, circuit, real, midpoint: bool, clock: Clock | None = None, states_of=None
) -> dict[str, Any]:
    """The fields of `likelihood.changes.Changes` as vectors.

    circuit: engine numbers;  real: the real circuit, which shows what is present
    clock: of the recording, in engine numbers;  None: that of its light
    states_of(light, dynamics): another integrator's (samples, at), see `continuous`; None: the closed-form step
    """
    dynamics, present = dynamics_of(circuit), dynamics_of(real)
    finite = present.differencing < PRESENT_BELOW
    parasitic = real.leak_hz_per_radiance != 0
    light = Light(op, frozen, circuit, midpoint)
    if states_of is None:
        samples = trajectory(op, light, dynamics)

        def at(index, tau):
            r, linearised = light.at(op, index)
            return step(op, tuple(op.take(x, index) for x in samples), r, tau, linearised, dynamics), r

    else:
        samples, at = states_of(light, dynamics)
    lights = op.cumulate(light_integral(op, op.take(light.radiance, np.arange(len_of(light))), light.slope, light.tau))
    t = frozen.t

    def start(index, when):
        """What an interval starts from: (level, offset, light integral) at release."""
        tau = when - op.constant(t[index])
        tau = op.where(tau > 0.0, tau, 0.0 * tau)
        (_, _, s, d), r = at(index, tau)
        shone = 0.0
        if parasitic:
            shone = op.take(lights, index) + light_integral(op, op.take(light.radiance, index), r, tau)
        return op.take(light.u, index) + s, (d - s if finite else 0.0 * s), shone

    def sample(index, when, begun):
        """(change, drift) at the samples `index` (those ≥ 0) of intervals released at `when`."""
        level, offset, shone = begun
        some = np.flatnonzero(index >= 0)
        k = index[some]
        since = op.constant(t[k]) - op.take(when, some)
        output = op.take(light.u, k) + op.take(samples[3 if finite else 2], k)
        change = output - op.take(level, some)
        if finite:
            change = change - op.take(offset, some) * op.exp(-dynamics.differencing * since)
        drift = circuit.leak_hz * since
        if parasitic:
            drift = drift + circuit.leak_hz_per_radiance * (op.take(lights, k) - op.take(shone, some))
        return op.spread(change, some, len(index)), op.spread(drift, some, len(index))

    stamps = map(op.constant, (frozen.previous, frozen.time, frozen.last))
    previous, stamp, begin = stamps if clock is None else map(clock.on_light, stamps)
    release = previous + (circuit.refractory - circuit.delay)
    time = stamp - circuit.delay
    begun = start(frozen.step_r, release)
    level, offset, shone = begun
    tau = time - op.constant(t[frozen.step_e])
    tau = op.where(tau > 0.0, tau, 0.0 * tau)
    (v, y, s, d), r = at(frozen.step_e, tau)
    foot = op.take(light.u, frozen.step_e)
    since = time - release
    rows: dict[str, Any] = {}
    if finite:
        decay = offset * op.exp(-dynamics.differencing * since)
        rows["change"] = foot + d - level - decay
        rows["slope"] = dynamics.differencing * (s - d + decay)
    else:
        rows["change"] = foot + s - level
        rows["slope"] = dynamics.follower * (y - s) if present.follower < PRESENT_BELOW else v
    rows["drift"] = circuit.leak_hz * since
    rows["drift_slope"] = circuit.leak_hz + 0.0 * since
    if parasitic:
        radiance = op.take(light.radiance, frozen.step_e)
        seen = op.take(lights, frozen.step_e) + light_integral(op, radiance, r, tau)
        rows["drift"] = rows["drift"] + circuit.leak_hz_per_radiance * (seen - shone)
        rows["drift_slope"] = rows["drift_slope"] + circuit.leak_hz_per_radiance * radiance * op.exp(r * tau)
    sign = op.constant(-frozen.sign)
    c, f = sample(frozen.opposite_at, release, begun)
    rows["opposite"], rows["opposite_drift"] = sign * c, sign * f
    last = begin + (circuit.refractory - circuit.delay)
    begun = start(frozen.step_l, last)
    rows["rise"], rows["rise_drift"] = sample(frozen.rise_at, last, begun)
    c, f = sample(frozen.fall_at, last, begun)
    rows["fall"], rows["fall_drift"] = -c, -f
    return rows


def light_integral(op: Operations, radiance, r, tau):
    """∫ L dt over the first `tau` of steps that start at `radiance` and ramp at r."""
    x = r * tau
    near = op.abs(x) < 1e-4
    safe = op.where(near, 1.0 + 0.0 * x, x)
    return radiance * tau * op.where(near, 1.0 + x / 2.0 + x * x / 6.0, (op.exp(safe) - 1.0) / safe)


def log_likelihood(op: Operations, frozen: Frozen, circuit, changes_of=None) -> Any:
    """The log-likelihood of `EventTimes`, a scalar of the engine, at the circuit's numbers.

    changes_of(recording, circuit, frozen circuit, clock) replaces `changes` (another integrator).
    """
    midpoint = frozen.circuit.linearisation == "midpoint"
    made = changes_of or (lambda part, own, real, clock: changes(op, part, own, real, midpoint, clock))
    parts = []
    for part in frozen.recordings:
        name = part.recording.name
        own, real = circuit.in_recording(name), frozen.circuit.in_recording(name)
        parts.append(made(part, own, real, clock_in(part.recording, circuit)))
    at, kept, survived = frozen.layout, frozen.kept, frozen.survived
    group, on, off = at.group[kept], circuit.on_threshold, circuit.off_threshold

    def row(name, index):
        return op.take(op.join([part[name] for part in parts]), index)

    is_on = op.constant((np.arange(at.groups) % 2 == 1).astype(float))
    C = on * is_on + off * (1.0 - is_on)
    S = (circuit.mismatch * C) * (circuit.mismatch * C)
    scale = op.constant(at.sign[kept] / frozen.threshold_factor[kept])
    growth = 1.0 + circuit.threshold_drift * op.constant(at.time_s[kept])
    factor = memory_factor(circuit.polarity_memory, op.constant(at.alike[kept]))
    z = scale * (row("change", kept) + on * row("drift", kept)) / (growth * factor)
    rate = scale * (row("slope", kept) + on * row("drift_slope", kept)) / (growth * factor)
    rate = rate - z * circuit.threshold_drift / growth
    share = frozen.clock_share[kept]
    clock = op.constant(share * at.tick_s[kept] ** 2 / 12.0) + circuit.jitter * circuit.jitter * op.constant(share)

    def weighed(threshold):
        """(variance, Σ w, Σ w z) with noise that scales with `threshold` (groups,)."""
        sd = circuit.noise * op.take(threshold, group) / factor
        variance = sd * sd + rate * rate * clock
        return variance, op.sum_by(group, 1.0 / variance, at.groups), op.sum_by(group, z / variance, at.groups)

    _, W, A = weighed(C)
    variance, W, A = weighed((C + S * A) / (1.0 + S * W))
    seen = np.bincount(group, minlength=at.groups) > 0
    safe = W + op.constant(1.0 - seen)
    z_bar = A / safe
    q = 1.0 + S * W
    miss = (z_bar - C) * op.constant(seen.astype(float))
    within = z - op.take(z_bar, group)
    total = (
        op.total(op.log(rate) - 0.5 * op.log(2.0 * math.pi * variance) - 0.5 * within * within / variance)
        + op.total(-0.5 * op.log(q) - 0.5 * miss * miss / (S + 1.0 / safe))
        + frozen.background * math.log(BACKGROUND_HZ)
    )
    mean = (C + S * A) / q

    def survival(index, reached, alike):
        shrunk = memory_factor(circuit.polarity_memory, op.constant(alike))
        drawn = circuit.noise * op.take(mean, index) / shrunk
        sd = op.sqrt(drawn * drawn + op.take(S / q, index))
        margin = (op.take(mean, index) - reached / shrunk) / sd
        return op.total(op.log(MISSED + (1.0 - MISSED) * op.normal_cdf(margin)))

    if len(survived):
        reached = row("opposite", survived) + on * row("opposite_drift", survived)
        reached = reached / (1.0 + circuit.threshold_drift * op.constant(at.time_s[survived]))
        total = total + survival(at.group[survived] ^ 1, reached, -at.alike[survived])
    every = np.arange(at.ends)
    grown = 1.0 + circuit.threshold_drift * op.constant(at.last_time_s)
    rise, fall = (row(name, every) + on * row(f"{name}_drift", every) for name in ("rise", "fall"))
    total = total + survival(2 * at.last_pixel + 1, rise / grown, at.last_sign)
    return total + survival(2 * at.last_pixel, fall / grown, -at.last_sign)
