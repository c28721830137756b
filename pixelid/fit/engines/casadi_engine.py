"""The CasADi engine: IPOPT on exact derivatives.

Two ways to evaluate the discrete form (`evaluation`):

    "expression"  the whole likelihood, scan included, as one CasADi expression: exact gradient by reverse and exact
                  Hessian by forward-over-reverse differentiation of the mapped accumulation.  The discrete choices
                  (`frozen.py`) are refreshed between solves.
    "compiled"    IPOPT driven by the compiled objective: its value, gradient and Gauss–Newton information.
    "auto"        the expression up to `EXPRESSION_SIZE` samples and events and where every effect has a symbolic form,
                  compiled beyond: CasADi's virtual machine takes ten times as long per exact Hessian there.

The continuous form is `collocation.py`.

Warm start: IPOPT begins at the start (barrier 1e-8, bounds hardly pushed), in coordinates scaled to about one standard
error, so that its tolerance means a fraction of a standard error.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from pixelid.errors import InputError
from pixelid.fit.engines.casadi_operations import CasadiOperations
from pixelid.fit.engines.engine import (
    EVALUATIONS,
    Engine,
    Progress,
    maximise_in_rounds,
    parameter_values,
    scales,
    through_expression,
    with_priors,
)
from pixelid.fit.engines.expression import log_likelihood
from pixelid.fit.engines.frozen import freeze
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.newton import Optimum
from pixelid.fit.objective import Local, Objective
from pixelid.interruption import interrupt_kept

# A step that promises more than it holds is halved so often, and then taken as it is: it moves next to nothing.  Where
# the value has kinks (those of the light) IPOPT would halve it down to rounding, at a likelihood each.
HALVINGS = 6
IDLE = 3  # iterations in which less than the tolerance is gained, after which a solve has come to rest on kinks
REACH = 3.0  # how far, in longest moves, one solve may go: beyond, the frozen choices are no longer those of the data


def symbolic(objective: EventTimesObjective, x: np.ndarray) -> tuple[ca.MX, ca.MX]:
    """(vector of coordinates, log posterior) as CasADi expressions, the discrete choices frozen at x."""
    coordinates = objective.coordinates
    at = ca.MX.sym("x", len(coordinates))
    values = parameter_values(coordinates, at, ca.exp)
    circuit = coordinates.model.circuit(values)
    value = log_likelihood(CasadiOperations(), freeze(objective, x), circuit)
    return at, with_priors(value, coordinates, at, ca.log)


class CasadiEngine(Engine):
    """evaluation: see the module.  `value`, `gradient`, `hessian` are the expression's where the objective has one."""

    name = "casadi"

    def __init__(self, evaluation: str = "auto") -> None:
        if evaluation not in EVALUATIONS:
            raise InputError(f"evaluation must be one of {', '.join(EVALUATIONS)}, found {evaluation!r}")
        self.evaluation = evaluation

    def value(self, objective: Objective, x: np.ndarray) -> float:
        if not isinstance(objective, EventTimesObjective):
            return objective.value(x)
        at, value = symbolic(objective, x)
        return float(ca.Function("value", [at], [value])(x))

    def gradient(self, objective: Objective, x: np.ndarray) -> np.ndarray:
        if not isinstance(objective, EventTimesObjective):
            return objective.local(x).gradient
        at, value = symbolic(objective, x)
        return np.array(ca.Function("gradient", [at], [ca.gradient(value, at)])(x)).ravel()

    def hessian(self, objective: Objective, x: np.ndarray) -> np.ndarray:
        if not isinstance(objective, EventTimesObjective):
            return objective.hessian(x)
        at, value = symbolic(objective, x)
        return np.array(ca.Function("hessian", [at], [ca.hessian(value, at)[0]])(x))

    def maximise(
        self, objective: Objective, start: np.ndarray, *, tolerance: float = 1e-6, max_steps: int = 200,
        progress: Progress | None = None,
    ) -> Optimum:  # fmt: skip
        symbolically = through_expression(self.evaluation, objective, np.asarray(start, dtype=float))

        def advance(objective, x, local, held, tolerance, max_steps):
            return _solve(objective, x, local, symbolically, tolerance, max_steps)

        return maximise_in_rounds(
            objective, start, advance, tolerance=tolerance, max_steps=max_steps, progress=progress
        )

    def continuous(self, objective: Objective, x: np.ndarray) -> Objective:
        from pixelid.fit.engines.collocation import collocation_objective

        return collocation_objective(objective, x)


