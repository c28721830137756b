"""Arrays from npz files, with errors that name file and key."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from pixelid.arrays import load_arrays
from pixelid.errors import InputError, shown

MOST_OFF = 1e-2  # of a unit quaternion's norm and of R Rᵀ from 1: files hold four digits or more


def read_arrays(file: Path, keys: Iterable[str]) -> dict[str, np.ndarray]:
    """The arrays of an npz file under these keys.  Raises InputError for a missing or damaged file and missing keys."""
    if not file.is_file():
        raise InputError(f"{file}: no such file")
    stored = load_arrays(file)
    missing = [key for key in keys if key not in stored]
    if missing:
        found = shown(", ".join(stored) or "nothing", 200)
        raise InputError(f"{file}: {missing[0]}: missing; the file has {found}")
    return {key: stored[key] for key in keys}


def has_none(file: Path, keys: Iterable[str]) -> bool:
    """Whether an npz file is there and has none of these keys."""
    try:
        return not set(keys) & set(load_arrays(file))
    except InputError:
        return False


def scalar(file: Path, arrays: dict, key: str, *, above=None, least=None, finite: bool = True) -> float:
    """One number of an npz file.  Raises InputError for several, for NaN, and for values out of range."""
    values = np.asarray(arrays[key])
    limit = f" > {above}" if above is not None else (f" ≥ {least}" if least is not None else "")
    if values.size != 1 or values.dtype.kind not in "fiub":
        raise InputError(f"{file}: {key}: expected one number{limit}, found {values.dtype} of shape {values.shape}")
    value = float(values.reshape(-1)[0])
    low = (above is not None and not value > above) or (least is not None and not value >= least)
    if np.isnan(value) or low or (finite and np.isinf(value)):
        raise InputError(f"{file}: {key}: expected a number{limit}, found {value}")
    return value


def unit_quaternions(file: Path, key: str, values: np.ndarray) -> np.ndarray:
    """(n, 4) unit quaternions x, y, z, w of orientations (n, 4) or (n, 3, 3).

    Raises:
        InputError: they are neither; quaternions whose norm is not 1, matrices that are no rotations (reflections too).
    """
    if values.ndim not in (2, 3) or values.shape[1:] not in ((4,), (3, 3)):
        raise InputError(f"{file}: {key}: expected (n, 4) or (n, 3, 3), found {values.shape}")
    values = finite(file, key, values)
    if values.ndim == 3:
        with np.errstate(all="ignore"):  # what overflows is no rotation
            wrong = ~rotations(values)
        if wrong.any():
            raise InputError(f"{file}: {key}: expected rotation matrices, row {int(np.argmax(wrong))} is none")
        from scipy.spatial.transform import Rotation

        return Rotation.from_matrix(values).as_quat()
    return of_unit_length(f"{file}: {key}", values)


def of_unit_length(where: str, quaternions: np.ndarray) -> np.ndarray:
    """(n, 4) quaternions of about unit length, scaled to it.  Raises InputError for others; `where` names them."""
    with np.errstate(all="ignore"):
        norm = np.linalg.norm(quaternions, axis=1, keepdims=True)
    if not (np.abs(norm - 1) <= MOST_OFF).all():
        raise InputError(f"{where}: expected unit quaternions, found norms {norm.min():.3g} … {norm.max():.3g}")
    return quaternions / norm


def rotations(matrices: np.ndarray) -> np.ndarray:
    """(…,) whether matrices (…, 3, 3) are rotations: orthonormal to `MOST_OFF`, and right-handed."""
    off = np.abs(matrices @ np.swapaxes(matrices, -1, -2) - np.eye(3)).max(axis=(-1, -2))
    return (off <= MOST_OFF) & (np.linalg.det(matrices) > 0)


def intrinsics_of(file: Path, values: object) -> np.ndarray:
    """(3, 3) intrinsics of a pinhole: positive focal lengths, last row 0 0 1.

    Raises:
        InputError: anything else.
    """
    try:
        matrix = np.asarray(values)
        matrix = matrix.astype(np.float64) if matrix.dtype.kind in "fiu" else np.empty(0)
    except (TypeError, ValueError):  # rows of different lengths
        matrix = np.empty(0)
    right = matrix.shape == (3, 3) and np.isfinite(matrix).all() and (np.abs(matrix) < 1e9).all()
    if not right or not (matrix[0, 0] > 0 and matrix[1, 1] > 0 and np.abs(matrix[2] - (0, 0, 1)).max() < 1e-6):
        raise InputError(
            f"{file}: intrinsics: expected a 3 × 3 matrix fx s cx, 0 fy cy, 0 0 1 of pixels with fx, fy > 0, found "
            f"{shown(matrix.tolist() if matrix.size else values, 120)}"
        )
    if matrix[0, 0] * matrix[1, 1] - matrix[0, 1] * matrix[1, 0] < 1e-12:
        raise InputError(f"{file}: intrinsics: expected an invertible matrix, found {shown(matrix.tolist(), 120)}")
    return matrix


def finite(file: Path, key: str, values: np.ndarray) -> np.ndarray:
    """`values` as float64.  Raises InputError when they are no numbers, not an array of any, or not all finite."""
    if values.dtype.kind not in "fiu" or values.ndim == 0:
        raise InputError(f"{file}: {key}: expected numbers, found {values.dtype} of shape {values.shape}")
    values = values.astype(np.float64)
    if not np.isfinite(values).all():
        row = int(np.argmin(np.isfinite(values.reshape(len(values), -1)).all(axis=1)))
        raise InputError(f"{file}: {key}: row {row} is NaN or infinite")
    return values
