"""What the data pinned and what they left open, from the curvature at the optimum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pixelid.parameters.parameter import OPEN_SD
from pixelid.statistics import Z95

if TYPE_CHECKING:
    from pixelid.fit.coordinates import Coordinates

# Lags go as 1/f: in ln f the third derivative of the log posterior is of the size of the second.  The limits of a
# direction of standard deviation s are then off by a share of about s.
BENT_SD = 0.1
CONDITION = 1e13


@dataclass(frozen=True)
class Identified:
    """Covariance in fitting coordinates and its reading.

    sd: (n,) standard errors;  identified: (n,) whether each parameter is pinned;  sentences: what is not, in words
    condition: ratio of the largest to the smallest eigenvalue of the curvature
    directions: best known to least known, {"in_words", "sd"} each, sd in the scale of the coordinates (logs)
    """

    covariance: np.ndarray
    sd: np.ndarray
    identified: np.ndarray
    sentences: tuple[str, ...]
    condition: float = 1.0
    directions: tuple[dict, ...] = ()

    @property
    def bends(self) -> bool:
        """Whether a single direction is known so little that the log posterior need not be a parabola along it."""
        *_, next_to_last, last = (0.0, 0.0, *(direction["sd"] for direction in self.directions))
        return last > BENT_SD and next_to_last < OPEN_SD


def read_curvature(coordinates: Coordinates, curvature: np.ndarray, on_bound: np.ndarray) -> Identified:
    """Covariance and unidentified directions of a negated Hessian (n, n).

    A direction counts as open when it is known no better than `OPEN_SD` in the scale of the coordinates (logs;
    a millisecond for delays).  Parameters on a bound are one-sided: they are reported, and held in the covariance.
    """
    n = len(curvature)
    scale = coordinates.longest_moves()
    K = curvature * np.outer(scale, scale)
    free = ~on_bound
    covariance = np.zeros((n, n))
    sd = np.full(n, np.inf)
    sentences = []
    directions = []
    condition = 1.0
    if free.any():
        eigenvalues, vectors = np.linalg.eigh(K[np.ix_(free, free)])
        floor = max(eigenvalues.max(), 1e-300) / CONDITION
        safe = np.maximum(eigenvalues, floor)
        covariance[np.ix_(free, free)] = (vectors / safe) @ vectors.T
        sd[free] = np.sqrt(np.diag(covariance)[free])
        names = [name for name, keep in zip(coordinates.names, free, strict=True) if keep]
        condition = float(eigenvalues.max() / max(eigenvalues.min(), floor))
        for value, vector in zip(eigenvalues[::-1], vectors.T[::-1], strict=True):
            width = 1.0 / np.sqrt(max(value, floor))
            directions.append({"in_words": combination(names, vector), "sd": float(width)})
            if width > OPEN_SD:
                sentences.append(_in_words(names, vector, width))
    for name, held in zip(coordinates.names, on_bound, strict=True):
        if held:
            sentences.append(f"{name} sits on its bound: the data only limit it from one side")
    identified = free & (sd < OPEN_SD)
    return Identified(
        covariance * np.outer(scale, scale), sd * scale, identified, tuple(sentences), condition, tuple(directions)
    )


def combination(names: Sequence[str], vector: np.ndarray, least: float = 0.15, most: int | None = None) -> str:
    """An eigenvector in words: "alpha × k with beta × k^0.9".

    least: share of the largest component below which others are left out;  most: how many are named
    """
    order = np.argsort(-np.abs(vector))
    lead = vector[order[0]]
    parts = [
        f"{names[i]} × k" + (f"^{vector[i] / lead:.2g}" if i != order[0] else "")
        for i in order
        if abs(vector[i] / lead) > least
    ]
    return " with ".join(parts[:most])


def _in_words(names: list[str], vector: np.ndarray, width: float) -> str:
    lead = np.abs(vector).max()
    known = f"this combination is known within a factor {np.exp(min(Z95 * width * lead, 50.0)):.2g}"
    return f"scaling {combination(names, vector)}: {known} (95 %)"
