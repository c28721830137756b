"""Pooled sessions whose truth is known: pixels walked event by event (`whole_pixel`), their addresses forgotten."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tests.oracles import whole_pixel as oracle

BIT_S = 2e-3  # of the light, a random sequence of two levels


@dataclass(frozen=True)
class Session:
    """What a pool wrote, and its truth.

    Attributes:
        t_ns, p: (n,) times and polarities (0 or 1).
        light_t, light: (m,) s and radiance, which stays until the next time.
        truth: Name of a parameter in dvs128 → value; "pooled.pixels" too.
    """

    t_ns: np.ndarray
    p: np.ndarray
    light_t: np.ndarray
    light: np.ndarray
    truth: Mapping[str, float]


def session(seed: int, seconds: float = 0.5, dead_s: float | None = None) -> Session:
    """A pool drawn at random: 16 to 100 pixels, dead time 10 µs to 1 ms, thresholds 0.15 to 0.35, levels 5 to 20 apart.

    Args:
        seed: Of the pool, its light and its noise.
        seconds: Of the recording.
        dead_s: Instead of a dead time drawn.
    """
    rng = np.random.default_rng(seed)
    pixels = int(rng.integers(16, 101))
    low, contrast = np.exp(rng.uniform(np.log(20.0), np.log(100.0))), np.exp(rng.uniform(np.log(5.0), np.log(20.0)))
    bits = rng.integers(0, 2, int(np.ceil(seconds / BIT_S)))
    levels = np.where(bits > 0, low * contrast, low)
    drawn = float(np.exp(rng.uniform(np.log(1e-5), np.log(1e-3))))
    pixel = oracle.Pixel(
        61287.0, 1851.0, 1.1236, 2 * np.pi * 3122.0, 2 * np.pi * 16000.0, rng.uniform(0.15, 0.35),
        rng.uniform(0.15, 0.35), drawn if dead_s is None else dead_s, rng.uniform(0.03, 0.08), rng.uniform(0.02, 0.05),
    )  # fmt: skip
    seen = oracle.signals(pixel, lambda t: levels[np.minimum((t / BIT_S + 1e-9).astype(int), len(bits) - 1)], seconds)
    t, _, sign = oracle.events(pixel, oracle.thresholds(pixel, pixels, rng), seen, rng)
    truth = {
        "alpha": pixel.alpha, "beta": pixel.beta, "gamma": pixel.gamma, "sf_cutoff_hz": 3122.0,
        "diff_cutoff_hz": 16000.0, "on_threshold": pixel.on, "off_threshold": pixel.off,
        "threshold_sigma": pixel.sigma, "threshold_mismatch.sigma": pixel.mismatch, "refractory_s": pixel.dead_s,
        "delay_s": 0.0, "pooled.pixels": float(pixels),
    }  # fmt: skip
    at = BIT_S * np.arange(len(bits) + 1)
    return Session(
        np.round(t * 1e9).astype(np.int64), (sign > 0).astype(np.uint8), at, np.append(levels, levels[-1]), truth
    )
