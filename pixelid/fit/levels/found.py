"""What a fit with levels shows of them, and how far they enlarge the errors of the camera's parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pixelid.fit.levels.covariance import Joint
from pixelid.fit.levels.pixel_levels import BACKGROUND, GAIN, PixelLevels, Scales, half_normal, places
from pixelid.fit.levels.scales import Levelled, Told, told_by_events

CARRIED = 0.9  # of a standard error, below which knowing the mean gain would make a difference
NOTHING = np.empty(0)


def pixel_levels(found: Levelled, covariance: np.ndarray, on_bound: np.ndarray, width: int) -> PixelLevels:
    """What a fit with levels shows.

    Args:
        found: the fit.
        covariance: (d, d) of the camera's parameters, levels integrated out.
        on_bound: (d,) those held by a bound.
        width: of the sensor.
    """
    objective, x = found.objective, found.optimum.x
    u, scales = objective.best(x).u, objective.scales
    block, cross = objective.curvature(x)
    joint = Joint(covariance, block, np.linalg.solve(block, cross))
    these, variance = covariance, joint.level_variances
    if GAIN in scales.kinds:
        these, variance = joint.given_mean(scales.kinds.index(GAIN))
    levels = dict(zip((GAIN, BACKGROUND), scales.levels(u), strict=True))
    told = told_by_events(objective, found.optimum)
    sd = {}
    for column, kind in enumerate(scales.kinds):
        s = np.sqrt(np.maximum(variance[:, column], 0.0))
        sd[kind] = getattr(scales, kind) * (s if kind == GAIN else half_normal_sd(u[:, column], s))
    px, py = places(objective.likelihood.pixel_keys, width)
    camera = _camera(objective.coordinates.names, covariance, these, -objective.held(x).hessian(x), ~on_bound)
    return PixelLevels(
        px, py, levels[GAIN] if GAIN in sd else NOTHING, sd.get(GAIN, NOTHING),
        levels[BACKGROUND] if BACKGROUND in sd else NOTHING, sd.get(BACKGROUND, NOTHING),
        {kind: _scale(found, kind, told[kind]) for kind in scales.kinds}, camera, notes(scales, camera, variance),
    )  # fmt: skip


def _scale(found: Levelled, kind: str, told: Told) -> dict[str, Any]:
    value, given = getattr(found.objective.scales, kind), kind in found.wanted.given
    light = found.objective.likelihood.recordings[0].stimulus
    return {
        "value": value,
        "unit": "1" if kind == GAIN or light is None else light.unit,
        "interval_95": None if given else list(told.interval(value, *found.limits[kind])),
        "given": given,
    }


def _camera(names, covariance, these, known, free) -> dict[str, dict[str, float]]:
    """Standard errors by parameter: see `PixelLevels`; known: (d, d) curvature with the levels held."""
    held = np.full(len(free), np.nan)
    inverse = np.linalg.pinv(known[np.ix_(free, free)], hermitian=True)
    held[free] = np.sqrt(np.maximum(np.diag(inverse), 0.0))
    out = {}
    for i, name in enumerate(names):
        if free[i] and held[i] > 0:
            sd, of_these = (float(np.sqrt(max(matrix[i, i], 0.0))) for matrix in (covariance, these))
            out[name] = {
                "sd": sd, "sd_if_levels_known": float(held[i]), "growth": sd / float(held[i]),
                "sd_of_these_pixels": of_these,
            }  # fmt: skip
    return out


def notes(scales: Scales, camera: Mapping[str, Mapping[str, float]], variance: np.ndarray) -> tuple[str, ...]:
    """What levels that all pixels share cannot be distinguished from, and which levels single pixels hardly identify.

    Args:
        scales: of the levels.
        camera: see `PixelLevels`.
        variance: (p, k) of the levels, 1 before there are events.
    """
    said, pixels = [], len(variance)
    if scales.gain is not None:
        text = "a gain common to all pixels is another scale of the radiance: the mean of ln gain is held at 0"
        if carried := [name for name, sd in camera.items() if sd["sd_of_these_pixels"] < CARRIED * sd["sd"]]:
            share = 100.0 * scales.gain / np.sqrt(pixels)
            text += f"; these {pixels} may be {share:.2g} % off it, which the errors of {', '.join(carried)} hold"
        said.append(text)
    if scales.background is not None:
        said.append("a background common to all pixels is not distinguishable from a dark current: it is their sum")
    untold = 0.75  # of a level's variance that events leave
    for kind, left in zip(scales.kinds, np.median(variance, axis=0), strict=True):
        if left > untold:
            said.append(
                f"the {kind} of single pixels is hardly identified by their events: little better than its spread"
            )
    return tuple(said)


def half_normal_sd(u: np.ndarray, sd: np.ndarray) -> np.ndarray:
    """Standard deviations (p,) of `half_normal` of normal levels: near 0 its slope alone would promise too much."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(20)
    values, weights = half_normal(u[:, None] + sd[:, None] * nodes), weights / weights.sum()
    mean = values @ weights
    return np.sqrt(np.maximum((values - mean[:, None]) ** 2 @ weights, 0.0))
