"""95 % intervals of the parameters of a fitted model, in their own units."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pixelid.fit.coordinates import Coordinates
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.maximise import Maximum
from pixelid.fit.uncertainty.small_sample import intervals
from pixelid.likelihood.event_times import EventTimes

# Variance that unknown times add, over that between refits to successive draws of them.  Draws remember each other, so
# they vary less than independent ones; that the factor is two is a choice.
IMPUTATION_VARIANCE_FACTOR = 2.0


def interval_95(
    likelihood: EventTimes, end: Maximum, scatter: Mapping[str, float] | None = None
) -> dict[str, tuple[float, float]]:
    """name → (low, high) of every free parameter, from the Hessian (information matrix where it is not positive).

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
        covariance = np.linalg.pinv(end.information)
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    drawn = np.array([(scatter or {}).get(name, 0.0) for name in end.coordinates.names])
    sd = np.sqrt(sd**2 + IMPUTATION_VARIANCE_FACTOR * drawn**2)
    lower, upper = intervals(end.coordinates.names, end.x, sd, likelihood.pixels)
    return {name: _in_units(end.coordinates, i, lower[i], upper[i]) for i, name in enumerate(end.coordinates.names)}


def _in_units(coordinates: Coordinates, i: int, low: float, high: float) -> tuple[float, float]:
    p = coordinates.parameters[i]
    low, high = (p.from_coordinate(float(np.clip(c, -300.0, 300.0))) for c in (low, high))
    return max(low, p.lower), min(high, p.upper)
