"""What holds a field smooth, with gradients in one pass: total variation of log radiance, mean square of harmonics.

    V = Σ_axes mean |c(vertex) − c(next vertex along the axis)|      the mean also over colours

Means are over all vertices of the box: where no brick is, nothing varies.
Tensors would pass over the grid a dozen times; they remain for other devices, and as what the kernel is tested against.
Density has no part in it: that added nothing where it was tried.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numba import njit

from pixelid.nerf.bricks import ROWS, SIDE, Bricks, row
from pixelid.nerf.render import threads
from pixelid.parallel import map_threads, ranges

EMPTIEST = -6.0  # log density below which nothing is to be cleared


def variation(grid: torch.Tensor, bricks: Bricks, engine: str = "auto") -> torch.Tensor:
    """V of the log radiance of a grid (rows, 1 + C), log density first;  engine: as of `render`."""
    if engine == "tensors" or (engine == "auto" and grid.device.type != "cpu"):
        return _variation_of_tensors(grid, bricks)
    return _Variation.apply(grid, bricks)


def _variation_of_tensors(grid: torch.Tensor, bricks: Bricks) -> torch.Tensor:
    colour, total = grid[:, 1:], grid.new_zeros(())
    for here, after in bricks.neighbours_on(grid.device):
        total = total + (colour.index_select(0, after) - colour.index_select(0, here)).abs().sum()
    return total * _share(bricks, grid.shape[1])


def _share(bricks: Bricks, depth: int) -> float:
    """One over the number of differences along an axis, of all colours."""
    n = bricks.vertices
    return 1.0 / ((n - 1) * n * n * (depth - 1))


class _Variation(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, grid: torch.Tensor, bricks: Bricks):
        values = grid.detach().numpy()
        by_grid, places, share = np.zeros_like(values), bricks.places(), _share(bricks, values.shape[1])
        parts = map_threads(
            lambda some: _fill(values, places[some], bricks.index, bricks.vertices, np.float32(share), by_grid),
            ranges(len(places), threads()), threads=threads(),
        )  # fmt: skip
        ctx.save_for_backward(torch.from_numpy(by_grid))
        return grid.new_tensor(share * sum(parts))

    @staticmethod
    def backward(ctx: Any, *by_outputs: torch.Tensor):
        (by_grid,) = ctx.saved_tensors
        return by_grid * by_outputs[0], None


def mean_log_density(grid: torch.Tensor, bricks: Bricks) -> torch.Tensor:
    """Mean over all vertices of the log density, `EMPTIEST` where it is less or no brick is."""
    total, number = (grid[ROWS:, 0].clamp(min=EMPTIEST) - EMPTIEST).sum(), bricks.vertices**3
    return EMPTIEST + total / number


def mean_square(values: torch.Tensor, bricks: Bricks) -> torch.Tensor:
    """Mean over all vertices of squares of (rows, C, K), without what `square()` keeps for its gradient."""
    return _MeanSquare.apply(values, bricks.vertices**3 * values[0].numel())


class _MeanSquare(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, values: torch.Tensor, number: int):
        ctx.save_for_backward(values)
        ctx.number = max(number, 1)
        flat = values.detach().flatten()
        return torch.dot(flat, flat) / ctx.number

    @staticmethod
    def backward(ctx: Any, *by_outputs: torch.Tensor):
        (values,) = ctx.saved_tensors
        return values * (2.0 * by_outputs[0] / ctx.number), None


@njit(cache=True, nogil=True, error_model="numpy")
def _fill(values, places, index, n, share, by_values):
    """Σ of the absolute differences that begin in bricks at places (k, 3); the gradient of their rows is filled in."""
    depth, total = values.shape[1], 0.0
    for p in range(len(places)):
        first, second, third = places[p, 0] * SIDE, places[p, 1] * SIDE, places[p, 2] * SIDE
        for ix in range(first, min(first + SIDE, n)):
            for iy in range(second, min(second + SIDE, n)):
                for iz in range(third, min(third + SIDE, n)):
                    at = row(index, ix, iy, iz)
                    for axis in range(3):
                        dx, dy, dz = 1 if axis == 0 else 0, 1 if axis == 1 else 0, 1 if axis == 2 else 0
                        place = ix if axis == 0 else (iy if axis == 1 else iz)
                        if place + 1 < n:
                            other = row(index, ix + dx, iy + dy, iz + dz)
                            if other >= ROWS:
                                for c in range(1, depth):
                                    step = values[at, c] - values[other, c]
                                    total += abs(step)
                                    by_values[at, c] += share * np.sign(step)
                        if place > 0:
                            other = row(index, ix - dx, iy - dy, iz - dz)
                            if other >= ROWS:
                                for c in range(1, depth):
                                    by_values[at, c] += share * np.sign(values[at, c] - values[other, c])
    return total
