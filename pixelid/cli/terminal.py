"""What commands print: plain text that any terminal shows whole, names never cut, nothing read as markup."""

from __future__ import annotations

import os
import re
import shutil
import sys
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import click

from pixelid.errors import Doubtful, SetAside, printable

MOST_CHARACTERS = 1000  # of a line of an error
VERDICTS = {
    "converged": "green", "named": "cyan", "none": "green", "misfit": "yellow", "at_bound": "yellow",
    "not_identified": "yellow", "ambiguous": "yellow", "unknown": "yellow", "not_converged": "red", "diverged": "red",
    "interrupted": "red",
}  # fmt: skip


class Judged(Protocol):
    """A result with a status."""

    @property
    def status(self) -> str: ...
    def summary(self, width: int | None = None) -> str: ...


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
    from pixelid.results import wrapped

    say(*(wrapped(f"- {sentence}", columns(), "  ") for sentence in sentences if sentence))


def say_result(result: Judged, out: Path | None = None, remarks: Iterable[str] = ()) -> None:
    """Print a result, its verdict coloured, and where its page is, if it has one."""
    say(*remarks)
    headline, line_break, rest = result.summary(columns()).partition("\n")
    click.echo(coloured(printable(headline), result.status) + line_break + printable(rest))
    if out is not None:
        say(str(out / "report.html"))


def columns() -> int | None:
    """Of the terminal that is printed to; None where there is none, and lines stay whole for whatever reads them."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


def coloured(text: str, status: str = "") -> str:
    """A line with the first word of `VERDICTS` in its colour, else all of it in that of `status`.

    The terminal may be set to show no colours.
    """
    if not sys.stdout.isatty() or os.environ.get("NO_COLOR"):
        return text
    words = "|".join(VERDICTS)
    shown, found = re.subn(
        rf"\b({words})\b", lambda word: click.style(word[1], fg=VERDICTS[word[1]], bold=True), text, count=1
    )
    return shown if found or status not in VERDICTS else click.style(text, fg=VERDICTS[status], bold=True)
