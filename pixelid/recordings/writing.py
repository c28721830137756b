"""Write a recording whole or not at all; the extension chooses the format."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from pixelid.errors import InputError
from pixelid.outputs import whole_file
from pixelid.recordings.parts import LongRecording
from pixelid.recordings.recording import Recording

WRITABLE = (".h5", ".hdf5", ".npz", ".csv", ".txt")


def check_writable(path: str | Path) -> None:
    """Raise InputError when the extension of `path` names no format that can be written."""
    suffix = Path(path).suffix.lower()
    if suffix not in WRITABLE:
        found = suffix or "no extension"
        raise InputError(f"{path}: expected an output ending in {', '.join(WRITABLE)}, found {found}")


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
    from pixelid.recordings import hdf5_writing, npz, text

    path = Path(path)
    check_writable(path)
    writers = {
        ".h5": hdf5_writing.write,
        ".hdf5": hdf5_writing.write,
        ".npz": partial(npz.write, progress=progress),
        ".csv": text.write,
        ".txt": text.write,
    }
    with whole_file(path, overwrite) as temporary:
        writers[path.suffix.lower()](recording, temporary)
