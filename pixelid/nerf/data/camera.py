"""From pixel positions to viewing directions: pinhole intrinsics and two lens distortions, undone."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pixelid.errors import InputError

DISTORTIONS = ("plumb_bob", "equidistant")
ITERATIONS = 20  # Newton steps of the inverse; lenses in use converge in fewer than ten
# Between a pixel and where the lens puts what was found for it: a tenth of a calibration's error
MOST_OFF_PIXELS = 0.01
WAY = 64  # steps from the middle to the border in which a lens that turns back is noticed: 1.4° each at most


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

    @property
    def distorts(self) -> bool:
        """Whether a coefficient of the lens differs from 0."""
        return bool(np.any(self.distortion != 0))

    def flat(self, xy) -> np.ndarray:
        """Positions (n, 2) in pixels → (n, 2) on the plane at distance 1, as the lens has distorted them."""
        xy = np.asarray(xy, dtype=np.float64)
        flat = np.column_stack([xy, np.ones(len(xy))]) @ np.linalg.inv(self.intrinsics).T
        return flat[:, :2] / flat[:, 2:]

    def distorted(self, flat: np.ndarray) -> np.ndarray:
        """Where the lens puts points of the plane at distance 1: (n, 2) → (n, 2)."""
        if not self.distorts:
            return flat
        if self.model == "plumb_bob":
            return _plumb_bob(flat, self.distortion)[0]
        r = np.linalg.norm(flat, axis=1)
        theta_d, _ = _equidistant(np.arctan(r), self.distortion)
        return flat * np.where(r > 1e-12, theta_d / np.maximum(r, 1e-12), 1.0)[:, None]

    def undone(self, seen: np.ndarray) -> np.ndarray:
        """The inverse of `distorted`, where there is one (`refuse_lens_without_inverse`)."""
        if not self.distorts:
            return seen
        undo = _undo_plumb_bob if self.model == "plumb_bob" else _undo_equidistant
        return undo(seen, self.distortion)

    def directions(self, xy) -> np.ndarray:
        """Unit viewing directions (n, 3) in the camera frame (x right, y down, z forward) of positions (n, 2)."""
        flat = self.undone(self.flat(xy))
        rays = np.column_stack([flat, np.ones(len(flat))])
        return rays / np.linalg.norm(rays, axis=1, keepdims=True)

    def all_directions(self) -> np.ndarray:
        """(height · width, 3) directions of every pixel, row by row."""
        y, x = np.mgrid[: self.height, : self.width]
        return self.directions(np.column_stack([x.ravel(), y.ravel()]))

    @property
    def border(self) -> np.ndarray:
        """(2 · (width + height), 2) positions of the outermost pixels, corners twice."""
        x, y = np.arange(self.width), np.arange(self.height)
        return np.concatenate([
            np.column_stack([x, 0 * x]), np.column_stack([x, 0 * x + self.height - 1]),
            np.column_stack([0 * y, y]), np.column_stack([0 * y + self.width - 1, y]),
        ])  # fmt: skip

    @property
    def half_angle(self) -> float:
        """Half the horizontal field of view [rad]."""
        return float(np.arctan(self.width / 2 / self.intrinsics[0, 0]))


def pinhole(width: int, height: int, horizontal_fov: float) -> Camera:
    """An ideal camera of a horizontal field of view [rad]; principal point (W/2 − 0.5, H/2 − 0.5)."""
    return pinhole_of_focal(width, height, width / 2 / np.tan(horizontal_fov / 2))


def pinhole_of_focal(width: int, height: int, focal: float) -> Camera:
    """The same of a focal length in pixels."""
    intrinsics = np.array([[focal, 0, width / 2 - 0.5], [0, focal, height / 2 - 0.5], [0, 0, 1]])
    return Camera(intrinsics, width, height, np.empty(0))


def sub_pixel_directions(camera: Camera, supersample: int) -> np.ndarray:
    """(pixels · supersample², 3) directions on a regular sub-grid of every pixel, a pixel's rays together."""
    y, x = np.mgrid[: camera.height, : camera.width]
    offset = (np.arange(supersample) + 0.5) / supersample - 0.5
    dy, dx = np.meshgrid(offset, offset, indexing="ij")
    xy = np.stack([x.reshape(-1, 1) + dx.ravel(), y.reshape(-1, 1) + dy.ravel()], axis=-1)
    return np.ascontiguousarray(camera.directions(xy.reshape(-1, 2)))


