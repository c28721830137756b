"""Write a recording whole or not at all; the extension chooses the format."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path

from pixelid.errors import InputError
from pixelid.outputs import whole_file
from pixelid.recordings.parts import LongRecording
from pixelid.recordings.recording import Recording

WRITERS = {".h5": "hdf5_writing", ".hdf5": "hdf5_writing", ".npz": "npz", ".csv": "text", ".txt": "text"}  # modules


def check_writable(path: str | Path) -> None:
    """Raise InputError when the extension of `path` names no format that can be written."""
    suffix = Path(path).suffix.lower()
    if suffix not in WRITERS:
        found = suffix or "no extension"
        raise InputError(f"{path}: expected an output ending in {', '.join(WRITERS)}, found {found}")


def write_recording(
    recording: Recording | LongRecording,
    path: str | Path,
    *,
    overwrite: bool = False,
    progress: Callable[[str, float], None] | None = None,
) -> None:
    """Write `recording` to `path` (.h5, .npz, .csv or .txt); reading it back gives the same recording.

    A long recording goes there part by part, in memory that does not grow with it.

    Args:
        recording: Of any length.
        path: The file.
        overwrite: Whether a file that is there is replaced.
        progress: Called with what is being done and the share that is done, while columns of .npz are packed.

    Raises:
        InputError: an unknown extension, an existing file without `overwrite`, a per-pixel stimulus in a text file.
    """
    path = Path(path)
    check_writable(path)
    module = importlib.import_module(f"pixelid.recordings.{WRITERS[path.suffix.lower()]}")
    with whole_file(path, overwrite) as temporary:
        module.write(recording, temporary, **({"progress": progress} if module.__name__.endswith("npz") else {}))
