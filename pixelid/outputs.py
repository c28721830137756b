"""Results reach disk whole or not at all, and never in place of something else.

A result is written next to its target under a hidden name, flushed to disk, and swapped in by one rename.  Only a
folder that holds a result of pixelid is ever replaced, and never one that holds an input of the run.  `claimed` keeps
a second run off the same target.
"""

from __future__ import annotations

import ctypes
import errno
import glob
import itertools
import json
import math
import os
import re
import shutil
import socket
import sys
import tempfile
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from pixelid.documents import read_json
from pixelid.errors import InputError, OutputError, SetAside

# The JSON files that mark a folder as a result, which --overwrite may replace.
RESULT_FILES = (
    "calibration.json", "fit.json", "gap.json", "posterior.json", "lowlight.json", "design.json", "rates.json",
    "flicker.json", "latency.json", "noise.json", "sensor.json", "compare.json", "inspect.json", "static_noise.json",
    "reconstruction.json", "conform.json", "render.json", "dataset.json", "biases.json",
)  # fmt: skip
_AT_FDCWD, _RENAME_EXCHANGE = -100, 2  # linux/fcntl.h, linux/fs.h
MOST_CHARACTERS = 60  # of a file's name made from a label: of four bytes each, with an ending, they are less than 255
OLD = ".old"  # added to the name of a result that is being replaced where the system cannot swap two folders
_open: dict[Path, Path] = {}  # this process's temporary folders → what they are for


def refuse_existing(path: Path, overwrite: bool, *, markers: Sequence[str] | None = RESULT_FILES) -> None:
    """Check that `path` can be made, or replaced.

    Args:
        path: of the result, a file or a folder.
        overwrite: whether the user agrees to lose what is there.
        markers: files of which one must be in a folder that is replaced; None: any folder is replaced.

    Raises:
        InputError: it exists and may not be replaced, or its parent is missing.
    """
    path = Path(path)
    if os.path.lexists(path):
        if not overwrite:
            raise InputError(f"{path}: exists already; choose another --out or pass --overwrite")
        if path.exists() and not (path.is_file() or path.is_dir()):  # /dev/null, which root could replace
            raise InputError(f"{path}: expected a file or a folder, found a device or a pipe; choose another --out")
        if path.is_dir() and markers is not None and not holds_result(path, markers):
            raise InputError(
                f"{path}: --overwrite replaces only a result of pixelid (a folder with {markers[0]} or the like), "
                "found something else; choose another --out"
            )
    if not path.parent.exists():
        raise InputError(f"{path}: the folder {path.parent} does not exist")


def refuse_inputs(path: Path, inputs: Iterable[str | Path]) -> None:
    """Check that writing `path` would not lose an input.

    Raises:
        InputError: `path` is one of the inputs, or a folder that holds one.
    """
    target = Path(path).resolve()
    for name in inputs:
        source = Path(name)
        if not source.exists():
            continue
        links = [member for member in source.iterdir() if member.is_symlink()] if source.is_dir() else []
        for file in (source, *links):
            if file.resolve() == target or target in file.resolve().parents:
                raise InputError(f"{path}: --out would replace the input {file}; choose another --out")


def holds_result(folder: Path, markers: Sequence[str] = RESULT_FILES) -> bool:
    """Whether a folder is empty or holds one of our results."""
    if not any(folder.iterdir()):
        return True
    for name in markers:
        try:
            if not name.endswith(".json") and (folder / name).exists():
                return True
            if (folder / name).is_file() and read_json(folder / name) is not None:
                return True
        except (OSError, InputError):
            continue
    return False


