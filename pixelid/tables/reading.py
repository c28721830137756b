"""Read a table of a CSV file: a header, one row per line, `#` lines are remarks, empty cells were not measured.

Cells are separated by commas, semicolons or tabs; numbers may have decimal commas where commas are not the mark.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from pixelid.delimited import SPACES, cells_of, with_points
from pixelid.documents import read_text
from pixelid.errors import InputError, did_you_mean, printable, shown


@dataclass(frozen=True)
class TextTable:
    """The cells of a CSV file as text.

    Attributes:
        path: where it came from.
        names: of the columns.
        rows: cells by row, as many as there are names.
    """

    path: Path
    names: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def text(self, name: str) -> list[str]:
        """The cells of a column.  Raises InputError when there is none of that name."""
        if name not in self.names:
            found = f"{', '.join(self.names)}{did_you_mean(name, self.names)}"
            raise InputError(f"{self.path}: no column {name!r}; found {found}")
        return [row[self.names.index(name)].strip() for row in self.rows]

    def numbers(self, name: str) -> np.ndarray:
        """(rows,) a column of finite numbers, NaN for empty cells.  Raises InputError naming row and cell."""
        return np.array([_number(self.path, k, cell) for k, cell in enumerate(self.text(name), 1)])

    def check(self, name: str, allowed: np.ndarray, expected: str) -> None:
        """Raise InputError that names the first row (n,) of a column that is not `allowed`, and what it holds."""
        if not allowed.all():
            k = int(np.argmin(allowed))
            raise InputError(
                f"{self.path}: {name}: row {k + 1}: expected {expected}, found {shown(self.text(name)[k])}"
            )

    def last_digit(self, names: tuple[str, ...]) -> float:
        """The smallest difference that the cells of these columns can write.

        Counts over a time are no whole multiples of a last digit.  Where cells hold zeros and the others are written
        with far more digits than they have, the smallest difference between two of them stands for it.
        """
        cells = [cell for name in names for cell in self.text(name) if cell]
        digit = 10.0 ** min((_exponent(cell) for cell in cells), default=0)
        values = np.concatenate([self.numbers(name) for name in names]) if names else np.zeros(0)
        different = np.unique(values[np.isfinite(values)])
        full_precision = 1e-3  # of the smallest value: digits beyond are of a quotient, not of a measurement
        if len(different) < 2 or different[0] != 0 or digit >= full_precision * different[1]:
            return digit
        gaps = np.diff(different)
        rounding = 1e-9  # relative, of two cells that are one number
        return float(gaps[gaps > rounding * different[1:]].min())


def _exponent(cell: str) -> int:
    """Of ten, in the last digit that a cell writes, 0 at most; 0 for one that is no number."""
    try:
        exponent = Decimal(cell).as_tuple().exponent
    except InvalidOperation:
        return 0
    most_places = 17  # behind the point
    return max(min(exponent, 0), -most_places) if isinstance(exponent, int) else 0


def read_text_table(path: Path, *, first: str, expected: str) -> TextTable:
    """The table of a CSV file.

    Args:
        path: the file.
        first: how the name of the first column begins (in lower case).
        expected: the header in words, for the error.

    Raises:
        InputError: naming the file, and the row that is wrong.
    """
    path = Path(path)
    text = printable(read_text(path, "CSV"))
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    mark = cells_of(lines[0])[1] if lines else ","
    try:
        rows = list(csv.reader(lines, delimiter="," if mark == SPACES else mark))
    except csv.Error as error:
        raise InputError(f"{path}: expected a text table, found {error}") from None
    rows = [*rows[:1], *with_points(rows[1:], mark, str(path))]
    if not rows or len(rows[0]) < 2 or not rows[0][0].strip().lower().startswith(first):
        raise InputError(
            f"{path}: expected a header line {expected}, found {shown(lines[0], 60) if lines else 'nothing'}"
        )
    for k, row in enumerate(rows[1:], 1):
        if len(row) != len(rows[0]):
            raise InputError(f"{path}: row {k} has {len(row)} cells, expected {len(rows[0])}")
    names = tuple(name.strip() for name in rows[0])
    if len(set(names)) < len(names):
        raise InputError(f"{path}: expected columns of different names, found {shown(names, 200)}")
    return TextTable(path, names, tuple(tuple(row) for row in rows[1:]))


def _number(path: Path, row: int, cell: str) -> float:
    if not cell:
        return float("nan")
    try:
        value = float(cell if "_" not in cell else "")  # Python reads 1_000, nobody else does
    except ValueError as error:
        raise InputError(f"{path}: row {row}: expected a number, found {shown(cell)}") from error
    if not np.isfinite(value):
        raise InputError(f"{path}: row {row}: expected a finite number, found {shown(cell)}")
    return value
