"""What commands print: plain text that any terminal shows whole, names never cut, nothing read as markup."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import click

from pixelid.errors import Doubtful, SetAside, printable

MOST_CHARACTERS = 1000  # of a line of an error


def use_utf8() -> None:
    """Print UTF-8 whatever the locale says; a terminal that cannot shows question marks, and nothing crashes."""
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)  # absent where a test or notebook has replaced the stream
        if reconfigure is not None:
            reconfigure(encoding="utf-8", errors="replace")


@contextmanager
def warnings_as_lines() -> Iterator[None]:
    """Print our own warnings as one plain line each; those of libraries say nothing to users (PIXELID_DEBUG=1 does)."""
    with warnings.catch_warnings():
        for ours in (SetAside, Doubtful):
            warnings.simplefilter("always", ours)
        others = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *where: Any) -> None:
            if issubclass(category, SetAside | Doubtful):
                complain(str(message))
            elif os.environ.get("PIXELID_DEBUG") == "1":
                others(message, category, *where)

        warnings.showwarning = show
        yield


def complain(message: str) -> None:
    """Print an error: at most three lines, without what a terminal would obey (names come from files)."""
    lines = [line for line in printable(message).splitlines() if line.strip()] or ["unknown error"]
    cut = [line if len(line) <= MOST_CHARACTERS else line[: MOST_CHARACTERS - 1] + "…" for line in lines[:3]]
    print("\n".join([f"pixelid: {cut[0]}", *cut[1:]]), file=sys.stderr)


def say(*lines: str) -> None:
    """Print lines that are not empty."""
    for line in lines:
        if line:
            click.echo(printable(line))


def say_sentences(sentences: Iterable[str]) -> None:
    """Print sentences as a list."""
    say(*(f"- {sentence}" for sentence in sentences if sentence))
