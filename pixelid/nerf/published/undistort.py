"""Pictures without the distortion of their lens: posed views are pinhole images."""

from __future__ import annotations

import numpy as np

from pixelid.errors import InputError
from pixelid.nerf.camera import Camera

MOST_ZOOM = 4.0  # a lens that needs more to fill the picture has a field of view that no plane shows


def distorted(camera: Camera, flat: np.ndarray) -> np.ndarray:
    """Where a lens puts points of the plane at distance 1: (n, 2) → (n, 2); the inverse of `Camera.directions`."""
    if not np.any(camera.distortion != 0):
        return flat
    x, y = flat.T
    if camera.model == "equidistant":
        r = np.hypot(x, y)
        theta = np.arctan(r)
        series = 1 + sum(k * theta ** (2 * power) for power, k in enumerate(camera.distortion, start=1))
        return flat * np.where(r > 1e-12, theta * series / np.maximum(r, 1e-12), 1.0)[:, None]
    k1, k2, p1, p2, k3 = (*camera.distortion, *np.zeros(5 - len(camera.distortion)))
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return np.column_stack([
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    ])  # fmt: skip


def pinhole_of(camera: Camera) -> Camera:
    """The pinhole camera of the same size whose every pixel the lens has filled, with the least zoom.

    Raises:
        InputError: there is none below `MOST_ZOOM`.
    """
    if not np.any(camera.distortion != 0):
        return camera
    low, high = 1.0, MOST_ZOOM
    if not _filled(camera, _zoomed(camera, high)):
        raise InputError(
            f"distortion {camera.distortion.tolist()}: no pinhole view fits; leave the pictures out: --views 0"
        )
    if _filled(camera, _zoomed(camera, low)):
        return _zoomed(camera, low)
    for _ in range(20):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if _filled(camera, _zoomed(camera, middle)) else (middle, high)
    return _zoomed(camera, high)


def undistorted(image: np.ndarray, camera: Camera, pinhole: Camera) -> np.ndarray:
    """A picture (H, W) or (H, W, channels) as the pinhole camera would have taken it; bilinear, of the same type."""
    if not np.any(camera.distortion != 0):
        return image
    from scipy.ndimage import map_coordinates

    y, x = np.mgrid[: pinhole.height, : pinhole.width]
    at = _seen_at(camera, pinhole, np.column_stack([x.ravel(), y.ravel()]))[:, ::-1].T
    layers = np.atleast_3d(image).astype(np.float32)
    out = np.stack([map_coordinates(layers[..., k], at, order=1, mode="nearest") for k in range(layers.shape[2])], -1)
    out = out.reshape(pinhole.height, pinhole.width, -1)
    out = np.rint(out).astype(image.dtype) if image.dtype.kind in "ui" else out.astype(image.dtype)
    return out[..., 0] if image.ndim == 2 else out


def _zoomed(camera: Camera, zoom: float) -> Camera:
    intrinsics = camera.intrinsics.copy()
    intrinsics[[0, 1], [0, 1]] *= zoom
    return Camera(intrinsics, camera.width, camera.height, np.empty(0))


def _filled(camera: Camera, pinhole: Camera) -> bool:
    """Whether the border of the pinhole's picture is inside the lens' picture."""
    x, y = np.arange(pinhole.width), np.arange(pinhole.height)
    border = np.concatenate([
        np.column_stack([x, 0 * x]), np.column_stack([x, 0 * x + pinhole.height - 1]),
        np.column_stack([0 * y, y]), np.column_stack([0 * y + pinhole.width - 1, y]),
    ])  # fmt: skip
    at = _seen_at(camera, pinhole, border)
    inside = (at >= -0.5) & (at <= np.array([camera.width, camera.height]) - 0.5)
    return bool(inside.all())


def _seen_at(camera: Camera, pinhole: Camera, xy: np.ndarray) -> np.ndarray:
    """Positions (n, 2) in the lens' picture of positions (n, 2) in the pinhole's."""
    flat = np.column_stack([xy, np.ones(len(xy))]) @ np.linalg.inv(pinhole.intrinsics).T
    moved = distorted(camera, flat[:, :2] / flat[:, 2:])
    return (np.column_stack([moved, np.ones(len(moved))]) @ camera.intrinsics.T)[:, :2]
