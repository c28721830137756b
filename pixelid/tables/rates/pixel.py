"""One pixel's rate table: per column (bias setting) its bandwidth, dead time and noise; the light's swing is shared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pixelid.parameters.parameter import Parameter
from pixelid.tables.fit import fit_table
from pixelid.tables.model import Rows
from pixelid.tables.rates.grid import GridFit, GridModel
from pixelid.tables.rates.reading import RateTable
from pixelid.tables.rates.square_wave import rate

SWING = Parameter("swing_over_threshold", 30.0, "thresholds", 1.0, 300.0, "log")
CUTOFF = Parameter("cutoff_hz", 300.0, "Hz", 1.0, 1e6, "log")
DEAD = Parameter("dead_time_s", 5e-6, "s", 1e-7, 3e-3, "log")
NOISE = Parameter("noise_hz", 10.0, "Hz", 1e-2, 1e6, "log")
KINDS = {"swing": SWING, "cutoff": CUTOFF, "dead": DEAD, "noise": NOISE}
DEAD_STARTS_S = (1e-6, 1e-5)  # the likelihood has one maximum where dead time shows and one where it does not
# And one where the roll-off of a slow column passes for outliers, with a cutoff twice too high.
CUTOFF_STARTS = (1.0, 0.0, 0.3)


@dataclass(frozen=True)
class PixelModel(GridModel):
    """Rates of one pixel under a blinking light as a `TableModel`.

    Attributes:
        table: what was measured.
        shared: which of "swing" and "dead" have one value for all columns.
        dead_s: dead time that the fit begins at.
        slower: factor of the cutoffs that the fit begins at, where rates fall below half of the shared swing; 0: those
            where each column's rates fall below half of their own largest.
    """

    table: RateTable
    shared: tuple[str, ...] = ("swing",)
    dead_s: float = DEAD_STARTS_S[0]
    slower: float = 1.0

    nuisances: frozenset[str] = frozenset()
    # a dead time or a noise too small to show, a pixel faster than every frequency of the table
    neutral_bounds: tuple[tuple[str, str], ...] = (
        ("dead_time_s", "lower"), ("noise_hz", "lower"), ("cutoff_hz", "upper")
    )  # fmt: skip

    @property
    def values(self) -> np.ndarray:
        """(n, m) of the table."""
        return self.table.rate_hz

    @property
    def rows(self) -> Rows:
        """The measured cells, one after the other."""
        row, column = self.cells
        return Rows(
            self.table.rate_hz[row, column],
            self.table.resolution_hz,
            columns={
                "frequency_hz": self.table.frequency_hz[row].tolist(),
                "column": [self.table.columns[k] for k in column],
            },
        )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Swing, cutoffs, dead times and noises, started from each column's own high rates and roll-off."""
        table = self.table
        per_cycle = table.per_cycle
        quiet = [np.nanmin(np.where(np.isfinite(c), c, np.nan)) for c in table.rate_hz.T]
        swing = float(np.clip(0.5 * np.nanmin(np.nanmax(per_cycle, axis=0)), 2.0, 200.0))
        parameters = []
        for kind, base in KINDS.items():
            for k, name in enumerate(table.columns):
                if kind in self.shared and k:
                    continue
                value = {"swing": swing, "dead": self.dead_s, "noise": quiet[k], "cutoff": 0.0}[kind]
                if kind == "cutoff":
                    full = swing if self.slower else float(np.nanmax(per_cycle[:, k]))
                    above = np.isfinite(per_cycle[:, k]) & (per_cycle[:, k] > 0.5 * full)
                    highest = table.frequency_hz[above].max(initial=100.0 if self.slower else 0.0)
                    value = float(np.clip((self.slower or 1.0) * highest, 2.0, 1e5))
                value = float(np.clip(value, 1.01 * base.lower, 0.99 * base.upper))
                label = base.name if kind in self.shared else f"{base.name}[{name}]"
                parameters.append(Parameter(label, value, base.unit, base.lower, base.upper, "log"))
        return tuple(parameters)

    @cached_property
    def places(self) -> tuple[np.ndarray, ...]:
        """Where swing, cutoff, dead time and noise of each column sit in the vector of parameters."""
        places, first, columns = [], 0, len(self.table.columns)
        for kind in KINDS:
            count = 1 if kind in self.shared else columns
            places.append(first + (np.zeros(columns, int) if count == 1 else np.arange(columns)))
            first += count
        return tuple(places)

    def dependence(self) -> Sequence[np.ndarray]:
        """Each cell depends on one parameter of each kind."""
        return [place[self.cells[1]] for place in self.places]

    def predict(self, x: np.ndarray) -> np.ndarray:
        """(cells,) events per second."""
        row, column = self.cells
        return self.rate_at(x, self.table.frequency_hz[row], column)

    def rate_at(self, x: np.ndarray, frequency_hz: np.ndarray, column: np.ndarray) -> np.ndarray:
        """Events per second at any frequencies of the table's columns."""
        swing, cutoff, dead, noise = (np.exp(x[place[column]]) for place in self.places)
        return rate(frequency_hz, swing, 1.0 / (2.0 * np.pi * cutoff), dead, noise)


class PixelFit(GridFit[PixelModel]):
    """A fitted table of one pixel."""

    @property
    def table(self) -> RateTable:
        """What was measured."""
        return self.model.table

    @property
    def observed(self) -> np.ndarray:
        """(cells,) measured rates."""
        return self.model.rows.measured

    def curve(self, column: int, frequency_hz: np.ndarray) -> np.ndarray:
        """Fitted rates of one column at other frequencies."""
        return self.model.rate_at(self.regression.x, frequency_hz, np.full(len(frequency_hz), column))


def fit_pixel(table: RateTable, shared: tuple[str, ...] = ("swing",)) -> PixelFit:
    """Fit all columns together, from dead times short and long and cutoffs of three kinds; the likeliest end counts.

    Args:
        table: event rates per frequency and setting.
        shared: which of "swing" and "dead" have one value for all columns.
    """
    fits = [fit_table(PixelModel(table, shared, dead, slower)) for dead in DEAD_STARTS_S for slower in CUTOFF_STARTS]
    best = max(fits, key=lambda fit: fit.log_likelihood)
    assert isinstance(best.model, PixelModel)
    return PixelFit(best.model, best)
