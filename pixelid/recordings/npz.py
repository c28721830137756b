"""Recordings in NumPy's .npz, events under the names that people use, or in one array of a .npy."""

from __future__ import annotations

import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import IO

import numpy as np

from pixelid.errors import InputError
from pixelid.recordings import metadata
from pixelid.recordings.columns import PART_EVENTS
from pixelid.recordings.damage import refusing
from pixelid.recordings.events import Events
from pixelid.recordings.layouts import Arrays, chosen_stream
from pixelid.recordings.parts import LongRecording
from pixelid.recordings.raw import RawEvents
from pixelid.recordings.recording import Recording
from pixelid.recordings.source import ReadingOptions
from pixelid.recordings.statements import stated_size, stated_unit

PREFIX = "stimulus_"  # of the arrays of the light
ERRORS = zipfile.BadZipFile, EOFError, OSError, ValueError, zlib.error
DAMAGE = "expected a .npz archive, found a damaged or different file", *ERRORS
COLUMNS = {"t": np.dtype(np.int64), "x": np.dtype(np.uint16), "y": np.dtype(np.uint16), "p": np.dtype(np.uint8)}


def opened(path: Path, options: ReadingOptions) -> RawEvents:
    """What a .npz file holds; raises InputError where no events can be found in it."""
    where = f"{path}: events"
    with refusing(path, *DAMAGE), _members(path) as members:
        arrays = _arrays(path)
        values = {
            name: np.lib.format.read_array(members[name](), allow_pickle=False)
            for name, (_, shape) in arrays.kinds.items()
            if shape in ((), (1,), (2,)) or name.startswith(PREFIX)
        }
    small = {name: str(value) if value.dtype.kind in "US" else value for name, value in values.items()}
    meta = metadata.from_json(str(small["metadata"]), f"{path}: metadata") if "metadata" in small else {}
    stream, streams = chosen_stream(arrays, options, where)
    unit = meta.get("unit") or options.time_unit or stream.unit or stated_unit(small, (), where)
    size, likely = stated_size([meta, small], where)
    light = {name[len(PREFIX) :]: value for name, value in values.items() if name.startswith(PREFIX)} or None
    head = metadata.assemble(meta, Events.empty(1, 1), light, path, str(path))
    return RawEvents(
        head, lambda: stream.blocks(arrays), where, unit, meta.get("tick_ns"), size=size, likely_sizes=likely,
        polarity="01" if meta else None, inferred=stream.inferred, streams=streams,
    )  # fmt: skip


@contextmanager
def _members(path: Path) -> Iterator[dict[str, Callable[[], IO[bytes]]]]:
    """What opens each array of an archive, or the one of a .npy file, by name."""
    if path.suffix.lower() == ".npy":
        yield {"events": partial(path.open, "rb")}
        return
    with zipfile.ZipFile(path) as packed:
        yield {name.removesuffix(".npy"): partial(packed.open, name) for name in packed.namelist()}


def _arrays(path: Path) -> Arrays:
    """The arrays of a file, which are read piece by piece."""
    kinds = {}
    with _members(path) as members:
        for name, open_member in members.items():
            with open_member() as file:
                shape, dtype, _ = _array_header(file)
            if not dtype.hasobject:
                kinds[name] = (dtype, shape)
    if members and not kinds:
        raise InputError(f"{path}: holds Python objects only, which are not read; save numbers: array.astype(float)")

    def pieces(names: Sequence[str]) -> Iterator[list[np.ndarray]]:
        with refusing(path, *DAMAGE), _members(path) as members, ExitStack() as stack:
            files = [stack.enter_context(members[name]()) for name in names]
            headers = [_array_header(file) for file in files]
            if any(fortran for _, _, fortran in headers):
                yield [np.lib.format.read_array(members[name](), allow_pickle=False) for name in names]
                return
            length = headers[0][0][0]
            for k in range(0, length, PART_EVENTS):
                count = min(PART_EVENTS, length - k)
                yield [
                    np.frombuffer(file.read(count * dtype.itemsize * int(np.prod(shape[1:]))), dtype).reshape(
                        count, *shape[1:]
                    )
                    for file, (shape, dtype, _) in zip(files, headers, strict=True)
                ]

    return Arrays(kinds, pieces)


def _array_header(file) -> tuple[tuple, np.dtype, bool]:
    """Shape, type and order of a .npy file, which is then read from its first number on."""
    version = np.lib.format.read_magic(file)
    reading = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran, dtype = reading(file)
    return shape, dtype, fortran and len(shape) > 1


def write(
    recording: Recording | LongRecording, path: Path, progress: Callable[[str, float], None] | None = None
) -> None:
    """Write `recording` to a compressed .npz with t in nanoseconds and everything else in `metadata`.

    The columns of a long recording wait in raw files next to `path` (13 bytes an event) until all its parts have been
    read, since a column's length stands before its first number.

    Args:
        recording: Of any length; memory does not grow with it.
        path: To be written.
        progress: Called with which array is being packed, and the share of all that is done.
    """
    head = recording.head if isinstance(recording, LongRecording) else recording
    with ExitStack() as stack:
        if isinstance(recording, LongRecording):
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix=".columns-", dir=path.parent))
            columns = _spilled(recording, Path(folder))
        else:
            columns = {name: getattr(recording.events, name) for name in COLUMNS}
        light = {} if head.stimulus is None else {PREFIX + name: a for name, a in head.stimulus.arrays.items()}
        arrays = {"metadata": np.array(metadata.to_json(head)), **columns, **light}
        archive = stack.enter_context(zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, allowZip64=True))
        for k, (name, array) in enumerate(arrays.items()):
            array = np.asarray(array, order="C")
            flat = array.reshape(-1)
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array_header_1_0(member, np.lib.format.header_data_from_array_1_0(array))
                for j in range(0, len(flat), PART_EVENTS):
                    member.write(flat[j : j + PART_EVENTS].view(np.uint8).data)
                    if progress is not None:
                        progress(f"packing {name}", (k + min((j + PART_EVENTS) / len(flat), 1.0)) / len(arrays))


def _spilled(recording: LongRecording, folder: Path) -> dict[str, np.ndarray]:
    """The columns of a long recording, which is read once, each mapped from a raw file of `folder`."""
    count = 0
    with ExitStack() as stack:
        files = {name: stack.enter_context((folder / name).open("wb")) for name in COLUMNS}
        for part in recording.read():
            for name, file in files.items():
                file.write(np.ascontiguousarray(getattr(part.events, name), COLUMNS[name]).data)
            count += len(part.events)
    return {name: np.memmap(folder / name, dtype, "r") if count else np.empty(0, dtype)
            for name, dtype in COLUMNS.items()}  # fmt: skip
