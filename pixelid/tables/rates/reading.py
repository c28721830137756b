"""A table of event rates: one row per frequency of the light, one column per setting of the sensor.

CSV: a header `freq_hz,<column>,…`, empty cells where nothing was measured, `#` lines are remarks.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pixelid.errors import InputError, shown
from pixelid.tables.reading import read_text_table

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
    """The table of a CSV file.

    Args:
        path: the file.
        unit: of its rates, one of `UNITS`.

    Raises:
        InputError: naming file, row and cell.
    """
    if unit not in UNITS:
        raise InputError(f"unit: expected one of {', '.join(UNITS)}, found {unit!r}")
    text = read_text_table(path, first="freq", expected="freq_hz,column,…")
    if re.search(r"[km]hz", text.names[0].lower()):
        raise InputError(f"{path}: expected frequencies in Hz, found a column {shown(text.names[0])}")
    frequency, names = text.numbers(text.names[0]), text.names[1:]
    rates = np.stack([text.numbers(name) for name in names], axis=1)
    text.check(text.names[0], frequency > 0, "a frequency above 0")
    for name, column in zip(names, rates.T, strict=True):
        text.check(name, ~(column < 0), "a rate of at least 0")
    if len(rates) < 2:
        raise InputError(f"{path}: expected at least two rows, found {len(rates)}")
    for k, name in enumerate(names):
        if np.isnan(rates[:, k]).all():
            raise InputError(f"{path}: column {shown(name)}: expected at least one rate, found only empty cells")
    scale = UNITS[unit]
    return RateTable(frequency, names, rates * scale, scale * text.last_digit(names), text.path)
