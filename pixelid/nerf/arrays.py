"""Arrays from npz files, with errors that name file and key."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from pixelid.arrays import load_arrays
from pixelid.errors import InputError, shown


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


def finite(file: Path, key: str, values: np.ndarray) -> np.ndarray:
    """`values` as float64.  Raises InputError when they are no numbers or not all finite."""
    if values.dtype.kind not in "fiu":
        raise InputError(f"{file}: {key}: expected numbers, found {values.dtype}")
    values = values.astype(np.float64)
    if not np.isfinite(values).all():
        row = int(np.argmin(np.isfinite(values.reshape(len(values), -1)).all(axis=1)))
        raise InputError(f"{file}: {key}: row {row} is NaN or infinite")
    return values
