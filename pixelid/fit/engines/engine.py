"""What every engine can do with an objective."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from pixelid.errors import InputError
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.engines.frozen import freeze
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.newton import Optimum, held_by_bounds
from pixelid.fit.newton import maximise as newton_steps
from pixelid.fit.objective import Local, Objective

Progress = Callable[[int, float], None]
# One round of an engine's own optimiser: (objective, x, local there, coordinates held by bounds, tolerance, most steps)
# → (where it ended, steps taken).
Round = Callable[[Objective, np.ndarray, Local, np.ndarray, float, int], tuple[np.ndarray, int]]
MOST_ROUNDS = 10  # an optimiser that has not arrived by then is helped by Newton steps
EVALUATIONS = ("auto", "expression", "compiled")
# The largest problem, stimulus samples + events, whose discrete form an engine differentiates through its own
# expression by default; beyond it the compiled objective gives the same numbers faster.
EXPRESSION_SIZE = 2_000


class Engine(ABC):
    """Evaluates and maximises log posteriors (`fit.objective.Objective`) over their coordinate vectors x (p,)."""

    name: str

    @abstractmethod
    def value(self, objective: Objective, x: np.ndarray) -> float:
        """The log posterior at x by this engine's own arithmetic."""

    @abstractmethod
    def gradient(self, objective: Objective, x: np.ndarray) -> np.ndarray:
        """(p,) its gradient."""

    @abstractmethod
    def hessian(self, objective: Objective, x: np.ndarray) -> np.ndarray:
        """(p, p) its second derivatives."""

    @abstractmethod
    def maximise(
        self,
        objective: Objective,
        start: np.ndarray,
        *,
        tolerance: float = 1e-6,
        max_steps: int = 200,
        progress: Progress | None = None,
    ) -> Optimum:
        """Move from `start` until one more step promises less than `tolerance` nats; progress(step, value)."""

    @abstractmethod
    def continuous(self, objective: Objective, x: np.ndarray) -> Objective:
        """The continuous form of an event-time objective, by this engine's integrator; searched around x.

        Raises InputError for what it lacks, see `continuous.discrete_form`.
        """


def maximise_in_rounds(
    objective: Objective,
    start: np.ndarray,
    advance: Round,
    *,
    tolerance: float,
    max_steps: int,
    progress: Progress | None = None,
) -> Optimum:
    """Repeat an optimiser's rounds until one more step promises less than `tolerance` nats.

    A round ends where the optimiser wants discrete choices and scaling refreshed.  Where it does not arrive, damped
    Newton steps finish.

    Args:
        objective: what to maximise.
        start: (p,) where to begin, clipped to the bounds.
        advance: one round.
        tolerance: nats.
        max_steps: of the optimiser, over all rounds.
        progress: called after every round with steps and value.

    Returns:
        The best point; `converged` by the same criterion for every engine.
    """
    lower, upper = objective.coordinates.bounds()
    x = np.clip(np.asarray(start, dtype=float), lower, upper)
    local, steps = objective.local(x), 0
    held = held_by_bounds(x, local, lower, upper)
    for _ in range(MOST_ROUNDS):
        moved, taken = advance(objective, x, local, held, tolerance, max_steps - steps)
        steps += max(taken, 1)
        there = objective.local(moved) if np.isfinite(moved).all() else local
        better = there.value > local.value
        if better:
            x, local = moved, there
            held = held_by_bounds(x, local, lower, upper)
        if progress:
            progress(steps, local.value)
        if promised(local, held) < tolerance:
            return Optimum(x, local, True, held, steps)
        if not better or steps >= max_steps:
            break
    end = newton_steps(objective, x, tolerance=tolerance, max_steps=max(max_steps - steps, 1), progress=progress)
    return Optimum(end.x, end.local, end.converged, end.on_bound, steps + end.steps)


def through_expression(evaluation: str, objective: Objective, x: np.ndarray, limit: float = EXPRESSION_SIZE) -> bool:
    """Whether an engine differentiates its own expression of the objective, rather than the compiled one."""
    if not isinstance(objective, EventTimesObjective) or evaluation == "compiled":
        return False
    if evaluation == "expression":
        return True
    try:
        frozen = freeze(objective, x)
    except InputError:  # an effect that the expression lacks
        return False
    return frozen.samples + frozen.layout.events <= limit


def parameter_values(coordinates: Coordinates, x: Any, exp: Callable) -> dict[str, Any]:
    """All parameters by name at an engine's vector x; `exp` is the engine's exponential."""
    fixed: Mapping[str, float] = {name: p.value for name, p in coordinates.nuisances.items()}
    free = {p.name: exp(x[i]) if p.transform == "log" else x[i] for i, p in enumerate(coordinates.parameters)}
    return {**coordinates.model.values, **fixed, **free}


def with_priors(value: Any, coordinates: Coordinates, x: Any, log: Callable) -> Any:
    """A log-likelihood and the log priors at an engine's vector x, in the engine's numbers and by its logarithm."""
    for i, p in enumerate(coordinates.parameters):
        if p.prior is not None:
            value = value + p.prior.log_density(x[i], log)
    return value


def promised(local: Local, held: np.ndarray) -> float:
    """Nats that a Newton step on the coordinates not held promises."""
    free = ~held
    if not free.any():
        return 0.0
    g = local.gradient[free]
    return 0.5 * float(g @ np.linalg.lstsq(local.information[np.ix_(free, free)], g, rcond=1e-14)[0])


def scales(local: Local, longest: np.ndarray) -> np.ndarray:
    """(p,) about one standard error of each coordinate by itself, at most its longest sensible move."""
    return np.minimum(1.0 / np.sqrt(np.maximum(np.diag(local.information), 1e-300)), longest)
