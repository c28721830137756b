"""Pictures without the distortion of their lens: posed views are pinhole images."""

from __future__ import annotations

import numpy as np

from pixelid.errors import InputError
from pixelid.nerf.data.camera import Camera

MOST_ZOOM = 4.0  # a lens that needs more to fill the picture has a field of view that no plane shows


def pinhole_of(camera: Camera) -> Camera:
    """The pinhole camera of the same size whose every pixel the lens has filled, with the least zoom.

    Raises:
        InputError: there is none below `MOST_ZOOM`.
    """
    if not camera.distorts:
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
    if not camera.distorts:
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
    at = _seen_at(camera, pinhole, pinhole.border)
    inside = (at >= -0.5) & (at <= np.array([camera.width, camera.height]) - 0.5)
    return bool(inside.all())


def _seen_at(camera: Camera, pinhole: Camera, xy: np.ndarray) -> np.ndarray:
    """Positions (n, 2) in the lens' picture of positions (n, 2) in the pinhole's."""
    moved = camera.distorted(pinhole.flat(xy))
    return (np.column_stack([moved, np.ones(len(moved))]) @ camera.intrinsics.T)[:, :2]
