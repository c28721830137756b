"""A table of event rates: one row per frequency of the light, one column per setting of the sensor.

CSV: a header `freq_hz,<column>,…`, empty cells where nothing was measured, `#` lines are remarks.
NPZ: arrays `frequency_hz` (n,), `<column>` (n,) of rates in the same unit.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pixelid.errors import InputError

UNITS = {"hz": 1.0, "kev/s": 1e3, "mev/s": 1e6}


@dataclass(frozen=True)
class RateTable:
    """Event rates of one pixel (or one pool) under square-wave light.

    frequency_hz: (n,);  columns: m names;  rate_hz: (n, m) events per second, NaN where not measured
    resolution_hz: the last digit written: rates are known no better, and less was "no events"
    """

    frequency_hz: np.ndarray
    columns: tuple[str, ...]
    rate_hz: np.ndarray
    resolution_hz: float
    source: Path | None = None

    @property
    def per_cycle(self) -> np.ndarray:
        """(n, m) events per cycle of the light."""
        return self.rate_hz / self.frequency_hz[:, None]


def read_table(path: Path, unit: str = "hz") -> RateTable:
    """The table of a CSV file; unit: of its rates, one of `UNITS`.  Raises InputError naming line and cell."""
    if unit not in UNITS:
        raise InputError(f"unit: expected one of {', '.join(UNITS)}, found {unit!r}")
    path = Path(path)
    try:
        lines = [line for line in path.read_text().splitlines() if line.strip() and not line.lstrip().startswith("#")]
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: expected a text table, found a binary file") from error
    rows = list(csv.reader(lines))
    if not rows or len(rows[0]) < 2 or not rows[0][0].strip().lower().startswith("freq"):
        raise InputError(f"{path}: expected a header line freq_hz,column,…")
    names = tuple(name.strip() for name in rows[0][1:])
    cells, digits = [], []
    for k, row in enumerate(rows[1:], 1):
        if len(row) != len(rows[0]):
            raise InputError(f"{path}: row {k} has {len(row)} cells, expected {len(rows[0])}")
        cells.append([_number(path, k, cell) for cell in row])
        digits += [len(cell.strip().partition(".")[2]) for cell in row[1:]]
    table = np.array(cells)
    if len(table) < 2 or not (table[:, 0] > 0).all() or (np.nan_to_num(table[:, 1:]) < 0).any():
        raise InputError(f"{path}: expected at least two rows, frequencies above 0 and rates of at least 0")
    scale = UNITS[unit]
    return RateTable(table[:, 0], names, table[:, 1:] * scale, scale * 10.0 ** -max(digits), path)


def _number(path: Path, row: int, cell: str) -> float:
    if not cell.strip():
        return float("nan")
    try:
        value = float(cell)
    except ValueError as error:
        raise InputError(f"{path}: row {row}: expected a number, found {cell!r}") from error
    if not np.isfinite(value):
        raise InputError(f"{path}: row {row}: expected a finite number, found {cell!r}")
    return value
