"""Fit a table of counts: Poisson with exposure, by damped Fisher scoring inside bounds.

Cells count events n of rate λ(x) over an exposure T: log-likelihood Σ n ln λ − λT, Fisher information Σ (∂λ)² T/λ.
Counts that scatter more than Poisson's law are allowed for by dividing the information by their dispersion.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Rates = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]  # (cells) rates, and (coordinates, cells) derivatives


@dataclass(frozen=True)
class Maximum:
    """Where the likelihood is highest: coordinates, log-likelihood, and whether the search came to rest."""

    x: np.ndarray
    log_likelihood: float
    converged: bool


def log_likelihood(rate: np.ndarray, counts: np.ndarray, exposure: np.ndarray) -> float:
    """Poisson log-likelihood of counts, without the factorials."""
    return float((counts * np.log(rate)).sum() - (rate * exposure).sum())


def information(rate: np.ndarray, slopes: np.ndarray, exposure: np.ndarray) -> np.ndarray:
    """(coordinates, coordinates) Fisher information of rates and their derivatives."""
    J = slopes.reshape(len(slopes), -1)
    return J @ (slopes * exposure / rate).reshape(len(slopes), -1).T


def maximise(
    x: np.ndarray,
    rates: Rates,
    counts: np.ndarray,
    exposure: np.ndarray,
    bounds: tuple[np.ndarray, np.ndarray],
    steps: int,
) -> Maximum:
    """Climb from x by damped scoring (Levenberg–Marquardt on the Fisher information).

    Args:
        x: (coordinates,) start inside the bounds.
        rates: coordinates → rates per cell, and their derivatives.
        counts: events of the cells, broadcasting with the rates.
        exposure: seconds of the cells, broadcasting with the rates.
        bounds: lower and upper; equal ones hold a coordinate.
        steps: at most so many.
    """
    lower, upper = bounds
    cells = tuple(range(1, counts.ndim + 1))
    (rate, J), damping = rates(x), 1e-2
    value = log_likelihood(rate, counts, exposure)
    min_gain_nats = 1e-6
    max_slope_sigmas = 0.5  # of what is left of the gradient where no step gains any more
    for _ in range(steps):
        gradient = (J * (counts / rate - exposure)).sum(cells)
        free = ~(((x <= lower) & (gradient <= 0)) | ((x >= upper) & (gradient >= 0)) | (lower == upper))
        H = information(rate, J[free], exposure)
        move = np.zeros(len(x))
        while damping < 1e10:
            step = np.linalg.solve(H + damping * np.diag(np.diag(H) + 1e-9), gradient[free])
            move[free] = step / max(1.0, np.abs(step).max())
            trial = np.clip(x + move, lower, upper)
            there = rates(trial)
            new = log_likelihood(there[0], counts, exposure)
            if new > value:
                break
            damping *= 4.0
        else:
            left = np.abs(gradient[free]) @ np.sqrt(np.maximum(np.diag(np.linalg.pinv(H)), 0.0))
            return Maximum(x, value, bool(left < max_slope_sigmas))
        gain, x, value, (rate, J), damping = new - value, trial, new, there, max(damping / 5.0, 1e-8)
        if gain < min_gain_nats:
            return Maximum(x, value, True)
    return Maximum(x, value, False)
