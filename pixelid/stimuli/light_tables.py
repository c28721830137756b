"""Light over time in a table of text: a photodiode's trace as a program or an oscilloscope writes it.

Rows before the numbers are a header, the last of which names the columns (or, where it holds units only, with the one
above it).  The unit of each column is in its name, in brackets, or in a comment line:

    t_s,radiance_lux          time [ms];irradiance [W/m²]          # unit: fA

`NAME.source.toml` next to the file states what it does not: `columns` (two names or numbers from 1: time, light),
`unit` of the light, `time_unit`.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import numpy as np

from pixelid.delimited import (
    COMMENTS,
    CONTROL,
    HEAD_BYTES,
    NO_ROW,
    SPACES,
    cells_of,
    encoding_of,
    is_number,
    split,
    with_points,
)
from pixelid.documents import read_toml, refuse_hollow, words_of
from pixelid.errors import InputError, first_line, shown
from pixelid.stimuli.light_times import DATE, TIME_WORDS, counted, of_dates, seconds, states_time
from pixelid.stimuli.light_units import LIGHT_WORDS, has_unit_of_light, is_unit, unit_of_light
from pixelid.time_units import SECONDS_PER, with_unit

CHANNEL = re.compile(
    r"c(h(an)?)?\d+v?|channel|volt(s|age)?|ampl|amplitude|signal|value|pd|diode|photocurrent|current|[a-d]|[1-4]"
)
LOGARITHM = re.compile(r"(log|ln|db)\d*$")
OVERFLOW = 1e30  # what oscilloscopes write for it, as 9.91e37, lies above, and no light does
MOST_ROWS, MOST_BYTES, HEAD_ROWS = 50_000_000, 2 << 30, 100
WAY = '; state them in NAME.source.toml: columns = ["time", "light"], by name or number from 1'


@dataclass(frozen=True)
class Stated:
    """What a user states of a table of light.

    Attributes:
        columns: of time and light, by name or by number from 1.
        unit: of the light.
        time_unit: a word of `SECONDS_PER`.
    """

    columns: tuple[str | int, ...] = ()
    unit: str | None = None
    time_unit: str | None = None

    @classmethod
    def of(cls, values: dict, where: str) -> Stated:
        """Of a document's values.  Raises InputError for others; `where` names them."""
        columns, unit, time_unit = values.get("columns", []), values.get("unit"), values.get("time_unit")
        if (
            not isinstance(columns, list)
            or len(columns) not in (0, 2)
            or not all(type(c) in (str, int) for c in columns)
        ):
            raise InputError(f"{where}: columns: expected two names or numbers, time and light, found {shown(columns)}")
        if time_unit is not None and time_unit not in SECONDS_PER:
            raise InputError(f"{where}: time_unit: expected s, ms, us, ns or min, found {shown(time_unit)}")
        return cls(tuple(columns), unit, time_unit)

    @classmethod
    def beside(cls, path: Path) -> Stated:
        """What `NAME.source.toml` states of a table."""
        file = path.with_suffix(".source.toml")
        if not file.is_file():
            return cls()
        document = read_toml(file)
        unknown = [key for key in document if key not in ("columns", "unit", "time_unit")]
        if unknown:
            raise InputError(f"{file}: expected columns, unit, time_unit, found {shown(unknown[0])}")
        return cls.of(document, str(file))


@dataclass
class _Table:
    """A table as text: what its header says, the lines of numbers, and the cells of the first of them."""

    names: list[str] = field(default_factory=list)
    lines: list[str] = field(default_factory=list)
    rows: list[list[str]] = field(default_factory=list)
    mark: str = ","
    comments: str = ""
    head: list[list[str]] = field(default_factory=list)


def is_text(path: Path) -> bool:
    """Whether a file begins as text, whatever its name."""
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
    return len(head) > 0 and (CONTROL.search(head) is None or encoding_of(head) == "utf-16")


def is_light_table(path: Path) -> bool:
    """Whether a table of text is no table of events, which names t, x, y, p or has four columns of numbers."""
    from pixelid.recordings.rules import named_columns

    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
    lines = [line.strip() for line in head.decode(encoding_of(head), "replace").splitlines()[:HEAD_ROWS]]
    rows = [cells_of(line.lstrip("#%/ "))[0] for line in lines if line]
    if any(named_columns(row)[0] is not None for row in rows):
        return False
    numbers = sum(map(is_number, rows[-2 if len(rows) > 1 else -1])) if rows else 0
    return numbers != 4 or not all(is_number(cell) for line in lines if line[:1] not in ("", "#", "%", "/")
                                   for cell in cells_of(line)[0])  # fmt: skip


