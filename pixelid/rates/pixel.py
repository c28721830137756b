"""One pixel's rate table: per column (bias setting) its bandwidth, dead time and noise; the light's swing is shared."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pixelid.parameters.parameter import Parameter
from pixelid.rates.fit import Regression, regress
from pixelid.rates.model import rate
from pixelid.rates.table import RateTable

SWING = Parameter("swing_over_threshold", 30.0, "thresholds", 1.0, 300.0, "log")
CUTOFF = Parameter("cutoff_hz", 300.0, "Hz", 1.0, 1e6, "log")
DEAD = Parameter("dead_time_s", 5e-6, "s", 1e-7, 3e-3, "log")
NOISE = Parameter("noise_hz", 10.0, "Hz", 1e-2, 1e6, "log")


@dataclass(frozen=True)
class PixelFit:
    """A fitted table: the regression over its measured cells (row, column)."""

    table: RateTable
    row: np.ndarray
    column: np.ndarray
    observed: np.ndarray
    regression: Regression
    shared: tuple[str, ...]

    def curve(self, column: int, frequency_hz: np.ndarray) -> np.ndarray:
        """Fitted rates of one column at other frequencies."""
        return _predict(self.regression.x, frequency_hz, np.full(len(frequency_hz), column), self._places)

    @property
    def _places(self):
        return _places(len(self.table.columns), self.shared)


def fit_pixel(table: RateTable, shared: tuple[str, ...] = ("swing",)) -> PixelFit:
    """Fit all columns together.  shared: which of "swing" and "dead" have one value for all columns.

    Started from each column's own high rates and roll-off, and from dead times short and long; the best end counts.
    """
    row, column = np.nonzero(np.isfinite(table.rate_hz))
    observed = table.rate_hz[row, column]
    frequency = table.frequency_hz[row]
    places = _places(len(table.columns), shared)

    def predict(x: np.ndarray) -> np.ndarray:
        return _predict(x, frequency, column, places)

    ends = []
    for dead in (1e-6, 1e-5):
        start = _start(table, shared, dead)
        ends.append(regress(start, predict, observed, table.resolution_hz, [place[column] for place in places]))
    best = max(ends, key=lambda end: end.log_likelihood)
    return PixelFit(table, row, column, observed, best, shared)


def _places(columns: int, shared: tuple[str, ...]) -> list[np.ndarray]:
    """Where swing, cutoff, dead time and noise of each column sit in the vector of parameters."""
    places, first = [], 0
    for kind in ("swing", "cutoff", "dead", "noise"):
        count = 1 if kind in shared else columns
        places.append(first + (np.zeros(columns, int) if count == 1 else np.arange(columns)))
        first += count
    return places


def _predict(x: np.ndarray, frequency: np.ndarray, column: np.ndarray, places: list[np.ndarray]) -> np.ndarray:
    swing, cutoff, dead, noise = (np.exp(x[place[column]]) for place in places)
    return rate(frequency, swing, 1.0 / (2.0 * np.pi * cutoff), dead, noise)


def _start(table: RateTable, shared: tuple[str, ...], dead: float) -> tuple[Parameter, ...]:
    per_cycle = table.per_cycle
    quiet = [np.nanmin(np.where(np.isfinite(c), c, np.nan)) for c in table.rate_hz.T]
    swing = float(np.clip(0.5 * np.nanmin(np.nanmax(per_cycle, axis=0)), 2.0, 200.0))
    found = []
    for kind, base in (("swing", SWING), ("cutoff", CUTOFF), ("dead", DEAD), ("noise", NOISE)):
        for k, name in enumerate(table.columns):
            if kind in shared and k:
                continue
            value = {"swing": swing, "dead": dead, "noise": quiet[k], "cutoff": 0.0}[kind]
            if kind == "cutoff":
                above = np.isfinite(per_cycle[:, k]) & (per_cycle[:, k] > 0.5 * swing)
                value = float(np.clip(table.frequency_hz[above].max(initial=100.0), 2.0, 1e5))
            value = float(np.clip(value, 1.01 * base.lower, 0.99 * base.upper))
            label = base.name if kind in shared else f"{base.name}[{name}]"
            found.append(Parameter(label, value, base.unit, base.lower, base.upper, "log"))
    return tuple(found)
