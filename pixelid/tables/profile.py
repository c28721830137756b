"""Errors that follow the likelihood where it is no parabola, along one coordinate that the others go with.

The normal approximation knows the curvature at the maximum only.  Where a direction is nearly open and the likelihood
skewed, as along the swing of a light that scales all thresholds, it excludes what the rows hardly speak against.  So
the coordinate is moved until the profile has fallen by what a 95 % interval allows, and its error raised to that
distance, with all that goes with it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from pixelid.statistics import Z95
from pixelid.tables.fit import TableFit, Tie, covariance_at, fit_table, log_posterior_at

FALL = 0.5 * Z95**2  # nats at the ends of a 95 % interval
LEAST_SD = 0.01  # the curvature of a skewed likelihood said 3 % where its profile says 8
HELD_SD = 1e-3  # in ln: far below LEAST_SD


Fallen = Callable[[int, float, np.ndarray], float]  # see `follow_profile`


def follow_profile(fit: TableFit, name: str, fallen: Fallen | None = None, moving: str = "") -> TableFit:
    """The fit with errors widened to the profile of one parameter, where that is wider than the normal approximation.

    Args:
        fit: at its maximum.
        name: of the parameter.
        fallen: (place of a coordinate, value at which it is held, coordinates to begin at) → by how many nats the
            maximum is lower then; of `fit_table` by default.
        moving: part of the names of those whose errors are raised; by default of all that goes with the parameter.

    Returns:
        The same fit where the parameter is known to `LEAST_SD`, lies on a bound or is wide open.
    """
    k = [p.name for p in fit.parameters].index(name)
    covariance = covariance_at(fit)
    sd = float(np.sqrt(covariance[k, k]))
    if not (LEAST_SD < sd < np.inf and np.isfinite(fit.sd[k])):
        return fit
    along = covariance[:, k] / covariance[k, k]
    reach = max(_reach(fit, k, side, sd, along, fallen or _fallen(fit)) for side in (-1.0, 1.0)) / Z95
    if reach <= sd:
        return fit
    moved = np.array([moving in p.name for p in fit.parameters])
    return _widened(fit, moved * along * np.sqrt(reach**2 - sd**2))


def with_rivals(fit: TableFit, others: Sequence[TableFit]) -> tuple[TableFit, list[TableFit]]:
    """The fit with errors that reach the other maxima which the rows speak no more against than a 95 % interval allows.

    Args:
        fit: at the highest.
        others: at further ones, of the same model.

    Returns:
        The fit, and those of the others that are as good and elsewhere.
    """
    top, rivals = log_posterior_at(fit, fit.x), []
    for other in others:
        apart = np.abs(other.x - fit.x) / np.where(np.isfinite(fit.sd), fit.sd, np.inf)
        if top - log_posterior_at(fit, other.x) < FALL and apart.max() > Z95:
            # to the far end of the other's interval, where that is farther than the fit's own
            reach = np.abs(other.x - fit.x) / Z95 + np.where(np.isfinite(other.sd), other.sd, 0.0)
            further = np.sqrt(np.maximum(reach**2 - np.where(np.isfinite(fit.sd), fit.sd, np.inf) ** 2, 0.0))
            fit = _widened(fit, np.sign(other.x - fit.x) * further)
            rivals.append(other)
    return fit, rivals


def _widened(fit: TableFit, by: np.ndarray) -> TableFit:
    rows = by[None] if fit.wider is None else np.vstack([fit.wider, by])
    return replace(fit, wider=rows, sd=np.sqrt(fit.sd**2 + by**2))


def _fallen(fit: TableFit) -> Fallen:
    top = log_posterior_at(fit, fit.x)

    rest = 0.02  # nats; the end of an interval moves by half a per cent

    def fallen(k: int, wanted: float, start: np.ndarray) -> float:
        held = fit_table(fit.model, np.exp(start).tolist(), (*fit.ties, Tie((k,), wanted, HELD_SD)), rest=rest)
        return top - log_posterior_at(fit, held.x)

    return fallen


def _reach(fit: TableFit, k: int, side: float, sd: float, along: np.ndarray, fallen: Fallen) -> float:
    """How far the coordinate goes to one side until the profile has fallen by `FALL`; up to its bound."""
    lower, upper = np.array([p.coordinate_bounds() for p in fit.parameters]).T
    most = abs((upper if side > 0 else lower)[k] - fit.x[k])
    before, fallen_before, distance = 0.0, 0.0, Z95 * sd
    growth, tries = 1.6, 4  # of the step that looks for the end of the interval; up to ten standard errors away
    for _ in range(tries):
        distance = min(distance, most)
        start = np.clip(fit.x + along * side * distance, lower, upper)
        now = fallen(k, float(fit.x[k] + side * distance), start)
        if now >= FALL:  # roots of the fall are nearly linear in the distance
            a, b = np.sqrt(max(fallen_before, 0.0)), np.sqrt(now)
            return before + (distance - before) * float((np.sqrt(FALL) - a) / (b - a))
        if distance >= most:
            return most
        before, fallen_before, distance = distance, now, distance * growth
    return before
