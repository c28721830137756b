"""What every engine can do with an objective."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from pixelid.fit.coordinates import Coordinates
from pixelid.fit.newton import Optimum
from pixelid.fit.objective import Local, Objective

Progress = Callable[[int, float], None]
# The largest problem, stimulus samples + events, that an engine differentiates through its own expression by default;
# beyond it the compiled objective gives the same numbers faster.
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
        """Climb from `start` until one more step promises less than `tolerance` nats; progress(step, value)."""


def parameter_values(coordinates: Coordinates, x: Any, exp: Callable) -> dict[str, Any]:
    """All parameters by name at an engine's vector x; `exp` is the engine's exponential."""
    fixed: Mapping[str, float] = {name: p.value for name, p in coordinates.nuisances.items()}
    free = {p.name: exp(x[i]) if p.transform == "log" else x[i] for i, p in enumerate(coordinates.parameters)}
    return {**coordinates.model.values, **fixed, **free}


def held_by_bounds(x: np.ndarray, local: Local, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """(p,) bool: coordinates on a bound and pushed outwards."""
    return ((x <= lower) & (local.gradient < 0)) | ((x >= upper) & (local.gradient > 0))


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
