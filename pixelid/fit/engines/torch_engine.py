"""The torch engine: the same expression on float64 tensors, on any device, maximised by L-BFGS or Adam.

Two ways to evaluate the discrete form (`evaluation`):

    "expression"  the likelihood in torch operations (`torch_operations.py`): no loop over samples, autograd through all
    "compiled"    `torch.autograd.Function` around the compiled objective and its gradient
    "auto"        the expression up to `EXPRESSION_SIZE` samples and events or on a CUDA device, compiled beyond

The continuous form is `torch_continuous.py`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from pixelid.errors import InputError
from pixelid.fit.engines.engine import (
    EVALUATIONS,
    EXPRESSION_SIZE,
    Engine,
    Progress,
    maximise_in_rounds,
    parameter_values,
    promised,
    scales,
    through_expression,
    with_priors,
)
from pixelid.fit.engines.expression import log_likelihood
from pixelid.fit.engines.frozen import Frozen, freeze
from pixelid.fit.engines.torch_operations import TorchOperations
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.newton import Optimum
from pixelid.fit.objective import Objective

OPTIMISERS = ("lbfgs", "adam")
ROUND = 20  # L-BFGS iterations between refreshes of the discrete choices and of the scaling


class Compiled(torch.autograd.Function):
    """The log posterior of any objective as a differentiable function of a coordinate tensor (p,)."""

    @staticmethod
    def forward(ctx: Any, x: torch.Tensor, objective: Objective) -> torch.Tensor:
        local = objective.local(x.detach().cpu().numpy())
        ctx.save_for_backward(torch.as_tensor(local.gradient, device=x.device))
        return x.new_tensor(local.value)

    @staticmethod
    def backward(ctx: Any, *by_value: torch.Tensor):
        (gradient,) = ctx.saved_tensors
        return by_value[0] * gradient, None


def log_posterior(objective: EventTimesObjective, frozen: Frozen, x: torch.Tensor) -> torch.Tensor:
    """The log posterior at a coordinate tensor (p,), differentiable; discrete choices from `frozen`."""
    coordinates = objective.coordinates
    values = parameter_values(coordinates, x, torch.exp)
    circuit = coordinates.model.circuit(values)
    operations: Any = TorchOperations(x.device)
    value = log_likelihood(operations, frozen, circuit)
    return with_priors(value, coordinates, x, torch.log)


class TorchEngine(Engine):
    """evaluation, optimiser: see the module;  device: of the tensors, "cpu" or "cuda"."""

    name = "torch"

    def __init__(self, evaluation: str = "auto", device: str = "cpu", optimiser: str = "lbfgs") -> None:
        for value, known in ((evaluation, EVALUATIONS), (optimiser, OPTIMISERS)):
            if value not in known:
                raise InputError(f"expected one of {', '.join(known)}, found {value!r}")
        self.evaluation, self.optimiser, self.device = evaluation, optimiser, torch.device(device)

    def _tensor(self, x: np.ndarray) -> torch.Tensor:
        return torch.tensor(np.asarray(x, dtype=float), device=self.device, requires_grad=True)

    def value(self, objective: Objective, x: np.ndarray) -> float:
        if not isinstance(objective, EventTimesObjective):
            return objective.value(x)
        with torch.no_grad():
            return float(log_posterior(objective, freeze(objective, x), self._tensor(x)))

    def gradient(self, objective: Objective, x: np.ndarray) -> np.ndarray:
        if not isinstance(objective, EventTimesObjective):
            return objective.local(x).gradient
        at = self._tensor(x)
        log_posterior(objective, freeze(objective, x), at).backward()
        assert at.grad is not None
        return at.grad.cpu().numpy()

    def hessian(self, objective: Objective, x: np.ndarray) -> np.ndarray:
        if not isinstance(objective, EventTimesObjective):
            return objective.hessian(x)
        frozen = freeze(objective, x)
        H = torch.autograd.functional.hessian(lambda at: log_posterior(objective, frozen, at), self._tensor(x))
        assert isinstance(H, torch.Tensor)
        return H.cpu().numpy()

    def maximise(
        self, objective: Objective, start: np.ndarray, *, tolerance: float = 1e-6, max_steps: int = 200,
        progress: Progress | None = None,
    ) -> Optimum:  # fmt: skip
        limit = EXPRESSION_SIZE if self.device.type == "cpu" else np.inf
        through = through_expression(self.evaluation, objective, np.asarray(start, dtype=float), limit)

        def advance(objective, x, local, held, tolerance, max_steps):
            return self._round(objective, x, local, held, through)

        return maximise_in_rounds(
            objective, start, advance, tolerance=tolerance, max_steps=max_steps, progress=progress
        )

    def continuous(self, objective: Objective, x: np.ndarray) -> Objective:
        from pixelid.fit.engines.torch_continuous import torchdiffeq_objective

        return torchdiffeq_objective(objective, x, self.device)

    def _round(self, objective, x0, local, held, through: bool) -> tuple[np.ndarray, int]:
        """Some iterations in coordinates whitened by the information at x0: (where they ended, iterations)."""
        scale = scales(local, objective.coordinates.longest_moves())
        free = np.flatnonzero(~held)
        correlated = (local.information * np.outer(scale, scale))[np.ix_(free, free)] + 1e-10 * np.eye(len(free))
        mixing = np.zeros((len(x0), len(free)))
        mixing[free] = np.linalg.inv(np.linalg.cholesky(correlated)).T * scale[free, None]
        base, mix = (torch.as_tensor(part, device=self.device) for part in (x0, mixing))
        lower, upper = (torch.as_tensor(part, device=self.device) for part in objective.coordinates.bounds())
        frozen = freeze(objective, x0) if through else None
        q = torch.zeros(len(free), dtype=torch.float64, device=self.device, requires_grad=True)
        if self.optimiser == "lbfgs":
            search: torch.optim.Optimizer = torch.optim.LBFGS(
                [q], lr=1.0, max_iter=ROUND, tolerance_grad=1e-5, tolerance_change=0.0, line_search_fn="strong_wolfe"
            )
        else:
            search = torch.optim.Adam([q], lr=0.1 * max(1.0, float(np.sqrt(2.0 * promised(local, held) / len(free)))))
        worst = float(local.value) - 1e12

        def closure():
            search.zero_grad()
            x = torch.clamp(base + mix @ q, lower, upper)
            value = log_posterior(objective, frozen, x) if frozen is not None else Compiled.apply(x, objective)
            assert isinstance(value, torch.Tensor)
            if not torch.isfinite(value):  # a step far outside: any large finite number sends the search back
                value = worst - (q * q).sum()
            loss = -(value - local.value)
            loss.backward()
            return float(loss.detach())

        taken = ROUND
        if self.optimiser == "adam":
            decay = torch.optim.lr_scheduler.ExponentialLR(search, 0.9)
            for _ in range(ROUND):
                search.step(closure)
                decay.step()
        else:
            search.step(closure)
            taken = int(search.state[q].get("n_iter", ROUND))
        with torch.no_grad():
            return torch.clamp(base + mix @ q, lower, upper).cpu().numpy(), taken
