"""TUM-VIE (Klenk et al., IROS 2021): two Prophesee Gen 4 sensors next to two cameras, under motion capture.

NAME-events_left.h5         events/{x, y, t, p}, t in µs; compressed by Blosc
mocap_data.txt              lines of t (µs), x, y, z, qx, qy, qz, qw of the marker, in NAME-vi_gt_data/
camera-calibration*.json    Basalt's: two cameras, then two sensors (Kannala–Brandt), `T_imu_cam` of each
mocap-imu-calibration*.json `T_imu_marker`
left_images/                image_timestamps_left.txt (µs), image_exposures_left.txt, 00000.jpg, …
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from pixelid.documents import read_json
from pixelid.errors import InputError
from pixelid.nerf.data.arrays import MOST_OFF
from pixelid.nerf.data.camera import Camera
from pixelid.nerf.data.published.hdf5_events import events_of
from pixelid.nerf.data.published.source import (
    Pictures,
    Source,
    camera_of,
    equal_exposures,
    found,
    matrices,
    nanoseconds,
    poses_of,
    read_table,
    wanted,
)
from pixelid.recordings.pictures import read_picture

SIDES = {"left": (0, 2), "right": (1, 3)}  # camera and sensor in the calibration
RIG_A = ("loop-floor", "mocap-desk", "skate-easy")  # sequences of the first calibration, the others are of the second
# As Low & Lee (2023) estimate from the sequences; the threshold itself is assumed: events leave a factor open.
OFF_THRESHOLD, RATIO, DEAD_TIME_NS = 0.25, 1.458, 1375.0
SETTLING = 80  # pictures at the beginning while the exposure control settles: 4 s, which Low & Lee leave out as well
NOTES = (
    f"thresholds are assumed: OFF {OFF_THRESHOLD}, ON {RATIO} times that (Low & Lee 2023)",
    "the circuit is not published",
)


def read(path: Path, camera: str = "left") -> Source:
    """A sequence of TUM-VIE.

    Args:
        path: its folder; calibrations may lie in it, below it or next to it.
        camera: "left" or "right".

    Returns:
        The sequence.

    Raises:
        InputError: naming the file that is missing or wrong.
    """
    side = camera or "left"
    if side not in SIDES:
        raise InputError(f"--camera: expected left or right, found {side!r}")
    if not path.is_dir():
        raise InputError(f"{path}: expected the folder of a sequence with *events_{side}.h5 and mocap_data.txt")
    events, mocap = wanted(path, f"*events_{side}.h5", f"events_{side}/*.h5"), wanted(path, "mocap_data.txt")
    rig = _rig(events, f"events_{side}")
    cameras = wanted(path, f"camera-calibration{rig}.json", "camera-calibration*.json", "calibration*.json")
    marker = wanted(path, f"mocap-imu-calibration{rig}.json", "mocap-imu-calibration*.json")
    content, frame, sensor = _content(cameras), *SIDES[side]
    from_sensor = np.linalg.inv(_transform(_content(marker).get("T_imu_marker"), marker, "T_imu_marker"))
    in_imu = _of_camera(content, sensor, cameras)
    table = read_table(mocap, 8)
    t = nanoseconds(mocap, table[:, 0], 1e3)
    markers = poses_of(mocap, t, table[:, 1:4], table[:, 4:8])
    world = matrices(markers.position, markers.orientation) @ from_sensor @ in_imu
    poses = poses_of(mocap, markers.t, world[:, :3, 3], Rotation.from_matrix(world[:, :3, :3]).as_quat())
    pictures = _pictures(path, side, _camera(content, frame, cameras), np.linalg.inv(in_imu) @ _of_camera(
        content, frame, cameras
    ))  # fmt: skip
    pixel = {
        "pos_contrast_threshold": RATIO * OFF_THRESHOLD,
        "neg_contrast_threshold": OFF_THRESHOLD,
        "refractory_period": DEAD_TIME_NS,
    }
    return Source(
        "tumvie", _camera(content, sensor, cameras), poses, events_of(events), pictures, pixel, None, None, NOTES,
        (events, mocap, cameras, marker),
    )  # fmt: skip


def _rig(events: Path, ending: str) -> str:
    """Which calibration, A or B: by the file's name or, where that says the side alone, its folder's.

    events: NAME-events_left.h5, NAME/events_left.h5 or NAME/events_left/….h5;  ending: "events_left"
    """
    place = Path(os.path.abspath(events))  # where it is named, whatever links lead to
    names = (place.stem if place.stem.endswith(ending) else "", *(folder.name for folder in place.parents))
    sequence = next((name for name in names if name not in ("", ending)), "")
    return "A" if any(name in sequence for name in RIG_A) else "B"


def _content(file: Path) -> Mapping[str, Any]:
    """A file of Basalt, with or without the name that its library puts around everything."""
    document = read_json(file)
    inside = document.get("value0", document)
    if not isinstance(inside, dict):
        raise InputError(f"{file}: value0: expected an object")
    return inside


def _transform(entry: Any, file: Path, key: str) -> np.ndarray:
    """(4, 4) of px, py, pz, qx, qy, qz, qw."""
    try:
        numbers = np.array([[float(entry[name]) for name in ("px", "py", "pz", "qx", "qy", "qz", "qw")]])
    except (TypeError, KeyError, ValueError):
        raise InputError(f"{file}: {key}: expected px, py, pz, qx, qy, qz, qw") from None
    if not np.isfinite(numbers).all() or abs(np.linalg.norm(numbers[0, 3:]) - 1) > MOST_OFF:
        raise InputError(f"{file}: {key}: expected finite numbers and a unit quaternion")
    return matrices(numbers[:, :3], numbers[:, 3:])[0]


def _of_camera(content: Mapping[str, Any], index: int, file: Path) -> np.ndarray:
    entries = content.get("T_imu_cam")
    if not isinstance(entries, list) or len(entries) <= index:
        raise InputError(f"{file}: T_imu_cam: expected an entry {index}")
    return _transform(entries[index], file, f"T_imu_cam[{index}]")


def _camera(content: Mapping[str, Any], index: int, file: Path) -> Camera:
    try:
        entry, size = content["intrinsics"][index], content["resolution"][index]
        kind, numbers = entry["camera_type"], entry["intrinsics"]
        if kind != "kb4":
            raise InputError(f"{file}: intrinsics[{index}].camera_type: expected kb4, found {kind!r}")
        focal, centre = (numbers["fx"], numbers["fy"]), (numbers["cx"], numbers["cy"])
        lens = [numbers[f"k{k}"] for k in (1, 2, 3, 4)]
    except (KeyError, IndexError, TypeError):
        raise InputError(f"{file}: intrinsics[{index}], resolution[{index}]: expected a camera of type kb4") from None
    return camera_of(file, focal, centre, size, lens, "equidistant")


def _pictures(path: Path, side: str, camera: Camera, pose: np.ndarray) -> Pictures | None:
    """The frames of the camera next to the sensor, where they are there."""
    stamps = found(path, f"image_timestamps_{side}.txt")
    if stamps is None:
        return None
    files = sorted(stamps.parent.glob("*.jpg")) or sorted(stamps.parent.glob("*.png"))
    if not files:
        files = [file for ending in ("jpg", "png") for file in sorted(path.glob(f"**/images_{side}/*.{ending}"))]
    t = nanoseconds(stamps, read_table(stamps, 1)[:, -1], 1e3)
    if len(files) != len(t):
        raise InputError(f"{stamps}: expected a time for each of {len(files)} pictures, found {len(t)}")
    kept = slice(SETTLING if len(t) > 2 * SETTLING else 0, None)
    exposure, notes = _exposure(stamps.with_name(f"image_exposures_{side}.txt"), len(t), kept)
    files, t = files[kept], t[kept]

    def read_some(which: np.ndarray) -> Iterator[np.ndarray]:
        return (read_picture(files[k]) for k in which)

    return Pictures(t, tuple(file.stem for file in files), exposure, camera, pose, read_some, notes)


def _exposure(file: Path, pictures: int, kept: slice) -> tuple[np.ndarray, tuple[str, ...]]:
    """Those of the pictures that are kept, 1 where they are not known, which is then said."""
    exposure = read_table(file, 1)[:, -1] if file.is_file() else np.empty(0)
    if not file.is_file():
        why = "no such file"
    elif len(exposure) != pictures:
        why = f"{len(exposure)} of them for {pictures} pictures"
    elif not (np.isfinite(exposure[kept]) & (exposure[kept] > 0)).all():
        why = "one is not a positive number"
    else:
        return exposure[kept], ()
    return np.ones(pictures)[kept], equal_exposures(file, why)
