"""The plain engine: the compiled scan, maximised by damped Newton steps or SciPy's L-BFGS-B."""

from __future__ import annotations

import numpy as np

from pixelid.errors import InputError
from pixelid.fit.engines.engine import Engine, Progress, maximise_in_rounds, scales
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
        return maximise_in_rounds(objective, start, _lbfgs, tolerance=tolerance, max_steps=max_steps, progress=progress)

    def continuous(self, objective: Objective, x: np.ndarray) -> Objective:
        from pixelid.fit.engines.scipy_continuous import solve_ivp_objective

        return solve_ivp_objective(objective, x)


def _lbfgs(objective, x0, here, held, tolerance, max_steps) -> tuple[np.ndarray, int]:
    """L-BFGS-B in coordinates scaled by the Cholesky factor of the information at x0: (where it ended, steps).

    The mixing turns the bounds; a quadratic wall stands for them.
    """
    from scipy.optimize import minimize

    lower, upper = objective.coordinates.bounds()
    scale = scales(here, objective.coordinates.longest_moves())
    correlated = here.information * np.outer(scale, scale) + 1e-10 * np.eye(len(x0))
    mixing = np.linalg.inv(np.linalg.cholesky(correlated)).T * scale[:, None]

    def function(q):
        x = x0 + mixing @ q
        inside = np.clip(x, lower, upper)
        local = objective.local(inside)
        wall = 0.5 * np.sum(((x - inside) / scale) ** 2)
        return wall - local.value, mixing.T @ ((x - inside) / scale**2 - local.gradient)

    options = {
        "maxiter": max(max_steps, 1), "ftol": 1e-15, "gtol": np.sqrt(2.0 * tolerance / len(x0)), "maxcor": 20
    }  # fmt: skip
    end = minimize(function, np.zeros(len(x0)), jac=True, method="L-BFGS-B", options=options)
    return np.clip(x0 + mixing @ end.x, lower, upper), int(end.nit)
