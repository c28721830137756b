"""What stamps say of a model, the true times integrated out: one Newton step at a time, about times drawn.

Where stamps are blurred by more than a threshold's noise makes of an interval, refits to times drawn hardly move: the
times tell far more than the stamps do, and they were drawn from the model that is to move (the rate of EM is the share
of information that is missing; Dempster, Laird & Rubin 1977, J. R. Stat. Soc. B 39, 1).  Here the times are integrated
out, to first order about a draw of them.  With event k at t_k and stamped a_k = t_k + ξ_k, its level over its threshold
e_k = z_k − M, its slope r_k by its own time and g_k by that of the event before,

    y_k = e_k + r_k (a_k − t_k) + g_k (a_{k−1} − t_{k−1})  =  threshold noise − J_k·Δθ + ΔM + r_k ξ_k + g_k ξ_{k−1}

does not depend on the draw, and is normal with a covariance V of three diagonals: s_k² + σ² (r_k² + g_k²) and
σ² g_k r_{k−1}.  Parameters and pixels' thresholds follow by least squares weighed by V⁻¹, the thresholds' noise and σ
by the average-information step of restricted likelihood (Gilmour, Thompson & Cullis 1995, Biometrics 51, 1440).  A
stamp rounded to a tick has σ = tick/√12.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.linalg import solveh_banded

from pixelid.fit.coordinates import Coordinates
from pixelid.gap.imputation.blur import of_intervals, slopes_of
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import Model

STEP = 1e-4  # of a coordinate's longest move, one-sided difference
LONGEST = 0.3  # of a coordinate's longest move, in one step
MAX_LOG_MOVE = 0.5  # of noise and σ, in one step
NOISE, MISMATCH = "threshold_sigma", "threshold_mismatch.sigma"


@dataclass(frozen=True)
class MarginalStep:
    """Where one step leads.

    x: (d,) coordinates of the model;  sigma_s: of the stamps
    sd: (d,) of the coordinates, and sigma_error: relative, of σ: what the stamps tell, the times integrated out
    missing_sd: (d,) what the blur adds to the errors of the coordinates
    """

    x: np.ndarray
    sigma_s: float
    sd: np.ndarray
    sigma_error: float
    missing_sd: np.ndarray


@dataclass(frozen=True)
class _Linear:
    """n intervals in the order of pixel and time: y, its derivatives J (n, d), slopes r, g, variance s² of the
    thresholds, group, and `follows`: whether an interval begins where the one above it ends."""

    y: np.ndarray
    J: np.ndarray
    r: np.ndarray
    g: np.ndarray
    noise: np.ndarray
    group: np.ndarray
    follows: np.ndarray

    def solve(self, sigma: float, right: np.ndarray) -> np.ndarray:
        """V⁻¹ times (n, …)."""
        return solveh_banded(self.covariance(sigma), right, lower=True, check_finite=False)

    def covariance(self, sigma: float) -> np.ndarray:
        """V (2, n): its diagonal, and the one below it."""
        below = np.zeros(len(self.y))
        below[:-1] = np.where(self.follows[1:], sigma**2 * self.g[1:] * self.r[:-1], 0.0)
        return np.array([self.noise + sigma**2 * (self.r**2 + self.g**2), below])

    def only(self, kept: np.ndarray) -> _Linear:
        """Without some intervals."""
        follows = self.follows & np.concatenate([[False], kept[:-1]])
        return _Linear(
            self.y[kept], self.J[kept], self.r[kept], self.g[kept], self.noise[kept], self.group[kept], follows[kept]
        )


def marginal_step(
    likelihood: EventTimes, stamps: Sequence[np.ndarray], model: Model, sigma_s: float, estimate: bool
) -> MarginalStep:
    """One step from a model towards what the stamps say.

    Args:
        likelihood: Of times drawn under the model.
        stamps: Per recording (n,) s, of its events in order of the times drawn.
        model: Where to step from.
        sigma_s: Standard deviation of the stamps about the times.
        estimate: Whether that is to be found as well.
    """
    coordinates = Coordinates.of(model)
    x = coordinates.start
    terms, linear = _linearised(likelihood, stamps, coordinates, x)
    d, groups = len(x), likelihood.layout.groups
    farthest_sd = 6.0  # of y: intervals farther off have another cause
    far = np.abs(linear.y) > farthest_sd * np.sqrt(linear.covariance(sigma_s)[0])
    linear = linear.only(~far)
    if len(linear.y) < 2:  # nothing that a step could be taken by
        return MarginalStep(x, sigma_s, np.zeros(d), 0.0, np.zeros(d))
    thresholds = np.zeros((len(linear.y), groups))
    thresholds[np.arange(len(linear.y)), linear.group] = -1.0
    full = np.concatenate([linear.J, thresholds], axis=1)
    solved = linear.solve(sigma_s, np.concatenate([full, linear.y[:, None]], axis=1))
    of_prior, pull = _priors(coordinates, x, terms, d, groups)
    covariance = _inverse(full.T @ solved[:, :-1] + of_prior)
    step = covariance @ (pull - full.T @ solved[:, -1])
    left = linear.y + full @ step
    longest = LONGEST * coordinates.longest_moves()
    moved = x + np.clip(step[:d], -longest, longest)
    known = _inverse(full.T @ (full / linear.noise[:, None]) + of_prior)  # the same, had the times been seen
    by_noise, by_sigma, noise_error, error = _variances(linear, left, sigma_s, estimate)
    names = coordinates.names
    if NOISE in names:
        moved[names.index(NOISE)] = x[names.index(NOISE)] + by_noise
    if MISMATCH in names:
        moved[names.index(MISMATCH)] = _mismatch(terms, step[d:], np.diag(covariance)[d:], x[names.index(MISMATCH)])
    lower, upper = coordinates.bounds()
    # of a direction that nothing tells, rounding leaves a variance of either sign
    variance, variance_known = (np.maximum(np.diag(each)[:d], 0.0) for each in (covariance, known))
    if NOISE in names:
        variance[names.index(NOISE)], variance_known[names.index(NOISE)] = noise_error**2, 0.5 / len(left)
    return MarginalStep(
        np.clip(moved, lower, upper), sigma_s * float(np.exp(by_sigma)), np.sqrt(np.maximum(variance, 0.0)), error,
        np.sqrt(np.maximum(variance - variance_known, 0.0)),
    )  # fmt: skip


def _inverse(information: np.ndarray) -> np.ndarray:
    """The inverse, with directions that nothing tells left out."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-12))
    return np.linalg.pinv(information * scale * scale[:, None], rcond=1e-10) * scale * scale[:, None]


