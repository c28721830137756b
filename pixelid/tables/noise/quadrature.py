"""Nodes and weights: of slopes at crossings, of the stored reference, of thresholds as they are drawn."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

GRID = 0.3  # of the stored reference, in standard deviations of the output: e⁻⁸ at thresholds of 4
# Relative spread of thresholds: rates go as e^{b² x} with a change x, and at b = 4 and x = 5 % three nodes err by 2 %
NARROW = 0.05
# Of pixels whose thresholds differ: nodes of the difference lie `RIDGE` apart (standard deviations of the output) where
# both are alike, then farther by `GROWTH` of the difference, up to `APART` standard deviations of it, out to `REACH`:
# half of all that changes mean rates by 1.2 % at most, 0.4 % where thresholds are nearly alike (24 cases)
RIDGE, GROWTH, APART, REACH = 0.08, 0.7, 1.0, 3.0


@dataclass(frozen=True)
class Resolution:
    """How finely noise events are computed.

    Attributes:
        slopes: nodes.
        spacing: of references, in standard deviations of the output.
        fine: the same where both thresholds are alike, so that ON and OFF events undo each other, and a pair of them
            hardly moves the reference.
        least_hidden: share of the greatest variance of a hidden state from which on it is followed.
        pixels: how far apart thresholds of pixels are taken that differ, in what `mismatch_draws` takes.
    """

    slopes: int
    spacing: float
    fine: float
    least_hidden: float
    pixels: float

    def spacing_of(self, fineness: float) -> float:
        """Of references, where they must be as fine (0 … 1)."""
        return self.spacing + fineness * (self.fine - self.spacing)


# Finer references change rates by 0.8 % at most (by 3 % where thresholds are alike), further slopes and hidden states
# by 0.5 %
WHOLE = Resolution(slopes=4, spacing=0.2, fine=0.1, least_hidden=1e-3, pixels=1.0)
# For derivatives of ln rate and for where a search begins: a pixel's rates within 3 % (90 % of 72 cases), means of
# pixels that differ within 0.5 % of those of nodes twice as dense (39 cases with threshold noise of 4 %)
ROUGH = Resolution(slopes=3, spacing=0.3, fine=0.15, least_hidden=math.inf, pixels=2.0)


def offset_nodes(relative_sd: float) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights of the stored reference, a normal draw of so many standard deviations of the output.

    The mean wait is about 1 / (e^{−(C + c)²/2σ²} + e^{−(C − c)²/2σ²}) of the reference c, which has poles at
    c = ± iπσ²/2C: a uniform grid of spacing h errs by e^{−π²σ²/hC}, polynomials need a narrow draw.
    """
    if relative_sd < 0.25:
        return hermite(1 if relative_sd < 1e-3 else 3 if relative_sd < 0.08 else 5)
    spacing = min(GRID / relative_sd, 0.6)
    nodes = spacing * np.arange(-math.ceil(4.5 / spacing), math.ceil(4.5 / spacing) + 1)
    weights = np.exp(-0.5 * nodes**2)
    return nodes, weights / weights.sum()


@lru_cache
def threshold_draws(relative_sd: float) -> tuple[np.ndarray, np.ndarray]:
    """(draws, 2) factors of the ON and OFF threshold and (draws,) weights: both independent and normal.

    Up to `NARROW` a triangle, exact to the third order in both together; one corner lowers both thresholds, where the
    rates grow.  Above, the centre and a regular hexagon, exact to the fifth (Stroud 1971, E₂ʳ² 5-1).
    """
    if relative_sd <= 0:
        return np.ones((1, 2)), np.ones(1)
    if relative_sd <= NARROW:
        angles, radius, weights = math.pi * np.array([1.25, 1.25 + 2 / 3, 1.25 + 4 / 3]), math.sqrt(2.0), np.ones(3) / 3
        centre = np.zeros((0, 2))
    else:
        angles, radius, weights = math.pi / 3 * np.arange(6), 2.0, np.array([6, 1, 1, 1, 1, 1, 1]) / 12.0
        centre = np.zeros((1, 2))
    points = np.vstack([centre, radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)])
    return 1.0 + min(relative_sd, 0.4) * points, weights


def mismatch_draws(
    on: float, off: float, relative_sd: float, sigma: float, coarser: float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """The same for pixels that differ, whose rates are averaged; on, off: mean thresholds, sigma: of the output.

    With a short dead time rates have a narrow maximum at equal thresholds: a pixel whose ON and OFF events undo each
    other goes on for long.  Threshold noise of 4 % at thresholds of 4 leaves it some tenth of a standard deviation
    wide.  So nodes of the difference are dense around 0, wherever the mean difference lies, and the average has no
    waves as that moves.
    """
    if relative_sd <= 0:
        return threshold_draws(0.0)
    sd = min(relative_sd, 0.3) / math.sqrt(2.0)  # out to `REACH` no threshold is negative
    spread = sd * (on + off)
    growth, apart, least = GROWTH * coarser, APART * coarser * spread, RIDGE * sigma / GROWTH
    factors, weights = [], []
    for along in (-1.0, 1.0):
        middle, far = (on - off) * (1.0 + sd * along), REACH * spread
        limit = math.asinh((abs(middle) + far) / least)
        differences = least * np.sinh(np.linspace(-limit, limit, 2001))
        place = differences / apart + np.arcsinh(differences / least) / growth
        first, last = np.interp([middle - far, middle + far], differences, place)
        nodes = np.interp(np.arange(math.ceil(first), math.floor(last) + 1), place, differences)
        across = (nodes - middle) / spread
        per_node = 1.0 / (1.0 / apart + 1.0 / (growth * np.hypot(nodes, least)))
        weight = per_node * np.exp(-0.5 * across**2)
        weights.append(0.5 * weight / weight.sum())
        factors.append(1.0 + sd * np.stack([along + across, along - across], axis=1))
    return np.concatenate(factors), np.concatenate(weights)


@lru_cache
def hermite(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights of a standard normal draw."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(count)
    return nodes, weights / weights.sum()


@lru_cache
def rayleigh_nodes(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss nodes and weights of a slope of density w e^{−w²/2}: Golub & Welsch, the recurrence by Stieltjes."""
    x, weight = np.polynomial.legendre.leggauss(400)
    x = 5.0 * (x + 1.0)  # e⁻⁵⁰ is left beyond 10
    weight = weight * x * np.exp(-0.5 * x * x)
    weight /= weight.sum()
    alpha, beta = np.zeros(count), np.zeros(count)
    before, now, norm = np.zeros_like(x), np.ones_like(x), 1.0
    for k in range(count):
        size = float(weight @ now**2)
        alpha[k], beta[k] = float(weight @ (x * now**2)) / size, size / norm
        before, now, norm = now, (x - alpha[k]) * now - (beta[k] if k else 0.0) * before, size
    side = np.sqrt(beta[1:])
    nodes, vectors = np.linalg.eigh(np.diag(alpha) + np.diag(side, 1) + np.diag(side, -1))
    return nodes, vectors[0] ** 2
