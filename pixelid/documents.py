"""TOML and JSON files that nobody should trust, read in bounded time and memory, and said no to in one line.

A file is regular, UTF-8 (a byte order mark is skipped) and no larger than `MOST_BYTES`; what is in it is nested at most
`MOST_NESTED` deep, and its whole numbers fit 64 bits, as TOML 1.0 asks and JSON (RFC 8259, section 6) advises.
Python's parsers have no such limits: they recurse for every bracket, and take quadratic time for keys of many parts.
"""

from __future__ import annotations

import errno
import json
import math
import os
import re
import stat
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeGuard, cast

from pixelid.delimited import BYTE_ORDER_MARKS, encoding_of
from pixelid.errors import InputError, first_line, printable, shown

MOST_BYTES = {"TOML": 2 << 20, "JSON": 64 << 20, "CSV": 64 << 20}  # each is read within 5 s
MOST_NESTED = 64  # of what pixelid writes, gap.json is the deepest: 8

GREEK_MU = "\u03bc"  # which looks like the micro sign

# What TOML consists of, as far as nesting matters; every alternative consumes what it has looked at: linear time.
_TOKEN = re.compile(
    r'"""(?:[^"\\]|\\(?:.|\Z)|"(?!""))*+(?:"""|\Z|"+)|\'\'\'(?:[^\']|\'(?!\'\'))*+(?:\'\'\'|\Z|\'+)'
    r'|"(?:[^"\\\n]|\\(?:.|\Z))*+"?|\'[^\'\n]*+\'?|#[^\n]*+|[\[{]|[\]}]|\.|[=,\n]|[^"\'#\[\]{}.=,\n]++',
    re.DOTALL,
)


def read_toml(path: str | Path) -> dict[str, Any]:
    """A TOML file as a dictionary; control characters in its texts are left out.

    Raises:
        InputError: it is missing, too large, or not TOML.
    """
    text = read_text(path, "TOML").replace("\r\n", "\n")
    _check_structure(text, Path(path))
    try:
        document = tomllib.loads(text)
        _check(document)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not valid TOML: {first_line(error)}") from None
    return cast(dict[str, Any], _cleaned(document))


def read_json(path: str | Path) -> dict[str, Any]:
    """A JSON file that holds an object; control characters in its texts are left out.

    Raises:
        InputError: it is missing, too large, not JSON, or no object.
    """
    try:
        content = json.loads(read_text(path, "JSON"), parse_constant=_refuse_constant, parse_float=_finite)
        _check(content)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not valid JSON: {first_line(error)}") from None
    if not isinstance(content, dict):
        raise InputError(f"{path}: expected a JSON object, found {type(content).__name__}")
    return cast(dict[str, Any], _cleaned(content))


def read_text(path: str | Path, kind: str) -> str:
    """The text of a regular file of at most `MOST_BYTES[kind]`; nothing is waited for, pipes and devices are refused.

    Raises:
        InputError: naming the file and what is wrong.
    """
    most = MOST_BYTES[kind]
    try:
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
        with os.fdopen(handle, "rb") as file:
            status = os.fstat(handle)
            if not stat.S_ISREG(status.st_mode):
                raise InputError(f"{path}: expected a {kind} file, found a device, pipe or socket")
            content = file.read(most + 1)
    except (OSError, ValueError) as error:  # ValueError: a name with a null character
        raise InputError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from None
    if len(content) > most:
        raise InputError(f"{path}: expected {kind} of at most {most >> 20} MiB, found {status.st_size} bytes")
    try:
        return content.decode(encoding_of(content) if kind == "CSV" else BYTE_ORDER_MARKS.get(content[:2], "utf-8-sig"))
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: expected UTF-8 text, found other bytes at byte {error.start}") from None


def words_of(name: str) -> list[str]:
    """A column's name as words of small letters and digits: time [µs] → time, µs."""
    return [word for word in re.split(r"[^a-zµ0-9²]+", name.lower().replace(GREEK_MU, "µ")) if word]


