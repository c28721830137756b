"""The plain engine: the compiled scan, climbed by damped Newton steps or SciPy's L-BFGS-B."""

from __future__ import annotations

import numpy as np

from pixelid.errors import InputError
from pixelid.fit.engines.engine import Engine, Progress, held_by_bounds, promised, scales
from pixelid.fit.newton import Optimum, maximise
from pixelid.fit.objective import Objective

METHODS = ("trust", "lbfgs")


class ScipyEngine(Engine):
    """method: "trust", Levenberg–Marquardt on the information matrix (`fit.newton`), or "lbfgs", L-BFGS-B."""

    name = "scipy"

    def __init__(self, method: str = "trust") -> None:
        if method not in METHODS:
            raise InputError(f"method must be one of {', '.join(METHODS)}, found {method!r}")
        self.method = method

    def value(self, objective: Objective, x: np.ndarray) -> float:
        return objective.value(x)

    def gradient(self, objective: Objective, x: np.ndarray) -> np.ndarray:
        return objective.local(x).gradient

    def hessian(self, objective: Objective, x: np.ndarray) -> np.ndarray:
        return objective.hessian(x)

    def maximise(
        self, objective: Objective, start: np.ndarray, *, tolerance: float = 1e-6, max_steps: int = 200,
        progress: Progress | None = None,
    ) -> Optimum:  # fmt: skip
        if self.method == "trust":
            return maximise(objective, start, tolerance=tolerance, max_steps=max_steps, progress=progress)
        return _lbfgs(objective, start, tolerance, max_steps, progress)


def _lbfgs(objective, start, tolerance, max_steps, progress) -> Optimum:
    """L-BFGS-B in coordinates scaled by the Cholesky factor of the information at the start, where bounds allow it."""
    from scipy.optimize import minimize

    lower, upper = objective.coordinates.bounds()
    x0 = np.clip(np.asarray(start, dtype=float), lower, upper)
    here = objective.local(x0)
    scale = scales(here, objective.coordinates.longest_moves())
    correlated = here.information * np.outer(scale, scale) + 1e-10 * np.eye(len(x0))
    mixing = np.linalg.inv(np.linalg.cholesky(correlated)).T * scale[:, None]
    steps = 0

    def function(q):
        x = x0 + mixing @ q
        local = objective.local(np.clip(x, lower, upper))
        outside = x - np.clip(x, lower, upper)  # a quadratic wall stands for the bounds, which the mixing turns
        wall = 0.5 * np.sum((outside / scale) ** 2)
        return wall - local.value, mixing.T @ (outside / scale**2 - local.gradient)

    def each(q):
        nonlocal steps
        steps += 1
        if progress:
            progress(steps, 0.0)

    options = {"maxiter": max_steps, "ftol": 1e-15, "gtol": np.sqrt(2.0 * tolerance / len(x0)), "maxcor": 20}
    found = minimize(function, np.zeros(len(x0)), jac=True, method="L-BFGS-B", callback=each, options=options)
    x = np.clip(x0 + mixing @ found.x, lower, upper)
    local = objective.local(x)
    held = held_by_bounds(x, local, lower, upper)
    return Optimum(x, local, promised(local, held) < 10.0 * tolerance, held, steps)
