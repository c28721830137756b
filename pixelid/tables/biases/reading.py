"""Read tables of quantities against bias codes: which column is what, and which unit, is inferred and stated.

Columns `bias_*` are codes; one numeric column, known by its name, is the quantity (`dead_time_us`, `refractory_us`,
`threshold`, `cutoff_hz`, `latency_ms`, or any with a unit); `polarity` splits it into ON and OFF; `NAME_sd`, `NAME_err`
is its error; a column named mismatch or spread is that between pixels.  What two readings are possible of is refused.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from pixelid.documents import interpreting, read_json
from pixelid.errors import InputError, shown
from pixelid.tables.rates.bias_law import biases_of
from pixelid.tables.reading import TextTable, read_text_table

UNITS = {"s": ("s", 1.0), "ms": ("s", 1e-3), "us": ("s", 1e-6), "µs": ("s", 1e-6), "ns": ("s", 1e-9),
         "hz": ("Hz", 1.0), "khz": ("Hz", 1e3), "mhz": ("Hz", 1e6), "log": ("log radiance", 1.0)}  # fmt: skip
KINDS = {  # kind → (words in a column's name, SI unit)
    "refractory_s": (("refractory", "dead"), "s"), "threshold": (("threshold",), "log radiance"),
    "cutoff_hz": (("cutoff", "bandwidth"), "Hz"), "latency_s": (("latency",), "s"),
}  # fmt: skip
PARAMETERS = {"refractory_s", "on_threshold", "off_threshold", "sf_cutoff_hz", "diff_cutoff_hz"}  # of models
EDGES = {"on": "on", "1": "on", "off": "off", "0": "off", "-1": "off"}
ERROR = re.compile(r"(^|_)(sd|std|se|sem|err|error)(_|$)")
SPREAD = re.compile(r"mismatch|spread")
LEAST = 1e-18  # of a quantity in SI units
EXPECTED = "as bias_refr,dead_time_us"


@dataclass(frozen=True)
class BiasTable:
    """Rows of one quantity.

    Attributes:
        name: as results call it;  unit: SI;  codes: names of its one or two biases.
        code: (rows, codes);  measured: (rows,) NaN where only asked for.
        relative_error: (rows,) that the table states;  last_digit: smallest difference written.
        spread: (rows,) standard deviation between pixels, empty where the table has none.
        sources: files.
    """

    name: str
    unit: str
    codes: tuple[str, ...]
    code: np.ndarray
    measured: np.ndarray
    relative_error: np.ndarray
    last_digit: float = 0.0
    spread: np.ndarray = field(default_factory=lambda: np.empty(0))
    sources: tuple[Path, ...] = ()

    @property
    def parameter(self) -> str:
        """Of a model, that the quantity is; "" where it is of none."""
        return self.name if self.name in PARAMETERS else ""

    def select(self, kept: np.ndarray) -> BiasTable:
        """Only these rows (rows,) bool."""
        spread = self.spread[kept] if len(self.spread) else self.spread
        return replace(self, code=self.code[kept], measured=self.measured[kept],
                       relative_error=self.relative_error[kept], spread=spread)  # fmt: skip


@dataclass(frozen=True)
class Stated:
    """What the user states: columns of quantities and of biases, and the quantities' unit."""

    quantity: tuple[str, ...] = ()
    bias: tuple[str, ...] = ()
    unit: str | None = None


def read_bias_tables(
    paths: Sequence[Path], stated: Stated = Stated(), *, measured: bool = True
) -> tuple[list[BiasTable], list[str]]:
    """The quantities of tables, and per file one line that says what was inferred.

    Args:
        paths: CSV files.
        stated: over what is inferred.
        measured: whether a quantity must be there; else a table may hold codes alone.

    Raises:
        InputError: naming the file and what is missing or ambiguous, with the option that states it.
    """
    quantities: dict[str, BiasTable] = {}
    lines = []
    for path in paths:
        tables, line = _read(Path(path), stated, measured)
        lines.append(line)
        for table in tables:
            other = quantities.get(table.name)
            quantities[table.name] = table if other is None else _joined(other, table)
    return list(quantities.values()), lines


