"""NumPy files that nobody should trust: no pickles, no archive that unpacks to more than memory should hold."""

from __future__ import annotations

import warnings
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pixelid.errors import InputError, shown

MOST_BYTES = 2 << 30  # unpacked; deflate packs zeros a thousandfold


def load_arrays(path: str | Path) -> dict[str, np.ndarray]:
    """The arrays of a .npz archive by name; of a .npy file its one array, without a name.

    Raises:
        InputError: it is no regular file, damaged, too large, or holds Python objects.
    """
    path = Path(path)
    if not path.is_file():
        found = "a folder, device, pipe or socket" if path.exists() else "nothing of that name"
        raise InputError(f"{path}: expected a file of arrays, found {found}")
    try:
        if zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as archive:
                _refuse_large(sum(member.file_size for member in archive.infolist()), path)
        else:
            _refuse_large(path.stat().st_size, path)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the parser of headers speaks of damaged ones beside raising
            content = np.load(path, allow_pickle=False)
        if isinstance(content, np.ndarray):
            return {"": content}
        with content:
            arrays = {name: content[name] for name in content.files}
    except InputError:
        raise
    except MemoryError:
        raise InputError(f"{path}: damaged: it declares more than memory holds") from None
    except Exception as error:  # NumPy and zipfile raise many kinds for damaged archives
        reason = shown(str(error).partition("\n")[0] or type(error).__name__, 100)
        raise InputError(f"{path}: expected NumPy arrays, found a damaged or different file ({reason})") from None
    wrong = next((name for name, array in arrays.items() if not isinstance(array, np.ndarray)), None)
    if wrong is not None:  # a member that is no .npy comes as bytes
        raise InputError(f"{path}: {shown(wrong)}: expected an array, found other bytes")
    return arrays


def save_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write a compressed .npz; unlike those of `np.savez_compressed`, names may be any text ("file" too)."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, np.asanyarray(array), allow_pickle=False)


def _refuse_large(size: int, path: Path) -> None:
    if size > MOST_BYTES:
        raise InputError(f"{path}: expected at most {MOST_BYTES >> 30} GiB of arrays, found {size} bytes")
