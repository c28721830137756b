"""The continuous form in torch: torchdiffeq's Dormand–Prince 5(4) over all stimulus steps at once, and autograd.

The published torchdiffeq has no implicit solver, and an explicit one along a recording would take millions of small
steps one after the other.  Over independent stimulus steps (`continuous.py`) a handful of its steps serves them all.
Blocks of stimulus steps are integrated again for the gradient instead of being remembered, so memory stays bounded.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch.utils.checkpoint import checkpoint
from torchdiffeq import odeint

from pixelid.dynamics.continuous import right_hand_side
from pixelid.dynamics.of_circuit import dynamics_of
from pixelid.dynamics.trajectory import Dynamics
from pixelid.fit.engines.continuous import ContinuousObjective, discrete_form, log_posterior
from pixelid.fit.engines.frozen import freeze
from pixelid.fit.engines.torch_operations import TorchOperations
from pixelid.fit.objective import Objective

BLOCK = 20_000  # problems integrated together: some 100 MB while they are differentiated


def torchdiffeq_objective(
    objective: Objective, x: np.ndarray, device: torch.device | str = "cpu"
) -> ContinuousObjective:
    """The continuous form of an objective by torchdiffeq.

    Args:
        objective: the discrete form.
        x: (p,) where the search will be; decides which stages are present.
        device: of the tensors.

    Raises:
        InputError: see `continuous.discrete_form`.
    """
    discrete = discrete_form(objective, x)
    present = dynamics_of(discrete.coordinates.circuit(x))
    op: Any = TorchOperations(device)

    def flow(state, drive, slope, tau, radiance, dynamics):
        columns = (*state, drive, slope, tau, radiance)
        values = [torch.as_tensor(value, dtype=torch.float64, device=device) for value in dynamics]
        blocks = zip(*(torch.split(column, BLOCK) for column in columns), strict=True)
        if torch.is_grad_enabled():
            parts = [checkpoint(_flow, present, values, *block, use_reentrant=False) for block in blocks]
        else:
            parts = [_flow(present, values, *block) for block in blocks]
        return tuple(torch.cat(column) for column in zip(*parts, strict=True))

    def value(x):
        with torch.no_grad():
            at = torch.as_tensor(x, dtype=torch.float64, device=device)
            return float(log_posterior(op, discrete, freeze(discrete, x), at, flow))

    def value_and_gradient(x):
        at = torch.tensor(x, dtype=torch.float64, device=device, requires_grad=True)
        log_density = log_posterior(op, discrete, freeze(discrete, x), at, flow)
        log_density.backward()
        assert at.grad is not None
        return float(log_density.detach()), at.grad.cpu().numpy()

    return ContinuousObjective(discrete, value, value_and_gradient)


def _flow(present: Dynamics, values, v, y, s, d, drive, slope, tau, radiance):
    """(v, y, s, d) (n,) after tau, each problem in its own time t = σ tau, σ from 0 to 1.

    The slope v is carried as v · tau, in the unit of the levels, so that one tolerance suits all four.
    """
    _, derivatives = right_hand_side(present, values)
    unit = torch.where(tau > 0, tau, torch.ones_like(tau))

    def rate(sigma, state):
        t = sigma * tau
        w, y, s, d = state
        dv, dy, ds, dd = derivatives((w / unit, y, s, d), drive * t, radiance * torch.exp(slope * t))
        return torch.stack((unit * tau * dv, tau * dy, tau * ds, tau * dd))

    start = torch.stack((v * unit, y, s, d))
    span = torch.tensor([0.0, 1.0], dtype=torch.float64, device=tau.device)
    rtol, atol = 1e-8, 1e-10  # of a step's local error, root mean square over the block
    end = odeint(rate, start, span, rtol=rtol, atol=atol, method="dopri5")[-1]
    return end[0] / unit, end[1], end[2], end[3]