def _linearised(likelihood: EventTimes, stamps: Sequence[np.ndarray], coordinates: Coordinates, x: np.ndarray):
    """(terms at x, the intervals linearised)."""
    circuit = coordinates.circuit(x)
    here = likelihood.terms(circuit)
    slopes = slopes_of(likelihood, circuit, here)
    aside = slopes.aside
    e = here.z - here.group_mean[likelihood.group]
    moves, J = STEP * coordinates.longest_moves(), np.zeros((len(e), len(x)))
    for i, h in enumerate(moves):
        if coordinates.names[i] in (NOISE, MISMATCH):
            continue
        moved = x.copy()
        moved[i] += h
        other = coordinates.circuit(moved)
        terms = likelihood.terms(other, likelihood.changes(other, here.changes))
        shift = terms.z - here.z - e * (terms.log_rate - here.log_rate)
        aside = aside | terms.background
        J[:, i] = shift / h
    sound = ~aside & np.isfinite(J).all(axis=1)
    r, g, noise, order = slopes.own, slopes.before, here.scale**2, slopes.order
    late = [stamp - 1e-9 * r.events.t for r, stamp in zip(likelihood.recordings, stamps, strict=True)]
    off, off_before = of_intervals(likelihood, late)
    y = e + r * off + g * off_before
    linear = _Linear(y[order], J[order], r[order], g[order], noise[order], likelihood.group[order], slopes.follows)
    return here, linear.only(sound[order])


