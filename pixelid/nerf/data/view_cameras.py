"""The camera of posed pictures, as `transforms_*.json` of NeRF, nerfstudio and instant-ngp state it.

`camera_angle_x` alone (NeRF's synthetic scenes), `intrinsics` (a 3 × 3 matrix), or `fl_x`, `fl_y`, `cx`, `cy`, `w`,
`h` with OpenCV's distortion (`k1`, `k2`, `k3`, `p1`, `p2`) or its fisheye's (`k1` … `k4`), for all views or in each of
them, as long as they are one camera.  Their pixel centres are at half coordinates, ours at whole ones.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from pixelid.documents import is_number
from pixelid.errors import InputError, shown
from pixelid.nerf.data.arrays import intrinsics_of
from pixelid.nerf.data.camera import Camera, pinhole, refuse_lens_without_inverse

PLANE = ("", "PINHOLE", "SIMPLE_PINHOLE", "PERSPECTIVE")
PLUMB_BOB = ("OPENCV", "RADIAL", "SIMPLE_RADIAL", "FULL_OPENCV")
FISHEYE = ("OPENCV_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE")
LENS = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2", "s1", "s2", "s3", "s4")
KEYS = (
    "camera_angle_x", "camera_angle_y", "fl_x", "fl_y", "cx", "cy", "w", "h", "camera_model", "is_fisheye",
    "intrinsics",
)  # fmt: skip
# Names of what a camera does to its pictures, of which those that are not read would be lost in silence.
OF_CAMERA = re.compile(r"[kps]\d|omega|distort.*|ftheta.*|.*rolling_shutter.*|skew|fl_.|focal.*|.*fisheye.*|lens.*|xi|"
                       r"K|camera_matrix|principal.*|shift_[xy]")  # fmt: skip
MOST_ASPECT, MOST_FOCAL = 0.02, 0.01  # relative, of what two statements of one camera may differ by


def states_camera(document: dict) -> bool:
    """Whether a document says what its camera sees."""
    stated = _stated(document)
    return any(key in stated for key in ("camera_angle_x", "camera_angle_y", "fl_x", "intrinsics"))


def stated_size(document: dict) -> tuple[int, int] | None:
    """Width and height of the pictures that a document's intrinsics are of."""
    stated = _stated(document)
    sides = [stated.get(key) for key in ("w", "h")]
    return (int(sides[0]), int(sides[1])) if all(is_number(s) and 0 < s < 1 << 16 for s in sides) else None  # type: ignore[arg-type,return-value,operator]


def refuse_several_cameras(file: Path, document: dict) -> None:
    """Raise InputError where views have cameras of their own that differ."""
    frames = document.get("frames")
    first = _stated(document)
    for k, frame in enumerate(frames if isinstance(frames, list) else ()):
        own = _of_frame(document, frame)
        other = next((key for key in {*own, *first} if own.get(key) != first.get(key)), None)
        if other is not None:
            raise InputError(
                f"{file}: frames[{k}].{other}: expected one camera for all views, found "
                f"{shown(own.get(other), 30)} and {shown(first.get(other), 30)}; make a file for each camera"
            )


def camera_of_document(file: Path, document: dict, width: int, height: int) -> Camera:
    """The camera of a `transforms_*.json` whose pictures have this size.

    Raises:
        InputError: it states none, one that is not read, or one of pictures of another shape.
    """
    refuse_several_cameras(file, document)
    _refuse_unread(file, document)
    stated = _stated(document)
    if "intrinsics" in stated:
        wide, high = stated_size(document) or (width, height)
        model, distortion = _lens(file, stated)
        camera = Camera(intrinsics_of(file, stated["intrinsics"]), wide, high, distortion, model)
        refuse_lens_without_inverse(file, "k1, k2, …", camera)
        return camera if (wide, high) == (width, height) else camera.resized(width, height)
    if "fl_x" not in stated:
        return _by_angle(file, stated, width, height)
    wide, high = stated_size(document) or (width, height)
    if abs(wide * height / (high * width) - 1) > MOST_ASPECT:
        raise InputError(f"{file}: w, h: expected pictures of the shape {wide} x {high}, found {width} x {height}")
    fl_x = _number(file, stated, "fl_x", least=0)
    fl_y = _number(file, stated, "fl_y", fl_x, least=0)
    cx, cy = _number(file, stated, "cx", wide / 2), _number(file, stated, "cy", high / 2)
    _refuse_other_angle(file, stated, "camera_angle_x", wide, fl_x)
    _refuse_other_angle(file, stated, "camera_angle_y", high, fl_y)
    model, distortion = _lens(file, stated)
    intrinsics = np.array([[fl_x, 0, cx - 0.5], [0, fl_y, cy - 0.5], [0, 0, 1]])
    camera = Camera(intrinsics, wide, high, distortion, model)
    refuse_lens_without_inverse(file, "k1, k2, …", camera)
    return camera if (wide, high) == (width, height) else camera.resized(width, height)


