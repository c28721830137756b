"""From pixel positions to viewing directions: pinhole intrinsics and two lens distortions, undone."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

DISTORTIONS = ("plumb_bob", "equidistant")
ITERATIONS = 20  # fixed-point steps of the inverse; lenses in use converge in fewer than ten


@dataclass(frozen=True)
class Camera:
    """A pinhole with distortion.

    intrinsics: (3, 3), pixel centres at integer coordinates;  width, height: pixels;  distortion: (0,) or four or
    five numbers;  model: one of `DISTORTIONS` (plumb_bob: k1, k2, p1, p2[, k3];  equidistant: k1 … k4)
    """

    intrinsics: np.ndarray
    width: int
    height: int
    distortion: np.ndarray
    model: str = "plumb_bob"

    def resized(self, width: int, height: int) -> Camera:
        """The same view in another number of pixels."""
        across, down = width / self.width, height / self.height
        # pixel centres at whole numbers: a picture begins half a pixel before the first
        scale = np.array([[across, 0, 0.5 * across - 0.5], [0, down, 0.5 * down - 0.5], [0, 0, 1]])
        return replace(self, intrinsics=scale @ self.intrinsics, width=width, height=height)

    def directions(self, xy) -> np.ndarray:
        """Unit viewing directions (n, 3) in the camera frame (x right, y down, z forward) of positions (n, 2)."""
        xy = np.asarray(xy, dtype=np.float64)
        homogeneous = np.column_stack([xy, np.ones(len(xy))])
        flat = homogeneous @ np.linalg.inv(self.intrinsics).T
        flat = flat[:, :2] / flat[:, 2:]
        if len(self.distortion) and np.any(self.distortion != 0):
            flat = _undo_radial(flat, self.distortion) if self.model == "plumb_bob" else _undo_fisheye(
                flat, self.distortion
            )  # fmt: skip
        rays = np.column_stack([flat, np.ones(len(flat))])
        return rays / np.linalg.norm(rays, axis=1, keepdims=True)

    def all_directions(self) -> np.ndarray:
        """(height · width, 3) directions of every pixel, row by row."""
        y, x = np.mgrid[: self.height, : self.width]
        return self.directions(np.column_stack([x.ravel(), y.ravel()]))

    @property
    def half_angle(self) -> float:
        """Half the horizontal field of view [rad]."""
        return float(np.arctan(self.width / 2 / self.intrinsics[0, 0]))


def pinhole(width: int, height: int, horizontal_fov: float) -> Camera:
    """An ideal camera of a horizontal field of view [rad]; principal point (W/2 − 0.5, H/2 − 0.5)."""
    f = width / 2 / np.tan(horizontal_fov / 2)
    intrinsics = np.array([[f, 0, width / 2 - 0.5], [0, f, height / 2 - 0.5], [0, 0, 1]])
    return Camera(intrinsics, width, height, np.empty(0))


def sub_pixel_directions(camera: Camera, supersample: int) -> np.ndarray:
    """(pixels · supersample², 3) directions on a regular sub-grid of every pixel, a pixel's rays together."""
    y, x = np.mgrid[: camera.height, : camera.width]
    offset = (np.arange(supersample) + 0.5) / supersample - 0.5
    dy, dx = np.meshgrid(offset, offset, indexing="ij")
    xy = np.stack([x.reshape(-1, 1) + dx.ravel(), y.reshape(-1, 1) + dy.ravel()], axis=-1)
    return np.ascontiguousarray(camera.directions(xy.reshape(-1, 2)))


def _undo_radial(distorted: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    k1, k2, p1, p2, k3 = (*coefficients, *np.zeros(5 - len(coefficients)))
    at = distorted.copy()
    for _ in range(ITERATIONS):
        x, y = at.T
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        dx = 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        dy = p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        at = (distorted - np.column_stack([dx, dy])) / radial[:, None]
    return at


def _undo_fisheye(distorted: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """θ_d = θ (1 + k1 θ² + … + k4 θ⁸), inverted by Newton's method."""
    theta_d = np.minimum(np.linalg.norm(distorted, axis=1), np.pi / 2)
    theta = theta_d.copy()
    powers = np.arange(1, 5) * 2
    for _ in range(ITERATIONS):
        series = theta[:, None] ** powers * coefficients
        value = theta * (1 + series.sum(axis=1)) - theta_d
        theta = theta - value / (1 + (series * (powers + 1)).sum(axis=1))
    scale = np.where(theta_d > 1e-12, np.tan(theta) / np.maximum(theta_d, 1e-12), 1.0)
    return distorted * scale[:, None]
