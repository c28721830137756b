"""Write a recording whole or not at all; the extension chooses the format."""

from __future__ import annotations

from pathlib import Path

from pixelid.errors import InputError
from pixelid.outputs import whole_file
from pixelid.recordings.recording import Recording

WRITABLE = (".h5", ".hdf5", ".npz", ".csv", ".txt")


def check_writable(path: str | Path) -> None:
    """Raise InputError when the extension of `path` names no format that can be written."""
    suffix = Path(path).suffix.lower()
    if suffix not in WRITABLE:
        found = suffix or "no extension"
        raise InputError(f"{path}: expected an output ending in {', '.join(WRITABLE)}, found {found}")


def write_recording(recording: Recording, path: str | Path, *, overwrite: bool = False) -> None:
    """Write `recording` to `path` (.h5, .npz, .csv or .txt); reading it back gives the same recording.

    Raises InputError for an unknown extension, an existing file without `overwrite`, and a per-pixel
    stimulus in a text file.
    """
    from pixelid.recordings import hdf5, npz, text

    path = Path(path)
    check_writable(path)
    writers = {".h5": hdf5.write, ".hdf5": hdf5.write, ".npz": npz.write, ".csv": text.write, ".txt": text.write}
    with whole_file(path, overwrite) as temporary:
        writers[path.suffix.lower()](recording, temporary)
