"""Options are data: one frozen dataclass per analysis, which its function, its command and its checks read.

    @dataclass(frozen=True)
    class Options(Checked):
        cells: int | None = option(None, "cells of the field per side", low=8, high=512)

A field states its default, its bounds, its words and, where a number decides something, the reason for that number.
Kinds are read from annotations, which a module of options postpones (`from __future__ import annotations`).
"""

from __future__ import annotations

import inspect
import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from numbers import Integral, Real
from pathlib import Path
from typing import Any, TypeVar

from pixelid.errors import InputError, shown

F = TypeVar("F", bound=Callable[..., Any])


@dataclass(frozen=True)
class Statement:
    """What a field of an options class states beyond its name, kind and default.

    Attributes:
        help: what it is, in the words of the command's help, its unit included.
        low, high: bounds of a number, both allowed.
        above: bound of a number that is not allowed itself.
        choices: the words that it may be, or of which it may hold several.
        count: how many numbers it takes together.
        word: that may stand in place of a number.
        flags: names on the command line, where these are not the field's.
        metavar: what the command line calls its values.
        also: types that the function takes in addition to its own.
        why: reason for the default or the bounds.
    """

    help: str
    low: float = -math.inf
    high: float = math.inf
    above: float = -math.inf
    choices: tuple[str, ...] = ()
    count: int = 0
    word: str = ""
    flags: tuple[str, ...] = ()
    metavar: str | None = None
    also: str = ""
    why: str = ""


@dataclass(frozen=True)
class Option:
    """One field of an options class.  kind: a word of `_checked`."""

    name: str
    kind: str
    default: Any
    annotation: str
    stated: Statement


def option(default: Any, help: str, **stated: Any) -> Any:
    """A field of an options class; the keywords are those of `Statement`."""
    return field(default=default, metadata={"stated": Statement(help, **stated)})


def options_of(cls: type) -> tuple[Option, ...]:
    """The fields of an options class that state something, in order."""
    stated = [f for f in fields(cls) if "stated" in f.metadata]
    return tuple(Option(f.name, _kind(str(f.type)), f.default, str(f.type), f.metadata["stated"]) for f in stated)


def _kind(annotation: str) -> str:
    first = annotation.split(" | ")[0]
    kinds = {"tuple[str, ...]": "words", "tuple[float, ...]": "numbers", "tuple[int, ...]": "wholes"}
    return kinds.get(first, first)


class Checked:
    """Checks every field against what it states; paths and tuples may be given as text and lists.

    Raises:
        InputError: a value of another kind, or out of bounds; it names the field.
    """

    def __post_init__(self) -> None:
        for of in options_of(type(self)):
            value = getattr(self, of.name)
            if value is not None or of.default is not None:
                object.__setattr__(self, of.name, _checked(of, value))


def _checked(of: Option, value: Any) -> Any:
    name, stated = of.name, of.stated
    if of.kind == "Path":
        if not isinstance(value, str | os.PathLike):
            raise InputError(f"{name}: expected a path, found {shown(value)}")
        return Path(value)
    if of.kind == "bool":
        if not isinstance(value, bool):
            raise InputError(f"{name}: expected True or False, found {shown(value)}")
        return value
    if of.kind == "words":
        if isinstance(value, str) or not isinstance(value, Sequence):
            raise InputError(f"{name}: expected a list of {', '.join(stated.choices)}, found {shown(value)}")
        return tuple(one_of(name, word, stated.choices) for word in value)
    if of.kind == "numbers":
        return numbers(name, value, stated.count, least=stated.low)
    if of.kind == "wholes":
        numbers(name, value, stated.count)
        return tuple(whole_number(name, one, int(stated.low), int(stated.high)) for one in value)
    if of.kind == "int":
        if stated.word and isinstance(value, str) and value == stated.word:
            return value
        or_else = f" or {stated.word!r}" if stated.word else ""
        return whole_number(name, value, int(stated.low), int(stated.high), or_else)
    if of.kind == "float":
        return number(name, value, above=stated.above, least=stated.low)
    if stated.choices:
        return one_of(name, value, stated.choices)
    if not isinstance(value, str):
        raise InputError(f"{name}: expected text, found {shown(value)}")
    return value


def takes(cls: type) -> Callable[[F], F]:
    """Let a function with `**options` show the fields of `cls` in its signature, and in place of a line `**options`
    in its docstring."""

    def decorate(function: F) -> F:
        own = inspect.signature(function)
        every = options_of(cls)
        new = [
            inspect.Parameter(of.name, inspect.Parameter.KEYWORD_ONLY, default=of.default, annotation=_taken(of))
            for of in every
        ]
        kept = [p for p in own.parameters.values() if p.kind is not inspect.Parameter.VAR_KEYWORD]
        first = [p for p in kept if p.kind is not inspect.Parameter.KEYWORD_ONLY]
        later = [p for p in kept if p.kind is inspect.Parameter.KEYWORD_ONLY]
        function.__signature__ = own.replace(parameters=[*first, *new, *later])  # type: ignore[attr-defined]
        lines = "\n".join(f"        {of.name}: {described(of)}" for of in every)
        function.__doc__ = (function.__doc__ or "").replace("        **options", lines)
        return function

    return decorate


def _taken(of: Option) -> str:
    """The annotation of an option in a function that users call: paths may be text."""
    annotation = of.annotation.replace("Path", "str | Path")
    return f"{of.stated.also} | {annotation}" if of.stated.also else annotation


def described(of: Option) -> str:
    """What an option is, with its choices and the word that stands for a number."""
    help = of.stated.help[:1].lower() + of.stated.help[1:]
    words = ", ".join(f'"{word}"' for word in of.stated.choices or ((of.stated.word,) if of.stated.word else ()))
    return f"{help}  ({words})" if words else help


def one_of(name: str, value: Any, known: Sequence[str]) -> str:
    """The word itself.  Raises InputError for one that is not known.

    >>> one_of("scale", "level", ("auto", "level", "free"))
    'level'
    """
    if not isinstance(value, str) or value not in known:
        raise InputError(f"{name}: expected {', '.join(known[:-1])} or {known[-1]}, found {shown(value)}")
    return value


def whole_number(name: str, value: Any, least: int, most: int, or_else: str = "") -> int:
    """The number.  Raises InputError for one below `least` or above `most`, and for anything else."""
    if isinstance(value, bool) or not isinstance(value, Integral) or not least <= int(value) <= most:
        raise InputError(f"{name}: expected a whole number from {least} to {most}{or_else}, found {shown(value)}")
    return int(value)


def number(name: str, value: Any, *, above: float = -math.inf, least: float = -math.inf) -> float:
    """The number.  Raises InputError for one that is not finite, not above `above` or below `least`, and for others."""
    try:
        read = float(value) if isinstance(value, Real) and not isinstance(value, bool) else math.nan
    except OverflowError:  # a whole number of hundreds of digits
        read = math.nan
    if not (math.isfinite(read) and read > above and read >= least):
        low = f" above {above:g}" if above > -math.inf else f" of at least {least:g}" if least > -math.inf else ""
        raise InputError(f"{name}: expected a finite number{low}, found {shown(value)}")
    return read


def numbers(name: str, values: Any, many: int, *, least: float = -math.inf) -> tuple[float, ...]:
    """So many numbers.  Raises InputError for more or fewer, and for one that `number` refuses."""
    try:
        given = () if isinstance(values, str) else tuple(values)
    except TypeError:
        given = ()
    if len(given) != many:
        raise InputError(f"{name}: expected {many} numbers, found {shown(values)}")
    return tuple(number(name, value, least=least) for value in given)
