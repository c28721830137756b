"""How far gain and background spread over pixels, estimated by the pixels themselves, and the fit that this makes.

Empirical Bayes in rounds.  In each the camera's parameters and all levels are brought to their joint optimum for given
scales (`objective.py`); then every scale goes to where the levels that the events show, centre c_i with variance w_i,
are likeliest:

    ln gain      Π N(c_i; 0, s² + w_i)
    background   Π 2 N(c_i; 0, s² + w_i) Φ(c_i s / √(w_i (s² + w_i))),     c_i and w_i without the prior's part.

w_i is marginal: what a change of the camera's parameters can stand for is in it.  So the divisor of s² is one less than
the number of pixels where the mean gain cannot be distinguished from the radiance's scale.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar, root_scalar
from scipy.special import log_ndtr, ndtr, ndtri

from pixelid.errors import InputError
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.event_times import weighs_stamps
from pixelid.fit.levels.covariance import Joint
from pixelid.fit.levels.objective import LevelledObjective
from pixelid.fit.levels.pixel_levels import (
    BACKGROUND,
    FAR,
    GAIN,
    Scales,
    Wanted,
    half_normal,
    half_normal_slope,
    with_own_lights,
)
from pixelid.fit.newton import Optimum, maximise
from pixelid.fit.refine import BETWEEN, PART_EVENTS
from pixelid.likelihood.event_times import EventTimes
from pixelid.recordings.own_light import with_fine_light
from pixelid.recordings.recording import Recording
from pixelid.recordings.selection import few
from pixelid.statistics import DROP_NATS
from pixelid.stimuli.pixel_lights import PixelLights

START = {GAIN: 0.2, BACKGROUND: 0.05}  # of ln gain; of the dimmest light's mean
# Of ln gain; of the dimmest light's mean, and of the brightest's.  Less is less than any parameter of a camera is known
# to; more is no nuisance.
LEAST, MOST = 1e-3, 2.0
# Of ln scale: a tenth of its standard error for 25 pixels.  Of x: squared, in standard errors.
SETTLED, MOST_ROUNDS = 0.015, 12
ROUND_NATS = 1e-4  # that a step of the camera's parameters may still promise: 0.014 standard errors
FAR_NATS, FAR_STEPS = 1.0, 40  # the same, and most steps, where scales are guesses
FAR_LEVELS = {"tolerance": 1e-2, "most_steps": 6}  # levels need not be at their best there: a better θ moves them more
VOLUME_STEP = 1e-2  # in standard errors of θ, for the slope of ln det
UNTOLD = 1e-6  # of a level's variance that events take away: they do not depend on it


@dataclass(frozen=True)
class Told:
    """A kind of level as the events show it, without the prior: centres and variances (p,) in its own unit."""

    centre: np.ndarray
    variance: np.ndarray
    positive: bool

    def evidence(self, scale: float) -> float:
        """Log-likelihood of a scale."""
        total = scale**2 + self.variance
        terms = -0.5 * (self.centre**2 / total + np.log(total))
        if self.positive:
            terms = terms + log_ndtr(self.centre * scale / np.sqrt(self.variance * total))
        return float(terms.sum())

    def likeliest(self, least: float, most: float) -> float:
        """The scale of the largest evidence."""
        grid = np.geomspace(least, most, 60)
        k = int(np.argmax([self.evidence(s) for s in grid]))
        ends = np.log(grid[[max(k - 1, 0), min(k + 1, 59)]])
        end = minimize_scalar(lambda s: -self.evidence(np.exp(s)), bounds=tuple(ends), method="bounded")
        return float(np.exp(end.x))

    def interval(self, scale: float, least: float, most: float) -> tuple[float, float | None]:
        """95 % by the likelihood ratio: 0 where no scale is too small, None where none is too large."""
        enough = self.evidence(scale) - DROP_NATS

        def over(log_scale: float) -> float:
            return self.evidence(np.exp(log_scale)) - enough

        def root(first: float, last: float) -> float:
            return float(np.exp(root_scalar(over, bracket=(first, last)).root))

        low, high = np.log(least), np.log(most)
        below = 0.0 if over(low) >= 0 else root(low, np.log(scale))
        above = None if over(high) >= 0 else root(np.log(scale), high)
        return below, above


@dataclass(frozen=True)
class Levelled:
    """A fit with levels.

    objective, optimum: of the camera's parameters;  wanted: what was asked for;  limits: of the scales, by kind
    details: as results show them
    """

    objective: LevelledObjective
    optimum: Optimum
    wanted: Wanted
    limits: Mapping[str, tuple[float, float]]
    details: Mapping[str, Any]


def fit_levels(
    recordings: Sequence[Recording], coordinates: Coordinates, starts: Sequence[np.ndarray], wanted: Wanted,
    between: Sequence[str],
) -> Levelled:  # fmt: skip
    """The camera's parameters, all levels and their scales.

    Args:
        recordings: with pixel addresses and a light each.
        coordinates: of the camera.
        starts: (d,) each, the likeliest of which is begun at: ends of searches without levels, which may be far off.
        wanted: what is asked for.
        between: how light may run between its samples (`refine.BETWEEN`); the likeliest is kept.

    Raises:
        InputError: events that do not depend on a kind of level at all.
    """
    ends: dict[str, Levelled] = {}
    for kind in between:
        finer = [with_fine_light(recording, kind) for recording in recordings]
        ends[kind] = _in_rounds(finer, coordinates, starts, wanted, next(iter(ends.values()), None))
    evidence = {kind: end.objective.evidence(end.optimum.x) for kind, end in ends.items()}
    best = max(evidence, key=lambda kind: evidence[kind])
    details = {**ends[best].details, "stimulus_between_samples": best}
    if len(ends) == len(BETWEEN):
        details["smooth_minus_linear_nats"] = evidence["smooth"] - evidence["linear"]
    return replace(ends[best], details=details)


def _in_rounds(
    recordings: Sequence[Recording], coordinates: Coordinates, starts: Sequence[np.ndarray], wanted: Wanted,
    begin: Levelled | None,
) -> Levelled:  # fmt: skip
    """As `fit_levels`, under light that is sampled finely; scales and levels begin where `begin` ended."""
    own = with_own_lights(recordings)
    likelihood, (dimmest, brightest) = EventTimes(own), _mean_lights(own)
    unit = {GAIN: 1.0, BACKGROUND: dimmest}
    limits = {GAIN: (LEAST, MOST), BACKGROUND: (LEAST * dimmest, MOST * brightest)}
    if begin is None:
        scales = Scales(**{kind: wanted.given.get(kind, START[kind] * unit[kind]) for kind in wanted.kinds})
        part = EventTimes(few(own, PART_EVENTS, np.random.default_rng(0)))
        first = LevelledObjective(part, coordinates, scales, **FAR_LEVELS)
        x = max(starts, key=lambda start: np.nan_to_num(first.value(start), nan=-np.inf))
        _refuse_untold(first, x)
        x = maximise(first, x, tolerance=FAR_NATS, max_steps=FAR_STEPS).x
        start = first.best(x).u if part.pixels == likelihood.pixels else None
        objective = LevelledObjective(likelihood, coordinates, scales, start)
    else:
        old, x = begin.objective, begin.optimum.x
        scales = old.scales
        objective = LevelledObjective(likelihood, coordinates, scales, old.best(x).u, old.tilt)
    for rounds in range(1, MOST_ROUNDS + 1):
        if rounds <= 2 and weighs_stamps(likelihood, coordinates):
            objective = objective.weighed(x)
        optimum = maximise(objective, x, tolerance=ROUND_NATS, max_steps=60)
        went, x = optimum.x - x, optimum.x
        told = told_by_events(objective, optimum)
        found = {kind: told[kind].likeliest(*limits[kind]) for kind in wanted.kinds if kind not in wanted.given}
        rescaled = max((abs(np.log(s / getattr(scales, kind))) for kind, s in found.items()), default=0.0)
        if rounds > 1 and rescaled < SETTLED and went @ optimum.local.information @ went < SETTLED:
            break
        if rounds < MOST_ROUNDS:
            tilt, old, scales = _tilt(objective, optimum), scales, replace(scales, **found)
            start = _rescaled(objective.best(x).u, old, scales)
            objective = LevelledObjective(objective.likelihood, coordinates, scales, start, tilt)
    return Levelled(objective, optimum, wanted, limits, {"rounds_of_level_scales": rounds})


def told_by_events(objective: LevelledObjective, optimum: Optimum) -> dict[str, Told]:
    """Every kind of level as the events show it, the camera's parameters being no better known than they are."""
    u = objective.best(optimum.x).u
    joint = Joint(_inverse(optimum), objective.best(optimum.x).block, objective.follows(optimum.x))
    out = {}
    for column, kind in enumerate(objective.scales.kinds):
        scale, at = getattr(objective.scales, kind), u[:, column]
        known = 1.0 / np.clip(joint.level_variances[:, column], 1e-12, 1.0 - 1e-9) - 1.0  # not the prior's
        if kind == GAIN:
            centre, slope = scale * at, scale
        else:
            centre, slope = scale * half_normal(at), scale * half_normal_slope(at)
        out[kind] = Told(centre + slope * at / known, slope**2 / known, kind == BACKGROUND)
    return out


