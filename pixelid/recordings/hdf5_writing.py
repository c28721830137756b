"""Recordings written as HDF5 of the project's own format (`hdf5.py` says what it holds), in blocks.

Extra memory does not grow with the recording, whether its events lie in memory or come in parts.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pixelid.interruption import interrupt_held
from pixelid.outputs import plain
from pixelid.recordings.answers import taken_apart
from pixelid.recordings.columns import RepeatCounter
from pixelid.recordings.events import Events
from pixelid.recordings.metadata import FORMAT, VERSION
from pixelid.recordings.parts import LongRecording, as_long
from pixelid.recordings.recording import Recording
from pixelid.recordings.triggers import Triggers

CHUNK = 1 << 16  # samples of a compressed piece
PACKED: dict = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
DTYPES = {"t": np.int64, "x": np.uint16, "y": np.uint16, "p": np.uint8}


def write(recording: Recording | LongRecording, path: Path) -> None:
    """Write a recording to a new HDF5 file, compressed, in blocks."""
    long = as_long(recording)
    head = long.head
    with _new_file(path) as (file, look):
        file.attrs.update({"format": FORMAT, "version": VERSION, "condition": head.condition, "sensor": head.sensor})
        if head.pooled:
            file.attrs["pooled"] = True
        for name, value in head.attributes.items():
            file.attrs[name] = json.dumps(plain(value)) if isinstance(value, (dict, list, tuple)) else value
        group, edges, counter, repeats = _EventGroup(file, "events", head.events), [], RepeatCounter(), 0
        for part in long.read():
            look()
            group.append(part.events)
            edges.append(part.triggers)
            repeats += 0 if head.pooled else counter.add(part.events)
        if repeats:
            group.group.attrs["duplicates"] = repeats
        if head.exposures is not None:
            _EventGroup(file, "exposures", head.exposures).append(head.exposures)
        stated, columns = taken_apart(replace(head, exposures=None, triggers=Triggers.joined([head.triggers, *edges])))
        for name, column in columns.items():
            if not name.startswith("events/"):
                _write_column(file, name, column.astype(np.uint8) if column.dtype == bool else column)
        if head.stimulus is not None:
            file["stimulus"].attrs.update(stated["stimulus"])


class _EventGroup:
    """A group of columns to which events are appended; times are microseconds as long as all are whole ones."""

    def __init__(self, file, name: str, like: Events) -> None:
        self.group, self.begin = file.create_group(name), 0
        self.group.attrs.update({"width": like.width, "height": like.height, "tick_ns": like.tick_ns})
        self.in_us = like.tick_ns % 1000 == 0
        self.columns = {
            letter: self.group.create_dataset(letter, (0,), dtype, maxshape=(None,), chunks=(CHUNK,), **PACKED)
            for letter, dtype in DTYPES.items()
        }

    def append(self, events: Events) -> None:
        if self.in_us and np.any(events.t % 1000):
            self._count_in_ns()
        end = self.begin + len(events)
        for letter, dataset in self.columns.items():
            dataset.resize((end,))
            column = getattr(events, letter)
            if len(column):
                dataset[self.begin : end] = column // 1000 if letter == "t" and self.in_us else column
        self.begin = end
        self.group["t"].attrs["unit"] = "us" if self.in_us else "ns"

    def _count_in_ns(self) -> None:
        """Turn the times that are written into nanoseconds."""
        self.in_us, step = False, 1 << 20
        times = self.columns["t"]
        for k in range(0, self.begin, step):
            part = slice(k, min(k + step, self.begin))
            times[part] = times[part] * 1000


@contextmanager
def _new_file(path: Path) -> Iterator[tuple[Any, Callable[[], None]]]:
    """An HDF5 file to write to, and a look for interrupts; raises what stopped the disk from taking it, once closed."""
    import h5py

    with interrupt_held() as look, _PatientFile(path, "w+b") as disk, h5py.File(disk, "w") as file:
        yield file, look
    if disk.error is not None:
        raise disk.error


class _PatientFile(io.FileIO):
    """A file that keeps its first error to itself: HDF5 crashes the process when the disk is full."""

    error: OSError | None = None

    def write(self, data, /) -> int:
        view = memoryview(data).cast("B")
        done = 0
        while self.error is None and done < len(view):
            try:
                done += super().write(view[done:]) or 0
            except OSError as error:
                self.error = error
        return len(view)

    def truncate(self, size=None, /) -> int:
        try:
            return super().truncate(size)
        except OSError as error:
            self.error = self.error or error
            return size or 0


def _write_column(file, name: str, column: np.ndarray) -> None:
    """A new dataset, compressed in pieces of at most CHUNK samples where there are any."""
    samples = int(np.prod(column.shape[1:], dtype=np.int64))
    pieces = {"chunks": (max(1, min(len(column), CHUNK // samples)), *column.shape[1:]), **PACKED}
    file.create_dataset(name, data=column, **(pieces if len(column) else {}))
