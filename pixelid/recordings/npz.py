"""Recordings in NumPy's .npz: columns t, x, y, p under the names people use."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np

from pixelid.errors import InputError
from pixelid.recordings import metadata
from pixelid.recordings.columns import PART_EVENTS, sensor_size, to_nanoseconds, validated
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
    t, x, y, p = (_column(archive, letter, where) for letter in "txyp")
    meta, unit, tick_ns = _described(archive, t.dtype, path)
    if t.dtype.kind == "f":
        t = seconds_to_ns(t, where)
    stated = [meta.get(name, _scalar(archive, name)) for name in ("width", "height")]
    if x.dtype.kind in "iu" and y.dtype.kind in "iu":
        stated = list(sensor_size(x, y, *stated))
    width, height = (1 if size is None else size for size in stated)
    nanoseconds = to_nanoseconds(t, unit, where)
    events = Events.from_columns(nanoseconds, x, y, p, width, height, tick_ns=tick_ns, where=where)
    return metadata.assemble(meta, events, _stimulus_arrays(archive), path, str(path))


def stream(path: Path) -> tuple[Recording, Iterator[Recording]] | None:
    """The same in parts: the recording without events, and its parts; None where it must be read whole.

    Columns that are arrays of their own are unpacked piece by piece; fields of one structured array are not.
    """
    where = f"{path}: events"
    damaged = (zipfile.BadZipFile, EOFError, OSError, ValueError, zipfile.error, zlib.error)
    try:
        with np.load(path, allow_pickle=False) as archive:
            names = [next((name for name in NAMES[letter] if name in archive.files), None) for letter in "txyp"]
            if None in names:
                return None
            members = [f"{name}.npy" for name in names]
            with zipfile.ZipFile(path) as packed:
                if not set(members) <= set(packed.namelist()):
                    return None
                kinds = [_member_dtype(packed, member, where) for member in members]
            meta, unit, tick_ns = _described(archive, kinds[0], path)
            stated = [meta.get(name, _scalar(archive, name)) for name in ("width", "height")]
            light = _stimulus_arrays(archive)
        if None in stated:
            stated = [1, 1]
            for x, y in _blocks(path, members[1:3], where):
                stated = [max(a, b) for a, b in zip(stated, sensor_size(x, y, None, None), strict=True)]
    except damaged as error:
        raise InputError(f"{path}: expected a .npz archive, found a damaged or different file ({error})") from error
    seconds = kinds[0].kind == "f"

    def columns() -> Iterator[tuple]:
        try:
            for t, *others in _blocks(path, members, where):
                yield seconds_to_ns(t, where) if seconds else t, *others
        except damaged as error:
            raise InputError(f"{path}: expected a .npz archive, found a damaged file ({error})") from error

    size = (int(stated[0] or 1), int(stated[1] or 1))
    head = metadata.assemble(meta, Events.empty(*size, tick_ns), light, path, str(path))
    events = validated(columns(), *size, unit=unit, tick_ns=tick_ns, where=where)
    return head, (replace(head, events=some) for some in events)


def _member_dtype(packed: zipfile.ZipFile, member: str, where: str) -> np.dtype:
    with packed.open(member) as file:
        shape, dtype = _array_header(file)
    if len(shape) != 1:
        raise InputError(f"{where}/{member.removesuffix('.npy')}: expected one column, found shape {shape}")
    return dtype


def _array_header(file) -> tuple[tuple, np.dtype]:
    """Shape and type of a .npy file, which is then read from its first number on."""
    version = np.lib.format.read_magic(file)
    reading = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = reading(file)
    if dtype.hasobject or dtype.itemsize == 0:
        raise ValueError(f"expected numbers, found {dtype}")
    return shape, dtype


def _blocks(path: Path, members: list[str], where: str) -> Iterator[list[np.ndarray]]:
    """Pieces of several columns, side by side."""
    with zipfile.ZipFile(path) as packed, ExitStack() as stack:
        files = [stack.enter_context(packed.open(member)) for member in members]
        headers = [_array_header(file) for file in files]
        lengths = [shape[0] for shape, _ in headers]
        if len(set(lengths)) != 1:
            raise InputError(f"{where}: t, x, y, p must have one length, found {', '.join(map(str, lengths))}")
        for k in range(0, lengths[0], PART_EVENTS):
            count = min(PART_EVENTS, lengths[0] - k)
            data = [file.read(count * dtype.itemsize) for file, (_, dtype) in zip(files, headers, strict=True)]
            yield [np.frombuffer(d, dtype, count) for d, (_, dtype) in zip(data, headers, strict=True)]


def _described(archive, kind: np.dtype, path: Path) -> tuple[dict, str, int]:
    """Metadata, unit and tick [ns] of times of a kind of number."""
    meta = metadata.from_json(str(archive["metadata"]), f"{path}: metadata") if "metadata" in archive else {}
    if kind.kind == "f":
        return meta, "ns", 1
    unit = meta.get("unit") or (str(archive["unit"]) if "unit" in archive else "us")
    return meta, unit, meta.get("tick_ns", 1 if unit == "ns" else 1000)


def _stimulus_arrays(archive) -> dict[str, np.ndarray] | None:
    return {name[len(PREFIX) :]: archive[name] for name in archive.files if name.startswith(PREFIX)} or None


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
