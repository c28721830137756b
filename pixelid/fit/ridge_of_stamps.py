"""Along the ridge of fast poles and dead time, where stamps are noisy: the likelihood itself, nothing of it held.

What levels share by the noise of stamps is held near an optimum (`likelihood/stamps.py`).  Held variances and shares
leave the mean of the score alone, not the curvature: along the direction that stamps hardly know, the held likelihood
is several times too narrow, and a search rests on a slope of the likelihood itself.  So the least known parameter that
shares follow is held at values in a row, all else at rest at each with its own shares, until the profile is known about
its maximum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pixelid.fit.bench import is_of_bench
from pixelid.fit.event_times import EventTimesObjective, only_density_differs
from pixelid.fit.newton import Optimum
from pixelid.fit.uncertainty.profiles import at_fixed
from pixelid.likelihood.stamps import Bend

LARGEST = 0.3  # of a step along the ridge, in the coordinate's longest moves


@dataclass(frozen=True)
class Ridge:
    """The maximum along a ridge.

    name: of the parameter that leads
    objective, optimum: there
    known: share of the held likelihood's information about that parameter which the profile bears out
    """

    name: str
    objective: EventTimesObjective
    optimum: Optimum
    known: float

    def opened(self, names: Sequence[str], information: np.ndarray) -> np.ndarray:
        """(d, d) information without what it pretends to know of the parameter, all others open."""
        i = list(names).index(self.name)
        opened = information.copy()
        opened[i, i] -= (1.0 - self.known) / np.linalg.pinv(information, hermitian=True)[i, i]
        return opened


def ridge_of_stamps(objective: EventTimesObjective, optimum: Optimum) -> Ridge | None:
    """The maximum along the ridge from an optimum at rest; None where stamps share nothing, nothing misleads, or levels
    bend too much within the noise of stamps.

    Args:
        objective: Held as at the optimum.
        optimum: Of it.
    """
    carried = objective.likelihood.carried
    if carried is None or not carried.nearly_straight:
        return None
    covariance = np.linalg.pinv(optimum.local.information, hermitian=True)
    i = _leads(objective, optimum.x, covariance, carried.bend)
    if i is None:
        return None
    longest, own = float(objective.coordinates.longest_moves()[i]), float(covariance[i, i])
    step = min(float(np.sqrt(own)), LARGEST * longest)
    along = covariance[:, i] / own
    points = _climbed(objective, optimum.x, optimum.local.value, i, along, step)
    moves = sorted(points)
    k = int(np.argmax([points[move][0] for move in moves]))
    if not 0 < k < len(moves) - 1:
        return None  # the ridge goes on to a bound
    left, top, right = moves[k - 1 : k + 2]
    slope_left = (points[top][0] - points[left][0]) / (top - left)
    slope_right = (points[right][0] - points[top][0]) / (right - top)
    bent = 2.0 * (slope_left - slope_right) / (right - left)
    best = 0.5 * (left + top) + slope_left / bent
    x = points[top][1] + (best - top) * (points[right][1] - points[left][1]) / (right - left)
    x = np.clip(x, *objective.coordinates.bounds())
    there = objective.near(x)
    if there.value(x) < points[top][0]:
        x = points[top][1]
        there = objective.near(x)
    known = min(_profile_curvature(points, best) * own, 1.0)
    return Ridge(objective.coordinates.names[i], there, replace(optimum, x=x, local=there.local(x)), known)


def _profile_curvature(points: dict[float, tuple[float, np.ndarray]], best: float) -> float:
    """Of the parabola with its vertex at the maximum that fits a profile's points; a flat top widens it."""
    moves = np.array(sorted(points)) - best
    values = np.array([points[move][0] for move in sorted(points)])
    fallen = values.max() - values
    squares, weights = moves**2, np.exp(-fallen)  # points far down are not of the parabola
    return max(float(2.0 * (weights * squares) @ fallen / ((weights * squares) @ squares)), 1e-12)


def _leads(objective: EventTimesObjective, x: np.ndarray, covariance: np.ndarray, bend: Bend | None) -> int | None:
    """The least known coordinate that shares follow; None where the likelihood's slope is that of the held one."""
    names, circuit = objective.coordinates.names, objective.circuit(x)
    sd, differs = np.sqrt(np.maximum(np.diag(covariance), 1e-300)), np.zeros(len(x))
    steps = np.minimum(sd, objective.coordinates.longest_moves())
    nearby = 0.1  # of a standard error, over which slopes are taken
    for i in range(len(x)):
        values = []
        if is_of_bench(names[i]) or "[" in names[i]:
            continue
        for sign in (1.0, -1.0):
            moved = x.copy()
            moved[i] += sign * nearby * steps[i]
            there = objective.circuit(moved)
            if only_density_differs(circuit, there):
                break
            follows = objective.likelihood.with_stamps_at(there, bend)
            values.append(follows.log_likelihood(there) - objective.likelihood.log_likelihood(there))
        if len(values) == 2:
            differs[i] = (values[0] - values[1]) / (2.0 * nearby * steps[i])
    moves = np.abs(covariance @ differs) / sd
    negligible = 0.05  # of a standard error, by which the maximum would move
    if moves[differs != 0.0].max(initial=0.0) < negligible:
        return None
    return int(np.argmax(np.where(differs != 0.0, sd / objective.coordinates.longest_moves(), 0.0)))


def _climbed(
    objective: EventTimesObjective, x: np.ndarray, value: float, i: int, along: np.ndarray, step: float
) -> dict[float, tuple[float, np.ndarray]]:
    """Move of coordinate i → (value, coordinates) of the profile, on both sides of its maximum."""
    lower, upper = objective.coordinates.bounds()
    points = {0.0: (value, x)}

    def added(move: float) -> bool:
        """Whether there is a finite point of the profile there, within bounds, which is then among the points."""
        nearest = points[min(points, key=lambda other: abs(other - move))][1]
        start = np.clip(nearest + (x[i] + move - nearest[i]) * along, lower, upper)
        if abs(start[i] - x[i] - move) > 1e-9:
            return False
        start[i] = x[i] + move
        points[move] = at_fixed(objective, start, i)
        return bool(np.isfinite(points[move][0]))

    most_steps = 12
    known_from = 0.5  # nats by which the profile has fallen on both sides, so that its parabola is known
    for _ in range(most_steps):
        moves = sorted(points)
        top = max(points, key=lambda move: points[move][0])
        sides = [
            sign for sign, far in ((-1, moves[0]), (1, moves[-1]))
            if points[far][0] > points[top][0] - known_from
        ]  # fmt: skip
        if not sides:
            break
        sign = max(sides, key=lambda sign: points[moves[-1 if sign > 0 else 0]][0])
        width = max(step, 0.5 * (moves[-1] - moves[0]))
        if not added((moves[-1] if sign > 0 else moves[0]) + sign * min(width, 3.0 * step)):
            break
    return points
