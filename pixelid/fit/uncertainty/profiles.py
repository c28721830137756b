"""Profile likelihoods: one parameter moved, all others fitted again; what curvature at the optimum cannot see.

A 95 % limit is where the profile has dropped by χ²₁(0.95)/2 = 1.92 (Raue et al. 2009, Bioinformatics 25, 1923).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from pixelid.errors import InputError
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.data import event_times_of
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.newton import maximise
from pixelid.fit.pooled_rate import PooledRateObjective
from pixelid.fit.result import FitResult
from pixelid.likelihood.pooled_rate import PooledRate
from pixelid.parameters.parameter import Parameter
from pixelid.recordings.recording import Recording
from pixelid.statistics import DROP_NATS, Z95

MOST_STEPS = 14  # per side
NEAR = 1.3  # times the drop: so little beyond it, the limit lies within 2 % of where the root of the drop is linear
TURNS, AT_REST = 4, 0.1  # at most, and nats twice over by which one may still move, of what is held near an optimum
STEPS_OF_OTHERS = 100  # after one has moved: along a ridge a few dozen are needed

Profiled: TypeAlias = EventTimesObjective | PooledRateObjective


@dataclass(frozen=True)
class Profile:
    """One parameter's profile.

    kind: "bounded" | "one-sided" | "flat";  interval_95: in the parameter's unit, None where a side stays open
    values, drops: (m,) points tried, sorted, and how far the log posterior fell there
    ends: coordinates (d,) at both limits, the others fitted again; where a side stays open those at the last point
    """

    name: str
    kind: str
    interval_95: tuple[float | None, float | None]
    values: tuple[float, ...]
    drops: tuple[float, ...]
    ends: tuple[np.ndarray, np.ndarray]

    def as_dict(self) -> dict:
        """The entry in fit.json."""
        return {"kind": self.kind, "interval_95": list(self.interval_95), "values": self.values, "drops": self.drops}

    def sentence(self) -> str:
        """What it says, in words; empty when the parameter is bounded."""
        low, high = self.interval_95
        if self.kind == "flat":
            return f"{self.name}: its profile likelihood is flat, any value between its bounds fits"
        if self.kind == "one-sided":
            limit = f"at least {low:.4g}" if low is not None else f"at most {high:.4g}"
            return f"{self.name}: its profile likelihood is one-sided, the data only say {limit} (95 %)"
        return ""


def profile(
    objective: Profiled,
    x: np.ndarray,
    name: str,
    covariance: np.ndarray,
    dispersion: float = 1.0,
) -> Profile:
    """The profile of one free parameter around an optimum x (d,) with its Laplace covariance (d, d).

    dispersion: by which drops are divided, 1 for event times.
    """
    coordinates = objective.coordinates
    i = coordinates.names.index(name)
    parameter = coordinates.parameters[i]
    top = objective.value(x)
    scale = float(coordinates.longest_moves()[i])
    variance = covariance[i, i]
    sd = min(np.sqrt(variance), scale) if variance > 0 else 0.3 * scale
    along = covariance[:, i] / variance if variance > 0 else np.eye(len(x))[i]
    points = {0.0: 0.0}
    limits, ends = [], []
    for sign in (-1, 1):
        limit, end = _side(objective, x, i, sign, sd, along, top, dispersion, points)
        limits.append(limit)
        ends.append(end)
    order = sorted(points)
    to_value: Callable[[float], float] = lambda move: float(parameter.from_coordinate(float(x[i] + move)))  # noqa: E731
    low, high = (None if limit is None else to_value(limit) for limit in limits)
    kind = "bounded" if None not in (low, high) else "flat" if low is None and high is None else "one-sided"
    return Profile(
        name, kind, (low, high), tuple(to_value(m) for m in order), tuple(points[m] for m in order), (ends[0], ends[1])
    )


def _side(objective, x, i, sign, sd, along, top, dispersion, points) -> tuple[float | None, np.ndarray]:
    """The signed move at which the profile has dropped by DROP_NATS, None when the bound comes first; the others then.

    Both between the points on either side of the limit, as the root of the drop is linear in the move.
    """
    lower, upper = objective.coordinates.bounds()
    bound = abs((upper if sign > 0 else lower)[i] - x[i])
    move, near, far = min(Z95 * sd, bound), (0.0, 0.0, x), None
    for _ in range(MOST_STEPS):
        if move <= 0:
            return None, near[2]
        enough, wanted = top - DROP_NATS * dispersion, top - NEAR * DROP_NATS * dispersion
        value, end = _best_at(objective, near[2], x, i, x[i] + sign * move, along, enough, wanted)
        drop = max(top - value, 0.0) / dispersion
        points[sign * move] = drop
        if drop < DROP_NATS:
            near = move, drop, end
            if move >= bound:
                return None, end
        else:
            far = move, drop, end
            if drop < NEAR * DROP_NATS:
                break
        if far is not None:
            move = 0.5 * (near[0] + far[0])
        else:
            growth = 1.15 * np.sqrt(DROP_NATS / drop) if drop > 0.05 else 2.0
            move = min(move * float(np.clip(growth, 1.1, 2.0)), bound)
    if far is None:
        return None, near[2]
    a, b = np.sqrt(near[1]), np.sqrt(far[1])
    share = (np.sqrt(DROP_NATS) - a) / (b - a)
    return sign * float(near[0] + (far[0] - near[0]) * share), near[2] + share * (far[2] - near[2])


def _best_at(
    objective, nearest: np.ndarray, x: np.ndarray, i: int, target: float, along: np.ndarray, enough: float,
    wanted: float,
) -> tuple[float, np.ndarray]:  # fmt: skip
    """(log posterior, coordinates) with coordinate i held at `target` and all others maximised.

    The others start where they were at the profile's nearest point, from there moved along the covariance (no
    coordinate by more than a long step: flat directions have covariances that lead out of the world), or where they
    are at the optimum x; the likeliest of these first.  Others that did not follow would look like a drop, and end a
    profile that is open, so below `enough` the remaining starts are tried, too.  What cannot come up to `wanted` is
    not followed to its end.
    """
    lower, upper = objective.coordinates.bounds()
    longest = objective.coordinates.longest_moves()
    moved = nearest + np.clip((target - nearest[i]) * along, -longest, longest)
    starts = []
    for start in (moved, nearest, x):
        start = np.clip(start, lower, upper)
        start[i] = target
        starts.append(start)
    best = -np.inf, x
    for start in sorted(starts, key=lambda start: -np.nan_to_num(objective.value(start), nan=-np.inf)):
        best = max(best, at_fixed(objective, start, i, wanted), key=lambda end: end[0])
        if best[0] > enough:
            break
    return best


def at_fixed(objective, x: np.ndarray, i: int, wanted: float | None = None) -> tuple[float, np.ndarray]:
    """(log posterior, coordinates) with coordinate i held at x[i] and all others maximised from x.

    wanted: a value below which the maximum need not be known, see `newton.maximise`.
    """
    held = _holding(objective.coordinates, i, float(x[i]))
    others = np.arange(len(x)) != i
    own = _own_prior(objective.coordinates.parameters[i], float(x[i]))
    free, end = objective.on(held), x[others]
    value = -np.inf
    for _ in range(TURNS):
        here = free.following(end)
        optimum = maximise(
            here, end, tolerance=1e-2, max_steps=STEPS_OF_OTHERS, wanted=None if wanted is None else wanted - own
        )
        went, end, value = optimum.x - end, optimum.x, optimum.local.value
        if here is free or went @ optimum.local.information @ went < AT_REST:
            break
    full = x.copy()
    full[others] = end
    return value + own, full


def _own_prior(parameter: Parameter, c: float) -> float:
    return 0.0 if parameter.prior is None else parameter.prior.log_density(c)


def _holding(coordinates: Coordinates, i: int, c: float) -> Coordinates:
    """The coordinates without number i, which keeps the value at c."""
    p = coordinates.parameters[i]
    value = p.within(p.from_coordinate(c))
    rest = tuple(q for q in coordinates.parameters if q.name != p.name)
    if p.name in coordinates.nuisances:
        nuisances = {**coordinates.nuisances, p.name: p.at(value).fixed()}
        return replace(coordinates, nuisances=nuisances, parameters=rest)
    return replace(coordinates, model=coordinates.model.fix({p.name: value}), parameters=rest)


def objective_of(result: FitResult, recordings: Sequence[Recording]) -> Profiled:
    """The objective whose optimum a result is."""
    if result.observation == "pooled_rate":
        return PooledRateObjective(PooledRate(recordings), result.coordinates)
    return event_times_of(result, recordings)


def profiled(
    result: FitResult, recordings: Sequence[Recording], progress: Callable[[str, float], None] | None = None
) -> FitResult:
    """The result with every free parameter profiled: `details["profiles"]`, and identified only where bounded.

    Raises InputError for a fit with levels of pixels.
    """
    if result.pixel_levels is not None:
        raise InputError("profile: not of a fit with pixel_levels, whose levels would be held at their estimates")
    objective = objective_of(result, recordings)
    dispersion = float(result.details.get("dispersion", 1.0))
    profiles = {}
    names = result.coordinates.names
    for i, name in enumerate(names):
        if progress:
            progress(f"profiling {name}", i / len(names))
        profiles[name] = profile(objective, result.x, name, result.covariance, dispersion)
    estimates = {
        name: replace(e, identified=e.identified and profiles[name].kind == "bounded") if name in profiles else e
        for name, e in result.estimates.items()
    }
    sentences = tuple(p.sentence() for p in profiles.values() if p.sentence())
    return replace(
        result,
        estimates=estimates,
        unidentified=(*result.unidentified, *sentences),
        details={**result.details, "profiles": {name: p.as_dict() for name, p in profiles.items()}},
    )
