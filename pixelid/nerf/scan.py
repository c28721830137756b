"""The pixel's response to samples of light, differentiable: what events are compared with.

Two engines that agree: "compiled" (`scan_kernels`, CPU threads) and "tensors" (`scan_tensors`, any device).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from pixelid.dynamics.trajectory import Dynamics
from pixelid.nerf import scan_kernels as kernels
from pixelid.nerf.render import threads
from pixelid.parallel import map_threads, ranges


def as_tuple(dynamics: torch.Tensor) -> tuple[float, ...]:
    """(α, β, γ, ω1, ω2, ωh, ωd) as floats."""
    return tuple(Dynamics(*dynamics.detach().cpu().tolist()).uniform()[:7])


def _groups(first: np.ndarray) -> list[tuple[slice, slice]]:
    """Per thread: its entries of `first` and its samples."""
    return [
        (slice(some.start, some.stop + 1), slice(int(first[some.start]), int(first[some.stop])))
        for some in ranges(len(first) - 1, threads())
    ]


class _Compiled(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, u: torch.Tensor, dynamics: torch.Tensor, t: np.ndarray, first: np.ndarray, midpoint: bool):
        values, light = as_tuple(dynamics), u.detach().numpy()
        states = np.empty((len(t), kernels.STATES))

        def part(group) -> None:
            runs, some = group
            kernels.forward(first[runs] - first[runs][0], t[some], light[some], values, midpoint, states[some])

        map_threads(part, _groups(first), threads=threads())
        ctx.save_for_backward(u, dynamics)
        ctx.rest = t, first, midpoint, states
        level = states[:, 3] - states[:, 4] if values[5] > 0 else states[:, 3]
        return torch.from_numpy(level.copy()), torch.from_numpy(states[:, 5].copy())

    @staticmethod
    def backward(ctx: Any, *by_outputs: torch.Tensor):
        u, dynamics = ctx.saved_tensors
        t, first, midpoint, states = ctx.rest
        values, light = as_tuple(dynamics), u.detach().numpy()
        by_level, by_output = (np.ascontiguousarray(by.numpy()) for by in by_outputs)
        by_u, groups = np.zeros(len(t)), _groups(first)
        by_dynamics = np.zeros((len(groups), kernels.PARAMETERS))

        def part(k: int) -> None:
            runs, some = groups[k]
            kernels.backward(
                first[runs] - first[runs][0], t[some], light[some], values, midpoint, states[some], by_level[some],
                by_output[some], ctx.needs_input_grad[1], by_u[some], by_dynamics[k],
            )  # fmt: skip

        map_threads(part, range(len(groups)), threads=threads())
        return torch.from_numpy(by_u), torch.from_numpy(by_dynamics.sum(axis=0)), None, None, None


def respond(
    u: torch.Tensor, dynamics: torch.Tensor, t: np.ndarray, first: np.ndarray, *, midpoint=True, engine="auto"
) -> tuple[torch.Tensor, torch.Tensor]:
    """(reset level, never-reset amplifier output), (n,) each, at samples of log radiance u (n,) float64.

    t: (n,) s, sorted within each run;  first: (runs + 1,) where each run begins, the last entry n;
    dynamics: (7,) the numbers of `Dynamics`.  Steady state at the first sample of every run.  Differentiable in u and
    in α, β, γ, ω1 and ωd.  engine: "compiled", "tensors" or "auto" (by device).
    """
    if engine == "tensors" or (engine == "auto" and u.device.type != "cpu"):
        from pixelid.nerf.scan_tensors import respond as by_tensors

        return by_tensors(u, dynamics, t, first, midpoint)
    level, output = _Compiled.apply(u, dynamics, t, first, midpoint)
    return level, output
