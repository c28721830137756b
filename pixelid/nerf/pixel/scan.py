"""The pixel's response to samples of light, differentiable: what events are compared with.

Two engines that agree: "compiled" (`scan_kernels`, CPU threads) and "tensors" (`scan_tensors`, any device).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from pixelid.nerf.field.render import by_tensors, threads
from pixelid.nerf.pixel import scan_kernels as kernels
from pixelid.parallel import map_threads, ranges


def _groups(first: np.ndarray) -> list[tuple[slice, slice]]:
    """Per thread: its entries of `first` and its samples."""
    return [
        (slice(some.start, some.stop + 1), slice(int(first[some.start]), int(first[some.stop])))
        for some in ranges(len(first) - 1, threads())
    ]


def _of(runs: slice) -> slice:
    """The runs between these entries of `first`."""
    return slice(runs.start, runs.stop - 1)


class _Compiled(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, u: torch.Tensor, dynamics: torch.Tensor, t: np.ndarray, first: np.ndarray, midpoint: bool):
        values, light = np.ascontiguousarray(dynamics.detach().numpy()), u.detach().numpy()
        states = np.empty((len(t), kernels.STATES))

        def part(group) -> None:
            runs, some = group
            begins = first[runs]
            kernels.forward(begins - begins[0], t[some], light[some], values[_of(runs)], midpoint, states[some])

        map_threads(part, _groups(first), threads=threads())
        ctx.save_for_backward(u, dynamics)
        ctx.rest = t, first, midpoint, states
        level = states[:, 3] - states[:, 4] if values[:, 5].any() else states[:, 3]
        return torch.from_numpy(level.copy()), torch.from_numpy(states[:, 5].copy())

    @staticmethod
    def backward(ctx: Any, *by_outputs: torch.Tensor):
        u, dynamics = ctx.saved_tensors
        t, first, midpoint, states = ctx.rest
        values, light = np.ascontiguousarray(dynamics.detach().numpy()), u.detach().numpy()
        by_level, by_output = (np.ascontiguousarray(by.numpy()) for by in by_outputs)
        by_u, groups = np.zeros(len(t)), _groups(first)
        by_dynamics = np.zeros(values.shape)

        def part(k: int) -> None:
            runs, some = groups[k]
            kernels.backward(
                first[runs] - first[runs][0], t[some], light[some], values[_of(runs)], midpoint, states[some],
                by_level[some], by_output[some], ctx.needs_input_grad[1], by_u[some], by_dynamics[_of(runs)],
            )  # fmt: skip

        map_threads(part, range(len(groups)), threads=threads())
        return torch.from_numpy(by_u), torch.from_numpy(by_dynamics), None, None, None


def respond(
    u: torch.Tensor, dynamics: torch.Tensor, t: np.ndarray, first: np.ndarray, *, midpoint=True, engine="auto"
) -> tuple[torch.Tensor, torch.Tensor]:
    """(reset level, never-reset amplifier output), (n,) each, at samples of log radiance u (n,) float64.

    t: (n,) s, sorted within each run;  first: (runs + 1,) where each run begins, the last entry n;
    dynamics: (8,) the numbers of `Dynamics`, or (runs, 8) of every run; the lower cutoff is one for all.  Steady state
    at the first sample of every run.  Differentiable in u and in α, β, γ, ω1, ωd and the floor.  engine: "compiled",
    "tensors" or "auto" (by device).
    """
    dynamics = dynamics.expand(len(first) - 1, kernels.PARAMETERS)
    if by_tensors(engine, u.device):
        from pixelid.nerf.pixel import scan_tensors

        return scan_tensors.respond(u, dynamics, t, first, midpoint)
    level, output = _Compiled.apply(u, dynamics, t, first, midpoint)
    return level, output
