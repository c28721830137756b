"""What holds a field smooth, with gradients in one pass: total variation of its logs, mean square of harmonics.

    V = Σ_axes mean |c(vertex) − c(next vertex along the axis)|      the mean also over colours

c is log radiance, or log density, `EMPTIEST` where it is less: how clear clear space is, nothing asks.  Means are over
all vertices of the box; where no brick is, nothing varies.
Tensors would pass over the grid a dozen times; they remain for other devices, and as what the kernel is tested against.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch
from numba import njit

from pixelid.nerf.bricks import ROWS, SIDE, Bricks, row
from pixelid.nerf.render import threads
from pixelid.parallel import map_threads, ranges

EMPTIEST = -6.0  # log density below which nothing is to be cleared


class Variation(NamedTuple):
    """Total variation of log density and of log radiance, scalars."""

    density: torch.Tensor
    radiance: torch.Tensor


def variation(grid: torch.Tensor, bricks: Bricks, engine: str = "auto", *, density: bool = True) -> Variation:
    """V of a grid (rows, 1 + C), log density first, both differentiable.

    Args:
        grid: of `bricks`.
        bricks: where its rows are.
        engine: as of `render`.
        density: whether that of the density is asked for; else it is 0, and not looked for.

    Returns:
        Both variations.
    """
    if engine == "tensors" or (engine == "auto" and grid.device.type != "cpu"):
        return _variation_of_tensors(grid, bricks, density)
    return Variation(*_Variation.apply(grid, bricks, density))


def _variation_of_tensors(grid: torch.Tensor, bricks: Bricks, density: bool) -> Variation:
    def of(values: torch.Tensor) -> torch.Tensor:
        total = values.new_zeros(())
        for here, after in bricks.neighbours_on(grid.device):
            total = total + (values.index_select(0, after) - values.index_select(0, here)).abs().sum()
        return total * _share(bricks, values.shape[1])

    return Variation(of(grid[:, : int(density)].clamp(min=EMPTIEST)), of(grid[:, 1:]))


def _share(bricks: Bricks, features: int) -> float:
    """One over the number of differences along an axis, of so many features."""
    n = bricks.vertices
    return 1.0 / ((n - 1) * n * n * max(features, 1))


class _Variation(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, grid: torch.Tensor, bricks: Bricks, density: bool):
        values = grid.detach().numpy()
        by_grid, places = np.zeros_like(values), bricks.places()
        shares = np.array([_share(bricks, 1), _share(bricks, values.shape[1] - 1)], np.float32)
        parts = map_threads(
            lambda some: _fill(
                values, places[some], bricks.index, bricks.vertices, 0 if density else 1,
                np.float32(EMPTIEST), shares, by_grid,
            ),
            ranges(len(places), threads()), threads=threads(),
        )  # fmt: skip
        ctx.save_for_backward(torch.from_numpy(by_grid))
        totals = np.sum(parts, axis=0) * shares
        return grid.new_tensor(totals[0]), grid.new_tensor(totals[1])

    @staticmethod
    def backward(ctx: Any, *by_outputs: torch.Tensor):
        (by_grid,) = ctx.saved_tensors
        by_density, by_radiance = by_outputs
        features = by_radiance.expand(by_grid.shape[1] - 1)
        return by_grid * torch.cat([by_density[None], features]), None, None


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
def _fill(values, places, index, n, start, floor, shares, by_values):
    """(density, radiance) Σ of the absolute differences that begin in bricks at places (k, 3), from feature `start` on.

    The gradient of their rows is filled in, times the share of each;  floor: of feature 0.
    """
    depth, of_density, of_radiance = values.shape[1], 0.0, 0.0
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
                                if start == 0:
                                    of_density += _density_step(values, at, other, floor, shares[0], by_values)
                                for c in range(1, depth):
                                    step = values[at, c] - values[other, c]
                                    of_radiance += abs(step)
                                    by_values[at, c] += shares[1] * np.sign(step)
                        if place > 0:
                            other = row(index, ix - dx, iy - dy, iz - dz)
                            if other >= ROWS:
                                if start == 0:
                                    _density_step(values, at, other, floor, shares[0], by_values)
                                for c in range(1, depth):
                                    by_values[at, c] += shares[1] * np.sign(values[at, c] - values[other, c])
    return of_density, of_radiance


@njit(inline="always", error_model="numpy")
def _density_step(values, at, other, floor, share, by_values):
    """The absolute difference of a row's log density to another one's; its gradient by the row is added."""
    step = max(values[at, 0], floor) - max(values[other, 0], floor)
    if values[at, 0] >= floor:
        by_values[at, 0] += share * np.sign(step)
    return abs(step)