def _read(path: Path, stated: Stated, measured: bool) -> tuple[list[BiasTable], str]:
    text = read_text_table(path, first="", expected=EXPECTED)
    if not text.rows:
        raise InputError(f"{path}: expected rows below the header, found none")
    edge = next((name for name in text.names if name.lower() in ("polarity", "edge", "pol")), None)
    numeric = [name for name in text.names if name != edge and _is_numeric(text, name)]
    biases = _chosen(text, stated.bias, "--bias") or [name for name in numeric if name.lower().startswith("bias_")]
    if not biases:
        raise InputError(f"{path}: expected columns named bias_…, found {', '.join(text.names)}: state them by --bias")
    for name in text.names:
        if name not in numeric and name != edge and len(set(text.text(name))) > 1:
            raise InputError(f"{path}: {name}: expected one value in all rows, found several: keep the rows of one")
    values = {name: text.numbers(name) for name in biases}
    most_code = 1e9
    for name, column in values.items():
        text.check(name, np.abs(column) < most_code, f"a code, less than {most_code:g} either way")
    varied = [name for name in biases if np.ptp(values[name]) > 0.0] if measured else biases
    if measured and not 1 <= len(varied) <= 2:
        raise InputError(
            f"{path}: expected one or two biases of several codes, found {', '.join(varied) or 'none'}: choose by "
            "--bias"
        )
    varied.sort(key=lambda name: name.lower() == "bias_diff")  # the amplifier's own comes last: laws have its gain
    others = [name for name in numeric if name not in biases]
    tables = [
        table
        for column in _quantities(text, others, stated, measured)
        for table in _tables(text, column, edge, varied, others, stated)
    ]
    if not tables:
        codes = np.column_stack([values[name] for name in varied])
        blank = np.full(len(codes), np.nan)
        tables = [BiasTable("", "", tuple(map(str.lower, varied)), codes, blank, 0.0 * codes[:, 0], sources=(path,))]
    words = "; ".join(f"{table.name or 'codes only'} [{table.unit or '–'}]" for table in tables)
    return tables, f"{path.name}: {words} against {', '.join(varied)}"


def _quantities(text: TextTable, others: list[str], stated: Stated, measured: bool) -> list[str]:
    """Columns of quantities: stated, or the one that is named as one."""
    if stated.quantity:
        return _chosen(text, stated.quantity, "--quantity")
    plain = [name for name in others if not SPREAD.search(name.lower()) and not ERROR.search(name.lower())]
    known = [name for name in plain if _kind(name)] or [name for name in plain if _unit(name)] or plain
    if len(known) > 1 or (measured and not known):
        columns = ", ".join(known or text.names)
        raise InputError(f"{text.path}: expected one column of a quantity, found {columns}: choose by --quantity")
    return known


def _tables(
    text: TextTable, column: str, edge: str | None, biases: list[str], others: list[str], stated: Stated
) -> list[BiasTable]:
    kind = _kind(column)
    unit = stated.unit or _unit(column) or ("log" if kind == "threshold" else None)
    if unit is None or unit not in UNITS or (kind and UNITS[unit][0] != KINDS[kind][1]):
        raise InputError(
            f"{text.path}: {column}: expected a unit ({', '.join(UNITS)}){f' of {KINDS[kind][1]}' if kind else ''} at "
            f"the end of the column's name, as {column}_us, or --unit; found {unit or 'none'}"
        )
    si, factor = UNITS[unit]
    value = text.numbers(column) * factor
    text.check(column, np.isnan(value) | ((value > LEAST) & (value < 1.0 / LEAST)), "a number above 0")
    error = next((name for name in others if ERROR.search(name.lower()) and name.lower().startswith(
        column.lower().removesuffix(f"_{unit}"))), None)  # fmt: skip
    spread = next((name for name in others if kind == "threshold" and SPREAD.search(name.lower())), None)
    if error is not None:
        text.check(error, ~(text.numbers(error) < 0.0), "an error of 0 or more")
    relative = np.zeros(len(value)) if error is None else np.nan_to_num(text.numbers(error) * factor / value)
    spreads = np.empty(0) if spread is None else text.numbers(spread) * factor
    edges = [""] * len(value) if edge is None else [EDGES.get(cell.lower(), "?") for cell in text.text(edge)]
    if "?" in edges:
        text.check(str(edge), np.array([one != "?" for one in edges]), "on, off, 1 or 0")
    code = np.column_stack([text.numbers(name) for name in biases])
    tables = []
    for one in dict.fromkeys(edges):
        kept = np.array([each == one for each in edges]) & np.isfinite(value)
        names = tuple(_of_edge(name.lower(), one) for name in biases)
        table = BiasTable(_name(column, kind, one, names), si, names, code, value, relative,
                          text.last_digit((column,)) * factor, spreads, (text.path,))  # fmt: skip
        tables.append(table.select(kept))
    return tables


