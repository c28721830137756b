"""Maximise a log posterior: damped Newton steps on the information matrix, inside bounds.

Levenberg–Marquardt with Nielsen's damping update (Madsen, Nielsen & Tingleff 2004, section 3.2).  Each step is the best
one of the quadratic model inside the bounds and the longest move of each coordinate: a coordinate that the data do not
identify goes as far as it may without shortening the moves of the others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pixelid.fit.coordinates import Coordinates
from pixelid.fit.objective import Local, Objective

CRAWL, ALIKE, FASTER = 5, 1.1, 10.0  # steps; ratio of promises that are the same; by which crawls may yet speed up


@dataclass(frozen=True)
class Optimum:
    """Where a search ended.

    x: coordinates;  local: value, gradient, information there;  converged: whether the expected gain of one more
    step is below the tolerance;  on_bound: (n,) coordinates held by a bound;  steps: how many it took.
    """

    x: np.ndarray
    local: Local
    converged: bool
    on_bound: np.ndarray
    steps: int


def maximise(
    objective: Objective,
    start: np.ndarray,
    *,
    tolerance: float = 1e-6,
    max_steps: int = 200,
    wanted: float | None = None,
    progress: Callable[[int, float], None] | None = None,
) -> Optimum:
    """Move from `start` until one more step promises less than `tolerance` nats.

    wanted: a value that the maximum is asked to reach; a search that crawls towards less ends early, not converged
    (`_hopeless`);  progress(step, value): called after every step
    """
    x = np.clip(np.asarray(start, dtype=float), *objective.coordinates.bounds())
    here = objective.local(x)
    damping: float = 1e-3
    growth = 2.0
    converged = False
    steps = 0
    held = np.zeros(len(x), dtype=bool)
    promises: list[float] = []
    while steps < max_steps:
        move, held = best_move(objective.coordinates, x, here, damping)
        if held.all():
            converged = True
            break
        trial = x + move
        predicted = here.gradient @ move - 0.5 * move @ here.information @ move
        steps += 1
        if damping <= 1.0 and predicted < tolerance:
            converged = True
            break
        promises.append(float(predicted))
        if wanted is not None and _hopeless(promises, wanted - here.value, max_steps - steps):
            break
        value = objective.value(trial)
        gain = value - here.value
        if np.isfinite(value) and gain > 1e-4 * predicted:
            x, here = trial, objective.local(trial)
            ratio = gain / predicted
            damping *= float(max(1.0 / 3.0, 1.0 - (2.0 * ratio - 1.0) ** 3))
            damping = max(damping, 1e-10)
            growth = 2.0
        else:
            damping *= growth
            growth *= 2.0
            if damping > 1e12:
                break
        if progress:
            progress(steps, here.value)
    return Optimum(x, here, converged, held, steps)


def with_observed_curvature(objective: Objective, optimum: Optimum, *, tolerance: float, rounds: int = 8) -> Optimum:
    """The optimum that expected information did not lead to, by Newton steps with the Hessian observed on the way.

    Where that is not the curvature (levels that noise moves, heavy-tailed priors), damped steps overshoot and crawl.
    """
    lower, upper = objective.coordinates.bounds()
    x, here, steps = optimum.x, optimum.local, optimum.steps
    halvings = 6  # of a step that overshoots
    for _ in range(rounds):
        held = held_by_bounds(x, here, lower, upper)
        free = ~held
        H, g = -objective.hessian(x, here)[np.ix_(free, free)], here.gradient[free]
        if not np.isfinite(H).all() or np.linalg.eigvalsh(H).min() <= 0.0:
            break
        move = np.zeros(len(x))
        move[free] = np.linalg.solve(H, g)
        move /= max(1.0, float(np.abs(move / objective.coordinates.longest_moves()).max()))
        if 0.5 * here.gradient @ move < tolerance:
            return Optimum(x, here, True, held, steps)
        for _ in range(halvings):
            trial = np.clip(x + move, lower, upper)
            if objective.value(trial) > here.value:
                break
            move = 0.5 * move
        else:
            break
        x, here, steps = trial, objective.local(trial), steps + 1
    return Optimum(x, here, False, held_by_bounds(x, here, lower, upper), steps)


def best_move(coordinates: Coordinates, x: np.ndarray, local: Local, damping: float) -> tuple[np.ndarray, np.ndarray]:
    """((d,) the damped Newton step from x, inside bounds and longest moves; (d,) bool: coordinates held by a bound)."""
    lower, upper = coordinates.bounds()
    longest = coordinates.longest_moves()
    held = held_by_bounds(x, local, lower, upper)
    move, free = np.zeros(len(x)), ~held
    if free.any():
        H = local.information[np.ix_(free, free)]
        scale = np.maximum(np.diag(H), 1e-8 * max(np.diag(H).max(), 1e-300))
        nearest, farthest = np.maximum(lower - x, -longest), np.minimum(upper - x, longest)
        damped = H + damping * np.diag(scale)
        move[free] = _best_inside(damped, local.gradient[free], nearest[free], farthest[free])
    return np.clip(x + move, lower, upper) - x, held


def held_by_bounds(x: np.ndarray, local: Local, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """(p,) bool: coordinates on a bound and pushed outwards."""
    return ((x <= lower) & (local.gradient < 0)) | ((x >= upper) & (local.gradient > 0))


def _best_inside(H: np.ndarray, g: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Where g·m − ½ m·H·m is largest with low ≤ m ≤ high (n,), by an active set (Nocedal & Wright 2006, chapter 16)."""
    move, inside = np.zeros(len(g)), np.ones(len(g), dtype=bool)
    for _ in range(3 * len(g)):
        push = g[inside] - H[np.ix_(inside, ~inside)] @ move[~inside]
        move[inside] = np.linalg.solve(H[np.ix_(inside, inside)], push)
        beyond = inside & ((move < low) | (move > high))
        if beyond.any():
            move = np.clip(move, low, high)
            inside &= ~beyond
            continue
        slope = g - H @ move
        back = ~inside & (((move <= low) & (slope > 0)) | ((move >= high) & (slope < 0))) & (low < high)
        if not back.any():
            break
        inside[np.argmax(np.where(back, np.abs(slope), -1.0))] = True
    return np.clip(move, low, high)


def _hopeless(promises: list[float], missing: float, left: int) -> bool:
    """Whether a search crawls: `CRAWL` steps have promised the same, and `FASTER` times that would not do.

    One small promise says little, since promises may double with every step along a ridge of exchangeable poles.
    """
    latest = promises[-CRAWL:]
    steady = len(latest) == CRAWL and max(latest) < ALIKE * min(latest)
    return steady and FASTER * left * latest[-1] < missing
