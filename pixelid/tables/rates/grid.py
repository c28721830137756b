"""What fits of a table of frequencies × settings have in common: cells by row and column."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Generic, TypeVar

import numpy as np

from pixelid.tables.fit import TableFit


class GridModel(ABC):
    """The part of a `TableModel` whose rows are the measured cells of a table."""

    @property
    @abstractmethod
    def values(self) -> np.ndarray:
        """(n, m) of the table, NaN where nothing was measured."""

    @cached_property
    def cells(self) -> tuple[np.ndarray, np.ndarray]:
        """(row, column) of the measured cells."""
        row, column = np.nonzero(np.isfinite(self.values))
        return row, column


M = TypeVar("M", bound=GridModel)


@dataclass(frozen=True)
class GridFit(Generic[M]):
    """A fitted table: its model and the regression over its measured cells."""

    model: M
    regression: TableFit

    @property
    def row(self) -> np.ndarray:
        """(cells,) row of each measured cell."""
        return self.model.cells[0]

    @property
    def column(self) -> np.ndarray:
        """(cells,) column of each measured cell."""
        return self.model.cells[1]
