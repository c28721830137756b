"""What makes one experiment better than another, as the logarithm of how much errors shrink (higher is better).

    D           ½ ln det(information after / before)          the volume of the joint error ellipsoid
    A           ½ ln(trace of the covariance before / after)  the mean square error of the fitting coordinates
    PARAMETER   ln(standard error before / after)             of one parameter

All three are in nats of one length: 0.69 halves it (for D: the product of all lengths).  Atkinson, Donev & Tobias,
Optimum Experimental Designs, with SAS, 2007, ch. 10.
"""

from __future__ import annotations

import numpy as np

from pixelid.errors import InputError


def score(criterion: str, names: tuple[str, ...], before: np.ndarray, after: np.ndarray) -> float:
    """How much `criterion` ("D", "A" or a name of `names`) gains from information before to after, both (n, n) > 0."""
    if criterion == "D":
        return 0.5 * float(np.linalg.slogdet(after)[1] - np.linalg.slogdet(before)[1])
    old, new = covariance(before), covariance(after)
    if criterion == "A":
        return 0.5 * float(np.log(np.trace(old) / np.trace(new)))
    i = names.index(criterion)
    return 0.5 * float(np.log(old[i, i] / new[i, i]))


def check(criterion: str, names: tuple[str, ...]) -> None:
    """Raise InputError unless the criterion is D, A or a free parameter."""
    if criterion not in ("D", "A", *names):
        raise InputError(f"--criterion: expected D, A or a free parameter ({', '.join(names)}), found {criterion!r}")


def covariance(information: np.ndarray) -> np.ndarray:
    """The inverse of a positive definite information matrix, well scaled."""
    scale = 1.0 / np.sqrt(np.diag(information))
    return np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)


def standard_errors(information: np.ndarray) -> np.ndarray:
    """(n,) standard errors in fitting coordinates."""
    return np.sqrt(np.diag(covariance(information)))


def most_improved(before: np.ndarray, after: np.ndarray) -> tuple[np.ndarray, float]:
    """(direction (n,), factor): along which change d of the coordinates information grows most, and by how much.

    d maximises (dᵀ after d)/(dᵀ before d); the factor is the square root of that, a ratio of standard errors along d.
    """
    factor = np.linalg.cholesky(before)
    inverse = np.linalg.inv(factor)
    eigenvalues, vectors = np.linalg.eigh(inverse @ after @ inverse.T)
    direction = inverse.T @ vectors[:, -1]
    return direction / np.abs(direction).max(), float(np.sqrt(max(eigenvalues[-1], 0.0)))
