"""Text in cells, as spreadsheets, oscilloscopes and programs of any country write it: marks, quotes, decimal commas."""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Sequence

from pixelid.errors import InputError, shown

SPACES = r"\s+"
NUMBER = re.compile(r"[-+]?(\d+[.,]?\d*|[.,]\d+)([eE][-+]?\d+)?|nan|true|false", re.I)
DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?|[-+]?\d+,\d*[eE][-+]?\d+")
COMMENTS = ("#", "%", "//")
NO_ROW = re.compile(r"\s*(?:[#%]|//|(?:nan|[\s,;])*$)", re.I)  # a comment, or a line without any number
CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1f\x7f\x81\x8d\x8f\x90\x9d]")  # in no text of one byte a letter
HEAD_BYTES = 1 << 16  # in which a text's coding shows, and a table's header lies
BYTE_ORDER_MARKS = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}


def encoding_of(first: bytes) -> str:
    """The coding of a text by its first bytes: UTF-16 where it is marked, else UTF-8, else Windows' of the West.

    >>> encoding_of(b"\\xff\\xfet\\x00"), encoding_of(b"t,x"), encoding_of(b"t [\\xb5s]")
    ('utf-16', 'utf-8-sig', 'cp1252')
    """
    if first[:2] in BYTE_ORDER_MARKS:
        return BYTE_ORDER_MARKS[first[:2]]
    try:
        codecs.getincrementaldecoder("utf-8")().decode(first)  # a letter may be cut at the end
    except UnicodeDecodeError:
        return "utf-8-sig" if CONTROL.search(first) else "cp1252"
    return "utf-8-sig"


def cells_of(line: str) -> tuple[list[str], str]:
    """The cells of a line without their quotes, and what they are apart by: ; tab , or white space.

    >>> cells_of('"t [ns]";x')
    (['t [ns]', 'x'], ';')
    >>> cells_of("0,0011 238 62 0")
    (['0,0011', '238', '62', '0'], '\\\\s+')
    """
    words = line.split()
    with_commas = [word for word in words if "," in word]
    decimal_commas = len(words) > 1 and all(NUMBER.fullmatch(word) and word[-1] != "," for word in with_commas)
    for mark in (";", "\t", ","):
        if mark in line and not (mark == "," and decimal_commas):
            return split(line, mark), mark
    return words, SPACES


def split(line: str, mark: str) -> list[str]:
    """The cells of a line that are apart by a mark; none where a cell is longer than any cell is."""
    if mark == SPACES:
        return line.split()
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=mark, skipinitialspace=True), [])]
    except csv.Error:
        return []


def is_number(cell: str) -> bool:
    """Whether a cell is a number, with a decimal point or comma."""
    return NUMBER.fullmatch(cell) is not None


def with_points(rows: Sequence[Sequence[str]], mark: str, where: str) -> list[list[str]]:
    """Cells with decimal points where the file has decimal commas, which lie in quotes where commas are the mark.

    Raises:
        InputError: some numbers have commas and others points.
    """
    commas = any(DECIMAL_COMMA.fullmatch(cell) for row in rows for cell in row)
    if not commas:
        return [list(row) for row in rows]
    for row in rows:
        for cell in row:
            if "." in cell and is_number(cell.replace(",", "")):
                raise InputError(f"{where}: decimal commas and points in one table: {shown(cell)}; write one of them")
    return [[cell.replace(",", ".") if DECIMAL_COMMA.fullmatch(cell) else cell for cell in row] for row in rows]