def read_table(path: Path, stated: Stated, say: Callable[[str], object]) -> tuple[np.ndarray, np.ndarray, str]:
    """Times [s], light and its unit in a table of text.

    Args:
        path: the file.
        stated: by the caller, over what `NAME.source.toml` states.
        say: called with what is inferred, in a line.

    Raises:
        InputError: no numbers, or columns of which two must be stated.
    """
    refuse_hollow(path)
    if path.stat().st_size > MOST_BYTES:
        raise InputError(f"{path}: expected at most {MOST_BYTES >> 30} GiB, found {path.stat().st_size} bytes")
    file = Stated.beside(path)
    stated = Stated(stated.columns or file.columns, stated.unit or file.unit, stated.time_unit or file.time_unit)
    try:
        with path.open("rb") as raw:
            coding = encoding_of(raw.read(HEAD_BYTES))
        with path.open(encoding=coding, newline="") as text:
            table = _parsed(list(islice(text, MOST_ROWS)), path, stated.columns)
    except UnicodeError as error:
        raise InputError(f"{path}: expected text, found binary data") from error
    time, light = _columns(table, stated, path)
    name = table.names[light].strip() if light < len(table.names) else ""
    unit = stated.unit or unit_of_light(name, table.comments, table.head, path)
    values = _numbers(table, light, path)
    if (bad := np.flatnonzero(~(np.abs(values) < OVERFLOW))).size:
        raise InputError(f"{path}: expected light in every row, found {values[bad[0]]:g} in row {bad[0] + 1}, as an "
                         f"overflow is written ({bad.size} in all); cut or correct those rows")  # fmt: skip
    return _times(table, time, stated.time_unit, path, say), values, unit


def _parsed(lines: list[str], path: Path, stated: tuple[str | int, ...] = ()) -> _Table:
    """Comments, names and rows of the lines of a table; of those that are stated by number, the rows where they are."""
    remarks = [line for line in lines[:HEAD_ROWS] if line.lstrip().startswith(COMMENTS)]
    table = _Table(comments=" ".join(remarks))
    lines = [line for line in lines if not NO_ROW.match(line)]
    if len(lines) < 2:
        raise InputError(f"{path}: expected a header t,radiance and at least two rows, found {len(lines)} lines")
    table.mark = mark = cells_of(lines[-1].strip())[1]
    places = [column - 1 for column in stated if isinstance(column, int)]
    rows = (split(line.strip(), mark) for line in lines[:HEAD_ROWS])
    first = next((k for k, cells in enumerate(rows) if _is_data(cells, places)), None)
    if first is None:
        first = 1  # what is no number is named where it is read
    table.head = [split(line.strip(), mark) for line in lines[:first]]
    header = set(lines[:first])  # comes again where files are joined
    table.lines = [line for line in lines[first:] if line not in header]
    if not table.lines:
        raise InputError(f"{path}: expected a header t,radiance and at least two rows, found the header only")
    cells = [split(line.strip(), mark) for line in lines[first : first + HEAD_ROWS]]
    table.rows = with_points(cells, mark, str(path))
    if table.rows != cells and mark == ",":  # in quotes
        table.lines = [";".join(with_points([split(line.strip(), ",")], ",", str(path))[0]) for line in table.lines]
        table.mark = ";"
    elif table.rows != cells:
        table.lines = [line.replace(",", ".") for line in table.lines]
    named = [row for row in table.head if len([cell for cell in row if cell]) >= 2]
    if not named and remarks and len(last := cells_of(remarks[-1].strip().lstrip("#%/ "))[0]) == len(table.rows[0]):
        named = [last]
    table.names = named[-1] if named else []
    of_units = len(named) > 1 and all(is_unit(cell) for cell in named[-1] if cell)
    if of_units or (len(named) > 1 and any(map(is_number, named[-1]))):  # units, or an oscilloscope's settings
        units = [cell.strip("()[]") if is_unit(cell) else "" for cell in named[-1]]
        units += [""] * len(named[-2])
        table.names = [f"{name} [{unit}]" if unit else name for name, unit in zip(named[-2], units, strict=False)]
    return table


