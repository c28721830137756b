"""Cameras and poses of COLMAP, as text or binary (`cameras.*` and `images.*` of one folder), as a transforms document.

A pose of COLMAP maps the world to the camera (x right, y down, z forward); a document holds its inverse with OpenGL's
axes.  Pixel centres are at half coordinates in both (colmap.github.io/format.html, `src/colmap/sensor/models.h`).
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from pixelid.documents import interpreting, read_json
from pixelid.errors import InputError, shown

IMAGES, CAMERAS = ("images.bin", "images.txt"), "cameras"
MODELS = {  # by COLMAP's number: name, parameters
    0: ("SIMPLE_PINHOLE", "f cx cy"), 1: ("PINHOLE", "fl_x fl_y cx cy"), 2: ("SIMPLE_RADIAL", "f cx cy k1"),
    3: ("RADIAL", "f cx cy k1 k2"), 4: ("OPENCV", "fl_x fl_y cx cy k1 k2 p1 p2"),
    5: ("OPENCV_FISHEYE", "fl_x fl_y cx cy k1 k2 k3 k4"),
    6: ("FULL_OPENCV", "fl_x fl_y cx cy k1 k2 p1 p2 k3 k4 k5 k6"), 7: ("FOV", "fl_x fl_y cx cy omega"),
    8: ("SIMPLE_RADIAL_FISHEYE", "f cx cy k1"), 9: ("RADIAL_FISHEYE", "f cx cy k1 k2"),
    10: ("THIN_PRISM_FISHEYE", "fl_x fl_y cx cy k1 k2 p1 p2 k3 k4 s1 s2"),
}  # fmt: skip
PLACES = (".", "sparse/0", "sparse", "colmap/sparse/0", "dense/sparse")
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
MOST_BYTES, MOST_NAME = 1 << 30, 200


def colmap_images(folder: Path) -> Path | None:
    """The file of poses in a folder of COLMAP's, None where there is none."""
    places = (folder / place / name for place in PLACES for name in IMAGES)
    return next((file for file in places if file.is_file()), None)


def read_transforms(file: Path) -> dict[str, Any]:
    """What a `transforms_*.json` holds, or COLMAP's files in the same form.

    Raises:
        InputError: it is missing, damaged, or of a camera that is not known.
    """
    return colmap_document(file) if file.name in IMAGES else read_json(file)


def colmap_document(images: Path) -> dict[str, Any]:
    """COLMAP's `images.txt` or `images.bin`, and the cameras next to it, as a `transforms_*.json` states them."""
    named = [images.with_name(CAMERAS + suffix) for suffix in (images.suffix, ".txt", ".bin")]
    file = next((file for file in named if file.is_file()), None)
    if file is None:
        raise InputError(f"{images}: expected {CAMERAS}{images.suffix} next to it, found none")
    cameras = dict(_entries(file, "cameras", _cameras))
    poses = _entries(images, "images", _poses)
    frames = []
    for number, quaternion, translation, name in poses:
        if number not in cameras:
            raise InputError(f"{images}: {shown(name, 60)}: camera {number} is not in {file.name}")
        with interpreting(images, "rotations"):
            rotation = Rotation.from_quat([*quaternion[1:], quaternion[0]]).as_matrix()
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation.T, -rotation.T @ np.array(translation)
        matrix = (pose @ OPENGL).tolist()
        frames.append({**cameras[number], "file_path": _picture(images, name), "transform_matrix": matrix})
    return {"frames": frames}


def _entries(file: Path, kind: str, read: Callable[[bytes, bool], Iterator[Any]]) -> list[Any]:
    """What a file of COLMAP's lists.  Raises InputError for a damaged one."""
    try:
        with interpreting(file, f"COLMAP's {kind}"):
            return list(read(_content(file), file.suffix == ".bin"))
    except struct.error:
        raise InputError(f"{file}: expected COLMAP's {kind}, found a file that is cut short") from None


def _content(file: Path) -> bytes:
    if file.stat().st_size > MOST_BYTES:
        raise InputError(f"{file}: expected at most {MOST_BYTES >> 30} GiB, found {file.stat().st_size} bytes")
    return file.read_bytes()


def _picture(images: Path, name: str) -> str:
    """An image's name as a path from the folder of the poses: pictures lie in `images/` of a folder above."""
    above = (images.parent, *images.resolve().parents[1:4])
    places = (folder / inside / name for folder in above for inside in ("images", "."))
    found = next((place for place in places if place.is_file()), None)
    return name if found is None else os.path.relpath(found, images.parent)


def _camera(model: str, width: int, height: int, values: list[float]) -> dict[str, Any]:
    names = next((words.split() for known, words in MODELS.values() if known == model), None)
    if names is None or len(names) != len(values):
        raise ValueError(f"camera model {shown(model, 30)} of {len(values)} parameters")
    stated: dict[str, Any] = {"camera_model": model, "w": width, "h": height}
    for name, value in zip(names, values, strict=True):
        stated |= {"fl_x": value, "fl_y": value} if name == "f" else {name: value}
    return stated


def _cameras(content: bytes, binary: bool) -> Iterator[tuple[int, dict[str, Any]]]:
    if not binary:
        for line in _lines(content):
            number, model, width, height, *values = line.split()
            yield int(number), _camera(model, int(width), int(height), [float(value) for value in values])
        return
    (count,), at = struct.unpack_from("<Q", content), 8
    for _ in range(count):
        number, model, width, height = struct.unpack_from("<iiQQ", content, at)
        name, words = MODELS.get(model, (str(model), ""))
        values = struct.unpack_from(f"<{len(words.split())}d", content, at + 24)
        at += 24 + 8 * len(values)
        yield number, _camera(name, width, height, list(values))


def _poses(content: bytes, binary: bool) -> Iterator[tuple[int, list[float], list[float], str]]:
    """(camera, quaternion w x y z, translation, name) of each image; what it saw is passed over."""
    if not binary:
        for line in _lines(content, blank=True)[::2]:
            _, *numbers, camera, name = line.split(maxsplit=9)
            yield _pose([float(number) for number in numbers], int(camera), name.strip())
        return
    (count,), at = struct.unpack_from("<Q", content), 8
    point_bytes = 24  # of what an image saw
    for _ in range(count):
        _, *values, camera = struct.unpack_from("<i7di", content, at)
        end = content.index(b"\0", at + 64)
        name = content[at + 64 : end].decode()
        at = end + 9 + point_bytes * struct.unpack_from("<Q", content, end + 1)[0]
        yield _pose(values, camera, name)


def _pose(values: list[float], camera: int, name: str) -> tuple[int, list[float], list[float], str]:
    if len(values) != 7 or not np.isfinite(values).all() or not any(values[:4]):
        raise ValueError(f"{shown(name, 60)}: no quaternion and translation")
    if not name or len(name.encode()) > MOST_NAME or "\0" in name:
        raise ValueError(f"{shown(name, 60)}: no name of a picture")
    return camera, values[:4], values[4:], name


def _lines(content: bytes, blank: bool = False) -> list[str]:
    """Lines without remarks; empty ones too where an image that saw nothing leaves one."""
    lines = [line for line in content.decode().splitlines() if not line.startswith("#")]
    while lines and not lines[-1].strip():
        lines.pop()
    return lines if blank else [line for line in lines if line.strip()]
