"""Errors a user can act on, and what may stand in their messages.

`InputError` is for bad input or usage (exit code 2): its message names the file, the field, what was
expected and what was found.  `UntrustworthyResult` is for a computation that ran but must not be believed
(exit code 1); it carries the advice that the result's JSON repeats.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

# Control characters, also those that turn the direction of text: nothing that a terminal or a page should be sent.
_UNPRINTABLE = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069\ud800-\udfff\ufffe\uffff]"
)


# In messages `--name` marks a parameter; what is a command's stands in backquotes and stays.
_PARAMETER = re.compile(r"`[^`]*`|(?<![\w-])--([a-z][a-z0-9]*(?:-[a-z0-9]+)*)(?![\w-])(?: (\w+)(?=[)\n]))?")
_IN_PYTHON = {
    "fix": "fixed", "recorded": "recordings", "train": "trained", "steps": "iterations", "out": "path",
    "overwrite": "overwrite=True", "with": "with_effect", "without": "without_effect", "set": ".set()",
}  # fmt: skip
_reader = {"words": "Python"}


@contextmanager
def on_command_line() -> Iterator[None]:
    """Until the end of the block, messages name parameters as the command line does."""
    before = _reader["words"]
    _reader["words"] = "command line"
    try:
        yield
    finally:
        _reader["words"] = before


def spelled(text: str) -> str:
    """A message whose parameters are named as its reader writes them.

    >>> spelled("--pixel-levels: expected a name; `pixelid convert --align` says more; add --with leak")
    'pixel_levels: expected a name; `pixelid convert --align` says more; add with_effect leak'
    """
    if _reader["words"] == "command line":
        return text

    def in_python(match: re.Match[str]) -> str:
        if match[1] is None:
            return match[0]
        name = _IN_PYTHON.get(match[1], match[1].replace("-", "_"))
        return (
            name
            if match[2] is None
            else (f'{name}("{match[2]}")' if name.endswith("_effect") else f"{name} {match[2]}")
        )

    return _PARAMETER.sub(in_python, text)


class PixelidError(Exception):
    """Base of every error raised on purpose by pixelid."""

    exit_code = 1

    def __str__(self) -> str:
        return spelled(super().__str__())


class InputError(PixelidError):
    """Input that cannot be used: the message says which, what was expected and what was found."""

    exit_code = 2


class OutputError(PixelidError):
    """A result that could not be written: disk full, no permission, another run at work on it.

    What was there before is still there.
    """

    exit_code = 2


class Doubtful(UserWarning):
    """What a user gave can be used, and is hardly what was meant."""


class SetAside(UserWarning):
    """What an earlier run kept cannot be used: it was renamed, and is computed again."""


class UntrustworthyResult(PixelidError):
    """A computation that finished without an answer that deserves trust."""

    exit_code = 1

    def __init__(self, message: str, advice: str = "") -> None:
        super().__init__(message)
        self.advice = advice


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """The words " (did you mean 'leak'?)" when a known name is close to the one given, else nothing.

    >>> did_you_mean("leek", ["leak", "dark_current"])
    " (did you mean 'leak'?)"
    """
    import difflib

    close = difflib.get_close_matches(str(name), list(known), n=1, cutoff=0.6)
    return f" (did you mean {close[0]!r}?)" if close else ""


def printable(text: str) -> str:
    """`text` without control characters; line breaks and tabs stay.

    >>> printable("\x1b[31mred\x1b[0m")
    '[31mred[0m'
    """
    return _UNPRINTABLE.sub("", text)


def shown(value: object, most: int = 60) -> str:
    """A value in a message: short, on one line."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # an integer of more digits than Python writes
        text = type(value).__name__
    return printable(text if len(text) <= most else text[: most - 1] + "…")


def first_line(error: Exception) -> str:
    """What an exception says, in a message: short, on one line."""
    if isinstance(error, RecursionError):
        return "nested too deeply"
    lines = printable(str(error)).splitlines()
    return lines[0][:160] if lines else type(error).__name__
