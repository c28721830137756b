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

from pixelid.delimited import COMMENTS, SPACES, cells_of, encoding_of, is_number, split, with_points
from pixelid.documents import interpreting, read_toml, refuse_hollow, words_of
from pixelid.errors import InputError, first_line, shown
from pixelid.stimuli.stimulus import UNITS as USUAL

# Words behind a column's name that are a unit; another may be a part of the name.
UNITS = (
    *USUAL,
    "klux",
    "cd/m2",
    "W",
    "mW",
    "uW",
    "nW",
    "W/cm2",
    "mW/cm2",
    "uW/cm2",
    "V",
    "mV",
    "A",
    "mA",
    "uA",
    "nA",
    "pA",
    "counts",
    "DN",
    "photons/s",
)
LIGHT_WORDS = (
    "radiance",
    "irradiance",
    "illuminance",
    "light",
    "photodiode",
    "luminance",
    "intensity",
    "voltage",
    "lux",
)
CHANNEL = re.compile(r"ch\d+|channel|volts?|ampl|amplitude|signal|pd|diode|photocurrent|current|[a-d]|[1-4]")
# Words in the name of a column of times that are no unit.
BESIDE_TIME = (
    "time", "t", "stamp", "timestamp", "since", "start", "of", "the", "in", "from", "elapsed", "relative", "rel", "abs",
    "absolute", "0", "zero", "clock", "axis", "unit", "units", "camera", "sensor", "light", "photodiode", "led",
    "trigger",
)  # fmt: skip
TIME_IN = re.compile(r"(?:^|[#;,.:])\s*times?\W+(?:is |are )?in\W+([^\W\d_]+)", re.I)  # of a comment
TIME_WORDS = ("t", "time", "timestamp", "seconds", "second", "x")
SECONDS_PER = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), 1.0), **dict.fromkeys(("min", "minutes"), 60.0),
    **dict.fromkeys(("ms", "msec", "millisecond", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "µs", "usec", "microsecond", "microseconds"), 1e-6),
    **dict.fromkeys(("ns", "nsec", "nanosecond", "nanoseconds"), 1e-9),
}  # fmt: skip
UNIT_WORDS = {
    **{unit.lower(): unit for unit in UNITS}, "lx": "lux", "w/m²": "W/m2", "w/m^2": "W/m2", "w_m2": "W/m2",
    "wm2": "W/m2", "volt": "V", "volts": "V", "µa": "uA", "µw": "uW", "ampere": "A", "cd/m²": "cd/m2",
    "µw/cm²": "uW/cm2", "µw/cm2": "uW/cm2", "mw/cm²": "mW/cm2", "w/cm²": "W/cm2", "count": "counts", "adu": "DN",
}  # fmt: skip
IN_BRACKETS = re.compile(r"[\[(]\s*([^\])]+?)\s*[\])]")
SUFFIX = re.compile(r"_([^\W\d_][\w/²^]*)$")
NO_UNIT = ("", "au", "a.u.", "arb", "arb.", "1", "-", "norm", "normalised", "normalized")
DATE = re.compile(r"\d{4}-\d\d-\d\d[ T]\d\d:\d\d:\d\d(\.\d+)?")
MOST_ROWS, MOST_BYTES, HEAD_ROWS = 50_000_000, 2 << 30, 100
HEAD_BYTES = 1 << 16  # in which a table's header lies


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


def is_light_table(path: Path) -> bool:
    """Whether a text file holds light over time, not events: by the names of its columns."""
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
    text = head.decode(encoding_of(head), "replace")
    lines = [line for line in text.splitlines()[:HEAD_ROWS] if line.strip() and not line.lstrip().startswith("#")]
    file = path.with_suffix(".source.toml")
    if file.is_file() and len(read_toml(file).get("columns", ())) == 2:
        return True
    if lines and len(cells_of(lines[-2 if len(lines) > 1 else -1].strip())[0]) in (2, 3):
        return True  # events have four columns
    try:
        names = [re.split(r"[^a-z0-9µ]+", name.lower()) for name in _parsed(lines[:-1] or lines, path).names]
    except InputError:
        return False
    light = any(word in LIGHT_WORDS for name in names for word in name)
    channel = any(name[0] in TIME_WORDS for name in names) and not any(name[0] in ("y", "p") for name in names)
    return len(names) >= 2 and (light or (channel and any(CHANNEL.fullmatch(word) for n in names for word in n)))


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
            coding = encoding_of(raw.read(2))
        with path.open(encoding=coding, newline="") as text:
            table = _parsed(list(islice(text, MOST_ROWS)), path)
    except UnicodeError as error:
        raise InputError(f"{path}: expected text, found binary data") from error
    time, light = _columns(table, stated, path)
    t, radiance = _times(table, time, stated, path, say), _numbers(table, light, path)
    return t, radiance, stated.unit or _unit(table, light, path)


