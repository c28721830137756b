"""The lights of a bench session, as functions of time, and a photodiode that samples them.  Shares no code."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

CHIRP_DEPTH, CHIRP_START_HZ = 0.75, 2.0
CHIRP_STOP_HZ = {3: 70.0, 24: 200.0, 400: 800.0}  # up to where each level's pixel still follows
STEPS, STEP_RANGE, RAMP_S = 13, 0.9, 200e-6  # number, ± log radiance, and how long a lamp takes
SLOW_HZ, SLOW_RANGE = 2.0, 0.9
FULL_SCALE = 1.1  # of a photodiode's converter, in maxima of its trace


@dataclass(frozen=True)
class Light:
    """Radiance in fA as a function of time in seconds; between `corners` it is smooth."""

    of: Callable[[np.ndarray], np.ndarray]
    duration_s: float
    corners: np.ndarray


def make_light(kind: str, level: float, duration_s: float, rng: np.random.Generator, stop: float, ramp: str) -> Light:
    """One of chirp, steps, slow, constant.

    Args:
        kind: which.
        level: radiance about which it turns, in fA.
        duration_s: how long.
        rng: draws levels, times and phase.
        stop: what the last frequency of a chirp is multiplied by.
        ramp: of a step: "corners", linear in log radiance, or "smooth", half a cosine.
    """
    none = np.empty(0)
    if kind == "constant":
        return Light(lambda t: np.full(np.shape(t), float(level)), duration_s, none)
    if kind == "slow":
        phase = rng.uniform(0, 2 * np.pi)
        return Light(lambda t: level * np.exp(SLOW_RANGE * np.sin(2 * np.pi * SLOW_HZ * t + phase)), duration_s, none)
    if kind == "chirp":
        nearest = min(CHIRP_STOP_HZ, key=lambda known: abs(np.log(known / level)))
        rate = np.log(stop * CHIRP_STOP_HZ[nearest] / CHIRP_START_HZ) / duration_s

        def of(t):
            return level * (1 + CHIRP_DEPTH * np.sin(2 * np.pi * CHIRP_START_HZ * np.expm1(rate * t) / rate))

        return Light(of, duration_s, none)
    if kind == "steps":
        return _steps(level, duration_s, rng, ramp)
    raise ValueError(f"no light {kind!r}")


def _steps(level: float, duration_s: float, rng: np.random.Generator, ramp: str) -> Light:
    heights = rng.uniform(-STEP_RANGE, STEP_RANGE, STEPS + 1)
    room = 0.96 * duration_s - STEPS * 2 * RAMP_S  # two ramps at least between beginnings
    starts = 0.02 * duration_s + np.sort(rng.uniform(0, room, STEPS)) + 2 * RAMP_S * np.arange(STEPS)

    def of(t):
        share = np.clip((np.asarray(t)[..., None] - starts) / RAMP_S, 0.0, 1.0)
        if ramp == "smooth":
            share = 0.5 - 0.5 * np.cos(np.pi * share)
        return level * np.exp(heights[0] + share @ np.diff(heights))

    return Light(of, duration_s, np.concatenate([starts, starts + RAMP_S]))


def sample(light: Light, t: np.ndarray, noise: float, bits: int, rng: np.random.Generator) -> np.ndarray:
    """What a photodiode shows at times (n,): relative noise, then `bits` of a converter, where it has any."""
    values = light.of(t)
    draws = rng.standard_normal(len(t))  # whether noisy or not: what is drawn later stays
    values = values * (1 + noise * draws)
    if bits:
        unit = FULL_SCALE * values.max() / 2**bits
        values = np.maximum(np.rint(values / unit), 1) * unit
    return values
