"""The circuit under a step of light: how far it has come at any time, and its noise while it does."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from pixelid.dynamics.of_circuit import dynamics_of
from pixelid.dynamics.trajectory import Dynamics, integrate
from pixelid.stages.circuit import Circuit

NEVER_S = 1.0  # beyond any LED's period: stands for a crossing that does not come
# From below a timestamp's µs; 9 % apart, so that linear interpolation errs by 0.1 %
TIMES_S = np.concatenate([[0.0], np.geomspace(3e-7, NEVER_S, 180)])


def changes(circuit: Circuit, before: np.ndarray, after: np.ndarray, speed: np.ndarray | None = None) -> np.ndarray:
    """(steps, times) the largest change so far, towards the new level, of the never-reset amplifier at `TIMES_S`.

    Args:
        circuit: its numbers; its dark current adds to the light.
        before, after: (steps,) radiance up to and from time 0 on; the circuit has settled at the first.
        speed: (steps,) factor of α (of the corner of one pole) after each step, 1 by default.
    """
    speeds = np.ones(len(before)) if speed is None else speed
    out = np.empty((len(before), len(TIMES_S)))
    of = {factor: dynamics_of(_sped_up(circuit, factor)) for factor in set(speeds.tolist())}
    for k, factor in enumerate(speeds.tolist()):
        low, high = float(before[k]) + circuit.dark, float(after[k]) + circuit.dark
        out[k] = _change(of[factor], circuit.linearisation, low, high)
    return out


def _sped_up(circuit: Circuit, factor: float) -> Circuit:
    if factor == 1.0:
        return circuit
    return replace(circuit, alpha=circuit.alpha * factor, corner=circuit.corner * factor)


@lru_cache(maxsize=256)  # most parameters of a table's fit change thresholds, delays or noise, and nothing here
def _change(dynamics: Dynamics, linearisation: str, low: float, high: float) -> np.ndarray:
    """(times,) the largest change so far, of one step from a light to another."""
    radiance = np.full(len(TIMES_S) + 1, high)
    radiance[0] = low
    output = integrate(np.append(0.0, TIMES_S), radiance, dynamics, linearisation=linearisation).stage("differencing")
    return np.maximum.accumulate((output[1:] - output[1]) * np.sign(high - low))


def noise_level(circuit: Circuit, radiance: np.ndarray, speed: np.ndarray | float = 1.0) -> np.ndarray:
    """(n,) standard deviation of the output, log radiance, from shot noise under constant light.

    White noise of one-sided density S/L through three real poles a (the photoreceptor's slow one), b and c:
    variance S/(4L) · abc (a+b+c) / ((a+b)(b+c)(c+a)).  Behind a = αL/β alone it is S α/(4β) at every light.
    speed: factor of α, scalar or (n,).
    """
    light = radiance + circuit.dark
    corner = circuit.corner if circuit.photoreceptor == "one_pole" else circuit.alpha / circuit.beta
    a, b, c = speed * corner * light, min(circuit.follower, 1e12), min(circuit.differencing, 1e13)
    passed = a * b * c * (a + b + c) / ((a + b) * (b + c) * (c + a))
    return np.sqrt(circuit.shot_density / (4.0 * light) * passed)
