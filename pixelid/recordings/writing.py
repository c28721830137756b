"""Write a recording whole or not at all; the extension chooses the format."""

from __future__ import annotations

from pathlib import Path

from pixelid.errors import InputError
from pixelid.outputs import whole_file
from pixelid.recordings.parts import LongRecording, joined
from pixelid.recordings.recording import Recording

WRITABLE = (".h5", ".hdf5", ".npz", ".csv", ".txt")


def check_writable(path: str | Path) -> None:
    """Raise InputError when the extension of `path` names no format that can be written."""
    suffix = Path(path).suffix.lower()
    if suffix not in WRITABLE:
        found = suffix or "no extension"
        raise InputError(f"{path}: expected an output ending in {', '.join(WRITABLE)}, found {found}")


def write_recording(recording: Recording | LongRecording, path: str | Path, *, overwrite: bool = False) -> None:
    """Write `recording` to `path` (.h5, .npz, .csv or .txt); reading it back gives the same recording.

    A long recording goes there part by part, except to .npz, for which all of it is taken into memory.

    Raises InputError for an unknown extension, an existing file without `overwrite`, and a per-pixel
    stimulus in a text file.
    """
    from pixelid.recordings import hdf5_writing, npz, text

    path = Path(path)
    check_writable(path)
    if isinstance(recording, LongRecording) and path.suffix.lower() == ".npz":
        recording = joined(recording.head, recording.read())
    writers = {
        ".h5": hdf5_writing.write,
        ".hdf5": hdf5_writing.write,
        ".npz": npz.write,
        ".csv": text.write,
        ".txt": text.write,
    }
    with whole_file(path, overwrite) as temporary:
        writers[path.suffix.lower()](recording, temporary)
