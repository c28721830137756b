"""Intervals of physical circuit values, from those of the invariants that events show."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pixelid.fit.coordinates import Coordinates
from pixelid.model.model import Model
from pixelid.parameters.invariants import INVARIANTS, PHYSICAL_NAMES, Physical
from pixelid.statistics import Z95

UNMOVED = 1e-9  # standard error of a logarithm below which the gauge holds a value, up to rounding


def physical_intervals(
    model: Model, coordinates: Coordinates, covariance: np.ndarray, values: Mapping[str, float]
) -> dict[str, tuple[float, float] | None]:
    """95 % intervals of the physical values under the model's gauge, by propagation of ln α, ln β, ln γ.

    Args:
        model: the fitted one, with a complete gauge.
        coordinates: of the fit.
        covariance: (d, d) in these coordinates.
        values: the physical values by name.

    Returns:
        Name → interval; None where the gauge states the value, and where the data leave it open.
    """
    physical = Physical(**values)
    index = {name: i for i, name in enumerate(coordinates.names)}
    by_log = np.zeros((len(INVARIANTS), len(covariance)))
    for row, name in enumerate(INVARIANTS):
        if name in index:
            linear = model.parameters[name].transform != "log"
            by_log[row, index[name]] = 1.0 / model.values[name] if linear else 1.0
    moved = model.gauge.response(physical) @ by_log
    reached = np.abs(moved) > UNMOVED
    known = np.where(np.isfinite(covariance), covariance, 0.0)
    variance = np.einsum("ij,jk,ik->i", moved, known, moved)
    is_open = reached @ ~np.isfinite(np.diag(covariance))
    return {
        name: None
        if unknown or not v > UNMOVED**2
        else tuple(float(values[name] * np.exp(side * Z95 * np.sqrt(v))) for side in (-1.0, 1.0))
        for name, v, unknown in zip(PHYSICAL_NAMES, variance, is_open, strict=True)
    }  # type: ignore[return-value]
