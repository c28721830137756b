"""Statistics that more than one folder needs."""

from __future__ import annotations

import numpy as np

Z95 = 1.959963984540054  # half of a 95 % interval of a normal coordinate, in standard deviations
DROP_NATS = 1.9207  # of a profile log-likelihood at its 95 % limits: χ²₁(0.95)/2
SD_PER_MEDIAN = 1.4826  # standard deviation of a normal x per median of |x|: what outliers do not move


def dispersion(counts: np.ndarray, expected: np.ndarray) -> float:
    """Pearson χ² per cell, 1 for Poisson counts; cells are gathered in order until each expects at least 5 events."""
    n, m = counts.ravel(), expected.ravel()
    min_expected = 5.0  # events per gathered cell, for Pearson's χ² to be one
    group = np.floor(np.cumsum(m) / min_expected).astype(int)
    n, m = np.bincount(group, n), np.bincount(group, m)
    keep = m > 1.0
    return float(((n - m)[keep] ** 2 / m[keep]).mean())


def departures(X: np.ndarray, y: np.ndarray, covariance: np.ndarray, least: float = 0.0) -> float:
    """τ, by which values scatter about a linear model beyond their errors, by moments; 0 where nothing is to spare.

    DerSimonian & Laird 1986, Controlled Clinical Trials 7, 177.  X: (n, p);  y: (n,);  covariance: (n, n) of errors;
    least: χ² of the model where a likelihood shows more of it than normal errors do
    """
    W = np.linalg.inv(covariance)
    inverse = np.linalg.inv(X.T @ W @ X)
    rest = y - X @ (inverse @ X.T @ W @ y)
    scale = np.trace(W) - np.trace(inverse @ X.T @ W @ W @ X)
    spare = len(y) - X.shape[1]
    return float(np.sqrt(max((max(float(rest @ W @ rest), least) - spare) / scale, 0.0))) if spare > 0 else 0.0
