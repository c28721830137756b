"""Searches of pooled counts: from several thresholds, round by round, and the last one to within its errors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from pixelid.fit.newton import Optimum, maximise
from pixelid.fit.pooled_rate import PooledRateObjective

BLUR = 0.1  # noise added to thresholds where the search of a blurred pool starts
SCALES = (0.6, 0.75, 0.9, 1.1, 1.3)  # of thresholds, there
MAX_STEPS = 20  # of a round
# Standard errors that one more step would move: an estimate off by so many still has an interval of 94 % instead of
# 95 %, since Φ(1.96 − 0.3) − Φ(−1.96 − 0.3) = 0.94.
SETTLED = 0.3
FINE_NATS = 0.5 * SETTLED**2  # the same by the curvature
FINE_STEPS, FINE_ROUNDS = 6, 3  # of the last search: variances settle in two rounds


def best_teeth(objective: PooledRateObjective, x: np.ndarray) -> np.ndarray:
    """Of several scales of both thresholds, each searched a few steps, the point that suits the counts best.

    Pixels in step fire at the same phases of a ramp with n and with n + 1 events on it: optima of their own.
    """
    names = objective.coordinates.names
    which = [names.index(name) for name in ("on_threshold", "off_threshold") if name in names]
    ends = []
    for scale in SCALES if which else (1.0,):
        begin = x.copy()
        begin[which] += np.log(scale)
        part = objective.near(begin, scatter=False, blur=BLUR)
        ends.append(maximise(part, begin, tolerance=10.0, max_steps=8))
    return max(ends, key=lambda end: end.local.value).x


def in_rounds(
    objective: PooledRateObjective,
    x: np.ndarray,
    tolerance: float,
    blurs: Sequence[float],
    report: Callable[[float], None],
    fine: bool = False,
) -> tuple[PooledRateObjective, Optimum]:
    """(the objective near its optimum, the optimum): variances of counts and blur follow the search, round by round.

    fine: whether derivatives are the likelihood's own.
    """
    steps = 0
    for turn, blur in enumerate(blurs):
        objective = objective.near(x, scatter=blur == 0, blur=blur)
        objective = objective.fine() if fine else objective
        noisy = max(objective.likelihood.dispersion(objective.expected(x)), 1.0)
        optimum = maximise(
            objective, x, tolerance=tolerance * noisy, max_steps=MAX_STEPS,
            progress=lambda step, value, turn=turn: report((turn + step / MAX_STEPS) / len(blurs)),
        )  # fmt: skip
        move, x, steps = optimum.x - x, optimum.x, steps + optimum.steps
        if blur == 0 and move @ optimum.local.information @ move < SETTLED**2 * noisy:
            break
    return objective, replace(optimum, steps=steps)


def settled(
    objective: PooledRateObjective, x: np.ndarray, seed: int, report: Callable[[float], None]
) -> tuple[PooledRateObjective, Optimum, np.ndarray]:
    """The last search, which ends where one more step would move estimates by a part of their standard errors.

    Rough derivatives bring a search near the optimum, but do not vanish where the value peaks; those of the likelihood
    itself do.  Counts of neighbouring bins are not independent, so the curvature promises more than the errors by the
    scatter of the score: how far is far is judged by the latter.

    Args:
        objective, x: Where the search with rough derivatives has ended.
        seed: Of the simulated scores.
        report: Called with the share done.

    Returns:
        The objective near its optimum, the optimum, and (d, d) the inverse of the estimates' covariance.
    """
    steps = 0
    for turn in range(FINE_ROUNDS):
        objective = objective.near(x).fine()
        noisy = max(objective.likelihood.dispersion(objective.expected(x)), 1.0)
        optimum = maximise(
            objective, x, tolerance=FINE_NATS * noisy, max_steps=FINE_STEPS,
            progress=lambda step, value, turn=turn: report((turn + step / FINE_STEPS) / FINE_ROUNDS),
        )  # fmt: skip
        before, x, steps = x, optimum.x, steps + optimum.steps
        information = objective.information(x, optimum.local, seed)
        free = ~optimum.on_bound
        left = np.zeros(len(x))
        H = optimum.local.information[np.ix_(free, free)]
        left[free] = np.linalg.lstsq(H, optimum.local.gradient[free], rcond=1e-14)[0]
        longest = objective.coordinates.longest_moves()
        left /= max(1.0, float(np.abs(left / longest).max(initial=0.0)))
        moved, owed = ((move @ information @ move) / noisy for move in (x - before, left))
        if max(moved, owed) < SETTLED**2:
            break
    return objective, replace(optimum, converged=bool(owed < SETTLED**2), steps=steps), information
