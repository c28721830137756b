"""Light that was measured or displayed: a photodiode's table, arrays, a video, or a folder of frames.

Times count from the clock of whatever measured the light; `pixelid convert --align` brings it onto the camera's.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from pixelid.arrays import load_arrays
from pixelid.errors import InputError, shown
from pixelid.stimuli.frames import VIDEOS, FrameOptions, read_frames
from pixelid.stimuli.light_tables import Stated, read_table
from pixelid.stimuli.light_times import seconds
from pixelid.stimuli.stimulus import Stimulus, unit_named

TABLES, ARRAYS = (".csv", ".txt", ".tsv"), (".npy", ".npz")


def read_light(
    path: Path, *, unit: str | None = None, frames: FrameOptions | None = None, table: Stated | None = None
) -> Stimulus:
    """The light in a file, or in a folder of frames.

    Args:
        path: table (.csv, .txt, .tsv), array (.npy of rows t, radiance; .npz with t and radiance), video, or a folder
            of pictures.
        unit: of the radiance, where the file does not say.
        frames: what is stated of a video or folder.
        table: what is stated of a table.

    Returns:
        A full-field stimulus; of shape (n, height, width) for frames.

    Raises:
        InputError: one line that names file, field, expected and found.
    """
    from pixelid.recordings.source import say

    unit = None if unit is None else unit_named(unit, where="unit of the light")
    suffix = path.suffix.lower()
    if not path.is_dir() and not path.is_file():
        raise InputError(f"{path}: expected a file or a folder of frames, found {_kind_of(path)}")
    if path.is_dir() or suffix in VIDEOS:
        return read_frames(path, unit or "relative", frames or FrameOptions(), say)
    if suffix in ARRAYS:
        return _array(path, unit, say)
    t, radiance, named = read_table(path, table or Stated(), say)
    return _stimulus(t, radiance, unit or named, path)


def _kind_of(path: Path) -> str:
    return "a device, pipe or socket" if path.exists() else "nothing of that name"


def _array(path: Path, unit: str | None, say: Callable[[str], object]) -> Stimulus:
    arrays, stated = load_arrays(path), Stated.beside(path)
    unit = unit or stated.unit
    if "" in arrays:
        content = arrays[""]
        if content.ndim != 2 or 2 not in content.shape or content.dtype.kind not in "fiu":
            raise InputError(f"{path}: expected rows of t, radiance, found {content.dtype} of shape {content.shape}")
        t, radiance = content.T if content.shape[1] == 2 else content
        return _stimulus(seconds(t, "t", "", stated.time_unit, say, path), radiance, unit or "relative", path)
    missing = [name for name in ("t", "radiance") if name not in arrays]
    if missing:
        raise InputError(f"{path}: {missing[0]}: missing; expected t and radiance, found {shown(list(arrays), 200)}")
    for name in ("t", "radiance"):
        if arrays[name].dtype.kind not in "fiu":
            raise InputError(f"{path}: {name}: expected numbers, found {arrays[name].dtype}")
    told = str(arrays["unit"]) if "unit" in arrays else None
    between = str(arrays["interpolation"]) if "interpolation" in arrays else "linear"
    t = seconds(arrays["t"], "t", "", stated.time_unit, say, path)
    return _stimulus(t, arrays["radiance"], unit or told or "relative", path, between)


def _stimulus(t: np.ndarray, radiance: np.ndarray, unit: str, path: Path, between: str = "linear") -> Stimulus:
    """A stimulus, where a trace that reaches zero or below says what may be done about it."""
    radiance = np.asarray(radiance)
    if unit != "shape" and radiance.dtype.kind in "fiu" and np.isfinite(radiance).any() and np.nanmin(radiance) <= 0:
        raise InputError(
            f"{path}/radiance: must be positive, found {np.nanmin(radiance):g}; take the detector's offset off, "
            'or state unit = "shape" (NAME.source.toml) for a trace known up to offset and gain'
        )
    return Stimulus.from_arrays(t, radiance, unit, between, where=str(path))
