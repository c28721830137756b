"""`raw_events.npz` written piece by piece: NumPy asks for whole arrays, and a sequence may hold a billion events."""

from __future__ import annotations

import shutil
import zipfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np

COLUMNS = {"position": np.dtype("<u2"), "timestamp": np.dtype("<i8"), "polarity": np.dtype("?")}
COPY = 1 << 20  # bytes


class EventFile:
    """The columns, each in a file of its own until their length is known."""

    def __init__(self, files: dict) -> None:
        self._files = files
        self.events = 0

    def add(self, t: np.ndarray, x: np.ndarray, y: np.ndarray, on: np.ndarray) -> None:
        """Events (n,) after those before; t: ns."""
        position = np.column_stack([x, y])
        for name, values in (("position", position), ("timestamp", t), ("polarity", on)):
            self._files[name].write(np.ascontiguousarray(values, COLUMNS[name]).data)
        self.events += len(t)


@contextmanager
def event_file(path: Path) -> Iterator[EventFile]:
    """Yield what takes the events of an npz file, which is there at the end; nothing is when an error stops it."""
    parts = {name: path.with_name(f".{name}.part") for name in COLUMNS}
    try:
        with ExitStack() as stack:
            writer = EventFile({name: stack.enter_context(part.open("wb")) for name, part in parts.items()})
            yield writer
        with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED, allowZip64=True) as archive:
            for name, part in parts.items():
                shape = (writer.events, 2) if name == "position" else (writer.events,)
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member, part.open("rb") as column:
                    header = {"descr": COLUMNS[name].str, "fortran_order": False, "shape": shape}
                    np.lib.format.write_array_header_1_0(member, header)
                    shutil.copyfileobj(column, member, COPY)
                part.unlink()
    finally:
        for part in parts.values():
            part.unlink(missing_ok=True)