def _refuse_unread(file: Path, document: dict) -> None:
    """Raise InputError for what a document states of its lens under names that are not read."""
    frames = document.get("frames")
    first = frames[0] if isinstance(frames, list) and frames and isinstance(frames[0], dict) else {}
    for key, value in (document | first).items():
        used = np.any(np.asarray(value, np.float64)) if _is_numbers(value) else bool(value)
        if used and key not in (*KEYS, *LENS) and OF_CAMERA.fullmatch(key):
            raise InputError(f"{file}: {shown(key)}: not read: remove it, or state fl_x, fl_y, cx, cy, k1, …")


def _is_numbers(value: object) -> bool:
    return is_number(value) or (isinstance(value, list) and all(map(is_number, value)))


def _stated(document: dict) -> dict[str, Any]:
    """What is stated of the camera: by the document, and by its first view."""
    frames = document.get("frames")
    first = frames[0] if isinstance(frames, list) and frames else {}
    return _of_frame(document, first)


def _of_frame(document: dict, frame: object) -> dict[str, Any]:
    own = frame if isinstance(frame, dict) else {}
    both = {key: document[key] for key in (*KEYS, *LENS) if key in document}
    return both | {key: own[key] for key in (*KEYS, *LENS) if key in own}


def _number(file: Path, stated: dict, key: str, default: float | None = None, least: float = -np.inf) -> float:
    value = stated.get(key, default)
    if not is_number(value) or not least < value < 1e9:
        raise InputError(f"{file}: {key}: expected a number{' above 0' if least == 0 else ''}, found {shown(value)}")
    return float(value)


def _by_angle(file: Path, stated: dict, width: int, height: int) -> Camera:
    key = next((key for key in ("camera_angle_x", "camera_angle_y") if key in stated), "")
    if not key:
        raise InputError(f"{file}: camera_angle_x: missing, and neither fl_x nor intrinsics there")
    angle = stated[key]
    if not is_number(angle) or not 0 < angle < np.pi:
        raise InputError(f"{file}: {key}: expected an angle between 0 and π, found {shown(angle)}")
    _lens_of_angle(file, stated)
    if key == "camera_angle_x":
        _refuse_other_angle(file, stated, "camera_angle_y", height, width / 2 / np.tan(angle / 2))
        return pinhole(width, height, angle)
    return pinhole(width, height, 2 * np.arctan(width / height * np.tan(angle / 2)))


def _lens_of_angle(file: Path, stated: dict) -> None:
    """Raise InputError for a lens with a bare angle: without a focal length its coefficients mean nothing certain."""
    used = [key for key in (*LENS, "cx", "cy") if stated.get(key)]
    if used or stated.get("is_fisheye"):
        raise InputError(f"{file}: {(used or ['is_fisheye'])[0]}: is read with fl_x only; add fl_x, fl_y, w and h")


def _refuse_other_angle(file: Path, stated: dict, key: str, pixels: int, focal: float) -> None:
    """Raise InputError where an angle of view and a focal length of as many pixels disagree."""
    angle = stated.get(key)
    if is_number(angle) and 0 < angle < np.pi and abs(focal / (pixels / 2 / np.tan(angle / 2)) - 1) > MOST_FOCAL:
        raise InputError(
            f"{file}: {key} {angle:g} and a focal length of {focal:g} pixels disagree over {pixels} pixels; leave one "
            "of them out"
        )


def _lens(file: Path, stated: dict) -> tuple[str, np.ndarray]:
    """The kind of distortion and its coefficients; none of a plane camera."""
    model = stated.get("camera_model", "")
    model = model.upper() if isinstance(model, str) else model
    known = (*PLANE, *PLUMB_BOB, *FISHEYE)
    if not isinstance(model, str) or model not in known:
        raise InputError(f"{file}: camera_model: expected one of {', '.join(known[1:])}, found {shown(model)}")
    values = {key: _number(file, stated, key, 0.0) for key in LENS}
    bent = next((key for key, value in values.items() if value), None)
    if model in ("PINHOLE", "SIMPLE_PINHOLE") and bent is not None:
        raise InputError(f"{file}: {bent}: camera_model {model} has no lens; state another model, or remove it")
    fisheye = model in FISHEYE or stated.get("is_fisheye") is True
    read = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2", "k3")
    unread = [key for key, value in values.items() if value and key not in read]
    if unread:
        kind = "a fisheye" if fisheye else "OpenCV's five coefficients"
        raise InputError(f"{file}: {unread[0]}: not read: only {', '.join(read)} of {kind} are")
    coefficients = np.array([values[key] for key in read])
    if not fisheye and not coefficients.any():
        coefficients = np.empty(0)
    return "equidistant" if fisheye else "plumb_bob", coefficients
