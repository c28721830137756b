"""Events of a light's whole image per cycle: many pixels, dim ones at the rim, each with a bandwidth of its own.

A photoreceptor's bandwidth is proportional to its light (`docs/model.md`), and a lamp's image has a halo: glare that
falls with distance r from its centre as r^−k lights an area ∝ L^−2/k more brightly than L.  So the pixels' cutoffs
are spread as

    number of pixels with cutoff above c  =  N (c / c_max)^−p,     p = 2/k,  c ≤ c_max

and the pool answers with  N ∫ p (c/c_max)^−p n(f; c) d ln c, n of `square_wave.edge_events` for both edges.  Where n
is a low-pass in f/c, the integral falls as f^−p far below c_max however steep the pixels themselves are.

A pool of identical pixels is the limit p → ∞; it is fitted as well for comparison.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pixelid.errors import InputError, shown
from pixelid.parameters.parameter import Parameter
from pixelid.tables.fit import fit_table
from pixelid.tables.model import Rows
from pixelid.tables.rates.grid import GridFit, GridModel
from pixelid.tables.rates.square_wave import after_hysteresis, edge_events

NODES, WEIGHTS = np.polynomial.legendre.leggauss(48)


@dataclass(frozen=True)
class PoolTable:
    """Events per cycle of a light's image.

    frequency_hz: (n,) of the light's cycles;  conditions: m labels;  per_cycle, spread: (n, m) mean and standard
    deviation over cycles, NaN where not measured
    """

    frequency_hz: np.ndarray
    conditions: tuple[str, ...]
    per_cycle: np.ndarray
    spread: np.ndarray

    def __post_init__(self) -> None:
        shape = (len(self.frequency_hz), len(self.conditions))
        if self.per_cycle.shape != shape or self.spread.shape != shape:
            raise InputError(f"pool: expected {shape} values, found {self.per_cycle.shape} and {self.spread.shape}")
        if not ((self.frequency_hz > 0) & np.isfinite(self.frequency_hz)).all():
            raise InputError("pool: expected frequencies above 0")
        for name, values in (("event counts", self.per_cycle), ("spreads", self.spread)):
            if np.isinf(values).any() or (np.nan_to_num(values) < 0).any():
                found = f"{np.nanmin(values):g} … {np.nanmax(values):g}"
                raise InputError(f"pool: expected {name} of at least 0, found {found}")
        for k, name in enumerate(self.conditions):
            if np.isnan(self.per_cycle[:, k]).all():
                raise InputError(f"pool: {shown(name)}: expected event counts, found none")


@dataclass(frozen=True)
class PoolModel(GridModel):
    """Events per cycle of a light's image as a `TableModel`.

    Pixels and c_max per condition; p, swing and dead time shared by all, and a floor: events per cycle that the way of
    counting adds (cycles were found by their peaks: none counts as 0).  Each cell's spread over cycles counts as its
    error: the number of cycles is not in the table.

    Attributes:
        table: what was measured.
        identical: all pixels alike (p → ∞).
    """

    table: PoolTable
    identical: bool = False

    nuisances: frozenset[str] = frozenset({"floor_per_cycle"})
    neutral_bounds: tuple[tuple[str, str], ...] = (
        ("dead_time_s", "lower"), ("top_cutoff_hz", "upper"), ("pixels", "lower")
    )  # fmt: skip

    @property
    def values(self) -> np.ndarray:
        """(n, m) of the table."""
        return self.table.per_cycle

    @property
    def rows(self) -> Rows:
        """The measured cells, one after the other."""
        row, column = self.cells
        measured = self.table.per_cycle[row, column]
        return Rows(
            measured,
            1e-3,
            np.nan_to_num(self.table.spread[row, column] / np.maximum(measured, 1e-9)),
            {
                "frequency_hz": self.table.frequency_hz[row].tolist(),
                "condition": [self.table.conditions[k] for k in column],
            },
        )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Pixels per condition, top cutoffs per condition, then what they share."""
        conditions = self.table.conditions
        largest = np.nanmax(self.table.per_cycle, axis=0)
        parameters = [
            Parameter(f"pixels[{name}]", max(float(most) / 40.0, 1e-3), "pixels", 1e-4, 1e7, "log")
            for name, most in zip(conditions, largest, strict=True)
        ]
        parameters += [Parameter(f"top_cutoff_hz[{name}]", 3e3, "Hz", 1.0, 1e7, "log") for name in conditions]
        parameters += [
            Parameter("swing_over_threshold", 20.0, "thresholds", 1.5, 200.0, "log"),
            Parameter("dead_time_s", 1e-5, "s", 1e-7, 3e-3, "log"),
            Parameter("floor_per_cycle", 1.0, "events", 0.05, 20.0, "log"),
        ]
        if not self.identical:
            parameters.append(Parameter("cutoff_exponent", 0.9, "1", 0.1, 3.0, "log"))
        return tuple(parameters)

    def dependence(self) -> Sequence[np.ndarray]:
        """Each cell depends on its condition's pixels and cutoff, and on all that is shared."""
        m, column = len(self.table.conditions), self.cells[1]
        shared = range(2 * m, len(self.parameters))
        return [column, m + column, *(np.full(len(column), k) for k in shared)]

    def predict(self, x: np.ndarray) -> np.ndarray:
        """(cells,) events per cycle."""
        (row, column), m, v = self.cells, len(self.table.conditions), np.exp(x)
        exponent = np.inf if self.identical else v[2 * m + 3]
        frequency = self.table.frequency_hz[row]
        return (
            pool_events(frequency, v[:m][column], v[m : 2 * m][column], exponent, v[2 * m], v[2 * m + 1]) + v[2 * m + 2]
        )


class PoolFit(GridFit[PoolModel]):
    """A fitted table of a light's image."""

    @property
    def table(self) -> PoolTable:
        """What was measured."""
        return self.model.table


def pool_events(frequency_hz, pixels, top_hz, spread, swing, dead_s) -> np.ndarray:
    """Events per cycle of the pool; one-dimensional arguments (cells,) or scalars.

    pixels: N;  top_hz: c_max;  spread: p (inf: all pixels at c_max);  swing, dead_s: as in `edge_events`.
    """
    f, pixels, top, p, swing, dead = np.broadcast_arrays(
        *np.atleast_1d(frequency_hz, pixels, top_hz, spread, swing, dead_s)
    )
    if np.isinf(p).all():
        return 2.0 * pixels * after_hysteresis(edge_events(swing, 1 / (2 * np.pi * top), dead, 0.5 / f), 1.0)
    # from c_max down to where even a bright pixel's swing stays below one threshold
    lowest = np.minimum(f / (2.0 * swing), 0.5 * top)
    depth_nats = 14.0  # how far below c_max cutoffs go: e⁻¹⁴ of the pixels' light
    length = np.minimum(np.log(top / lowest), depth_nats)
    down = 0.5 * length[:, None] * (1.0 + NODES)
    cutoff = top[:, None] * np.exp(-down)
    n = after_hysteresis(
        edge_events(swing[:, None], 1.0 / (2.0 * np.pi * cutoff), dead[:, None], 0.5 / f[:, None]), 1.0
    )
    return 2.0 * pixels * 0.5 * length * (WEIGHTS * p[:, None] * np.exp(p[:, None] * down) * n).sum(1)


def fit_pool(table: PoolTable, identical: bool = False) -> PoolFit:
    """Fit pixels and their top bandwidth per condition; `identical` takes all pixels as alike, for comparison."""
    model = PoolModel(table, identical)
    return PoolFit(model, fit_table(model))
