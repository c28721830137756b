"""Fit latencies: one circuit per camera, from a follower slow and fast; the likelier end counts."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from pixelid.errors import InputError
from pixelid.tables.fit import TableFit, fit_table, log_posterior_at
from pixelid.tables.latency.camera import Camera, camera_for
from pixelid.tables.latency.cells import Cells, gather
from pixelid.tables.latency.model import FOLLOWER_STARTS_HZ, THRESHOLD, LatencyModel
from pixelid.tables.latency.reading import LEAST_S, LatencyTable
from pixelid.tables.profile import follow_profile, with_rivals

SCALED = (0.5, 2.0)  # two maxima of the public table's CAM1, nearly as good as each other, are a factor of 2 apart
# Scales all thresholds of a table: the likelihood is skewed along it, and along the thresholds, whose errors by
# curvature alone were a third of their profiles'
SWING = "led_off_fraction"


@dataclass(frozen=True)
class CameraFit:
    """One camera's fit: its model, the regression over its cells, and others that are as good, with poles exchanged."""

    model: LatencyModel
    regression: TableFit
    rivals: tuple[TableFit, ...] = ()

    @property
    def name(self) -> str:
        """The camera's label."""
        return self.model.camera

    @property
    def camera(self) -> Camera:
        """What was found, ready to predict."""
        return self.model.camera_at(self.regression.x, self.regression.scale)


@dataclass(frozen=True)
class LatencyFit:
    """A fitted table: one fit per camera, and how long it took."""

    table: LatencyTable
    fits: tuple[CameraFit, ...]
    seconds: float

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """What was found, one per camera."""
        return tuple(fit.camera for fit in self.fits)


def fit_latency(
    table: LatencyTable, progress: Callable[[float], None] | None = None, start: Sequence[Camera] = ()
) -> LatencyFit:
    """Fit every camera of a table.

    Args:
        table: of `reading.read_tables`.
        progress: called with the fraction done.
        start: cameras to begin at, by label; by default every fit begins at the library's values.

    Raises:
        InputError: for a camera of fewer than 4 cells.

    Example:
        >>> from pixelid.tables.latency import fit_latency, read_tables
        >>> fit = fit_latency(read_tables(["nist_latency_by_roi.csv"]))  # doctest: +SKIP
        >>> fit.cameras[0].model.values["sf_cutoff_hz"]  # doctest: +SKIP
    """
    began = time.perf_counter()
    names = list(dict.fromkeys(table.camera.tolist()))
    fits = []
    for k, name in enumerate(names):
        begin = camera_for(start, name, ()) if start else None
        fits.append(fit_camera(name, gather(table.select(table.camera == name)), start=begin))
        if progress is not None:
            progress((k + 1) / len(names))
    return LatencyFit(table, tuple(fits), time.perf_counter() - began)


def fit_camera(name: str, cells: Cells, *, one_delay: bool = False, start: Camera | None = None) -> CameraFit:
    """Fit the cells of one camera; `one_delay` for comparison, see `LatencyModel`."""
    median = cells.table.latency_s["median"]
    measured = int((np.isfinite(median) & (median >= LEAST_S)).sum())
    least_cells = 4  # a threshold, a delay and a bandwidth, and one to spare
    if measured < least_cells:
        raise InputError(
            f"camera {name}: expected at least {least_cells} cells with a median of {1e6 * LEAST_S:g} µs or more, "
            f"found {measured} (columns of seconds are named median_s, …)"
        )
    starts = FOLLOWER_STARTS_HZ[: 1 if start is not None else None]
    models = [LatencyModel(name, cells, hz, one_delay, start) for hz in starts]
    fits = [(fit_table(model), model) for model in models]
    best, model = max(fits, key=lambda pair: log_posterior_at(pair[0], pair[0].x))
    ends = [best, *(fit_table(model, start) for start in (*_exchanged(best), *_scaled(best)))]
    best = max(ends, key=lambda end: log_posterior_at(end, end.x))
    middle = f"on_{THRESHOLD.name}[{model.settings[len(model.settings) // 2]}]"
    widened = follow_profile(follow_profile(best, SWING), middle, moving=f"_{THRESHOLD.name}[")
    widened, rivals = with_rivals(widened, [end for end in ends if end is not best])
    return CameraFit(model, widened, tuple(rivals))


def _exchanged(fit: TableFit) -> list[list[float]]:
    """Values with the photoreceptor's own pole β and one of the later stages' exchanged.

    In a step response poles commute; only that α L / β follows the light shows which of them is the photoreceptor's.
    """
    values = {p.name: float(np.exp(x)) for p, x in zip(fit.parameters, fit.x, strict=True)}
    starts = []
    for name in ("sf_cutoff_hz", "diff_cutoff_hz"):
        other = values | {"beta": 2.0 * np.pi * values[name], name: values["beta"] / (2.0 * np.pi)}
        starts.append([p.within(other[p.name]) for p in fit.parameters])
    return starts


def _scaled(fit: TableFit) -> list[list[float]]:
    """Values with all thresholds and the bandwidth per light smaller and larger together.

    Well below the swing of the light a latency is their ratio, so that maxima may lie far apart along it.
    """
    values = {p.name: float(np.exp(x)) for p, x in zip(fit.parameters, fit.x, strict=True)}
    moved = [name for name in values if name == "alpha_over_beta" or name.startswith(("on_threshold", "off_threshold"))]
    return [
        [p.within(values[p.name] * (factor if p.name in moved else 1.0)) for p in fit.parameters] for factor in SCALED
    ]
