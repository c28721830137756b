"""Shrinkage of noisy estimates towards their population: the normal–normal model, fitted by marginal likelihood.

    truth_i ~ N(μ, τ²),   estimate_i ~ N(truth_i, s_i²)   ⇒   estimate_i ~ N(μ, τ² + s_i²)

μ and τ maximise the restricted marginal likelihood (μ integrated out, so that τ is not biased towards 0).  Then

    truth_i | estimate_i ~ N(μ + k_i (estimate_i − μ), k_i s_i²),   k_i = τ²/(τ² + s_i²)

(Efron & Morris 1975; Morris 1983, JASA 78).  Each coordinate is shrunk by itself: correlated errors between
a threshold and a bandwidth are not exploited.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Population:
    """mean and spread (standard deviation) of the truth over pixels, and from how many estimates."""

    mean: float
    spread: float
    count: int


def population(estimate: np.ndarray, sd: np.ndarray) -> Population:
    """The population behind estimates (n,) with standard errors sd (n,); NaN and infinite errors are left out."""
    keep = np.isfinite(estimate) & np.isfinite(sd)
    x, v = estimate[keep], np.maximum(sd[keep], 1e-12) ** 2
    if len(x) == 0:
        return Population(np.nan, np.nan, 0)
    if len(x) == 1:
        return Population(float(x[0]), 0.0, 1)
    from scipy.optimize import minimize_scalar

    def negative(log_spread: float) -> float:
        total = np.exp(2.0 * log_spread) + v
        precision = (1.0 / total).sum()
        mean = (x / total).sum() / precision
        return 0.5 * float(np.log(total).sum() + ((x - mean) ** 2 / total).sum() + np.log(precision))

    scale = max(float(np.std(x)), 1e-6)
    low, high = np.log(1e-4 * scale), np.log(10.0 * scale)
    grid = np.linspace(low, high, 60)
    values = [negative(g) for g in grid]
    k = int(np.argmin(values))
    optimum = minimize_scalar(
        negative, bounds=(grid[max(k - 1, 0)], grid[min(k + 1, 59)]), method="bounded", options={"xatol": 1e-6}
    )
    spread = 0.0 if k == 0 else float(np.exp(optimum.x))
    total = spread**2 + v
    return Population(float((x / total).sum() / (1.0 / total).sum()), spread, len(x))


def shrink(estimate: np.ndarray, sd: np.ndarray, of: Population) -> tuple[np.ndarray, np.ndarray]:
    """(mean, standard deviation) (n,) of the truth given the estimates; the population where there is none."""
    known = np.isfinite(estimate) & np.isfinite(sd)
    k = np.where(known, of.spread**2 / (of.spread**2 + np.where(known, sd, 1.0) ** 2 + 1e-300), 0.0)
    mean = of.mean + k * np.where(known, estimate - of.mean, 0.0)
    return mean, np.where(known, np.sqrt(k) * np.where(known, sd, 0.0), of.spread)


def bootstrap(estimate: np.ndarray, sd: np.ndarray, seeds: np.ndarray) -> np.ndarray:
    """(len(seeds), 2) population mean and spread of pixels drawn with replacement, one draw per seed."""
    keep = np.flatnonzero(np.isfinite(estimate) & np.isfinite(sd))
    replicated = np.full((len(seeds), 2), np.nan)
    for i, seed in enumerate(seeds):
        drawn = np.random.default_rng(int(seed)).choice(keep, len(keep)) if len(keep) else keep
        again = population(estimate[drawn], sd[drawn])
        replicated[i] = again.mean, again.spread
    return replicated