def _refuse_untold(objective: LevelledObjective, x: np.ndarray) -> None:
    block = objective.best(x).block
    for column, kind in enumerate(objective.scales.kinds):
        if (block[:, column, column] - 1.0).max() < UNTOLD:
            raise InputError(f"pixel_levels: under model {objective.coordinates.model.name} no event depends on {kind}")


def _rescaled(u: np.ndarray, old: Scales, new: Scales) -> np.ndarray:
    """Levels u that are about the same under other scales."""
    out = u.copy()
    for column, kind in enumerate(old.kinds):
        ratio = getattr(old, kind) / getattr(new, kind)
        if kind == GAIN:
            out[:, column] *= ratio
        else:
            out[:, column] = _inverse_half_normal(ratio * half_normal(u[:, column]))
    return np.clip(out, -FAR, FAR)


def _inverse_half_normal(h: np.ndarray) -> np.ndarray:
    return -ndtri(np.clip(2.0 * ndtr(-h), 1e-300, 1.0 - 1e-16))


def _tilt(objective: LevelledObjective, optimum: Optimum) -> dict[str, tuple[float, float]]:
    """By parameter, the slope of −Σ ½ ln det B_i along it, the levels following."""
    x, u = optimum.x, objective.best(optimum.x).u
    follows, here = objective.follows(x), objective.log_volume(x, u)
    steps = VOLUME_STEP * np.sqrt(np.maximum(np.diag(_inverse(optimum)), 1e-12))
    steps = np.minimum(steps, 1e-2 * objective.coordinates.longest_moves())
    out = {}
    for i, name in enumerate(objective.coordinates.names):
        if optimum.on_bound[i]:
            continue
        moved = x.copy()
        moved[i] += steps[i]
        there = objective.log_volume(moved, np.clip(u + steps[i] * follows[:, :, i], -FAR, FAR))
        out[name] = float((there - here) / steps[i]), float(x[i])
    return out


def _inverse(optimum: Optimum) -> np.ndarray:
    """(d, d) covariance of the camera's parameters by Gauss and Newton's information, those on a bound held."""
    free = ~optimum.on_bound
    out = np.zeros(optimum.local.information.shape)
    out[np.ix_(free, free)] = np.linalg.pinv(optimum.local.information[np.ix_(free, free)], hermitian=True)
    return out


def _mean_lights(recordings: Sequence[Recording]) -> tuple[float, float]:
    """Mean radiance of the dimmest and of the brightest light."""
    stimuli = [recording.stimulus for recording in recordings]
    lights = [light for stimulus in stimuli if isinstance(stimulus, PixelLights) for light in stimulus.lights]
    means = [float(np.trapezoid(light.radiance, light.t) / light.duration_s) for light in lights]
    return min(means), max(means)
