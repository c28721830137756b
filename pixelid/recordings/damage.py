"""What libraries raise for damaged files, as one plain line that names the file."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pixelid.errors import InputError, first_line


@contextmanager
def refusing(path: Path, what: str, *kinds: type[Exception]) -> Iterator[None]:
    """Turn errors of these kinds, raised inside the block, into an InputError: the file, what is wrong, the reason."""
    try:
        yield
    except (InputError, MemoryError):
        raise
    except kinds as error:
        raise InputError(f"{path}: {what} ({first_line(error)[:120]})") from error