def _parsed(lines: list[str], path: Path) -> _Table:
    """Comments, names and rows of the lines of a table."""
    table = _Table(comments=" ".join(line for line in lines[:HEAD_ROWS] if line.lstrip().startswith("#")))
    lines = [line for line in lines if line.strip() and not line.lstrip().startswith(COMMENTS)]
    if len(lines) < 2:
        raise InputError(f"{path}: expected a header t,radiance and at least two rows, found {len(lines)} lines")
    table.mark = mark = cells_of(lines[-1].strip())[1]
    first = next((k for k, line in enumerate(lines[:HEAD_ROWS]) if _is_data(split(line.strip(), mark))), None)
    if first is None:
        first = 1  # what is no number is named where it is read
    table.head = [split(line.strip(), mark) for line in lines[:first]]
    table.lines = lines[first:]
    cells = [split(line.strip(), mark) for line in lines[first : first + HEAD_ROWS]]
    table.rows = with_points(cells, mark, str(path))
    if table.rows != cells:
        table.lines = [line.replace(",", ".") for line in table.lines]
    named = [row for row in table.head if len([cell for cell in row if cell]) >= 2]
    table.names = named[-1] if named else []
    of_units = len(named) > 1 and all(_is_unit(cell) for cell in named[-1] if cell)
    if of_units or (len(named) > 1 and any(map(is_number, named[-1]))):  # units, or an oscilloscope's settings
        units = [cell.strip("()[]") if _is_unit(cell) else "" for cell in named[-1]]
        units += [""] * len(named[-2])
        table.names = [f"{name} [{unit}]" if unit else name for name, unit in zip(named[-2], units, strict=False)]
    return table


def _is_data(cells: list[str]) -> bool:
    filled = [cell for cell in cells if cell]
    return len(filled) >= 2 and all(is_number(cell) or DATE.fullmatch(cell) for cell in filled)


def _is_unit(cell: str) -> bool:
    word = cell.strip("()[] ").lower()
    return word in SECONDS_PER or word in UNIT_WORDS or word in NO_UNIT


def _columns(table: _Table, stated: Stated, path: Path) -> tuple[int, int]:
    """Places of time and light."""
    if stated.columns:
        time, light = (_place(table, column, path) for column in stated.columns)
        return time, light
    words = [words_of(name) for name in table.names]
    times = [k for k, name in enumerate(words) if name and name[0] in TIME_WORDS]
    if not times:
        shown_head = shown(", ".join(table.names) or ", ".join((table.head or table.rows)[0]), 80)
        raise InputError(f"{path}: expected columns t and radiance in the first line, found {shown_head}{_way(table)}")
    others = [k for k in range(len(words)) if k != times[0] and words[k]]
    lights = [k for k in others if any(word in LIGHT_WORDS for word in words[k])]
    lights = lights or [k for k in others if any(CHANNEL.fullmatch(word) for word in words[k])]
    if len(lights) != 1:
        found = ", ".join(table.names[k] for k in (lights or others)) or "none"
        raise InputError(f"{path}: expected one column of light (radiance), found {shown(found, 80)}{_way(table)}")
    return times[0], lights[0]


def _way(table: _Table) -> str:
    return '; state them in NAME.source.toml: columns = ["time", "light"], by name or number from 1'


def _place(table: _Table, column: str | int, path: Path) -> int:
    if isinstance(column, int):
        if not 1 <= column <= max(map(len, table.rows), default=0):
            raise InputError(f"{path}: columns: expected numbers from 1 to {len(table.rows[0])}, found {column}")
        return column - 1
    found = [k for k, name in enumerate(table.names) if name.strip().lower() == column.strip().lower()]
    if not found:
        raise InputError(f"{path}: columns: no column {column!r}; found {shown(', '.join(table.names), 80)}")
    return found[0]


