"""Errors a user can act on.

`InputError` is for bad input or usage (exit code 2): its message names the file, the field, what was
expected and what was found.  `UntrustworthyResult` is for a computation that ran but must not be believed
(exit code 1); it carries the advice that the result's JSON repeats.
"""

from __future__ import annotations


class PixelidError(Exception):
    """Base of every error raised on purpose by pixelid."""

    exit_code = 1


class InputError(PixelidError):
    """Input that cannot be used: the message says which, what was expected and what was found."""

    exit_code = 2


class UntrustworthyResult(PixelidError):
    """A computation that finished without an answer that deserves trust."""

    exit_code = 1

    def __init__(self, message: str, advice: str = "") -> None:
        super().__init__(message)
        self.advice = advice
