"""Recordings in NumPy's .npz: columns t, x, y, p under the names people use."""

from __future__ import annotations

import math
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pixelid.errors import InputError, shown
from pixelid.recordings import metadata
from pixelid.recordings.columns import PART_EVENTS, sensor_size, to_nanoseconds, validated
from pixelid.recordings.events import NS_PER_UNIT, Events
from pixelid.recordings.parts import LongRecording
from pixelid.recordings.recording import Recording

PREFIX = "stimulus_"  # of the arrays of the light
COLUMNS = {"t": np.dtype(np.int64), "x": np.dtype(np.uint16), "y": np.dtype(np.uint16), "p": np.dtype(np.uint8)}
NAMES = {
    "t": ("t", "ts", "time", "times", "timestamp", "timestamps"),
    "x": ("x", "xs", "col", "column"),
    "y": ("y", "ys", "row"),
    "p": ("p", "ps", "pol", "polarity", "polarities", "on"),
}


def read(path: Path) -> Recording:
    """The recording in a .npz file.

    Integer times are microseconds and floating times are seconds, unless an array `unit` says otherwise.
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
        t, unit = floats_to_ns(t, unit, where), "ns"
    stated = [meta.get(name, _scalar(archive, name, where)) for name in ("width", "height")]
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
            stated = [meta.get(name, _scalar(archive, name, where)) for name in ("width", "height")]
            light = _stimulus_arrays(archive)
        if None in stated:
            stated = [1, 1]
            for x, y in _blocks(path, members[1:3], where):
                stated = [max(a, b) for a, b in zip(stated, sensor_size(x, y, None, None), strict=True)]
    except damaged as error:
        raise InputError(f"{path}: expected a .npz archive, found a damaged or different file ({error})") from error
    floating = kinds[0].kind == "f"

    def columns() -> Iterator[tuple]:
        try:
            for t, *others in _blocks(path, members, where):
                yield floats_to_ns(t, unit, where) if floating else t, *others
        except damaged as error:
            raise InputError(f"{path}: expected a .npz archive, found a damaged file ({error})") from error

    size = (int(stated[0] or 1), int(stated[1] or 1))
    head = metadata.assemble(meta, Events.empty(*size, tick_ns), light, path, str(path))
    events = validated(columns(), *size, unit="ns" if floating else unit, tick_ns=tick_ns, where=where)
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
    floating = kind.kind == "f"
    unit = meta.get("unit") or (str(archive["unit"]) if "unit" in archive else "s" if floating else "us")
    if unit not in NS_PER_UNIT:
        raise InputError(f"{path}: unit: expected {' or '.join(NS_PER_UNIT)}, found {shown(unit, 20)}")
    return meta, unit, meta.get("tick_ns", 1 if floating else NS_PER_UNIT[unit])


def _stimulus_arrays(archive) -> dict[str, np.ndarray] | None:
    return {name[len(PREFIX) :]: archive[name] for name in archive.files if name.startswith(PREFIX)} or None


def floats_to_ns(t: np.ndarray, unit: str, where: str) -> np.ndarray:
    """(n,) int64 nanoseconds from (n,) floating times, to the last decimal that all of them can carry.

    A double at 1.7e9 s is a multiple of 0.24 µs: what was written in µs would show a clock of that instead.
    Raises InputError for NaN and times beyond 64 bits.
    """
    if not np.isfinite(t).all():
        raise InputError(f"{where}/t: expected finite times, event {int(np.argmin(np.isfinite(t)))} has none")
    nanoseconds = t.astype(np.float64) * NS_PER_UNIT[unit]
    if len(t) and np.abs(nanoseconds).max() >= 9.2e18:
        found = f"{np.abs(t).max():g} {unit}"
        raise InputError(f"{where}/t: expected times that fit 64 bits in nanoseconds, found {found}")
    last = 10 ** math.ceil(math.log10(max(1.0, np.spacing(np.abs(nanoseconds).max(initial=0.0)))))
    return np.rint(nanoseconds / last).astype(np.int64) * last


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


def _scalar(archive, name: str, where: str) -> int | None:
    return metadata.whole(archive[name], f"{where}: {name}", metadata.MOST_SIZE) if name in archive else None


def write(
    recording: Recording | LongRecording, path: Path, progress: Callable[[str, float], None] | None = None
) -> None:
    """Write `recording` to a compressed .npz with t in nanoseconds and everything else in `metadata`.

    Columns are packed one after the other, piece by piece: those of a long recording wait in raw files beside `path`
    (13 bytes an event) until all its parts have been read, since a column's length stands before its first number.

    Args:
        recording: Of any length; memory does not grow with it.
        path: To be written.
        progress: Told which column is being packed, and the share of all columns that is done.
    """
    head = recording.head if isinstance(recording, LongRecording) else recording
    with ExitStack() as stack:
        if isinstance(recording, LongRecording):
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix=".columns-", dir=path.parent))
            columns = _spilled(recording, Path(folder))
        else:
            columns = {name: _in_memory(getattr(recording.events, name)) for name in COLUMNS}
        archive = stack.enter_context(zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, allowZip64=True))
        _pack(archive, "metadata", np.array(metadata.to_json(head)))
        for k, (name, column) in enumerate(columns.items()):
            for done in _packed(archive, name, column):
                if progress is not None:
                    progress(f"packing {name}", (k + done) / len(columns))
        if head.stimulus is not None:
            for name, array in head.stimulus.arrays.items():
                _pack(archive, f"{PREFIX}{name}", array)


class _Column(NamedTuple):
    """Of an archive: type, shape, and its numbers in pieces, in the order of the file."""

    dtype: np.dtype
    shape: tuple[int, ...]
    pieces: Iterable[np.ndarray]


def _in_memory(array: np.ndarray) -> _Column:
    flat = np.ascontiguousarray(array).reshape(-1)
    return _Column(array.dtype, array.shape, (flat[k : k + PART_EVENTS] for k in range(0, flat.size, PART_EVENTS)))


def _spilled(recording: LongRecording, folder: Path) -> dict[str, _Column]:
    """The columns of a long recording, which is read once, each in a raw file of `folder`."""
    count = 0
    with ExitStack() as stack:
        files = {name: stack.enter_context((folder / name).open("wb")) for name in COLUMNS}
        for part in recording.read():
            for name, file in files.items():
                file.write(np.ascontiguousarray(getattr(part.events, name), COLUMNS[name]).data)
            count += len(part.events)

    def pieces(name: str) -> Iterator[np.ndarray]:
        with (folder / name).open("rb") as file:
            while data := file.read(PART_EVENTS * COLUMNS[name].itemsize):
                yield np.frombuffer(data, COLUMNS[name])

    return {name: _Column(dtype, (count,), pieces(name)) for name, dtype in COLUMNS.items()}


def _pack(archive: zipfile.ZipFile, name: str, array: np.ndarray) -> None:
    for _ in _packed(archive, name, _in_memory(array)):
        pass


def _packed(archive: zipfile.ZipFile, name: str, column: _Column) -> Iterator[float]:
    """Write one array of the archive as np.savez does; the share that is written, after every piece."""
    header = {"descr": np.lib.format.dtype_to_descr(column.dtype), "fortran_order": False, "shape": column.shape}
    total, written = int(np.prod(column.shape, dtype=np.int64)), 0
    with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
        np.lib.format.write_array_header_1_0(member, header)
        for piece in column.pieces:
            member.write(piece.view(np.uint8).data)
            written += piece.size
            yield written / total
