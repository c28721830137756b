"""Statistics that more than one folder needs."""

from __future__ import annotations

import numpy as np

Z95 = 1.959963984540054  # half of a 95 % interval of a normal coordinate, in standard deviations
DROP_NATS = 1.9207  # of a profile log-likelihood at its 95 % limits: χ²₁(0.95)/2
SD_PER_MEDIAN = 1.4826  # standard deviation of a normal x per median of |x|: what outliers do not move
MIN_EXPECTED = 5.0  # events per gathered cell, for Pearson's χ² to be one


def dispersion(counts: np.ndarray, expected: np.ndarray) -> float:
    """Pearson χ² per cell, 1 for Poisson counts; cells are gathered in order until each expects at least 5 events."""
    n, m = counts.ravel(), expected.ravel()
    group = np.floor(np.cumsum(m) / MIN_EXPECTED).astype(int)
    n, m = np.bincount(group, n), np.bincount(group, m)
    keep = m > 1.0
    return float(((n - m)[keep] ** 2 / m[keep]).mean())
