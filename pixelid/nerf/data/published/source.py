"""What a published sequence holds, whatever its files look like: camera, poses, events in blocks, pictures.

Times are whole nanoseconds on one clock of the sequence's own.  Cameras look as in computer vision (x right, y down,
z forward), pixel centres are at integer coordinates.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from pixelid.documents import read_text
from pixelid.errors import InputError, first_line
from pixelid.nerf.data.arrays import intrinsics_of, of_unit_length
from pixelid.nerf.data.camera import DISTORTIONS, Camera, refuse_lens_without_inverse
from pixelid.nerf.data.dataset import MOST_AWAY, MOST_NS
from pixelid.recordings.events import MOST_PIXELS, MOST_SIDE


class Block(NamedTuple):
    """Some events, (n,) each.  t: int64 ns;  x, y: integers;  on: bool."""

    t: np.ndarray
    x: np.ndarray
    y: np.ndarray
    on: np.ndarray


class Poses(NamedTuple):
    """Camera to world.  t: (K,) int64 ns, increasing;  position: (K, 3);  orientation: (K, 4) unit x, y, z, w."""

    t: np.ndarray
    position: np.ndarray
    orientation: np.ndarray


@dataclass(frozen=True)
class Pictures:
    """Frames of a camera that moves with the event sensor.

    t: (n,) int64 ns;  names: n;  exposure: (n,) exposure × gain up to a factor;  camera: that took them;
    pose: (4, 4) from its frame to the event sensor's;  read: indices in increasing order → the pictures in that order;
    notes: what was assumed of them
    """

    t: np.ndarray
    names: tuple[str, ...]
    exposure: np.ndarray
    camera: Camera
    pose: np.ndarray
    read: Callable[[np.ndarray], Iterator[np.ndarray]]
    notes: tuple[str, ...] = ()


def equal_exposures(file: Path, why: str) -> tuple[str, ...]:
    """The note of `Pictures` whose exposures are not known, of the file that should state them."""
    return (f"exposures of the views are taken as equal ({file.name}: {why})",)


@dataclass(frozen=True)
class Source:
    """A published sequence.

    layout: its name;  camera: the event sensor;  events: (from ns, to ns) → blocks that hold all events of that time,
    and perhaps others;  pixel: keys of `camera_calibration.npz` that are known;  views: a folder of posed views that
    come with the sequence;  renderer: content of `renderer_params.npz`;  notes: what was assumed;  files: read
    """

    layout: str
    camera: Camera
    poses: Poses
    events: Callable[[int, int], Iterator[Block]]
    pictures: Pictures | None
    pixel: Mapping[str, Any]
    views: Path | None
    renderer: Mapping[str, Any] | None
    notes: tuple[str, ...]
    files: tuple[Path, ...]


def poses_of(file: Path, t: np.ndarray, position: np.ndarray, orientation: np.ndarray) -> Poses:
    """Checked poses, in order of time and each time once.

    Args:
        file: named in errors.
        t: (K,) int64 ns.
        position: (K, 3).
        orientation: (K, 4) quaternions x, y, z, w.

    Returns:
        The poses.

    Raises:
        InputError: fewer than two poses, numbers that are not finite, or quaternions far from unit length.
    """
    t, first = np.unique(t, return_index=True)
    position, orientation = position[first], orientation[first]
    if len(t) < 2:
        raise InputError(f"{file}: expected at least two poses, found {len(t)}")
    if not (np.isfinite(position).all() and np.isfinite(orientation).all()):
        raise InputError(f"{file}: a pose is NaN or infinite")
    if np.abs(position).max() > MOST_AWAY:
        away = f"{np.abs(position).max():.3g}"
        raise InputError(f"{file}: expected poses at most {MOST_AWAY:g} from the origin, found one at {away}")
    return Poses(t, position, of_unit_length(str(file), orientation))


def matrices(position: np.ndarray, orientation: np.ndarray) -> np.ndarray:
    """(K, 4, 4) of positions (K, 3) and quaternions (K, 4) x, y, z, w."""
    out = np.tile(np.eye(4), (len(position), 1, 1))
    out[:, :3, :3], out[:, :3, 3] = Rotation.from_quat(orientation).as_matrix(), position
    return out


def camera_of(file: Path, focal, centre, size, distortion, model: str) -> Camera:
    """A camera from the numbers of a calibration file.

    Args:
        file: named in errors.
        focal: (2,) pixels.
        centre: (2,) pixels.
        size: width and height.
        distortion: coefficients of the lens.
        model: one of `DISTORTIONS`, or any where no coefficient differs from 0.

    Returns:
        The camera.

    Raises:
        InputError: a model that is not known, numbers that make no camera, or a lens that cannot be undone.
    """
    try:
        numbers = np.array([*focal, *centre, *size], dtype=np.float64)
        distortion = np.array(distortion, dtype=np.float64).ravel()
    except (TypeError, ValueError):
        raise InputError(f"{file}: intrinsics, resolution, distortion_coeffs: expected numbers") from None
    if len(numbers) != 6 or not np.isfinite(numbers).all() or not (numbers[[0, 1, 4, 5]] > 0).all():
        raise InputError(f"{file}: intrinsics, resolution: expected fx, fy, cx, cy and width, height")
    width, height = numbers[4:]
    if min(width, height) < 1 or max(width, height) > MOST_SIDE or width * height > MOST_PIXELS:
        raise InputError(
            f"{file}: resolution: expected sides of 1 to {MOST_SIDE}, together {MOST_PIXELS} pixels, found "
            f"{width:g} × {height:g}"
        )
    while len(distortion) and distortion[-1] == 0 and len(distortion) > 4:
        distortion = distortion[:-1]
    allowed = {"plumb_bob": (4, 5), "equidistant": (4,)}
    if np.any(distortion != 0):
        if model not in DISTORTIONS:
            raise InputError(f"{file}: distortion model {model!r}: expected one of {', '.join(DISTORTIONS)}")
        if len(distortion) not in allowed[model] or not np.isfinite(distortion).all():
            raise InputError(f"{file}: {model}: expected {allowed[model][0]} coefficients, found {len(distortion)}")
    else:
        distortion, model = np.empty(0), "plumb_bob"
    intrinsics = intrinsics_of(file, [[numbers[0], 0, numbers[2]], [0, numbers[1], numbers[3]], [0, 0, 1]])
    camera = Camera(intrinsics, round(width), round(height), distortion, model)
    refuse_lens_without_inverse(file, "distortion_coeffs", camera)
    return camera


def nanoseconds(file: Path, times: np.ndarray, each: float) -> np.ndarray:
    """(K,) int64 ns of times (K,) that count `each` nanoseconds.

    Raises:
        InputError: one is NaN, infinite, or does not fit.
    """
    whole = np.rint(times * each)
    wrong = ~(np.abs(whole) <= MOST_NS)
    if wrong.any():
        k = int(np.argmax(wrong))
        raise InputError(f"{file}: time {k + 1}: expected one that fits 64 bits in nanoseconds, found {times[k]:g}")
    return whole.astype(np.int64)


def read_table(file: Path, columns: int) -> np.ndarray:
    """(n, columns at least) numbers of a text file; lines that begin with # are comments.

    Raises:
        InputError: it is missing, or a line has other than numbers or too few of them.
    """
    text = read_text(file, "CSV").replace(",", " ")
    try:
        table = np.loadtxt(io.StringIO(text), dtype=np.float64, comments="#", ndmin=2)
    except ValueError as error:
        raise InputError(f"{file}: expected lines of numbers ({first_line(error)[:100]})") from None
    if table.size and table.shape[1] < columns:
        raise InputError(f"{file}: expected {columns} numbers a line, found {table.shape[1]}")
    return table


def found(folder: Path, *patterns: str) -> Path | None:
    """The file that matches the first pattern that any does: in the folder, one or two levels below it, then in its
    parent.

    Raises:
        InputError: several match, and their names do not say which belongs to the folder.
    """
    for pattern in patterns:
        for where in (pattern, f"*/{pattern}", f"*/*/{pattern}"):
            if matches := sorted(folder.glob(where)):
                return _only(folder, pattern, matches)
    for pattern in patterns:
        if matches := sorted(folder.resolve().parent.glob(pattern)):
            sequence = folder.resolve().name.removesuffix("-vi_gt_data")
            return _only(folder, pattern, [m for m in matches if m.name.startswith(sequence)] or matches)
    return None


def _only(folder: Path, pattern: str, matches: list[Path]) -> Path:
    if len(matches) > 1:
        names = ", ".join(f"{path.parent.name}/{path.name}" for path in matches[:3])
        raise InputError(f"{folder}: {pattern}: expected one such file, found {names}; give the folder of one sequence")
    return matches[0]


def wanted(folder: Path, *patterns: str) -> Path:
    """As `found`.

    Raises:
        InputError: naming what was looked for.
    """
    path = found(folder, *patterns)
    if path is None:
        raise InputError(f"{folder}: {' or '.join(patterns)}: no such file there, two levels below, or in its parent")
    return path
