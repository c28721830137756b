"""A table of event rates: one row per frequency of the light, one column per setting of the sensor.

CSV: a header `freq_hz,<column>,…`, empty cells where nothing was measured, `#` lines are remarks.  Columns may say the
unit of their rates: `fo1477 [kev/s],…`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pixelid.errors import InputError, shown
from pixelid.tables.reading import read_text_table

UNITS = {"hz": 1.0, "kev/s": 1e3, "mev/s": 1e6}
SAME = {"ev/s": "hz", "1/s": "hz"}  # units of UNITS by other names
_UNIT = re.compile(r"\s*[\[(]\s*(" + "|".join((*UNITS, *SAME)) + r")\s*[\])]$", re.IGNORECASE)  # at the end of a name


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


def read_table(path: Path, unit: str | None = None) -> RateTable:
    """The table of a CSV file.

    Args:
        path: the file.
        unit: of its rates, one of `UNITS`; None: that of its header, and Hz where it says none.

    Raises:
        InputError: naming file, row and cell; for a unit that is not the header's.
    """
    if unit is not None and unit not in UNITS:
        raise InputError(f"unit: expected one of {', '.join(UNITS)}, found {unit!r}")
    text = read_text_table(path, first="freq", expected="freq_hz,column,…")
    if re.search(r"[km]hz|rad", text.names[0].lower()):
        raise InputError(f"{path}: expected frequencies in Hz, found a column {shown(text.names[0])}")
    frequency, headings = text.numbers(text.names[0]), text.names[1:]
    names = tuple(_UNIT.sub("", heading) for heading in headings)
    if len(set(names)) < len(names):
        raise InputError(f"{path}: expected columns of different names, found {shown(headings, 200)}")
    rates = np.stack([text.numbers(heading) for heading in headings], axis=1)
    text.check(text.names[0], frequency > 0, "a frequency above 0")
    for heading, column in zip(headings, rates.T, strict=True):
        text.check(heading, ~(column < 0), "a rate of at least 0")
    if len(rates) < 2:
        raise InputError(f"{path}: expected at least two rows, found {len(rates)}")
    for k, name in enumerate(names):
        if np.isnan(rates[:, k]).all():
            raise InputError(f"{path}: column {shown(name)}: expected at least one rate, found only empty cells")
    scale = UNITS[_unit(text.path, headings, unit)]
    return RateTable(frequency, names, rates * scale, scale * text.last_digit(headings), text.path)


def _unit(path: Path, headings: tuple[str, ...], asked: str | None) -> str:
    """The unit of the rates.  Raises InputError where columns have different ones, or another one than `asked`."""
    found = [_UNIT.search(heading) for heading in headings]
    said = {SAME.get(match[1].lower(), match[1].lower()) for match in found if match is not None}
    if not said:
        return asked or "hz"
    if len(said) > 1 or None in found:
        raise InputError(f"{path}: expected one unit for all rates, found columns {shown(headings, 200)}")
    unit = said.pop()
    if asked not in (None, unit):
        raise InputError(f"{path}: --unit {asked}: the columns say {unit}")
    return unit
