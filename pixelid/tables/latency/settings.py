"""What the name of a threshold setting says about its bias, and values at settings that were not measured.

A name of the form 0.75MIN or 0.25MAX is a fraction of the way from the default to the end of the range; a number is
itself the bias.  Subthreshold currents are exponential in their bias, and a threshold is the logarithm of a ratio of
currents: thresholds are linear in bias between neighbouring settings, and delays, inverse to a current, are so in
their logarithm.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

BEYOND = 0.5  # of the measured range of biases, beyond either end: an extrapolation further than that is none
_FRACTION = re.compile(r"([0-9]*\.?[0-9]+)(MIN|MAX)", re.IGNORECASE)


def bias_of(name: str) -> float | None:
    """The bias that a setting's name states, or None.

    >>> bias_of("0.75MIN"), bias_of("0"), bias_of("0.5MAX"), bias_of("night")
    (-0.75, 0.0, 0.5, None)
    """
    match = _FRACTION.fullmatch(name.strip())
    if match:
        return float(match[1]) * (-1.0 if match[2].upper() == "MIN" else 1.0)
    try:
        value = float(name)
    except ValueError:
        return None
    return value if np.isfinite(value) else None


def between(values: Mapping[float, float], bias: float, *, logarithmic: bool) -> float:
    """The value at a bias from those at measured ones: straight between neighbours, and beyond the ends.

    Args:
        values: bias → value > 0.
        bias: where it is wanted.
        logarithmic: whether the logarithm is what is linear.  Beyond the ends it always is, so that no threshold
            comes out negative.
    """
    x = np.array(sorted(values))
    y = np.array([values[b] for b in x])
    if len(x) == 1:
        return float(y[0])
    k = int(np.clip(np.searchsorted(x, bias) - 1, 0, len(x) - 2))
    share = (bias - x[k]) / (x[k + 1] - x[k])
    if logarithmic or not 0.0 <= share <= 1.0:
        return float(y[k] * (y[k + 1] / y[k]) ** share)
    return float(y[k] + share * (y[k + 1] - y[k]))
