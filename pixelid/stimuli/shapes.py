"""Built-in stimuli as pure functions, and the calibration session that excites every part of the pixel.

level: mean (or starting) radiance;  modulation: relative for periodic light, logarithmic where it says so;
duration_s, dt: seconds.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from pixelid.errors import InputError
from pixelid.stimuli.stimulus import Stimulus

MOST_SAMPLES = 50_000_000


def _times(duration_s: float, dt: float) -> np.ndarray:
    """0, dt, … up to the duration.  Raises InputError for steps that are not positive, or too many of them."""
    if not (math.isfinite(duration_s) and math.isfinite(dt) and 0 < dt <= duration_s):
        raise InputError(f"stimulus: expected 0 < dt ≤ duration_s, found dt = {dt:g}, duration_s = {duration_s:g}")
    if duration_s / dt > MOST_SAMPLES:
        raise InputError(f"stimulus: {duration_s:g} s at dt = {dt:g} s needs more than {MOST_SAMPLES} samples")
    return np.arange(math.floor(duration_s / dt + 1e-9) + 1) * dt


def _positive(**values: float) -> None:
    """Raises InputError naming the first value that is not positive and finite."""
    for name, value in values.items():
        if not 0 < value < math.inf:
            raise InputError(f"stimulus: {name} must be positive, found {value:g}")


def constant(level=100.0, duration_s=1.5) -> Stimulus:
    """Constant light, two samples."""
    return Stimulus.from_arrays(_times(duration_s, duration_s), np.full(2, level), where="constant")


def sine(level=100.0, modulation=0.5, frequency_hz=10.0, duration_s=1.0, dt=5e-5, phase=0.0) -> Stimulus:
    """level (1 + modulation sin(2π f t + phase))."""
    t = _times(duration_s, dt)
    radiance = level * (1 + modulation * np.sin(2 * np.pi * frequency_hz * t + phase))
    return Stimulus.from_arrays(t, radiance, where="sine")


def slow(level=100.0, modulation=0.9, frequency_hz=2.0, duration_s=1.0, dt=5e-5, seed=0) -> Stimulus:
    """A slow sine of ln L with amplitude `modulation` and random phase: reaches thresholds, not the bandwidth."""
    t = _times(duration_s, dt)
    phase = np.random.default_rng(seed).uniform(0, 2 * np.pi)
    return Stimulus.from_arrays(
        t, level * np.exp(modulation * np.sin(2 * np.pi * frequency_hz * t + phase)), where="slow"
    )


def chirp(level=100.0, modulation=0.75, start_hz=3.0, stop_hz=400.0, duration_s=0.8, dt=5e-5) -> Stimulus:
    """level (1 + modulation sin φ(t)), the frequency growing exponentially from start to stop."""
    t = _times(duration_s, dt)
    if not 0 < start_hz < stop_hz:
        raise InputError(f"chirp: expected 0 < start_hz < stop_hz, found {start_hz:g} and {stop_hz:g}")
    growth = math.log(stop_hz / start_hz) / duration_s
    phase = 2 * np.pi * start_hz * np.expm1(growth * t) / growth
    return Stimulus.from_arrays(t, level * (1 + modulation * np.sin(phase)), where="chirp")


def steps(level=100.0, modulation=0.9, hold_s=0.02, edge_s=2e-4, duration_s=0.8, dt=5e-5, seed=0) -> Stimulus:
    """Random levels, ln L uniform within ± modulation of ln level, each held; logistic edges about 5 edge_s wide."""
    t = _times(duration_s, dt)
    _positive(hold_s=hold_s, edge_s=edge_s, level=level)
    most_steps = 5_000_000_000  # steps × samples: some seconds of work
    most_held = 100_000  # steps, each with work of its own: likewise
    if duration_s / hold_s * len(t) > most_steps or duration_s / hold_s > most_held:
        raise InputError(f"steps: {duration_s:g} s in steps of {hold_s:g} s at dt = {dt:g} s are too many")
    count = math.ceil(duration_s / hold_s) + 1
    logs = np.random.default_rng(seed).uniform(-modulation, modulation, count)
    u = np.full(len(t), math.log(level)) + logs[0]
    saturated = 50.0  # edge widths from a step beyond which tanh is ±1 in double precision (from 38)
    for k in range(1, count):
        begin, end = np.searchsorted(t, [k * hold_s - saturated * edge_s, k * hold_s + saturated * edge_s])
        rise = logs[k] - logs[k - 1]
        u[begin:end] += rise * 0.5 * (1 + np.tanh(0.5 * (t[begin:end] - k * hold_s) / edge_s))
        u[end:] += rise
    return Stimulus.from_arrays(t, np.exp(u), where="steps")


def pulse(level=100.0, modulation=4.0, width_s=5e-3, duration_s=0.5, dt=5e-5) -> Stimulus:
    """One Gaussian pulse in the middle, level (1 + modulation exp(−½ ((t − T/2)/width)²))."""
    t = _times(duration_s, dt)
    _positive(width_s=width_s)
    radiance = level * (1 + modulation * np.exp(-0.5 * ((t - duration_s / 2) / width_s) ** 2))
    return Stimulus.from_arrays(t, radiance, where="pulse")


def edge(level=100.0, modulation=0.5, frequency_hz=5.0, steepness=8.0, duration_s=1.0, dt=5e-5) -> Stimulus:
    """A rounded square wave, level (1 + modulation tanh(steepness sin 2π f t))."""
    t = _times(duration_s, dt)
    radiance = level * (1 + modulation * np.tanh(steepness * np.sin(2 * np.pi * frequency_hz * t)))
    return Stimulus.from_arrays(t, radiance, where="edge")


def grating(
    level=100.0, modulation=0.5, frequency_hz=50.0, period_px=32.0, width=346, height=260, duration_s=0.02, dt=1e-4
) -> Stimulus:
    """A video: vertical sine grating moving to the right, `frequency_hz` cycles per second past each pixel."""
    t = _times(duration_s, dt)
    _positive(period_px=period_px)
    if width < 1 or height < 1 or len(t) * width * height > 5e8:
        raise InputError(f"grating: {len(t)} frames of {width} x {height} pixels cannot be held in memory")
    phase = 2 * np.pi * (frequency_hz * t[:, None] - np.arange(width)[None, :] / period_px)
    rows = (level * (1 + modulation * np.sin(phase))).astype(np.float32)
    frames = np.repeat(rows[:, None, :], height, axis=1)
    return Stimulus.from_arrays(t, frames, where="grating")


SHAPES: dict[str, Callable[..., Stimulus]] = {
    "constant": constant,
    "sine": sine,
    "slow": slow,
    "chirp": chirp,
    "steps": steps,
    "pulse": pulse,
    "edge": edge,
    "grating": grating,
}


def session(levels=(3.0, 24.0, 400.0), seed=0) -> dict[str, Stimulus]:
    """A calibration session, condition → stimulus: chirp, steps, slow and constant light at each radiance level.

    Chirps reach past the bandwidth, steps and slow light separate thresholds, leak and asymmetry, and several levels
    separate α, β and γ (docs/model.md, "Invariants").  A chirp ends at 40 √level Hz (20 Hz to
    5 kHz), where the pixel no longer follows it.
    """
    conditions = {}
    for k, level in enumerate(levels):
        name = f"{level:g}"
        stop = min(max(40.0 * math.sqrt(max(level, 0.0)), 20.0), 5000.0)
        conditions[f"chirp_{name}"] = chirp(level, stop_hz=stop)
        conditions[f"steps_{name}"] = steps(level, seed=seed + 2 * k)
        conditions[f"slow_{name}"] = slow(level, seed=seed + 2 * k + 1)
        conditions[f"constant_{name}"] = constant(level)
    return conditions
