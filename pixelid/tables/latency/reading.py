"""A table of latencies: one row per camera, lens, edge, irradiance, threshold setting and region of interest.

CSV: a header with `camera`, `lens`, `polarity` (1 light on, 0 light off), `irradiance_W_m2`, `bias_config`, and one or
more of `min`, `median`, `max`, `stdev`, `sd` in µs (or with the ending `_s` in seconds).  Empty cells were not
measured, `#` lines are remarks.  Optional: `roi_index`, `bias_on` and `bias_off` (biases as numbers), `pixels` or
`nb_pol0` and `nb_pol1` (mean number of pixels that fired).

`median`, `min` and `max` are over the region's pixels, averaged over the light's edges.  `stdev` is the standard
deviation between edges of the region's mean, as the program of the NIST tables writes it
(github.com/usnistgov/pixel_latency_eventcameras, scripts/plot_latency.py); `sd` that of the pixels about it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pixelid.errors import InputError, shown
from pixelid.tables.latency.settings import bias_of
from pixelid.tables.reading import TextTable, read_text_table

STATISTICS = ("median", "min", "max", "stdev", "sd")
TIMESTAMP_S = 1e-6  # event cameras stamp in µs: no latency is known better
LEAST_S = 0.1 * TIMESTAMP_S  # a latency below is none
PIXELS = 100.0  # of a region of interest where the table does not say: 10 × 10
PER_ROW = ("camera", "lens", "setting", "on", "irradiance", "bias", "pixels", "counted")
EXPECTED = "camera,lens,polarity,irradiance_W_m2,bias_config,median,…"


@dataclass(frozen=True)
class LatencyTable:
    """Rows of one or more tables.

    Attributes:
        columns: name → (rows,) cells as in the file, numbers where all of a column are.
        camera, lens, setting: (rows,) labels.
        on: (rows,) whether the light went on.
        irradiance: (rows,) W/m² while the light is on.
        bias: (rows,) of the threshold that fires, NaN where neither a column nor the setting's name says it.
        pixels: (rows,) that fired;  counted: (rows,) whether the table says so.
        latency_s: statistic → (rows,) seconds, NaN where not measured.
        sources: the files.
    """

    columns: dict[str, list]
    camera: np.ndarray
    lens: np.ndarray
    setting: np.ndarray
    on: np.ndarray
    irradiance: np.ndarray
    bias: np.ndarray
    pixels: np.ndarray
    counted: np.ndarray
    latency_s: dict[str, np.ndarray]
    sources: tuple[Path, ...] = ()

    def __len__(self) -> int:
        return len(self.camera)

    def select(self, keep: np.ndarray) -> LatencyTable:
        """The rows where `keep` (rows,) holds."""
        index = np.flatnonzero(keep)
        return LatencyTable(
            columns={name: [cells[k] for k in index] for name, cells in self.columns.items()},
            latency_s={name: values[index] for name, values in self.latency_s.items()},
            sources=self.sources,
            **{name: getattr(self, name)[index] for name in PER_ROW},
        )


def read_tables(paths: Sequence[Path], *, measured: bool = True) -> LatencyTable:
    """The rows of CSV files, one after the other; all must have the same columns.

    Args:
        paths: the files.
        measured: whether latencies must be there; a table to be predicted needs none.

    Raises:
        InputError: naming file, row and cell.
    """
    tables = [_table(Path(path), measured) for path in paths]
    first = tables[0]
    for path, table in zip(paths, tables, strict=True):
        if list(table.columns) != list(first.columns):
            raise InputError(
                f"{path}: expected the columns of {paths[0]}, found {shown(', '.join(table.columns), 200)}"
            )
    joined = LatencyTable(
        columns={name: [cell for table in tables for cell in table.columns[name]] for name in first.columns},
        latency_s={name: np.concatenate([table.latency_s[name] for table in tables]) for name in STATISTICS},
        sources=tuple(Path(path) for path in paths),
        **{name: np.concatenate([getattr(table, name) for table in tables]) for name in PER_ROW},
    )
    if measured and not np.isfinite(joined.latency_s["median"]).any():
        raise InputError(f"{paths[0]}: expected latencies in a column 'median', found none")
    return joined


def _table(path: Path, measured: bool) -> LatencyTable:
    if not path.exists():
        raise InputError(f"{path}: no such file")
    text = read_text_table(path, first="", expected=EXPECTED)
    rows = len(text.rows)
    if not rows:
        raise InputError(f"{path}: expected at least one row of {EXPECTED}")
    polarity, irradiance = text.numbers("polarity"), text.numbers("irradiance_W_m2")
    for k in range(rows):
        if polarity[k] not in (0.0, 1.0):
            raise InputError(f"{path}: row {k + 1}: polarity: expected 1 or 0, found {shown(text.text('polarity')[k])}")
        if not irradiance[k] > 0:
            found = shown(text.text("irradiance_W_m2")[k])
            raise InputError(f"{path}: row {k + 1}: irradiance_W_m2: expected a number above 0, found {found}")
    on = polarity == 1.0
    setting = np.array(_labels(text, "bias_config", rows))
    latency = {name: _latencies(text, name, rows) for name in STATISTICS}
    if measured and "median" not in {name.removesuffix("_s") for name in text.names}:
        raise InputError(f"{path}: no column 'median'; found {', '.join(text.names)}")
    fired = np.where(on, _numbers(text, "nb_pol1", rows), _numbers(text, "nb_pol0", rows))
    fired = np.where(np.isfinite(fired), fired, _numbers(text, "pixels", rows))
    counted = np.isfinite(fired) & (fired >= 1.0)
    named = np.array([np.nan if (bias := bias_of(name)) is None else bias for name in setting])
    stated = np.where(on, _numbers(text, "bias_on", rows), _numbers(text, "bias_off", rows))
    return LatencyTable(
        {name: _cells(text, name) for name in text.names},
        np.array(_labels(text, "camera", rows)),
        np.array(_labels(text, "lens", rows)),
        setting,
        on,
        irradiance,
        np.where(np.isfinite(stated), stated, named),
        np.where(counted, fired, PIXELS),
        counted,
        latency,
        (path,),
    )


def _labels(text: TextTable, name: str, rows: int) -> list[str]:
    return text.text(name) if name in text.names else ["-"] * rows


def _numbers(text: TextTable, name: str, rows: int) -> np.ndarray:
    return text.numbers(name) if name in text.names else np.full(rows, np.nan)


def _latencies(text: TextTable, name: str, rows: int) -> np.ndarray:
    microsecond_s = 1e-6
    values = text.numbers(f"{name}_s") if f"{name}_s" in text.names else microsecond_s * _numbers(text, name, rows)
    wrong = np.flatnonzero(values < 0)
    if len(wrong):
        raise InputError(f"{text.path}: row {wrong[0] + 1}: {name}: expected a latency of at least 0")
    return values


def _cells(text: TextTable, name: str) -> list:
    """A column as numbers (None where empty) if all of it are, otherwise as text."""
    cells = text.text(name)
    if name in ("camera", "lens", "bias_config"):
        return cells
    try:
        return [float(cell) if cell else None for cell in cells]
    except ValueError:
        return cells