@contextmanager
def claimed(path: Path, overwrite: bool = False, inputs: Iterable[str | Path] = ()) -> Iterator[None]:
    """Check `path` before the work begins, and keep other runs off it until the work is done.

    Raises:
        InputError: as `refuse_existing` and `refuse_inputs`, and when another run is at work on `path`.
    """
    path = Path(path)
    refuse_inputs(path, inputs)
    refuse_existing(path, overwrite, markers=RESULT_FILES)
    with _locked(path):
        yield


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold the lock file `.NAME.lock` next to `path`; the system releases it when the process dies."""
    try:
        import fcntl
    except ImportError:  # not on this system: two runs at once are not noticed
        yield
        return
    lock = path.with_name(f".{path.name}.lock")
    while True:
        try:
            handle = os.open(lock, os.O_CREAT | os.O_RDWR | os.O_NOFOLLOW, 0o644)
        except OSError as error:
            raise _cannot_write(path, error) from error
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            owner = os.read(handle, 100).decode(errors="replace").strip()
            os.close(handle)
            raise InputError(
                f"{path}: another run ({owner or 'starting'}) is writing it; choose another --out"
            ) from None
        except OSError:  # a file system without locks
            pass
        with suppress(OSError):
            if os.fstat(handle).st_ino == os.stat(lock).st_ino:
                break
        os.close(handle)  # the run before removed its lock file between our opening and locking it
    try:
        with suppress(OSError):
            os.ftruncate(handle, 0)
            os.write(handle, f"process {os.getpid()} on {socket.gethostname()}\n".encode())
        yield
    finally:
        with suppress(OSError):
            lock.unlink()
        os.close(handle)


@contextmanager
def whole_file(path: Path, overwrite: bool = False) -> Iterator[Path]:
    """Yield a temporary path in the same folder; on success it is renamed to `path`.

    Raises:
        InputError: `path` exists and may not be replaced.
        OutputError: it cannot be written; what was there is unchanged.
    """
    path = Path(path)
    refuse_existing(path, overwrite)
    if path.is_dir():
        raise InputError(f"{path}: expected a file to write, found a folder")
    with _beside(path) as folder:
        temporary = folder / path.name
        yield temporary
        _flush(temporary)
        refuse_existing(path, overwrite)  # again: the work between may have taken hours
        target, old = path.resolve(), folder / f"{path.name}{OLD}"
        with suppress(OSError):  # nothing there, or a file system without links
            os.link(target, old)
        os.replace(temporary, target)
        try:
            _flush(target.parent)
        except BaseException:  # then the old one is to stay
            os.replace(old, target) if old.exists() else target.unlink()
            raise


@contextmanager
def whole_folder(
    path: Path, overwrite: bool = False, *, markers: Sequence[str] | None = RESULT_FILES
) -> Iterator[Path]:
    """Yield a temporary folder next to `path`; on success it takes the place of `path`.

    Args:
        path: of the result.
        overwrite: whether a result that is there is replaced.
        markers: as in `refuse_existing`.

    Raises:
        InputError: `path` exists and may not be replaced.
        OutputError: it cannot be written; what was there is unchanged.
    """
    path = Path(path)
    refuse_existing(path, overwrite, markers=markers)
    if os.path.lexists(path) and not path.is_dir():
        raise InputError(f"{path}: expected a folder to replace, found a file")
    with _beside(path) as parent:
        temporary = parent / path.name
        temporary.mkdir()
        yield temporary
        for folder, _, files in os.walk(temporary):
            for name in files:
                _flush(Path(folder) / name)
            _flush(Path(folder))
        refuse_existing(path, overwrite, markers=markers)  # again: the work between may have taken hours
        target = path.resolve()
        swapped = target.exists()
        if swapped:
            _exchange(temporary, target)
        else:
            os.rename(temporary, target)
        try:
            _flush(target.parent)
        except BaseException:  # then the old one is to stay
            if swapped:
                old = temporary if temporary.exists() else parent / f"{path.name}{OLD}"
                _exchange(old, target)
            else:
                os.rename(target, temporary)
            raise


@contextmanager
def into_folder(path: Path) -> Iterator[Path]:
    """Yield a temporary folder; on success what is in it joins what is in `path`, of which nothing is replaced.

    Raises:
        InputError: `path` holds one of the names already.
        OutputError: it cannot be written.
    """
    path = Path(path)
    with _beside(path) as parent:
        temporary = parent / path.name
        temporary.mkdir()
        yield temporary
        new = sorted(temporary.iterdir())
        for member in new:
            if os.path.lexists(path / member.name):
                replaceable = " or pass --overwrite" if holds_result(path) else ""
                raise InputError(f"{path}: holds {member.name} already; choose another --out{replaceable}")
        for member in new:
            os.rename(member, path.resolve() / member.name)


def file_name(label: str) -> str:
    """A label as the name of one file or folder: nothing in it leads elsewhere, and the disk takes its length.

    >>> file_name("../../home/a b"), file_name("..")
    ('_.._home_a b', 'unnamed')
    """
    safe = re.sub(r'[\\/:*?"<>|\x00-\x1f]', "_", label).lstrip(". ")
    return safe[:MOST_CHARACTERS].rstrip(". ") or "unnamed"


def set_aside(path: Path, why: str, suffix: str) -> Path:
    """Rename what an earlier run kept and this one cannot use, and warn; nothing is lost, and the run goes on without.

    Args:
        path: a file or folder.
        why: in words, "is damaged" say.
        suffix: that is added to its name, with a number where there is such a name already.

    Returns:
        Where it is now.

    Raises:
        OutputError: it cannot be renamed.
    """
    aside = next(
        name
        for k in itertools.count(1)
        if not os.path.lexists(name := path.with_name(f"{path.name}.{suffix}{'' if k == 1 else k}"))
    )
    try:
        os.rename(path, aside)
    except FileNotFoundError:  # whoever removed it has spared us the trouble
        return aside
    except OSError as error:
        raise _cannot_write(path, error) from error
    warnings.warn(f"{path}: {why}; set aside as {aside.name}, and computed again", SetAside, stacklevel=2)
    return aside


@contextmanager
def _beside(path: Path) -> Iterator[Path]:
    """A hidden folder next to `path`, removed at the end; those of dead processes are removed as well.

    Raises:
        OutputError: for an OSError that concerns what is written, whichever step of writing it stopped.
    """
    folder: Path | None = None
    try:
        _remove_stale(path)
        folder = Path(tempfile.mkdtemp(prefix=_prefix(path, os.getpid()), suffix=".tmp", dir=path.resolve().parent))
        _open[folder] = path
        folder.chmod(0o755)
        yield folder
    except OSError as error:
        names = [Path(str(name)) for name in (error.filename, error.filename2) if name is not None]
        target = path.resolve()
        own = {folder, path, target}
        if folder and names and not any(name == target.parent or own & {name, *name.parents} for name in names):
            raise  # another file: an input
        raise _cannot_write(path, error) from error
    finally:
        if folder is not None:
            _remove_temporary(folder, path)
            _open.pop(folder, None)


def remove_temporaries() -> None:
    """Remove what this process is writing at present: it is about to end, and not by itself."""
    for folder, path in list(_open.items()):
        _remove_temporary(folder, path)


def _remove_temporary(folder: Path, path: Path) -> None:
    """Remove a temporary folder of `path`; a result that was moved there and not yet replaced goes back first."""
    target, old = path.resolve(), folder / f"{path.name}{OLD}"
    with suppress(OSError):
        if old.exists() and not os.path.lexists(target):
            os.rename(old, target)
    shutil.rmtree(folder, ignore_errors=True)


def _cannot_write(path: Path, error: OSError) -> OutputError:
    reason = error.strerror or (str(error).splitlines() or ["unknown reason"])[0][:120]
    return OutputError(f"{path}: cannot be written ({reason}); what was there before is unchanged")


def _prefix(path: Path, process: int) -> str:
    return f".{path.name}.{socket.gethostname()}-{process}-"


def _remove_stale(path: Path) -> None:
    """Remove temporary folders of `path` that processes of this machine left when they were killed."""
    start = _prefix(path, 0).removesuffix("0-")
    for left in path.resolve().parent.glob(f".{glob.escape(path.name)}.*.tmp"):
        process = left.name.removeprefix(start).partition("-")[0]
        if left.name.startswith(start) and process.isdigit() and not _alive(int(process)):
            _remove_temporary(left, path)


def _alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


def _flush(path: Path) -> None:
    """Wait until a file, or the entries of a folder, are on the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP, errno.EBADF):  # file systems that cannot flush folders
            raise
    finally:
        os.close(handle)


