"""Intervals along the direction that is known least, where the log posterior bends: one profile for all parameters.

The fastest poles, the dead time and a clock's delay are nearly exchangeable.  Along that ridge the likelihood is far
from a parabola (in ln f_diff, the pole's lag goes as 1/f_diff), and x ± 1.96 sd from the curvature at the optimum held
the truth in 6 of 10 sessions with free clocks.  So the parameter with the largest part in the ridge is profiled, and
each other one follows with what it moves to at the profile's limits.  With v_j the variance of parameter j, r_j its
correlation with the profiled one and d_j its move from the optimum to a limit,

    half width = √(d_j² + (half width of the normal interval)² − 1.96² r_j² v_j)

which is the normal interval again where the log posterior is a parabola (d_j = 1.96 r_j √v_j), and the profile's limit
where the ridge has no width.  Checked by `benchmarks/round_trip.py`.
"""

from __future__ import annotations

import numpy as np

from pixelid.fit.uncertainty.curvature import Identified
from pixelid.fit.uncertainty.profiles import Profile, Profiled, profile
from pixelid.statistics import Z95


def profile_of_ridge(objective: Profiled, x: np.ndarray, reading: Identified) -> Profile | None:
    """The profile of the parameter that leads the least known direction; None where none has a finite variance."""
    scale = objective.coordinates.longest_moves()
    covariance = reading.covariance / np.outer(scale, scale)
    _, vectors = np.linalg.eigh(covariance)
    lead = int(np.argmax(np.abs(vectors[:, -1])))
    if not covariance[lead, lead] > 0:
        return None
    return profile(objective, x, objective.coordinates.names[lead], reading.covariance)


def widened(
    normal: tuple[np.ndarray, np.ndarray], found: Profile, objective: Profiled, x: np.ndarray, covariance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(lower, upper) 95 % limits (d,) that follow a profile along the ridge.

    Args:
        normal: (lower, upper) as the curvature has them.
        found: the profile of the parameter that leads.
        objective: whose coordinates these are.
        x: optimum (d,).
        covariance: (d, d) of the curvature.

    Returns:
        Limits of the same shape; a side that the profile leaves open ends at the parameter's bound.
    """
    lead = objective.coordinates.names.index(found.name)
    bounds = objective.coordinates.bounds()
    explained = Z95**2 * covariance[:, lead] ** 2 / covariance[lead, lead]
    moves = np.stack([end - x for end in found.ends])
    limits = []
    for side, (limit, sign) in enumerate(zip(normal, (-1.0, 1.0), strict=True)):
        along = np.maximum(sign * moves, 0.0).max(axis=0)
        with np.errstate(invalid="ignore"):  # parameters on a bound have infinite intervals
            rest = np.maximum((limit - x) ** 2 - explained, 0.0)
        moved = np.where(np.isfinite(limit), x + sign * np.sqrt(along**2 + rest), limit)
        moved[lead] = x[lead] + sign * along[lead]
        if found.interval_95[side] is None:
            moved[lead] = bounds[side][lead]
        limits.append(moved)
    return limits[0], limits[1]
