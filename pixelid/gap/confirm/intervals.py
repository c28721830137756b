"""95 % intervals of the parameters of a fitted model, in their own units."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from pixelid.fit.coordinates import Coordinates
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.maximise import Maximum
from pixelid.fit.uncertainty.small_sample import intervals
from pixelid.likelihood.event_times import EventTimes
from pixelid.parameters.parameter import Parameter

# Curvature along a direction, of the largest there is, that rounding of sums over 1e4 to 1e6 events leaves of none.
FLAT = 1e-12
ROUNDING = 1e-9  # relative, of a bound that has gone through its coordinate and back
TAKES_PART = 1e-8  # share of a flat direction, squared: ten thousand standard errors of the others move it by one


def interval_95(
    likelihood: EventTimes, end: Maximum, scatter: Mapping[str, float] | None = None
) -> dict[str, tuple[float, float]]:
    """name → (low, high) of every free parameter, from the Hessian (information matrix where it is not positive).

    A parameter that the data do not tell has the whole range between its bounds.

    scatter: standard deviation of coordinates between draws of times behind a readout
    """
    objective = EventTimesObjective(likelihood, end.coordinates)
    curvature = -objective.hessian(end.x)
    try:
        covariance = np.linalg.inv(curvature)
        if not (np.diag(covariance) > 0).all() or not np.isfinite(covariance).all():
            raise np.linalg.LinAlgError
        np.linalg.cholesky(curvature)
    except np.linalg.LinAlgError:
        covariance = _inverse_or_open(end.information)
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    drawn = np.array([(scatter or {}).get(name, 0.0) for name in end.coordinates.names])
    # Variance that unknown times add, over that between refits to successive draws of them.  Draws remember each
    # other, so they vary less than independent ones; that the factor is two is a choice.
    imputation_variance_factor = 2.0
    sd = np.sqrt(sd**2 + imputation_variance_factor * drawn**2)
    lower, upper = intervals(end.coordinates.names, end.x, sd, likelihood.pixels)
    return {name: in_units(end.coordinates, i, lower[i], upper[i]) for i, name in enumerate(end.coordinates.names)}


def open_sides(limits: tuple[float, float] | None, parameter: Parameter) -> tuple[float | None, float | None] | None:
    """The interval with None for a side that ends where the parameter's range does: no data end it there."""
    if limits is None:
        return None
    low, high = limits
    open_below = low <= parameter.lower or math.isclose(low, parameter.lower, rel_tol=ROUNDING)
    open_above = high >= parameter.upper or math.isclose(high, parameter.upper, rel_tol=ROUNDING)
    return None if open_below else low, None if open_above else high


def _inverse_or_open(information: np.ndarray) -> np.ndarray:
    """The inverse (d, d) of an information matrix, with infinite variance of what takes part in a flat direction."""
    scale = np.sqrt(np.maximum(np.diag(information), 0.0))
    scale[scale == 0.0] = 1.0
    curvature, directions = np.linalg.eigh(information / np.outer(scale, scale))
    flat = curvature <= FLAT * max(float(curvature[-1]), 0.0)
    kept = directions[:, ~flat]
    covariance = (kept / curvature[~flat]) @ kept.T / np.outer(scale, scale)
    takes_part = (directions[:, flat] ** 2).sum(axis=1) > TAKES_PART
    covariance[takes_part, takes_part] = np.inf
    return covariance


def in_units(coordinates: Coordinates, i: int, low: float, high: float) -> tuple[float, float]:
    """An interval of coordinate i in the parameter's unit, within its bounds, however wide."""
    p = coordinates.parameters[i]
    low, high = (p.from_coordinate(float(np.clip(c, -300.0, 300.0))) for c in (low, high))
    return max(low, p.lower), min(high, p.upper)