def refuse_lens_without_inverse(file: Path, key: str, camera: Camera) -> None:
    """Check that the distortion can be undone all over the picture.

    It can when every pixel of the border has a point of the plane at distance 1 that the lens puts there, and when on
    the way to that point from the middle, at angles that grow to less than 90°, what is seen moves outwards all the
    time: a lens that turns back shows other points at the same pixels, and the one found may be the wrong one.

    Args:
        file: named in errors.
        key: of the coefficients in the file, named in errors.
        camera: with the lens.

    Raises:
        InputError: there is a pixel where it cannot.
    """
    if not camera.distorts:
        return
    border = camera.border
    with np.errstate(all="ignore"):  # what overflows has no inverse
        seen = camera.flat(border)
        point = camera.undone(seen)
        off = (camera.distorted(point) - seen) @ camera.intrinsics[:2, :2].T
        angle = np.arctan(np.linalg.norm(point, axis=1))
        outwards = np.zeros(len(border))
        right = np.linalg.norm(off, axis=1) <= MOST_OFF_PIXELS
        for share in np.arange(1, WAY + 1) / WAY:
            nearer = point * (np.tan(share * angle) / np.maximum(np.tan(angle), 1e-12))[:, None]
            further = (camera.distorted(nearer) * seen).sum(axis=1)
            right &= further >= outwards
            outwards = further
    if not right.all():
        column, row = border[np.argmin(right)]
        raise InputError(
            f"{file}: {key}: the lens cannot be undone at pixel ({column}, {row}): its field of view there is no "
            "plane's"
        )


def _plumb_bob(flat: np.ndarray, coefficients: np.ndarray) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
    """Where points (n, 2) are seen, (n, 2), and its derivatives: ∂x'/∂x, ∂x'/∂y = ∂y'/∂x, ∂y'/∂y, (n,) each."""
    k1, k2, p1, p2, k3 = (*coefficients, *np.zeros(5 - len(coefficients)))
    x, y = flat.T
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    steeper = 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))  # ∂radial/∂x = x · steeper
    seen = np.column_stack([
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    ])  # fmt: skip
    return seen, (
        radial + x * x * steeper + 2 * p1 * y + 6 * p2 * x,
        x * y * steeper + 2 * p1 * x + 2 * p2 * y,
        radial + y * y * steeper + 6 * p1 * y + 2 * p2 * x,
    )


def _undo_plumb_bob(seen: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """The points (n, 2) that are seen at (n, 2), by Newton's method."""
    at = seen.copy()
    for _ in range(ITERATIONS):
        found, (xx, xy, yy) = _plumb_bob(at, coefficients)
        dx, dy = (found - seen).T
        at = at - np.column_stack([yy * dx - xy * dy, xx * dy - xy * dx]) / (xx * yy - xy * xy)[:, None]
    return at


def _equidistant(theta: np.ndarray, coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """θ_d = θ (1 + k1 θ² + … + k4 θ⁸) of angles θ (n,), and its derivative."""
    powers = np.arange(1, 5) * 2
    series = theta[:, None] ** powers * coefficients
    return theta * (1 + series.sum(axis=1)), 1 + (series * (powers + 1)).sum(axis=1)


def _undo_equidistant(seen: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """The points (n, 2) that are seen at (n, 2), by Newton's method; turned round where θ is more than 90°."""
    theta_d = np.linalg.norm(seen, axis=1)
    theta = theta_d.copy()
    for _ in range(ITERATIONS):
        found, slope = _equidistant(theta, coefficients)
        theta = theta - (found - theta_d) / slope
    return seen * np.where(theta_d > 1e-12, np.tan(theta) / np.maximum(theta_d, 1e-12), 1.0)[:, None]
