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
from numba import njit

from pixelid.dynamics.blocks import REORDERED
from pixelid.dynamics.vector_math import vlog


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

    centre = float(x.mean())
    away = x - centre  # of the size of the spread: what is squared below loses no digits

    def negative(log_spread: float) -> float:
        return float(_negatives(away, v, np.array([log_spread]))[0])

    scale = max(float(np.std(x)), 1e-6)
    low, high = np.log(1e-4 * scale), np.log(10.0 * scale)
    grid = np.linspace(low, high, 60)
    k = int(np.argmin(_negatives(away, v, grid)))
    optimum = minimize_scalar(
        negative, bounds=(grid[max(k - 1, 0)], grid[min(k + 1, 59)]), method="bounded", options={"xatol": 1e-6}
    )
    spread = 0.0 if k == 0 else float(np.exp(optimum.x))
    total = spread**2 + v
    return Population(float((x / total).sum() / (1.0 / total).sum()), spread, len(x))


@njit(cache=True, nogil=True, error_model="numpy")
def _negatives(x, v, log_spreads):
    """Minus the restricted marginal log-likelihood (up to a constant) at each of some log spreads.

    x: (n,) estimates less a centre near their mean;  v: (n,) variances of their errors.  With w = 1/(τ² + v),

        ½ [Σ log(τ² + v) + Σ w x² − (Σ w x)²/Σ w + log Σ w]
    """
    values, logs = np.empty(len(log_spreads)), np.empty(len(x))
    for k in range(len(log_spreads)):
        spread = np.exp(2.0 * log_spreads[k])
        _logs(v, spread, logs)
        w0, w1, w2 = _moments(x, v, spread)
        values[k] = 0.5 * (logs.sum() + w2 - w1 * w1 / w0 + np.log(w0))
    return values


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _logs(v, spread, out):
    for i in range(len(out)):
        out[i] = vlog(spread + v[i])


@njit(cache=True, nogil=True, error_model="numpy", fastmath=REORDERED)
def _moments(x, v, spread):
    """(Σ w, Σ w x, Σ w x²)."""
    w0, w1, w2 = 0.0, 0.0, 0.0
    for i in range(len(x)):
        weight = 1.0 / (spread + v[i])
        w0 += weight
        w1 += weight * x[i]
        w2 += weight * x[i] * x[i]
    return w0, w1, w2


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
