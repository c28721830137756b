"""Searches of pooled counts: round by round, and the last one to within its errors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pixelid.fit.coordinates import Coordinates
from pixelid.fit.newton import Optimum, best_move, maximise
from pixelid.fit.objective import Local
from pixelid.fit.pooled_rate import PooledRateObjective
from pixelid.parameters.parameter import OPEN_SD
from pixelid.statistics import Z95

# Noise added to thresholds, step by step less.  Pixels in step fire at the same phases of a ramp with n and with n + 1
# events on it: optima of their own, which melt into one where noise hides from which pixel an event comes.
BLURS = (0.4, 0.2, 0.1, 0.05)
MAX_STEPS = 20  # of a round
# Standard errors that one more step would move: an estimate off by so many still has an interval of 94 % instead of
# 95 %, since Φ(1.96 − 0.3) − Φ(−1.96 − 0.3) = 0.94.
SETTLED = 0.3
ROUNDS, CHORDS = 10, 6  # of the last search, and steps with the derivatives of one round
# Rounds whose forward pass and variances are new: where these change, so does the optimum, within its errors.
FOLLOW = 2
CLOSER = 0.7  # times as far from the end, at most, after a step with the same derivatives
DAMPING, MILDER, TRIALS = 1e-3, 5.0, 6  # of steps where derivatives change too much: least, factor, how often
FOLLOWED = 0.5  # of a step's part along open directions, in the first rounds
# Joint standard errors that a round may move estimates: half of one along each of a dozen directions.  The correction
# takes derivatives of its own, and those a little off cost little precision.
NEAR = 2.0


def best_of(
    objective: PooledRateObjective,
    starts: Sequence[np.ndarray],
    tolerance: float,
    blurs: Sequence[float],
    report: Callable[[float], None],
) -> tuple[PooledRateObjective, Optimum]:
    """`in_rounds` from each start: where it ends best."""
    ends = [
        in_rounds(objective, x, tolerance, blurs, lambda part, i=i: report((i + part) / len(starts)))
        for i, x in enumerate(starts)
    ]
    return max(ends, key=lambda end: end[1].local.value)


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
    half way for a while, then left, and has arrived where the end is within its interval.

    Args:
        objective, x: Where the search with rough derivatives has ended.
        seed: Of the simulated scores.
        report: Called with the share done.
        within: Standard errors that one more step may move.

    Returns:
        The objective near its optimum, the optimum, and (d, d) the inverse of the estimates' covariance.
    """
    objective, coordinates, steps, damping = objective.fine(), objective.coordinates, 0, DAMPING
    last = np.zeros(len(x))
    while True:
        objective = objective.near(x) if steps < FOLLOW else objective
        local = objective.local(x)
        noisy = max(objective.likelihood.dispersion(objective.expected(x)), 1.0)
        information, _ = objective.scatter(x, local, seed)
        known, onto = identified(coordinates, information / noisy)
        begin, share = x, FOLLOWED if steps < FOLLOW else 0.0
        step = Step(objective, begin, local, onto)
        left, whole, held = step.at(x, share)
        owed, off = left @ known @ left, whole @ (information / noisy - known) @ whole
        for _ in range(CHORDS):
            if owed < within**2:
                break
            after, _, held_after = step.at(x + left, share)
            if after @ known @ after > CLOSER * owed:
                break
            x, left, held, owed = x + left, after, held_after, after @ known @ after
        steps += 1
        report(steps / ROUNDS)
        moved = (x - begin) @ known @ (x - begin)
        back = (x - begin) @ known @ last < 0 and moved >= NEAR**2  # derivatives of two places send it to and fro
        x = 0.5 * (begin + x) if back else x
        last = x - begin
        converged = bool(owed < within**2 and moved < NEAR**2 and off < Z95**2)
        if converged or steps == ROUNDS:
            if converged:  # the mean is of the order of what a pass that suits another model errs by
                begin, objective = x, objective.near(x)
                local = objective.local(x)
                information, mean = objective.scatter(x, local, seed)
                known, onto = identified(coordinates, information / noisy)
                x = _corrected(Step(objective, begin, local, onto), x, known, mean)
            local = replace(local, value=objective.value(x), gradient=objective.score(x, begin))
            return objective, Optimum(x, local, converged, held, steps), information
        if owed >= within**2 and x is begin:  # too far for a straight line
            x, damping = _uphill(objective, x, local, damping)


@dataclass(frozen=True)
class Step:
    """Steps towards a score of 0 with the derivatives `local` of one point `begin`.

    onto: (d, d) what takes from a step its part along open directions
    """

    objective: PooledRateObjective
    begin: np.ndarray
    local: Local
    onto: np.ndarray

    def at(
        self, x: np.ndarray, share: float, wanted: np.ndarray | float = 0.0
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(step from x with a share of its open part, the whole step, (d,) bool: held by a bound).

        wanted: (d,) the score to arrive at, if not 0
        """
        coordinates = self.objective.coordinates
        there = replace(self.local, gradient=self.objective.score(x, self.begin) - wanted)
        whole, held = best_move(coordinates, x, there, 0.0)
        known = self.onto @ whole
        return np.clip(x + known + share * (whole - known), *coordinates.bounds()) - x, whole, held


def identified(coordinates: Coordinates, information: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What an information matrix says of directions known better than `OPEN_SD` (as `read_curvature` has it).

    Returns:
        (d, d) the information of these alone; (d, d) the projection of moves onto them.
    """
    scale = coordinates.longest_moves()
    eigenvalues, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    vectors, eigenvalues = vectors[:, eigenvalues > OPEN_SD**-2.0], eigenvalues[eigenvalues > OPEN_SD**-2.0]
    known = (vectors * eigenvalues) @ vectors.T / np.outer(scale, scale)
    return known, scale[:, None] * (vectors @ vectors.T) / scale


def _uphill(objective: PooledRateObjective, x: np.ndarray, local: Local, damping: float) -> tuple[np.ndarray, float]:
    """(where a damped step from x has a larger value, damping to go on with); x where none of `TRIALS` has."""
    for _ in range(TRIALS):
        move, _ = best_move(objective.coordinates, x, local, damping)
        if objective.value(x + move) > local.value:
            return x + move, max(damping / MILDER, DAMPING)
        damping *= MILDER
    return x, damping


def _corrected(step: Step, x: np.ndarray, known: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """(d,) where the score is not 0, as at x, but the `mean` (d,) that simulated pixels show; x where steps find none.

    Backgrounds keep 0: quiet bins identify them.
    """
    names = step.objective.coordinates.names
    wanted = np.where([name.startswith("pooled.background") for name in names], 0.0, mean)
    at, owed = x, np.inf
    for _ in range(CHORDS):
        move, _, _ = step.at(at, 0.0, wanted)
        if move @ known @ move > CLOSER * owed:
            return x
        at, owed = at + move, move @ known @ move
        if owed < SETTLED**2:
            return at
    return x
