"""log Φ for real values and complex steps."""

from __future__ import annotations

import numpy as np
from scipy.special import log_ndtr as _log_ndtr


def log_ndtr(x: np.ndarray) -> np.ndarray:
    """log of the standard normal distribution function, elementwise.

    For a complex step x + ih it returns log Φ(x) + i h φ(x)/Φ(x), exact to first order in h.
    """
    if not np.iscomplexobj(x):
        return _log_ndtr(x)
    real = _log_ndtr(x.real)
    hazard = np.exp(-0.5 * x.real**2 - 0.5 * np.log(2 * np.pi) - real)
    return real + 1j * x.imag * hazard