def refuse_hollow(path: Path) -> None:
    """Refuse a large file of which next to nothing was ever written: reading its zeros takes as long as reading data.

    Raises:
        InputError: less than a thousandth of it lies on the disk.
    """
    size = path.stat().st_size
    hollow_bytes, most_ratio, most_extents = 64 << 20, 1000, 1000  # smaller files are read at once, whatever they hold
    if size < hollow_bytes or not hasattr(os, "SEEK_DATA"):
        return
    held, at = 0, 0
    with path.open("rb") as file:
        for _ in range(most_extents):
            try:
                begin = os.lseek(file.fileno(), at, os.SEEK_DATA)
                at = os.lseek(file.fileno(), begin, os.SEEK_HOLE)
            except OSError as error:
                if error.errno == errno.ENXIO:  # no data from here on
                    break
                return  # a file system that does not know
            held += at - begin
            if held * most_ratio >= size:
                return
    raise InputError(f"{path}: expected data, found a sparse file: {held} bytes on the disk stand for {size}")


def is_number(value: object) -> TypeGuard[int | float]:
    """Whether a document's value is a number: true and false are none, though Python counts with them."""
    return isinstance(value, int | float) and not isinstance(value, bool)


@contextmanager
def interpreting(path: str | Path, expected: str) -> Iterator[None]:
    """Turn what Python says about values of the wrong kind into an InputError that names the file.

    Args:
        path: the file whose content is interpreted inside the block.
        expected: what it should hold, in words.
    """
    try:
        yield
    except KeyError as error:
        raise InputError(f"{path}: expected {expected}, found no {shown(error.args[0])}") from error
    except (TypeError, ValueError, AttributeError, LookupError, ArithmeticError, RecursionError) as error:
        raise InputError(f"{path}: expected {expected}, found another kind of value ({first_line(error)})") from error


def _check_structure(text: str, path: Path) -> None:
    """Refuse nesting and keys that would take the parser out of its depth."""
    depth, parts = 0, 0
    most_parts = 64  # of a dotted key
    for token in _TOKEN.finditer(text):
        mark = token[0]
        if mark == ".":
            parts += 1
        elif mark in ("[", "{"):
            depth, parts = depth + 1, 0
        elif mark in ("]", "}"):
            depth -= 1
        elif mark in ("=", ",", "\n"):
            parts = 0
        if depth > MOST_NESTED or parts > most_parts:
            found = f"{MOST_NESTED} open brackets" if depth > MOST_NESTED else f"a key of {most_parts} parts"
            line = text.count("\n", 0, token.start()) + 1
            raise InputError(f"{path}: line {line}: expected a shallow TOML document, found more than {found}")


def _check(value: Any, depth: int = 0) -> None:
    """Raise ValueError for whole numbers beyond 64 bits, control characters in keys, and deep nesting."""
    if depth > MOST_NESTED:
        raise ValueError(f"nested more than {MOST_NESTED} deep")
    if isinstance(value, dict):
        for key, inner in value.items():
            if printable(key) != key or "\n" in key:
                raise ValueError(f"a key holds control characters: {shown(key)}")
            _check(inner, depth + 1)
    elif isinstance(value, list):
        for inner in value:
            _check(inner, depth + 1)
    elif isinstance(value, int) and not -(1 << 63) <= value < 1 << 63:
        raise ValueError("a whole number does not fit 64 bits")


def _cleaned(value: Any) -> Any:
    if isinstance(value, str):
        return printable(value)
    if isinstance(value, dict):
        return {key: _cleaned(inner) for key, inner in value.items()}
    return [_cleaned(inner) for inner in value] if isinstance(value, list) else value


def _finite(digits: str) -> float:
    value = float(digits)
    if not math.isfinite(value):  # 1e999
        raise ValueError("a number does not fit 64 bits")
    return value


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is no JSON number")