def _exchange(new: Path, old: Path) -> None:
    """Swap two folders: in one step where the system can, else by two renames, the first undone if the second fails."""
    if _exchange_at_once(new, old):
        return
    aside = new.with_name(f"{new.name}{OLD}")
    os.rename(old, aside)
    try:
        os.rename(new, old)
    except BaseException:
        os.rename(aside, old)
        raise


def _exchange_at_once(new: Path, old: Path) -> bool:
    """Whether Linux's renameat2(…, RENAME_EXCHANGE) has swapped them."""
    if not sys.platform.startswith("linux"):
        return False
    try:
        renameat2 = ctypes.CDLL(None, use_errno=True).renameat2
    except (OSError, AttributeError):
        return False
    done = renameat2(_AT_FDCWD, os.fsencode(new), _AT_FDCWD, os.fsencode(old), _RENAME_EXCHANGE)
    if done == 0:
        return True
    code = ctypes.get_errno()
    if code in (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP):  # an old kernel, or a file system that cannot
        return False
    raise OSError(code, os.strerror(code), str(new), None, str(old))


def plain(value: Any) -> Any:
    """`value` as JSON knows it: NumPy scalars and arrays become Python, non-finite floats become None."""
    import numpy as np

    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Path):
        return str(value)
    return value


def write_json(path: Path, value: Any) -> None:
    """Write `value` as indented JSON."""
    Path(path).write_text(json.dumps(plain(value), indent=2) + "\n", encoding="utf-8")
