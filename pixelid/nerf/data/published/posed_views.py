"""`views/` of a converted dataset: pictures of the sequence with their poses, or the posed views that came with it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np

from pixelid.documents import read_json
from pixelid.errors import InputError
from pixelid.nerf.data.camera import Camera
from pixelid.nerf.data.published.source import Pictures
from pixelid.nerf.data.published.window import Window
from pixelid.nerf.data.views import FOLDER, OPENGL, STAGES, picture_of

SPLIT = ("val", "test")  # every other picture each: one set fixes the correction, the other is scored


def write_pictures(folder: Path, pictures: Pictures, window: Window, most: int) -> dict[str, int]:
    """Write pictures as posed views, spread evenly over the time kept.

    Args:
        folder: of the dataset.
        pictures: of the sequence.
        window: the part kept; poses are interpolated at the pictures' times.
        most: pictures.

    Returns:
        Stage → how many; nothing where fewer than two pictures fall into the time kept.

    Raises:
        InputError: for a single picture: one corrects, another is scored.
    """
    if most < 2:
        raise InputError(f"--views {most}: expected 0, or 2 at least: some correct, the others are scored")
    inside = np.flatnonzero((pictures.t >= window.begin) & (pictures.t <= window.end))
    if len(inside) < 2:
        return {}
    chosen = inside[np.unique(np.linspace(0, len(inside) - 1, min(most, len(inside))).round().astype(int))]
    position, rotation = window.trajectory.at((pictures.t[chosen] - window.begin) * 1e-9)
    world = np.tile(np.eye(4), (len(chosen), 1, 1))
    world[:, :3, :3], world[:, :3, 3] = rotation, position
    world = world @ pictures.pose
    world[:, :3, :3] = world[:, :3, :3] @ OPENGL
    pinhole = pinhole_of(pictures.camera)
    frames: dict[str, list[dict]] = {stage: [] for stage in SPLIT}
    for stage in SPLIT:
        (folder / FOLDER / stage).mkdir(parents=True)
    for n, (k, image) in enumerate(zip(chosen, pictures.read(chosen), strict=True)):
        stage = SPLIT[n % 2]
        _save(
            folder / FOLDER / stage / f"{pictures.names[k]}.png",
            undistorted(_checked(image, pictures), pictures.camera, pinhole),
        )
        frames[stage].append({
            "file_path": f"./{stage}/{pictures.names[k]}", "exposure_time": float(pictures.exposure[k]),
            "transform_matrix": world[n].tolist(),
        })  # fmt: skip
    for stage in SPLIT:
        document = {"intrinsics": pinhole.intrinsics.tolist(), "frames": frames[stage]}
        (folder / FOLDER / f"transforms_{stage}.json").write_text(json.dumps(document, indent=1))
    return {stage: len(frames[stage]) for stage in SPLIT}


def copy_views(source: Path, folder: Path) -> dict[str, int]:
    """Copy a folder of posed views: its transforms and the pictures that they list.

    Args:
        source: the folder `views/` of the sequence.
        folder: of the dataset.

    Returns:
        Stage → how many.

    Raises:
        InputError: no transforms there, or a picture that is missing.
    """
    number = {}
    for stage in STAGES:
        file = source / f"transforms_{stage}.json"
        if not file.is_file():
            continue
        frames = read_json(file).get("frames")
        if not isinstance(frames, list) or not all(
            isinstance(frame, dict) and "file_path" in frame for frame in frames
        ):
            raise InputError(f"{file}: frames: expected a list of views with a file_path")
        target = folder / FOLDER
        target.mkdir(exist_ok=True)
        shutil.copyfile(file, target / file.name)
        for frame in frames:
            picture = picture_of(file, str(frame["file_path"]))
            copy = (target / str(frame["file_path"])).with_name(picture.name)
            if target.resolve() not in copy.resolve().parents:
                raise InputError(f"{file}: file_path: expected a picture inside {source}, found {frame['file_path']}")
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(picture, copy)
        number[stage] = len(frames)
    if not number:
        raise InputError(f"{source}: transforms_test.json: missing; --views 0 leaves the views out")
    return number


def _checked(image: np.ndarray, pictures: Pictures) -> np.ndarray:
    size = (pictures.camera.height, pictures.camera.width)
    if image.shape[:2] != size:
        raise InputError(
            f"{pictures.names[0]} …: pictures of {image.shape[1]} × {image.shape[0]} pixels, but the calibration says "
            f"{size[1]} × {size[0]}"
        )
    return image


def _save(path: Path, image: np.ndarray) -> None:
    from skimage.io import imsave

    imsave(path, image, check_contrast=False)


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
