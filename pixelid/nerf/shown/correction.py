"""Predictions are known up to a translated gamma; views show which: image ≈ exposure · (a L^b − c), per colour.

a and b start from the log-affine fit (c = 0); then at most 20 steps of Levenberg–Marquardt in a trust region
(`scipy.optimize.least_squares`, method "trf").  Source: Low & Lee, arXiv 2409.17988, supplement.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

STEPS = 20
SMALLEST = 1e-4


@dataclass(frozen=True)
class Correction:
    """a, b, c: (C,)."""

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray

    def __call__(self, radiance: np.ndarray, exposure: np.ndarray) -> np.ndarray:
        """Images (n, H, W, C) from radiance of that shape; exposure: (n,), exposure × gain of each."""
        scale = exposure.reshape(-1, 1, 1, 1)
        return scale * (self.a * np.maximum(radiance, SMALLEST) ** self.b - self.c)


def fit_correction(radiance: np.ndarray, images: np.ndarray, exposure: np.ndarray) -> Correction:
    """The correction that takes predicted radiance (n, H, W, C) closest to images (n, H, W, C), exposure (n,)."""
    L, target, scale = _columns(radiance, images, exposure)
    each = [_fitted(L[:, [k]], target[:, [k]], scale, *_log_affine(L[:, k], target[:, k], scale[:, 0]))
            for k in range(L.shape[1])]  # fmt: skip
    return Correction(*(np.concatenate([getattr(one, name) for one in each]) for name in ("a", "b", "c")))


def fit_shared_correction(radiance: np.ndarray, images: np.ndarray, exposure: np.ndarray) -> Correction:
    """As `fit_correction`, with one exponent for all colours: the least squared error over them together."""
    alone = fit_correction(radiance, images, exposure)
    if len(alone.a) == 1:
        return alone
    return _fitted(*_columns(radiance, images, exposure), np.maximum(alone.a, SMALLEST), alone.b.mean(), alone.c)


def _columns(radiance, images, exposure) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(radiance (N, C), images (N, C), exposure (N, 1)) of all pixels of all views."""
    colours = images.shape[-1]
    scale = np.repeat(exposure, radiance.shape[1] * radiance.shape[2])[:, None]
    return np.maximum(radiance.reshape(-1, colours), SMALLEST), images.reshape(-1, colours), scale


def _log_affine(L, image, scale) -> tuple[np.ndarray, float, np.ndarray]:
    """(a (1,), b, c (1,)) of a straight line in logs of one colour (N,), where c is 0."""
    x, z = np.log(L), np.log(np.maximum(image / scale, SMALLEST))
    spread = ((x - x.mean()) ** 2).sum()
    b = float(((x - x.mean()) * (z - z.mean())).sum() / spread) if spread > 1e-12 else 1.0
    b = min(max(b, 0.05), 5.0)
    return np.array([np.exp(z.mean() - b * x.mean())]), b, np.zeros(1)


def _fitted(L: np.ndarray, target: np.ndarray, scale: np.ndarray, a: np.ndarray, b: float, c: np.ndarray) -> Correction:
    """The correction of colours (N, C) with one exponent, from a (C,), b, c (C,)."""
    logs, colours = np.log(L), L.shape[1]

    def unpacked(p):
        return np.exp(p[:colours]), p[colours], p[colours + 1 :]

    def residual(p):
        a, b, c = unpacked(p)
        return (scale * (a * L**b - c) - target).ravel()

    def jacobian(p):
        a, b, _ = unpacked(p)
        power = scale * a * L**b
        rows = np.zeros((len(L), colours, 2 * colours + 1))
        for k in range(colours):
            rows[:, k, k], rows[:, k, colours] = power[:, k], power[:, k] * logs[:, k]
            rows[:, k, colours + 1 + k] = -scale[:, 0]
        return rows.reshape(-1, 2 * colours + 1)

    first = np.concatenate([np.log(a), [b], c])
    solution = least_squares(residual, first, jac=jacobian, method="trf", max_nfev=STEPS + 1)  # type: ignore[arg-type]
    a, b, c = unpacked(solution.x)
    return Correction(a, np.full(colours, b), c)
