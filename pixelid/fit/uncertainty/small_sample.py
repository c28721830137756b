"""Intervals when few pixels share a spread: what a normal approximation gets wrong, and by how much.

The mean threshold of n pixels is known to about σ C/√n, with σ the mismatch that the same 2n thresholds (ON and OFF)
must also identify.  Maximum likelihood puts σ low, by √(1 − 2/2n) as two means are estimated too, and a normal quantile
ignores that σ is itself uncertain; at 9 pixels 95 % intervals of the thresholds then hold the truth in some 91 %.
Restricted likelihood and Satterthwaite's degrees of freedom repair both (Patterson & Thompson 1971, Biometrika 58, 545;
Satterthwaite 1946, Biometrics Bulletin 2, 110), here in closed form:

    G = 1/(2 s²)       thresholds that determine σ, from s, the standard error of ln σ;  ν = G − 2 degrees of freedom
    σ                  interval σ̂ √(G/χ²_ν), equal tails
    ln C               variance v → v (1 + f (G/ν − 1)) and Student's t with ν/f² degrees of freedom, f = σ²/(n v) the
                       share of v that comes from mismatch
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import chi2, t

from pixelid.statistics import Z95

MISMATCH = "threshold_mismatch.sigma"
THRESHOLDS = ("on_threshold", "off_threshold")
LEAST_FREEDOM = 2.0


def mismatch_shares(names: Sequence[str], x: np.ndarray, sd: np.ndarray, pixels: int) -> np.ndarray:
    """(d,) share of each coordinate's variance that pixel-to-pixel mismatch makes: 0 but for thresholds, at most 1."""
    shares = np.zeros(len(x))
    names = list(names)
    if MISMATCH in names:
        spread = np.exp(2.0 * x[names.index(MISMATCH)]) / max(pixels, 1)
        for name in THRESHOLDS:
            if name in names and 0 < sd[names.index(name)] < np.inf:
                shares[names.index(name)] = min(float(spread / sd[names.index(name)] ** 2), 1.0)
    return shares


def intervals(names: Sequence[str], x: np.ndarray, sd: np.ndarray, pixels: int) -> tuple[np.ndarray, np.ndarray]:
    """(lower, upper) 95 % limits in fitting coordinates, from the optimum x (d,) and its standard errors sd (d,).

    pixels: how many share the spread.  Without a free mismatch: x ± 1.96 sd.
    """
    lower, upper = x - Z95 * sd, x + Z95 * sd
    names = list(names)
    if MISMATCH not in names:
        return lower, upper
    k = names.index(MISMATCH)
    if not np.isfinite(sd[k]) or sd[k] > 0.5:
        return lower, upper
    told = 1.0 / (2.0 * sd[k] ** 2)
    freedom = max(told - 2.0, LEAST_FREEDOM)
    lower[k] = x[k] + 0.5 * np.log(told / chi2.ppf(0.975, freedom))
    upper[k] = x[k] + 0.5 * np.log(told / chi2.ppf(0.025, freedom))
    shares = mismatch_shares(names, x, sd, pixels)
    for i in np.flatnonzero(shares):
        share = shares[i]
        width = sd[i] * np.sqrt(1.0 + share * (told / freedom - 1.0)) * t.ppf(0.975, freedom / max(share, 1e-3) ** 2)
        lower[i], upper[i] = x[i] - width, x[i] + width
    return lower, upper