def _solve(objective, x0, local: Local, symbolically: bool, tolerance: float, max_steps: int) -> tuple[np.ndarray, int]:
    """One IPOPT solve around x0: (where it ended, iterations)."""
    lower, upper = objective.coordinates.bounds()
    longest = objective.coordinates.longest_moves()
    scale = scales(local, longest)
    low, high = np.maximum(lower, x0 - REACH * longest), np.minimum(upper, x0 + REACH * longest)
    q = ca.MX.sym("q", len(x0))
    keep: list = [_at_rest(len(x0), tolerance)]
    options = {
        "iteration_callback": keep[0],
        "print_time": False,
        "error_on_fail": False,
        "show_eval_warnings": False,
        "ipopt": {
            "print_level": 0, "sb": "yes", "max_iter": max(max_steps, 1), "mu_init": 1e-8, "bound_push": 1e-8,
            "bound_frac": 1e-8, "nlp_scaling_method": "none", "tol": float(np.sqrt(2.0 * tolerance / len(x0))),
            "acceptable_iter": 0, "bound_relax_factor": 0.0, "mu_strategy": "monotone", "max_soc": 0,
            "accept_after_max_steps": HALVINGS,
        },
    }  # fmt: skip
    if symbolically:
        at, value = symbolic(objective, x0)
        f = ca.Function("f", [at], [-value])(x0 + scale * q)
    else:
        function, gradient, hessian = _callbacks(objective, x0, scale)
        keep += [function, gradient, hessian]
        f = function(q)
        options |= {"grad_f": gradient, "hess_lag": hessian}
    solver = ca.nlpsol("solver", "ipopt", {"x": q, "f": f}, options)
    with interrupt_kept():
        solution = solver(x0=np.zeros(len(x0)), lbx=(low - x0) / scale, ubx=(high - x0) / scale)
    x = x0 + scale * np.array(solution["x"]).ravel()
    near = 1e-6 * longest
    x = np.where(x - lower < near, lower, np.where(upper - x < near, upper, x))
    return x, int(solver.stats()["iter_count"])


class _Callback(ca.Callback):
    """A Python function of dense matrices as a CasADi function; slope: (sparsity, function) of its Jacobian."""

    def __init__(self, name, inputs, outputs, evaluate, slope: Any = None) -> None:
        ca.Callback.__init__(self)
        self.inputs, self.outputs, self.evaluate, self.slope = inputs, outputs, evaluate, slope
        self.construct(name, {})

    def get_n_in(self):
        return len(self.inputs)

    def get_n_out(self):
        return len(self.outputs)

    def get_sparsity_in(self, i):
        return self.inputs[i]

    def get_sparsity_out(self, i):
        return self.outputs[i]

    def eval(self, arg):
        return self.evaluate(*arg)

    def has_jacobian(self):
        return self.slope is not None

    def get_jacobian(self, name, inames, onames, opts):
        row, slope = self.slope
        self.jacobian_callback = _Callback(name, [*self.inputs, *self.outputs], [row], slope)
        return self.jacobian_callback


def _at_rest(n: int, tolerance: float) -> _Callback:
    """Asks IPOPT to stop after `IDLE` iterations without a value that is better than the best by the tolerance."""
    values: list[float] = []

    def stop(x, f, *multipliers):
        values.append(float(f))
        return [float(len(values) > IDLE and min(values[-IDLE:]) > min(values[:-IDLE]) - tolerance)]

    vector, one, none = ca.Sparsity.dense(n, 1), ca.Sparsity.dense(1, 1), ca.Sparsity.dense(0, 1)
    return _Callback("at_rest", [vector, one, none, vector, none, none], [one], stop)


def _callbacks(objective: Objective, x0: np.ndarray, scale: np.ndarray):
    """CasADi functions of q, x = x0 + scale · q: (−f; −f and gradient; Gauss–Newton Hessian of the Lagrangian)."""
    n = len(x0)
    memory: dict[bytes, Local] = {}

    def local(q) -> Local:
        x = x0 + scale * np.array(q).ravel()
        key = x.tobytes()
        if key not in memory:
            memory.clear()
            memory[key] = objective.local(x)
        return memory[key]

    vector, row, one = ca.Sparsity.dense(n, 1), ca.Sparsity.dense(1, n), ca.Sparsity.dense(1, 1)
    none, empty = ca.Sparsity(0, 1), ca.Sparsity(0, 0)

    def value(q):
        x = x0 + scale * np.array(q).ravel()
        return [-objective.value(x)]

    def slope(q, f):
        return [ca.DM(-scale * local(q).gradient).T]

    def gradient(q, p):
        here = local(q)
        return [-here.value, ca.DM(-scale * here.gradient)]

    def hessian(q, p, factor, multipliers):
        curvature = local(q).information * np.outer(scale, scale)
        return [ca.triu(ca.DM(float(factor) * curvature))]

    return (
        _Callback("value", [vector], [one], value, (row, slope)),
        _Callback("grad_f", [vector, empty], [one, vector], gradient),
        _Callback("hess_lag", [vector, empty, one, none], [ca.Sparsity.upper(n)], hessian),
    )
