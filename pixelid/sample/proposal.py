"""An independence proposal shaped like the posterior: a two-piece Student density around the optimum.

Along each axis of the Laplace covariance the log posterior is looked at on both sides, and each side gets the scale
that its drop shows (split-t of Geweke 1989, Econometrica 57, "Bayesian inference in econometric models using Monte
Carlo integration").  With d axes v_j, scales s⁺, s⁻ and e a multivariate t of ν degrees of freedom,

    u = Σ_j v_j s_j^± |e_j|,   sign + with probability s⁺/(s⁺ + s⁻),   q(u) ∝ t_ν(e) Π_j 2/(s⁺_j + s⁻_j)

Thresholds that are known as well as few pixels' mismatch σ allows have a width that grows with σ: a funnel.  So
x_i = x̂_i + u_i exp(f_i u_m), with m the coordinate ln σ and f_i the share of the threshold's variance that is mismatch.

The proposal only suggests: emcee's Metropolis rule accepts or rejects with the exact posterior.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

FREEDOM = 40.0  # tails heavier than the posterior's, near enough to accept most
SOFT, RIDGE = 3, 1.2  # axes that may be ridges, and how far along them their bend is measured


@dataclass(frozen=True)
class Proposal:
    """centre (d,);  axes (d, d), columns are Laplace standard deviations;  above, below (d,) scales along them
    bend: (d, d) shift of all axes per square of the distance along axis j (column j), for curved ridges; None: straight
    funnel: (d,) f of every coordinate, 0 for those whose width does not depend on coordinate `mouth`
    """

    centre: np.ndarray
    axes: np.ndarray
    above: np.ndarray
    below: np.ndarray
    funnel: np.ndarray
    mouth: int
    freedom: float = FREEDOM
    bend: np.ndarray | None = None

    def curve(self, y: np.ndarray) -> np.ndarray:
        """u at distances y (…, d) along the axes.  A shear: soft axes shift the others, so volume is kept."""
        return (y if self.bend is None else y + (y * y) @ self.bend.T) @ self.axes.T

    def straighten(self, u: np.ndarray) -> np.ndarray:
        """The inverse of `curve`."""
        y = np.linalg.solve(self.axes, u.T).T
        return y if self.bend is None else y - (y * y) @ self.bend.T

    def lift(self, u: np.ndarray) -> np.ndarray:
        """x at u (…, d)."""
        return self.centre + u * np.exp(self.funnel * u[..., self.mouth, None])

    def draw(self, n: int, rng) -> np.ndarray:
        """(n, d) draws;  rng: a NumPy RandomState."""
        d = len(self.centre)
        e = np.abs(rng.standard_normal((n, d))) / np.sqrt(rng.chisquare(self.freedom, (n, 1)) / self.freedom)
        up = rng.random_sample((n, d)) < self.above / (self.above + self.below)
        return self.lift(self.curve(np.where(up, self.above * e, -self.below * e)))

    def log_density(self, x: np.ndarray) -> np.ndarray:
        """(n,) log q at x (n, d), up to a constant."""
        mouth = (x - self.centre)[:, self.mouth, None]
        u = (x - self.centre) * np.exp(-self.funnel * mouth)
        y = self.straighten(u)
        e = np.where(y > 0, y / self.above, y / self.below)
        d = len(self.centre)
        radial = -0.5 * (self.freedom + d) * np.log1p((e**2).sum(axis=1) / self.freedom)
        return radial - self.funnel.sum() * mouth[:, 0]

    def suggest(self, coords: np.ndarray, rng) -> tuple[np.ndarray, np.ndarray]:
        """What `emcee.moves.MHMove` asks for: new points and ln q(x)/q(x')."""
        new = self.draw(len(coords), rng)
        return new, self.log_density(coords) - self.log_density(new)

    def refitted(self, x: np.ndarray) -> Proposal:
        """The proposal with mean, axes and scales of the draws x (n, d), and heavier tails."""
        centre = x.mean(axis=0)
        mouth = (x - centre)[:, self.mouth, None]
        u = (x - centre) * np.exp(-self.funnel * mouth)
        variances, vectors = np.linalg.eigh(np.cov(u.T))
        axes = vectors * np.sqrt(np.maximum(variances, 1e-30))
        y = np.linalg.solve(axes, u.T).T
        above, below = (np.sqrt((y**2 * side).sum(axis=0) / np.maximum(side.sum(axis=0), 1)) for side in (y > 0, y < 0))
        refitted_freedom = 8.0
        return Proposal(centre, axes, above, below, self.funnel, self.mouth, refitted_freedom)


def shaped(
    value: Callable[[np.ndarray], float],
    centre: np.ndarray,
    covariance: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    scale: np.ndarray,
    funnel: np.ndarray | None = None,
    mouth: int = 0,
    gradient: Callable[[np.ndarray], np.ndarray] | None = None,
) -> Proposal:
    """The proposal around an optimum.

    covariance: Laplace, zero for coordinates on a bound;  scale: (d,) a long step of each coordinate, the longest that
    a Laplace axis may take.
    """
    C = covariance / np.outer(scale, scale)
    stuck = np.diag(C) <= 0
    C[np.ix_(stuck, stuck)] += np.eye(int(stuck.sum())) * 0.01
    variances, vectors = np.linalg.eigh(C)
    widths = np.sqrt(np.clip(variances, 1e-20, 1.0))
    axes = scale[:, None] * vectors * widths
    d = len(centre)
    plain = np.zeros(d) if funnel is None else funnel
    shape = Proposal(np.asarray(centre, dtype=float), axes, np.ones(d), np.ones(d), plain, mouth)
    if gradient is not None and d > 1:
        shape = _curved_along_ridges(shape, gradient, lower, upper)
    top = value(centre)
    sides = np.array([[_scale(value, top, shape, sign * v, lower, upper) for sign in (1, -1)] for v in np.eye(d)])
    return replace(shape, above=sides[:, 0], below=sides[:, 1])


def _curved_along_ridges(shape: Proposal, gradient, lower, upper) -> Proposal:
    """The proposal curved along its softest axes.

    With whitened distances y the log posterior is −½|y|² and a cubic part, whose gradient across axis j at ± t is the
    even part of the slopes there: the ridge passes at that distance, c t².  Twice, the second time from the first bend.
    """
    d = len(shape.centre)
    soft = np.arange(max(d - SOFT, 1), d)  # eigh sorts widths upwards
    bend = np.zeros((d, d))
    for _ in range(2):
        correction = np.zeros((d, d))
        for j in soft:
            for sign in (-1, 1):
                y = np.zeros(d)
                y[j] = sign * RIDGE
                x = np.clip(shape.lift(replace(shape, bend=bend).curve(y)), lower, upper)
                correction[:, j] += 0.5 * (shape.axes.T @ gradient(x)) / RIDGE**2
        correction[soft] = 0.0
        bend = bend + np.clip(np.nan_to_num(correction), -1.0, 1.0)
    return replace(shape, bend=bend)


def _scale(value, top: float, shape: Proposal, v, lower, upper) -> float:
    """Standard deviations of one side, in units of v: the largest of distance/√(2 · drop), to cover the tails."""
    straight = shape.axes @ v
    with np.errstate(divide="ignore", invalid="ignore"):
        room = np.where(
            straight > 0,
            (upper - shape.centre) / straight,
            np.where(straight < 0, (lower - shape.centre) / straight, np.inf),
        )
    reach = max(float(room.min()), 1e-3)
    step, scale = min(1.0, reach), 0.0
    deepest, shallowest = 8.0, 0.5  # nats; drops outside this range say little about a scale
    for _ in range(8):
        drop = top - value(shape.lift(shape.curve(0.999 * step * v)))
        if drop < deepest:
            scale = max(scale, step / np.sqrt(2.0 * max(drop, 0.05)))
        elif scale == 0.0:
            step *= 0.5
            continue
        if step >= reach or not drop < 4.0:
            break
        step = min(step + 1.0 if drop > shallowest / 4 else 2.0 * step, reach)
    return float(min(scale, reach)) if scale > 0 else step
