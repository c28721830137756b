"""What leaks into a change: ∫ L dt, log radiance linear between samples, and the drift of an interval."""

from __future__ import annotations

import numpy as np
from numba import njit

from pixelid.dynamics import equations

_light_integral = njit(equations.light_integral, inline="always", error_model="numpy")


@njit(cache=True, nogil=True, error_model="numpy")
def light_integrals(t, u, lights):
    """Fill ∫ L dt from the first sample to each, log radiance linear in between."""
    lights[0] = 0.0
    for k in range(1, len(t)):
        tau = t[k] - t[k - 1]
        lights[k] = lights[k - 1]
        if tau > 0.0:
            lights[k] += _light_integral(np.exp(u[k - 1]), (u[k] - u[k - 1]) / tau, tau)


@njit(cache=True, error_model="numpy")
def _ramp(k, t, u):
    """Slope of log radiance in the step that begins at sample k; past the last sample the light is held."""
    return (u[k + 1] - u[k]) / (t[k + 1] - t[k]) if k + 1 < len(t) and t[k + 1] > t[k] else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def light_to(times, sample, t, u, lights, light):
    """Fill ∫ L dt from the first sample to `times`."""
    for i in range(len(times)):
        k = sample[i]
        light[i] = lights[k] + _light_integral(np.exp(u[k]), _ramp(k, t, u), times[i] - t[k])


def light_until(times: np.ndarray, sample: np.ndarray, t: np.ndarray, u: np.ndarray) -> np.ndarray:
    """(k,) ∫ L dt from the first sample to `times` (k,), in the steps that begin at `sample` (k,).

    t, u: (samples,) times and log radiance
    """
    lights, light = np.zeros(len(t)), np.empty(len(times))
    light_integrals(t, u, lights)
    light_to(times, sample, t, u, lights, light)
    return light


@njit(cache=True, nogil=True, error_model="numpy")
def drifts(release, time, sample, t, u, rate, per_light, lights, light, drift, slope):
    """Fill what has leaked at `time` since `release`, and its slope, in ON thresholds (per second)."""
    for i in range(len(time)):
        drift[i], slope[i] = rate * (time[i] - release[i]), rate
        if per_light != 0.0:
            k = sample[i]
            ramp, since = _ramp(k, t, u), time[i] - t[k]
            drift[i] += per_light * (lights[k] + _light_integral(np.exp(u[k]), ramp, since) - light[i])
            slope[i] += per_light * np.exp(u[k] + ramp * since)
