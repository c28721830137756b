"""What an observation model of a table is to the fitter: rows, parameters, and a prediction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from pixelid.parameters.parameter import Parameter

SQRT2 = np.sqrt(2.0)


@dataclass(frozen=True)
class Rows:
    """What was measured, row by row.

    Attributes:
        measured: (rows,) positive quantity (events/s, s, …); 0 where less than the last digit was seen.
        last_digit: (rows,) or scalar, the smallest difference that the table can write, in the same unit.
        relative_error: (rows,) or scalar, relative errors that the table itself states.
        pairs, pair_error: (pairs, 2) rows whose errors go together, and the relative errors of their sum and of their
            difference, each over √2.
        columns: what identifies a row (frequency, setting, illuminance, …): name → (rows,) values.
    """

    measured: np.ndarray
    last_digit: np.ndarray | float
    relative_error: np.ndarray | float = 0.0
    columns: Mapping[str, Sequence[Any]] = field(default_factory=dict)
    pairs: np.ndarray = field(default_factory=lambda: np.empty((0, 2), int))
    pair_error: np.ndarray = field(default_factory=lambda: np.empty((0, 2)))

    @property
    def rounding(self) -> np.ndarray:
        """(rows,) relative error of rounding to the last digit."""
        return self.last_digit / np.sqrt(12.0) / (self.measured + self.last_digit)

    @property
    def known_variance(self) -> np.ndarray:
        """(rows,) variance of ln measured that the table itself shows: rounding and stated errors."""
        return self.rounding**2 + np.asarray(self.relative_error) ** 2

    def log_ratio(self, predicted: np.ndarray) -> np.ndarray:
        """(rows,) ln measured over predicted, finite where less than the last digit was seen."""
        return np.log(self.measured + self.last_digit) - np.log(predicted + self.last_digit)

    def turned(self, values: np.ndarray) -> np.ndarray:
        """(rows, …) with sum and difference of every pair, over √2, in place of the two: they err independently."""
        found = np.array(values, float)
        first, second = values[self.pairs[:, 0]], values[self.pairs[:, 1]]
        found[self.pairs[:, 0]], found[self.pairs[:, 1]] = (first + second) / SQRT2, (first - second) / SQRT2
        return found

    @property
    def turned_variance(self) -> np.ndarray:
        """(rows,) the known variance of what is `turned`."""
        found = np.array(np.broadcast_to(self.known_variance, self.measured.shape))
        rounding = np.broadcast_to(self.rounding, self.measured.shape)[self.pairs] ** 2
        found[self.pairs] = self.pair_error**2 + rounding.mean(1, keepdims=True)
        return found


class TableModel(Protocol):
    """An observation model of a table.  Implementations are frozen dataclasses; `rates/pixel.py` is the pattern.

    Attributes:
        rows: what was measured.
        parameters: start, bounds, transform and prior of everything fitted, nuisances among them.
        nuisances: names of those that belong to the measurement and not to the pixel (a lamp's contrast, a floor).
        neutral_bounds: (beginning of a name, "lower" | "upper"): bounds at which an effect is absent or too fast to
            see.  A parameter there is open and not suspicious, unlike one on any other bound.
    """

    @property
    def rows(self) -> Rows: ...
    @property
    def parameters(self) -> tuple[Parameter, ...]: ...
    @property
    def nuisances(self) -> frozenset[str]: ...
    @property
    def neutral_bounds(self) -> tuple[tuple[str, str], ...]: ...

    def predict(self, x: np.ndarray) -> np.ndarray:
        """(rows,) prediction at fitting coordinates x, in the unit of `rows.measured`."""
        ...

    def dependence(self) -> Sequence[np.ndarray]:
        """Per kind of parameter, (rows,) which coordinate of that kind a row depends on.

        All coordinates of a kind are differentiated at once, so that thirty columns cost as much as one.
        """
        ...


def predicted_rows(model: TableModel, predicted: np.ndarray, standardised: np.ndarray) -> list[dict[str, Any]]:
    """The rows of a result: the table's columns with measured, predicted and standardised residual."""
    rows = model.rows
    names = list(rows.columns)
    return [
        {
            **{name: rows.columns[name][k] for name in names},
            "measured": float(rows.measured[k]),
            "predicted": float(predicted[k]),
            "standardised": float(standardised[k]),
        }
        for k in range(len(rows.measured))
    ]