def _is_data(cells: list[str], places: list[int]) -> bool:
    """Whether a row holds numbers: all that is in it, or in the columns that are stated."""
    read = [cells[k] if k < len(cells) else "" for k in places] or [cell for cell in cells if cell]
    return len(read) >= 2 and all(is_number(cell) or DATE.fullmatch(cell) for cell in read)


def _columns(table: _Table, stated: Stated, path: Path) -> tuple[int, int]:
    """Places of time and light; of a table that counts samples without a column for it, -1 for the time."""
    if stated.columns:
        time, light = (_place(table, column, path) for column in stated.columns)
        return time, light
    filled = [k for k, name in enumerate(table.names) if name and k < len(table.rows[0]) and table.rows[0][k]]
    words = {k: words_of(table.names[k]) for k in filled}
    times = [k for k in filled if words[k] and words[k][0] in TIME_WORDS]
    times = times or [k for k in filled if states_time(table.names[k])]
    times = times or [k for k in filled if DATE.fullmatch(table.rows[0][k])]
    if not times and counted(table.head) is None:
        found = shown(", ".join(table.names) or ", ".join((table.head or table.rows)[0]), 80)
        raise InputError(f"{path}: expected columns t and radiance in the first line, found {found}{WAY}")
    others = [k for k in filled if k not in times[:1] and words[k]]
    lights = [k for k in others if any(word in LIGHT_WORDS or CHANNEL.fullmatch(word) for word in words[k])]
    lights = [k for k in lights if words[k] != ["channel"]] or lights  # that column holds numbers of channels
    lights = lights or [k for k in others if has_unit_of_light(table.names[k])]
    if len(table.names) < max(len([cell for cell in row if cell]) for row in table.rows):
        raise InputError(f"{path}: expected {len(table.names)} numbers in a row, as columns are named, found more; "
                         f"decimal commas need quotes or semicolons{WAY}")  # fmt: skip
    if any(LOGARITHM.match(word) for k in lights for word in words[k]):
        raise InputError(f"{path}: expected light itself, found its logarithm ({shown(table.names[lights[0]], 40)})")
    if len(lights) != 1:
        found = ", ".join(table.names[k] for k in (lights or others)) or "none"
        raise InputError(f"{path}: expected one column of light (radiance), found {shown(found, 80)}{WAY}")
    return times[0] if times else -1, lights[0]


def _place(table: _Table, column: str | int, path: Path) -> int:
    if isinstance(column, int):
        if not 1 <= column <= max(map(len, table.rows), default=0):
            raise InputError(f"{path}: columns: expected numbers from 1 to {len(table.rows[0])}, found {column}")
        return column - 1
    wanted = column.strip().lower()
    for plain in (str.lower, lambda name: re.sub(r"\s*[\[(].*", "", name).lower(), lambda name: with_unit(name)[0]):
        found = [k for k, name in enumerate(table.names) if plain(name.strip()) == wanted]
        if found:
            return found[0]
    raise InputError(f"{path}: columns: no column {column!r}; found {shown(', '.join(table.names), 80)}")


def _numbers(table: _Table, k: int, path: Path) -> np.ndarray:
    """(rows,) the numbers of a column."""
    mark = None if table.mark == SPACES else table.mark
    try:
        return np.loadtxt(table.lines, np.float64, delimiter=mark, usecols=(k,), ndmin=1, quotechar='"')
    except (ValueError, IndexError) as error:
        raise InputError(f"{path}: expected numbers in every row: {first_line(error)}") from None


def _times(table: _Table, k: int, stated: str | None, path: Path, say: Callable[[str], object]) -> np.ndarray:
    """(rows,) seconds; of dates, since the first."""
    if all(len(row) > k and DATE.fullmatch(row[k]) for row in table.rows if k >= 0):
        return of_dates([split(line, table.mark)[k] for line in table.lines], path) if k >= 0 else _of_steps(table)
    name = table.names[k] if k < len(table.names) else ""
    if stated is None and (settings := counted(table.head)) is not None and with_unit(name)[1] is None:
        return settings[0] + settings[1] * _numbers(table, k, path)
    return seconds(_numbers(table, k, path), name, table.comments, stated, say, path)


def _of_steps(table: _Table) -> np.ndarray:
    start, increment = counted(table.head) or (0.0, 1.0)
    return start + increment * np.arange(len(table.lines))
