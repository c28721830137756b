"""Teacher-forced changes written out one interval at a time, every sample of an interval looked at."""

from __future__ import annotations

import numpy as np

from pixelid.dynamics import kernels
from pixelid.likelihood.changes import PER_EVENT, PER_PIXEL, ChangeEvaluator
from pixelid.stages.circuit import Circuit


def plain_changes(evaluator: ChangeEvaluator, circuit: Circuit) -> dict[str, np.ndarray]:
    """The rows of `Changes` by name; extremes are looked for everywhere, also where they cannot matter."""
    T, iv = evaluator.trajectory(circuit), evaluator.intervals
    finite = T.dynamics.differencing < 1e29
    output = T.states[:, 5] if finite else T.states[:, 3] - T.states[:, 4]
    rise = np.diff(np.log(T.radiance))
    mean = np.where(rise == 0, T.radiance[:-1], np.diff(T.radiance) / np.where(rise == 0, 1.0, rise))
    lights = np.concatenate([[0.0], np.cumsum(np.diff(T.t) * mean)])

    def light_until(when):
        k = max(int(np.searchsorted(T.t, when, side="right")) - 1, 0)
        held = k + 1 == len(T.t)
        ramp = 0.0 if held else rise[k] / (T.t[k + 1] - T.t[k])
        x = ramp * (when - T.t[k])
        return lights[k] + T.radiance[k] * (when - T.t[k]) * (np.expm1(x) / x if x != 0 else 1.0), k, ramp

    def outputs(when):
        _, k, ramp = light_until(when)
        state = np.empty((1, 6))
        if T.linear:
            at, step = np.array([when]), np.array([k])
            kernels.states_at(at, step, T.t, T.u, T.radiance, T.dynamics, T.midpoint, T.states, state)
        else:
            state[:] = T.at([when])
        return kernels.reference_and_slopes(tuple(state[0]), T.dynamics, ramp)

    def begun(release):
        """change(output, when), drift(when) since a release, and the samples after it."""
        level, out, _ = outputs(release)
        offset = out - level if finite else 0.0

        def change(value, when):
            return value - level - offset * np.exp(-T.dynamics.differencing * (when - release))

        def drift(when):
            light = np.array([light_until(w)[0] for w in np.atleast_1d(when)]) - light_until(release)[0]
            return circuit.leak_hz * (np.atleast_1d(when) - release) + circuit.leak_hz_per_radiance * light

        return change, drift, offset

    def extreme(release, looks, end, sign):
        change, drift, _ = begun(release)
        samples = np.flatnonzero((T.t > looks) & (T.t <= end))
        c, d = change(output[samples], T.t[samples]), drift(T.t[samples])
        if release < looks < end:
            c, d = np.append(c, change(outputs(looks)[1], looks)), np.append(d, drift(looks))
        if len(c) == 0:
            return 0.0, 0.0
        best = int(np.argmax(sign * (c + circuit.on_threshold * d)))
        if sign * (c + circuit.on_threshold * d)[best] <= 0:
            return 0.0, 0.0
        return sign * c[best], sign * d[best]

    rows = {name: [] for name in (*PER_EVENT, *PER_PIXEL)}
    for k in range(len(iv)):
        release, time = iv.previous_s[k] + circuit.refractory - circuit.delay, iv.time_s[k] - circuit.delay
        change, drift, offset = begun(release)
        _, out, slope = outputs(time)
        light = np.exp(np.interp(time, T.t, T.u))
        rows["change"].append(change(out, time))
        decay = T.dynamics.differencing if finite else 0.0
        rows["slope"].append(slope + decay * offset * np.exp(-decay * (time - release)))
        rows["drift"].append(drift(time)[0])
        rows["drift_slope"].append(circuit.leak_hz + circuit.leak_hz_per_radiance * light)
        looks = max(release, iv.previous_s[k] - circuit.delay + circuit.silent)
        value = extreme(release, looks, time, -iv.sign[k])
        rows["opposite"].append(value[0])
        rows["opposite_drift"].append(value[1])
        rows["early"].append(time <= looks)
    for before in iv.last_s - circuit.delay:
        release, looks = before + circuit.refractory, before + max(circuit.refractory, circuit.silent)
        for name, sign in (("rise", 1.0), ("fall", -1.0)):
            value = extreme(release, looks, iv.end_s, sign)
            rows[name].append(value[0])
            rows[f"{name}_drift"].append(value[1])
    return {name: np.array(values) for name, values in rows.items()}
