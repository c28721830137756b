"""The kinds of pixel that stand for a pool: thresholds that differ, and light that differs.

A lattice of points, evenly spread in every direction (the generalised golden ratio; Roberts 2018,
extremelearning.com.au, "The unreasonable effectiveness of quasirandom sequences"), through the inverse normal
distribution, made uncorrelated, of mean 0 and variance 1.  Expected counts are smooth in a threshold over the noise
that events have, so few kinds suffice.  The fluid limit is smooth in
the light: Gauss–Hermite quadrature.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import ndtri

from pixelid.stages.circuit import Circuit

KINDS = 12  # counts of a bin to 1 % of the pool at the usual mismatch of 3 % (tests/unit/test_pool.py)


@dataclass(frozen=True)
class Kind:
    """Pixels alike.  on, off, light: times the mean thresholds and the light of the pool;  share: of the pool."""

    on: float
    off: float
    light: float
    share: float


def kinds_of(circuit: Circuit, count: int) -> list[Kind]:
    """The kinds of pixel of a pool, at most `count`; one where all pixels are alike."""
    mismatch, spread = float(circuit.mismatch), float(circuit.light_spread)
    differing = (2 if mismatch > 0 else 0) + (1 if spread > 0 else 0)
    if differing == 0:
        return [Kind(1.0, 1.0, 1.0, 1.0)]
    points = normal_points(count, differing)
    on, off = (1.0 + mismatch * points[:, 0], 1.0 + mismatch * points[:, 1]) if mismatch > 0 else np.ones((2, count))
    light = np.exp(spread * points[:, -1]) if spread > 0 else np.ones(count)
    least = 0.05  # of a threshold: a pixel without one is no pixel
    return [
        Kind(max(float(a), least), max(float(b), least), float(c), 1.0 / count)
        for a, b, c in zip(on, off, light, strict=True)
    ]


def lights_of(circuit: Circuit) -> list[tuple[float, float]]:
    """(times as bright, share) of the pixels of a pool whose counts are smooth in the light."""
    if circuit.light_spread == 0:
        return [(1.0, 1.0)]
    nodes, weights = np.polynomial.hermite_e.hermegauss(KINDS)
    shares = weights / weights.sum()
    return [(float(math.exp(circuit.light_spread * z)), float(w)) for z, w in zip(nodes, shares, strict=True)]


@lru_cache(maxsize=8)
def normal_points(count: int, dimensions: int) -> np.ndarray:
    """(count, dimensions) points of a standard normal distribution, the same each time."""
    root = 2.0
    for _ in range(60):  # x^(d + 1) = x + 1
        root = (1.0 + root) ** (1.0 / (dimensions + 1))
    points = (0.5 + np.arange(1, count + 1)[:, None] * root ** -np.arange(1.0, dimensions + 1)) % 1.0
    rank = points.argsort(axis=0).argsort(axis=0)
    normal = ndtri((rank + 0.5) / count)  # no two alike
    normal -= normal.mean(axis=0)
    return np.linalg.solve(np.linalg.cholesky(normal.T @ normal / count), normal.T).T
