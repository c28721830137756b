"""What a result was made of: versions, hashes of its inputs, the command.  Versions are looked up without importing."""

from __future__ import annotations

import hashlib
import platform
import shlex
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from importlib import metadata
from pathlib import Path

from pixelid import __version__

PACKAGES = ("numpy", "scipy", "numba", "casadi", "torch", "torchdiffeq", "emcee", "arviz-stats", "h5py", "faery")

COMMAND_FILE = "command.txt"  # in the folder of a result that a command made
_running: ContextVar[str] = ContextVar("command", default="")


@contextmanager
def running(words: Sequence[str]) -> Iterator[None]:
    """While this command line runs, results can say what makes them again (`command`).

    Of absolute paths only the last name is kept: pages are handed on, and folders of one's own are nobody's business.
    """
    token = _running.set(shlex.join(["pixelid", *(Path(w).name if w.startswith("/") else w for w in words)]))
    try:
        yield
    finally:
        _running.reset(token)


def command() -> str:
    """The command line that runs, as a shell takes it; empty in a Python session."""
    return _running.get()


def versions() -> dict[str, str]:
    """Versions of pixelid, Python and the installed packages that numbers depend on."""
    installed = {"pixelid": __version__, "python": platform.python_version()}
    for name in PACKAGES:
        try:
            installed[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return installed


def sha256(path: Path) -> str:
    """Hex SHA-256 of a file."""
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def input_hashes(paths: Iterable[Path | None]) -> dict[str, str]:
    """File name → SHA-256 of the inputs that are files; files of one name appear under their paths as given."""
    files = [Path(path) for path in dict.fromkeys(paths) if path is not None and Path(path).is_file()]
    names = [path.name for path in files]
    return {str(path) if names.count(path.name) > 1 else path.name: sha256(path) for path in files}


def provenance(*inputs: Path) -> dict[str, dict[str, str]]:
    """The two keys every result's JSON carries: `versions` and `inputs_sha256`."""
    return {"versions": versions(), "inputs_sha256": input_hashes(inputs)}