def _name(column: str, kind: str, edge: str, codes: tuple[str, ...]) -> str:
    """A quantity's name in results: a model's parameter where it is one."""
    lower = column.lower()
    own = next((name for name in PARAMETERS if lower.startswith(name)), None)
    if own:
        return own
    if kind == "cutoff_hz":
        return "sf_cutoff_hz" if codes == ("bias_fo",) else "cutoff_hz"
    edge = edge or next((one for one in ("on", "off") if lower.startswith(f"{one}_")), "")
    base = kind or re.sub(r"\s*\[.*\]$", "", lower)
    return f"{edge}_{base}" if edge and kind != "refractory_s" else base


def _of_edge(name: str, edge: str) -> str:
    """bias_diff_on_off of ON rows is bias_diff_on."""
    return name.removesuffix("_on_off") + f"_{edge}" if edge and name.endswith("_on_off") else name


def _kind(column: str) -> str:
    return next((kind for kind, (words, _) in KINDS.items() if any(word in column.lower() for word in words)), "")


def _unit(column: str) -> str | None:
    """In brackets, or behind the last underscore."""
    match = re.search(r"(?:\[\s*(\S+)\s*\]|_([a-zµ]+))$", column.strip().lower())
    unit = (match[1] or match[2]) if match else None
    return unit if unit in UNITS else None


def _is_numeric(text: TextTable, name: str) -> bool:
    try:
        text.numbers(name)
    except InputError:
        if re.match(r"bias_", name.lower()) or _kind(name):
            raise  # a damaged cell, not a label
        return False
    return True


def _chosen(text: TextTable, wanted: Sequence[str], option: str) -> list[str]:
    for name in wanted:
        if name not in text.names:
            raise InputError(f"{text.path}: {option}: no column {shown(name)}; found {', '.join(text.names)}")
    return list(wanted)


def _joined(one: BiasTable, other: BiasTable) -> BiasTable:
    if one.codes != other.codes or bool(len(one.spread)) != bool(len(other.spread)):
        raise InputError(
            f"{other.sources[0]}: {other.name}: expected the columns of {one.sources[0].name}, found another layout: "
            "one table for each quantity"
        )
    parts = {name: np.concatenate([getattr(one, name), getattr(other, name)])
             for name in ("code", "measured", "relative_error", "spread")}  # fmt: skip
    return replace(one, **parts, last_digit=max(one.last_digit, other.last_digit), sources=one.sources + other.sources)


FILE = "rates.json"
CUTOFF = re.compile(r"^cutoff_hz\[(.+)\]$")


def is_rates(path: Path) -> bool:
    """Whether this is the folder of a result of `pixelid rates`, or its rates.json."""
    return path.name == FILE or (path / FILE).is_file()


def read_cutoffs(path: Path) -> tuple[BiasTable, str]:
    """The cutoffs that the rates fix, with their errors, and a line that says which.

    Raises:
        InputError: a damaged result, columns that no bias names, or no cutoff that is identified.
    """
    path = path if path.name == FILE else path / FILE
    content = read_json(path)
    with interpreting(path, "the cutoffs of a `pixelid rates` result"):
        cutoffs = {match[1]: entry for name, entry in content["parameters"].items() if (match := CUTOFF.match(name))}
        known = {
            name: (float(e["value"]), float(e["std"])) for name, e in cutoffs.items() if e["identified"] and e["std"]
        }
    if not known:
        raise InputError(f"{path}: expected cutoffs of several columns that the rates fix, found none")
    value, sd = np.array(list(known.values())).T
    label = re.sub(r"[\d.\s]+$", "", next(iter(known))).strip("_ ").lower()
    code = label if label.startswith("bias_") else f"bias_{label or 'mv'}"
    name = "sf_cutoff_hz" if code == "bias_fo" else "cutoff_hz"
    table = BiasTable(name, "Hz", (code,), biases_of(list(known))[:, None], value, sd / value, sources=(path,))
    left_out = [column for column in cutoffs if column not in known]
    words = f"; without {', '.join(left_out)}, whose cutoff the rates leave open" if left_out else ""
    return table, f"{path.name}: {name} [Hz] against {code}{words}"