def _numbers(table: _Table, k: int, path: Path) -> np.ndarray:
    """(rows,) the numbers of a column."""
    mark = None if table.mark == SPACES else table.mark
    try:
        return np.loadtxt(table.lines, np.float64, delimiter=mark, usecols=(k,), ndmin=1, quotechar='"')
    except (ValueError, IndexError) as error:
        raise InputError(f"{path}: expected numbers in every row: {first_line(error)}") from None


def _is_float(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _times(table: _Table, k: int, stated: Stated, path: Path, say: Callable[[str], object]) -> np.ndarray:
    """(rows,) seconds; of dates, since the first."""
    name = table.names[k] if k < len(table.names) else ""
    if all(len(row) > k and DATE.fullmatch(row[k]) for row in table.rows):
        cells = [split(line, table.mark)[k].replace(" ", "T") for line in table.lines]
        with interpreting(path, "a date and time in every row"):
            dates = np.array(cells, "datetime64[ns]")
        return (dates - dates[0]).astype(np.int64) * 1e-9
    counted = _sequence(table, k)
    if counted is not None:
        start, increment = counted
        return start + increment * _numbers(table, k, path)
    words = words_of(name)
    comment = [word for found in TIME_IN.findall(table.comments) for word in words_of(found)]
    units = [SECONDS_PER[word] for word in (*words[1:], *words[:1], *comment) if word in SECONDS_PER]
    unknown = [word for word in words[1:] if word not in SECONDS_PER and word not in BESIDE_TIME]
    if stated.time_unit:
        return _numbers(table, k, path) * SECONDS_PER[stated.time_unit]
    if not units and unknown and not stated.columns:
        raise InputError(f"{path}: unit of the times: expected s, ms, us, ns or min, found {shown(unknown[0], 30)}")
    if not units:
        say(f"{path.name}: {name or 'time'} taken as s: no unit stated")
    return _numbers(table, k, path) * (units[0] if units else 1.0)


def _sequence(table: _Table, k: int) -> tuple[float, float] | None:
    """Start and increment [s] of a column that counts samples, as some oscilloscopes write in their header."""
    for names, values in zip(table.head, table.head[1:], strict=False):
        places = {name.strip().lower(): place for place, name in enumerate(names)}
        if {"start", "increment"} <= set(places) and max(places["start"], places["increment"]) < len(values):
            start, increment = values[places["start"]], values[places["increment"]]
            if _is_float(start) and _is_float(increment) and float(increment) > 0:
                return float(start), float(increment)
    return None


def _unit(table: _Table, k: int, path: Path) -> str:
    """The unit of a column of light: in its name, else in a comment; `relative` where none is stated."""
    name = table.names[k].strip() if k < len(table.names) else ""
    bracket, suffix = IN_BRACKETS.search(name), SUFFIX.search(name)
    for found in (bracket, suffix):
        word = found[1].strip().lower().replace("\u03bc", "µ") if found else ""
        if word in NO_UNIT and found:
            return "relative"
        if word in UNIT_WORDS:
            return UNIT_WORDS[word]
        if found is bracket and found:
            raise InputError(f"{path}: unit of the light: expected one of {', '.join(UNITS)}, found {shown(found[1])}")
    named = unit_in(name) or unit_in(" ".join(re.findall(r"unit\s*[:=]\s*(\S+)", table.comments, re.I)))
    if named is None and suffix and words_of(name)[0] in LIGHT_WORDS:
        raise InputError(
            f"{path}: unit of the light: {shown(suffix[1])} of {shown(name)} is none of {', '.join(UNITS)}; "
            'state it in NAME.source.toml: unit = "relative"'
        )
    return named or "relative"


def unit_in(text: str) -> str | None:
    """A unit among the words of a text."""
    text = text.lower()
    for word, unit in UNIT_WORDS.items():
        if len(word) > 1 and re.search(rf"(^|[^a-z/]){re.escape(word)}($|[^a-z0-9²/])", text):
            return unit
    return None
