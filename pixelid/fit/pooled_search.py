"""Searches of pooled counts: from several thresholds, round by round, and the last one to within its errors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from pixelid.fit.coordinates import Coordinates
from pixelid.fit.newton import Optimum, best_move, maximise
from pixelid.fit.objective import Local
from pixelid.fit.pooled_rate import PooledRateObjective
from pixelid.parameters.parameter import OPEN_SD
from pixelid.statistics import Z95

BLUR = 0.1  # noise added to thresholds where the search of a blurred pool starts
# Times both thresholds: optima lie where a ramp makes one event more or less, of 3 to 10.
SCALES = (0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.25, 1.4, 1.6, 1.8)
# So many of the best go on, for so many steps: a few steps match the number of events, more the place of bursts.
LEGS = ((10_000, 2), (10, 10), (2, 40))
MAX_STEPS = 20  # of a round
# Standard errors that one more step would move: an estimate off by so many still has an interval of 94 % instead of
# 95 %, since Φ(1.96 − 0.3) − Φ(−1.96 − 0.3) = 0.94.
SETTLED = 0.3
ROUNDS, CHORDS = 10, 6  # of the last search, and steps with the derivatives of one round
FOLLOW = (
    2  # rounds whose forward pass and variances are new: where these change, so does the optimum, within its errors
)
CLOSER = 0.7  # times as far from the end, at most, after a step with the same derivatives
DAMPING, MILDER, TRIALS = 1e-3, 5.0, 6  # of steps where derivatives change too much: least, factor, how often
SLOW, HELD = 1.0, 1e6  # stiffness of open directions, times that of the least known other
NEAR = 1.0  # standard errors that a round may move estimates for its derivatives to be those of the optimum


def best_teeth(objective: PooledRateObjective, begins: Sequence[np.ndarray]) -> np.ndarray:
    """Of several scales of both thresholds from each point, what suits the counts best after a race of searches.

    Pixels in step fire at the same phases of a ramp with n and with n + 1 events on it: optima of their own.
    """
    names = objective.coordinates.names
    which = [names.index(name) for name in ("on_threshold", "off_threshold") if name in names]
    ends = []
    for x in begins:
        for scale in SCALES if which else (1.0,):
            begin = x.copy()
            begin[which] += np.log(scale)
            ends.append(begin)
    for most, steps in LEGS:
        optima = sorted((_blurred(objective, begin, steps) for begin in ends[:most]), key=lambda end: -end.local.value)
        ends = [end.x for end in optima]
    return ends[0]


def _blurred(objective: PooledRateObjective, x: np.ndarray, steps: int) -> Optimum:
    part = objective.near(x, scatter=False, blur=BLUR)
    return maximise(part, x, tolerance=1.0, max_steps=steps)


def in_rounds(
    objective: PooledRateObjective,
    x: np.ndarray,
    tolerance: float,
    blurs: Sequence[float],
    report: Callable[[float], None],
) -> tuple[PooledRateObjective, Optimum]:
    """(the objective near its optimum, the optimum): variances of counts and blur follow the search, round by round."""
    steps = 0
    for turn, blur in enumerate(blurs):
        objective = objective.near(x, scatter=blur == 0, blur=blur)
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
    objective: PooledRateObjective, x: np.ndarray, seed: int, report: Callable[[float], None], within: float = SETTLED
) -> tuple[PooledRateObjective, Optimum, np.ndarray]:
    """The last search: where the score Σ J (n − λ)/v is 0, to within a part of the estimates' standard errors.

    J and v are those of the model at which a round begins.  The score's expectation is 0 at the true λ whatever they
    are (McCullagh & Nelder 1989, section 9.5), so a round solves it with one J, which costs a dozen counts λ, and the
    next begins where it ended.  Narrow bursts make the likelihood a curved ridge, on which the value promises little;
    the score is solved along it.  Counts of neighbouring bins are not independent, so how far is far is judged by the
    scatter of the score, not by the curvature.  Simulated pixels also show the score's mean, which is corrected for.
    A direction that the data leave open has no end to arrive at, and what is known bends along it: it is followed
    slowly for a while, then held, and has arrived where the end is within its interval.

    Args:
        objective, x: Where the search with rough derivatives has ended.
        seed: Of the simulated scores.
        report: Called with the share done.
        within: Standard errors that one more step may move.

    Returns:
        The objective near its optimum, the optimum, and (d, d) the inverse of the estimates' covariance.
    """
    objective, coordinates, steps, damping = objective.fine(), objective.coordinates, 0, DAMPING
    while True:
        objective = objective.near(x) if steps < FOLLOW else objective
        local = objective.local(x)
        noisy = max(objective.likelihood.dispersion(objective.expected(x)), 1.0)
        information, mean = objective.scatter(x, local, seed)
        known, slow = identified(coordinates, information / noisy, SLOW if steps < FOLLOW else HELD)
        whole, _ = best_move(coordinates, x, local, 0.0)
        off = whole @ (information / noisy - known) @ whole
        slowed = replace(local, information=local.information + slow)
        begin, (left, held) = x, best_move(coordinates, x, slowed, 0.0)
        owed = left @ known @ left
        for _ in range(CHORDS):
            if owed < within**2:
                break
            there = replace(slowed, gradient=objective.score(x + left, begin))
            after, held_after = best_move(coordinates, x + left, there, 0.0)
            if after @ known @ after > CLOSER * owed:
                break
            x, left, held, owed = x + left, after, held_after, after @ known @ after
        steps += 1
        report(steps / ROUNDS)
        moved = (x - begin) @ known @ (x - begin)
        converged = bool(owed < within**2 and moved < NEAR**2 and off < Z95**2)
        if converged or steps == ROUNDS:
            x = x + _correction(objective, x, slowed, mean) if converged else x
            local = replace(local, value=objective.value(x), gradient=objective.score(x, begin))
            return objective, Optimum(x, local, converged, held, steps), information
        if owed >= within**2 and x is begin:  # too far for a straight line
            x, damping = _uphill(objective, x, slowed, damping)


def identified(coordinates: Coordinates, information: np.ndarray, stiff: float) -> tuple[np.ndarray, np.ndarray]:
    """The part of an information matrix that is of directions known better than `OPEN_SD` (as `read_curvature` has it).

    Returns:
        (d, d) that part; (d, d) what slows moves along the others, `stiff` times what is least known of the first.
    """
    scale = coordinates.longest_moves()
    eigenvalues, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    of_open = eigenvalues <= OPEN_SD**-2.0
    known, slow = np.where(of_open, 0.0, eigenvalues), np.where(of_open, stiff * OPEN_SD**-2.0, 0.0)
    known, slow = ((vectors * part) @ vectors.T / np.outer(scale, scale) for part in (known, slow))
    return known, slow


def _uphill(objective: PooledRateObjective, x: np.ndarray, local: Local, damping: float) -> tuple[np.ndarray, float]:
    """(where a damped step from x has a larger value, damping to go on with); x where none of `TRIALS` has."""
    for _ in range(TRIALS):
        move, _ = best_move(objective.coordinates, x, local, damping)
        if objective.value(x + move) > local.value:
            return x + move, max(damping / MILDER, DAMPING)
        damping *= MILDER
    return x, damping


def _correction(objective: PooledRateObjective, x: np.ndarray, local: Local, mean: np.ndarray) -> np.ndarray:
    """(d,) the move that takes the score's mean (d,) from estimates; none of backgrounds, which quiet bins identify."""
    which = np.array([not name.startswith("pooled.background") for name in objective.coordinates.names])
    inner = np.ix_(which, which)
    lower, upper = objective.coordinates.bounds()
    longest = objective.coordinates.longest_moves()[which]
    part = np.linalg.lstsq(local.information[inner], -mean[which], rcond=1e-14)[0]
    move = np.zeros(len(x))
    move[which] = part / max(1.0, float(np.abs(part / longest).max(initial=0.0)))
    return np.clip(x + move, lower, upper) - x
