"""How much better held-out events are explained by one scene than by another, and how much better they may become.

Comparisons are paired over pixels of the sensor, the independent units: what a scene gets wrong at a place is wrong for
all events there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.stats import t as student


class Gain(NamedTuple):
    """How much better rows are explained than by another pixel or scene.

    share: of the other's loss that is gone;  p_value: one-sided, of no gain at all, pixels being the units;  rows:
    compared
    """

    share: float
    p_value: float
    rows: int


def paired(old: np.ndarray, new: np.ndarray, rows: int) -> Gain:
    """The gain of losses new (pixels,) over losses old (pixels,) of the same pixels, sums over so many rows each."""
    total, (gained, spread) = float(old.sum()), _gained(old, new)
    score = gained / spread if spread > 0 else 0.0
    p_value = float(student.sf(score, len(old) - 1)) if len(old) > 1 else 1.0
    return Gain(gained / total if total > 0 else 0.0, p_value, rows)


def most_gained(looks: np.ndarray, ahead: float, alpha: float) -> float:
    """Upper limit, at confidence 1 − alpha, of the share of the last loss that a trend wins until it has gone on.

    The slope b of the line through the sums of losses has two independent errors: pixels (each has a slope of its own)
    and the course of the training, which moves all pixels together and shows as scatter about the line.

        b = Σ_k w_k ℓ_k      w_k = (k − k̄) / Σ (k − k̄)²      var b = n var(b_pixel) + s² Σ w²,  s² = Σ rest² / (m − 2)

    Args:
        looks: (m, pixels) losses at equal distances, in order.
        ahead: distances that are left.
        alpha: chance of a larger gain.

    Returns:
        The share; infinite where two looks or one pixel show no error.
    """
    m, n = looks.shape
    total = float(looks[-1].sum())
    if m < 3 or n < 2 or not total > 0:
        return float("inf")
    place = np.arange(m) - 0.5 * (m - 1)
    weights = place / (place**2).sum()
    sums, slopes = looks.sum(axis=1), weights @ looks
    rest = sums - sums.mean() - place * float(slopes.sum())
    course = float((rest**2).sum()) / (m - 2) * float((weights**2).sum())
    spread = np.sqrt(n * slopes.var(ddof=1) + course)
    return ahead * (spread * float(student.isf(alpha, m - 2)) - float(slopes.sum())) / total


def _gained(old: np.ndarray, new: np.ndarray) -> tuple[float, float]:
    """(sum of the gains of pixels (n,), its standard deviation)."""
    gains = old - new
    return float(gains.sum()), float(np.sqrt(((gains - gains.mean()) ** 2).sum()))
