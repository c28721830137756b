"""Where to look from: around the scene, or the poses of a file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from pixelid.errors import InputError
from pixelid.nerf.data.arrays import finite, read_arrays, unit_quaternions
from pixelid.nerf.data.calibration import read_calibration
from pixelid.nerf.data.camera import Camera, pinhole
from pixelid.nerf.data.colmap import colmap_images, read_transforms
from pixelid.nerf.data.dataset import CALIBRATION, POSES
from pixelid.nerf.data.scenes import FIELD_OF_VIEW, looking_at_centre, on_sphere
from pixelid.nerf.data.view_cameras import camera_of_document, stated_size, states_camera
from pixelid.nerf.data.views import (
    FOLDER,
    OPENGL,
    STAGES,
    frames_of,
    image_of,
    picture_of,
    pose_of_frame,
    views_folder,
)

DEFAULT_SIZE = 400, 400
ORBIT_ELEVATION, SPIRAL_ELEVATIONS = 0.4, (0.0, 0.9)  # rad; a spiral goes from the one to the other in two turns


class Listed(NamedTuple):
    """Where poses are listed next to their pictures: a `transforms_*.json`, which of its frames, of which data set."""

    file: Path
    which: list[int]
    dataset: Path | None


@dataclass(frozen=True)
class Way:
    """Cameras one after the other.

    position: (n, 3), rotation: (n, 3, 3) camera to world (x right, y down, z forward);  camera: of them all;  names: n;
    left_out: how many poses of a file are not among them;  listed: the file that may name their pictures
    """

    position: np.ndarray
    rotation: np.ndarray
    camera: Camera
    names: tuple[str, ...]
    left_out: int = 0
    listed: Listed | None = None

    def __len__(self) -> int:
        return len(self.position)


def around(
    low: ArrayLike, high: ArrayLike, kind: str, frames: int, size: tuple[int, int], *, fov: float = FIELD_OF_VIEW,
    up: ArrayLike = (0.0, 0.0, 1.0), distance: float | None = None,
) -> Way:  # fmt: skip
    """A way around the scene that looks at its centre.

    Args:
        low: (3,) corner of its box.
        high: (3,) corner of its box.
        kind: "orbit", one turn at one elevation, or "spiral", two turns that rise.
        frames: on the way.
        size: width and height in pixels.
        fov: horizontal field of view, rad.
        up: (3,) what is up in the scene.
        distance: of the camera from the centre; by default so that the box' middle fills the view.

    Returns:
        The way; its last frame is one step before the first, so that an orbit plays in a loop.

    Raises:
        InputError: a direction of no length.
    """
    low, high, up = np.asarray(low, float), np.asarray(high, float), np.asarray(up, float)
    if not np.linalg.norm(up) > 0:
        raise InputError(f"--up: expected a direction, found {up.tolist()}")
    centre, camera = 0.5 * (low + high), pinhole(*size, fov)
    away = 0.5 * float((high - low).max()) / np.tan(fov / 2) if distance is None else distance
    share = np.arange(frames) / frames
    spiral_turns = 2.0
    turns, (first, last) = (1.0, (ORBIT_ELEVATION,) * 2) if kind == "orbit" else (spiral_turns, SPIRAL_ELEVATIONS)
    azimuth, elevation = 2 * np.pi * turns * share, first + (last - first) * share
    upright = _upright(up / np.linalg.norm(up))
    seen_from = on_sphere(azimuth, elevation, away)
    rotation = upright @ looking_at_centre(seen_from)
    names = tuple(f"{kind}_{k:04d}" for k in range(frames))
    return Way(centre + seen_from @ upright.T, rotation, camera, names)


def way_of_file(path: Path, size: tuple[int, int] | None, fov: float | None = None, most: int = 10_000) -> Way:
    """The poses of a file, in its order.

    Args:
        path: a `transforms_*.json`, a dataset folder (its test views, else val, else train), a `camera_poses.npz`, or
            COLMAP's `images.txt` or `images.bin` or their folder.
        size: width and height in pixels, of the whole view; by default those of the first picture, of the event sensor
            where poses lie next to its calibration, or 400 × 400.
        fov: horizontal field of view [rad] where no camera is stated; by default `FIELD_OF_VIEW`.
        most: poses; more are thinned out evenly.

    Returns:
        The way.

    Raises:
        InputError: naming what the file lacks; a field of view with a camera that is stated.
    """
    dataset = path if path.is_dir() else None
    path = path if dataset is None else _inside(dataset)
    if not path.is_file():
        known = f"transforms_*.json, a dataset folder, {POSES}, or COLMAP's images.txt or images.bin"
        raise InputError(f"{path}: no such file; expected {known}")
    if path.suffix == ".npz":
        arrays = read_arrays(path, ("T_wc_position", "T_wc_orientation"))
        position = finite(path, "T_wc_position", arrays["T_wc_position"])
        turned = unit_quaternions(path, "T_wc_orientation", arrays["T_wc_orientation"])
        if position.shape != (len(turned), 3) or not len(turned):
            raise InputError(f"{path}: T_wc_position, T_wc_orientation: expected (n, 3) and (n, 4)")
        some = _thinned(len(position), most)
        rotation = Rotation.from_quat(turned[some]).as_matrix()
        names = tuple(f"pose_{k:05d}" for k in some)
        return Way(position[some], rotation, _camera_beside(path, size, fov), names, len(position) - len(some))
    document = read_transforms(path)
    frames = frames_of(path, document)
    some = _thinned(len(frames), most)
    poses = np.array([pose_of_frame(path, k, frames[k]) for k in some])
    names = tuple(f"{k:04d}_{Path(str(frames[k]['file_path'])).name}" for k in some)
    camera = _stated_camera(path, document, str(frames[0]["file_path"]), size, fov)
    listed = Listed(path, some, dataset)
    return Way(poses[:, :3, 3], poses[:, :3, :3] @ OPENGL, camera, names, len(frames) - len(some), listed)


def _inside(folder: Path) -> Path:
    views = views_folder(folder)
    for stage in reversed(STAGES):
        if views is not None and (views / f"transforms_{stage}.json").is_file():
            return views / f"transforms_{stage}.json"
    if (folder / POSES).is_file():
        return folder / POSES
    if (images := colmap_images(folder)) is not None:
        return images
    raise InputError(f"{folder}: neither {FOLDER}/ nor {POSES} nor COLMAP's images.txt there; expected a dataset")


def _thinned(number: int, most: int) -> list[int]:
    """At most so many of `number` indices, evenly."""
    return np.unique(np.linspace(0, number - 1, min(number, most)).round().astype(int)).tolist()


def _camera_beside(poses: Path, size: tuple[int, int] | None, fov: float | None) -> Camera:
    """The event camera whose calibration lies next to its poses, in `size` pixels; an ideal one where there is none."""
    file = poses.with_name(CALIBRATION)
    if not file.is_file():
        return pinhole(*(size or DEFAULT_SIZE), fov or FIELD_OF_VIEW)
    _refuse_angle(file, fov)
    camera = read_calibration(poses.parent).camera
    return camera if size is None else camera.resized(*size)


def _refuse_angle(file: Path, fov: float | None) -> None:
    if fov is not None:
        raise InputError(f"--fov: {file} says already what the camera sees; leave one of them out")


def _stated_camera(
    path: Path, document: dict, picture: str, size: tuple[int, int] | None, fov: float | None
) -> Camera:  # fmt: skip
    """The camera that a document states, in `size` pixels; an ideal one where it states none."""
    own = _shape(path, picture)
    shape = size or own or stated_size(document) or DEFAULT_SIZE
    if not states_camera(document):
        return pinhole(*shape, fov or FIELD_OF_VIEW)
    _refuse_angle(path, fov)
    if "camera_angle_x" in document and "fl_x" not in document:
        return camera_of_document(path, document, *shape)
    own = own or stated_size(document)
    if own is None:  # intrinsics are of pictures of one size
        raise InputError(f"{path}: intrinsics: {picture} is not there, whose size says what they are in units of")
    return camera_of_document(path, document, *own).resized(*shape)


def _shape(path: Path, name: str) -> tuple[int, int] | None:
    """Width and height of a view's picture, None where it is not there."""
    try:
        height, width = image_of(picture_of(path, name)).shape[:2]
    except InputError:
        return None
    return width, height


def _upright(up: np.ndarray) -> np.ndarray:
    """(3, 3) the least rotation whose third column is `up`; the identity for z."""
    axis = np.cross([0.0, 0.0, 1.0], up)
    if np.linalg.norm(axis) < 1e-9:  # along z, or against it
        return np.eye(3) if up[2] > 0 else np.diag([1.0, -1.0, -1.0])
    return Rotation.from_rotvec(axis / np.linalg.norm(axis) * np.arccos(np.clip(up[2], -1, 1))).as_matrix()
