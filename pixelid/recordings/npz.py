"""Recordings in NumPy's .npz: columns t, x, y, p under the names people use."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from pixelid.errors import InputError
from pixelid.recordings import metadata
from pixelid.recordings.columns import sensor_size, to_nanoseconds
from pixelid.recordings.events import Events
from pixelid.recordings.recording import Recording

PREFIX = "stimulus_"  # of the arrays of the light
NAMES = {
    "t": ("t", "ts", "time", "times", "timestamp", "timestamps"),
    "x": ("x", "xs", "col", "column"),
    "y": ("y", "ys", "row"),
    "p": ("p", "ps", "pol", "polarity", "polarities", "on"),
}


def read(path: Path) -> Recording:
    """The recording in a .npz file.

    Integer times are microseconds unless an array `unit` says otherwise, floating times are seconds.
    Columns may also be the fields of one structured array.  Raises InputError where they cannot be found.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            return _read(archive, path)
    except (zipfile.BadZipFile, EOFError, OSError, ValueError, zipfile.error) as error:
        raise InputError(f"{path}: expected a .npz archive, found a damaged or different file ({error})") from error


def _read(archive, path: Path) -> Recording:
    where = f"{path}: events"
    meta = metadata.from_json(str(archive["metadata"]), f"{path}: metadata") if "metadata" in archive else {}
    t, x, y, p = (_column(archive, letter, where) for letter in "txyp")
    unit = meta.get("unit") or (str(archive["unit"]) if "unit" in archive else "us")
    tick_ns = meta.get("tick_ns", 1 if unit == "ns" else 1000)
    if t.dtype.kind == "f":
        t, unit, tick_ns = seconds_to_ns(t, where), "ns", 1
    stated = [meta.get(name, _scalar(archive, name)) for name in ("width", "height")]
    if x.dtype.kind in "iu" and y.dtype.kind in "iu":
        stated = list(sensor_size(x, y, *stated))
    width, height = (1 if size is None else size for size in stated)
    nanoseconds = to_nanoseconds(t, unit, where)
    events = Events.from_columns(nanoseconds, x, y, p, width, height, tick_ns=tick_ns, where=where)
    stimulus = {name[len(PREFIX) :]: archive[name] for name in archive.files if name.startswith(PREFIX)} or None
    return metadata.assemble(meta, events, stimulus, path, str(path))


def seconds_to_ns(t: np.ndarray, where: str) -> np.ndarray:
    """(n,) int64 nanoseconds from (n,) floating seconds; raises InputError for NaN and times beyond 64 bits."""
    if not np.isfinite(t).all():
        raise InputError(f"{where}/t: expected finite times, event {int(np.argmin(np.isfinite(t)))} has none")
    if len(t) and np.abs(t).max() >= 9.2e9:
        raise InputError(f"{where}/t: expected times that fit 64 bits in nanoseconds, found {np.abs(t).max():g} s")
    return np.rint(t.astype(np.float64) * 1e9).astype(np.int64)


def _column(archive, letter: str, where: str) -> np.ndarray:
    for name in NAMES[letter]:
        if name in archive:
            column = archive[name]
            if column.ndim != 1:
                raise InputError(f"{where}/{name}: expected one column, found shape {column.shape}")
            return column
    structured = next((archive[key] for key in archive.files if archive[key].dtype.names), None)
    if structured is not None:
        for name in NAMES[letter]:
            if name in (structured.dtype.names or ()):
                return structured[name]
    raise InputError(f"{where}/{letter}: missing; expected arrays t, x, y, p, found {', '.join(archive.files)}")


def _scalar(archive, name: str) -> int | None:
    return int(archive[name]) if name in archive and archive[name].size == 1 else None


def write(recording: Recording, path: Path) -> None:
    """Write `recording` to a compressed .npz with t in nanoseconds and everything else in `metadata`."""
    events, stimulus = recording.events, recording.stimulus
    columns: dict = {"t": events.t, "x": events.x, "y": events.y, "p": events.p}
    if stimulus is not None:
        columns |= {f"{PREFIX}{name}": array for name, array in stimulus.arrays.items()}
    np.savez_compressed(path, metadata=np.array(metadata.to_json(recording)), **columns)