def _priors(coordinates: Coordinates, x: np.ndarray, terms, d: int, groups: int) -> tuple[np.ndarray, np.ndarray]:
    """(information, push) of the parameters' priors, and of the pixels' thresholds about the population's."""
    information, push = np.zeros((d + groups, d + groups)), np.zeros(d + groups)
    gradient, curvature = coordinates.prior_gradient_and_curvature(x)
    information[np.arange(d), np.arange(d)] += curvature
    push[:d] += gradient
    weight = 1.0 / np.maximum(terms.group.spread, (1e-4 * terms.centre) ** 2)
    away = terms.group_mean - terms.centre
    own = np.arange(d, d + groups)
    information[own, own] += weight
    push[own] -= weight * away
    for polarity, name in ((0, "off_threshold"), (1, "on_threshold")):
        if name not in coordinates.names:
            continue
        i = coordinates.names.index(name)
        mine = np.arange(polarity, groups, 2)
        slope = terms.centre[mine]  # of C by its logarithm
        information[i, i] += float(np.sum(weight[mine] * slope**2))
        information[i, d + mine] -= weight[mine] * slope
        information[d + mine, i] -= weight[mine] * slope
        push[i] += float(np.sum(weight[mine] * slope * away[mine]))
    return information, push


def _mismatch(terms, step: np.ndarray, variance: np.ndarray, now: float) -> float:
    """Log of the thresholds' relative spread over pixels, from where they now are."""
    told = terms.weight_sum > 0
    if told.sum() < 4:
        return now
    away = (terms.group_mean + step - terms.centre)[told] / terms.centre[told]
    away = away - np.where(np.arange(len(terms.centre))[told] % 2 == 1, away.mean(), away.mean())
    spread = float(np.sqrt(np.mean(away**2 + variance[told] / terms.centre[told] ** 2)))
    return now + float(np.clip(np.log(max(spread, 1e-4)) - now, -MAX_LOG_MOVE, MAX_LOG_MOVE))


def _variances(linear: _Linear, y: np.ndarray, sigma: float, estimate: bool) -> tuple[float, float, float, float]:
    """(steps of log noise and of log σ, their standard errors)."""
    V = linear.covariance(sigma)
    blurred = _Linear(y, linear.J, linear.r, linear.g, np.zeros(len(y)), linear.group, linear.follows)
    parts = [np.array([2.0 * linear.noise, np.zeros(len(y))]), 2.0 * blurred.covariance(sigma)]
    inverse = np.array(_selected_inverse(V[0], V[1]))
    solved = linear.solve(sigma, y)
    pushed = [_times(part, solved) for part in parts]
    score = np.array([0.5 * (float(solved @ p) - _trace(inverse, part)) for p, part in zip(pushed, parts, strict=True)])
    again = [linear.solve(sigma, p) for p in pushed]
    information = np.array([[0.5 * float(p @ a) for a in again] for p in pushed])
    if not estimate:
        score[1], information[0, 1], information[1, 0] = 0.0, 0.0, 0.0
    information[0, 0] += 1e-6 * len(y)
    covariance = np.linalg.pinv(information)
    step = np.clip(covariance @ score, -MAX_LOG_MOVE, MAX_LOG_MOVE)
    errors = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return float(step[0]), float(step[1]), float(errors[0]), float(errors[1])


def _times(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """A symmetric matrix of three diagonals (2, n) times a vector (n,)."""
    out = matrix[0] * vector
    out[1:] += matrix[1, :-1] * vector[:-1]
    out[:-1] += matrix[1, :-1] * vector[1:]
    return out


def _trace(inverse: np.ndarray, matrix: np.ndarray) -> float:
    """Trace of the product of two symmetric matrices, of one of which only three diagonals (2, n) are not zero."""
    return float(np.sum(inverse[0] * matrix[0]) + 2.0 * np.sum(inverse[1] * matrix[1]))


@njit(cache=True, error_model="numpy")
def _selected_inverse(diagonal, below):
    """(diagonal, the one below it) of the inverse of a positive matrix of three diagonals (Takahashi's recursion)."""
    n = len(diagonal)
    pivot, factor = np.empty(n), np.zeros(n)
    pivot[0] = diagonal[0]
    for k in range(1, n):
        factor[k - 1] = below[k - 1] / pivot[k - 1]
        pivot[k] = diagonal[k] - factor[k - 1] * below[k - 1]
    inverse, beside = np.empty(n), np.zeros(n)
    inverse[n - 1] = 1.0 / pivot[n - 1]
    for k in range(n - 2, -1, -1):
        beside[k] = -factor[k] * inverse[k + 1]
        inverse[k] = 1.0 / pivot[k] - factor[k] * beside[k]
    return inverse, beside
