"""Descriptions screened by their scores: how the log-likelihood changes with a strength that is still zero.

With g the derivative by the strength, θ the fitted parameters and I the information of both,

    S = g − I_sθ I_θθ⁻¹ g_θ        V = I_ss − I_sθ I_θθ⁻¹ I_θs

the part that the fitted parameters cannot imitate: it gains S²/2V nats, at a strength of S/V, to second order.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from pixelid.errors import InputError
from pixelid.fit.event_times import EventTimesObjective, along
from pixelid.fit.maximise import Maximum
from pixelid.likelihood.density import NUMBERS
from pixelid.likelihood.event_times import EventTimes
from pixelid.likelihood.information import Information, Tangent
from pixelid.model.model import Model
from pixelid.stages.described import Described

STEP = 1e-6  # of a strength, times its usual size: rounding 1e-14 of a change, the change of second order 1e-12
USUAL = {"dead_time": 1e-3}  # seconds; 1 for shares and Hz, and for a low-pass, which a microsecond does not bend


@dataclass(frozen=True)
class Screened:
    """A description and what its score promises.

    start: the model with it, at the strength that the score promises;  gain: nats
    """

    own: Described
    start: Model
    gain: float


def screened(likelihood: EventTimes, fit: Maximum, beginnings: Iterable[tuple[Described, Model]]) -> list[Screened]:
    """Descriptions by the gain that their scores promise on a likelihood's events, the largest first."""
    objective = EventTimesObjective(likelihood, fit.coordinates)
    d = len(fit.x)
    here = objective.terms(fit.x)
    gradient, information = here.gradient(), Information(here, d + 1)
    by_fitted = np.empty(d)
    for i in range(d):
        tangent = objective.tangent(fit.x, i)
        by_fitted[i] = along(gradient, tangent)
        information.add(i, tangent)
    found = []
    max_strength = 0.5  # of what may fall as well as rise, to start a fit from: the score is a straight line
    for own, start in beginnings:
        strength = start.parameter(f"{own.name}.strength")
        step = STEP * USUAL.get(own.quantity, 1.0)
        try:
            moved = likelihood.changes(start.set({strength.name: step}).circuit(), here.changes)
        except InputError:
            continue
        slope = moved.vector
        slope -= here.changes.vector
        slope /= step
        if not np.isfinite(slope).all():
            continue
        tangent = Tangent(moved, np.zeros(len(NUMBERS)))
        information.add(d, tangent)
        matrix = information.matrix()
        promise = _promise(along(gradient, tangent), by_fitted, matrix)
        if promise is None:
            continue
        at, gain = promise
        if strength.lower < at < strength.upper:
            limit = max_strength * USUAL.get(own.quantity, 1.0)
            begin = float(np.clip(at, -limit, limit)) if strength.lower < 0.0 else at
            found.append(Screened(own, start.set({strength.name: begin}), gain))
    return sorted(found, key=lambda one: -one.gain)


def _promise(g: float, by_fitted: np.ndarray, information: np.ndarray) -> tuple[float, float] | None:
    """(strength, nats); None where the fitted parameters imitate it."""
    cross = information[-1, :-1]
    solved = np.linalg.lstsq(information[:-1, :-1], np.column_stack([cross, by_fitted]), rcond=1e-12)[0]
    variance = float(information[-1, -1] - cross @ solved[:, 0])
    min_share_unfitted = 1e-3  # of a score's variance that must be left when the fitted parameters are projected out
    if not variance > min_share_unfitted * information[-1, -1]:
        return None
    score = g - float(cross @ solved[:, 1])
    return score / variance, 0.5 * score**2 / variance
