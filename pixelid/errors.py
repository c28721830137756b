"""Errors a user can act on.

`InputError` is for bad input or usage (exit code 2): its message names the file, the field, what was
expected and what was found.  `UntrustworthyResult` is for a computation that ran but must not be believed
(exit code 1); it carries the advice that the result's JSON repeats.
"""

from __future__ import annotations

from collections.abc import Iterable


class PixelidError(Exception):
    """Base of every error raised on purpose by pixelid."""

    exit_code = 1


class InputError(PixelidError):
    """Input that cannot be used: the message says which, what was expected and what was found."""

    exit_code = 2


class OutputError(PixelidError):
    """A result that could not be written: disk full, no permission, another run at work on it.

    What was there before is still there.
    """

    exit_code = 2


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
