"""What holds a field smooth, with gradients in one pass: total variation of log radiance, mean square of harmonics.

    V = Σ_axes mean |c(vertex) − c(next vertex along the axis)|      the mean also over colours

Tensors would pass over the grid a dozen times; they remain for other devices, and as what the kernel is tested against.
Density has no part in it: that added nothing where it was tried.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numba import njit

from pixelid.nerf.render import threads
from pixelid.parallel import map_threads, ranges


def variation(grid: torch.Tensor, engine: str = "auto") -> torch.Tensor:
    """V of the log radiance of a grid (n, n, n, 1 + C), log density first;  engine: as of `render`."""
    if engine == "tensors" or (engine == "auto" and grid.device.type != "cpu"):
        colour = grid[..., 1:]
        return torch.stack([torch.diff(colour, dim=axis).abs().mean() for axis in range(3)]).sum()
    return _Variation.apply(grid)


class _Variation(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, grid: torch.Tensor):
        values = grid.detach().numpy()
        by_grid = np.zeros_like(values)
        n, _, _, depth = values.shape
        share = 1.0 / ((n - 1) * n * n * (depth - 1))
        parts = map_threads(
            lambda some: _fill(values, some.start, some.stop, np.float32(share), by_grid),
            ranges(n, threads()), threads=threads(),
        )  # fmt: skip
        ctx.save_for_backward(torch.from_numpy(by_grid))
        return grid.new_tensor(share * sum(parts))

    @staticmethod
    def backward(ctx: Any, *by_outputs: torch.Tensor):
        (by_grid,) = ctx.saved_tensors
        return by_grid * by_outputs[0]


def mean_square(values: torch.Tensor) -> torch.Tensor:
    """Σ values² / their number, without what `square().mean()` keeps for its gradient."""
    return _MeanSquare.apply(values)


class _MeanSquare(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, values: torch.Tensor):
        ctx.save_for_backward(values)
        flat = values.detach().flatten()
        return torch.dot(flat, flat) / max(len(flat), 1)

    @staticmethod
    def backward(ctx: Any, *by_outputs: torch.Tensor):
        (values,) = ctx.saved_tensors
        return values * (2.0 * by_outputs[0] / max(values.numel(), 1))


@njit(cache=True, nogil=True, error_model="numpy")
def _fill(values, first, last, share, by_values):
    """Σ of the absolute differences that begin at vertices first ≤ ix < last; their gradient is filled in there."""
    n, depth, total = values.shape[0], values.shape[3], 0.0
    for ix in range(first, last):
        for iy in range(n):
            for iz in range(n):
                for c in range(1, depth):
                    here, slope = values[ix, iy, iz, c], np.float32(0.0)
                    if ix + 1 < n:
                        step = here - values[ix + 1, iy, iz, c]
                        total += abs(step)
                        slope += np.sign(step)
                    if iy + 1 < n:
                        step = here - values[ix, iy + 1, iz, c]
                        total += abs(step)
                        slope += np.sign(step)
                    if iz + 1 < n:
                        step = here - values[ix, iy, iz + 1, c]
                        total += abs(step)
                        slope += np.sign(step)
                    if ix > 0:
                        slope += np.sign(here - values[ix - 1, iy, iz, c])
                    if iy > 0:
                        slope += np.sign(here - values[ix, iy - 1, iz, c])
                    if iz > 0:
                        slope += np.sign(here - values[ix, iy, iz - 1, c])
                    by_values[ix, iy, iz, c] = share * slope
    return total
