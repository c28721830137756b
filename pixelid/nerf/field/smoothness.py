"""What holds a field smooth, with gradients in one pass: total variation of its log radiance, mean square of harmonics.

    V = Σ_axes mean |c(vertex) − c(next vertex along the axis)|      the mean also over colours

c is log radiance.  Means are over all vertices of the box; where no brick is, nothing varies.
Tensors would pass over the grid a dozen times; they remain for other devices, and as what the kernel is tested against.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numba import njit

from pixelid.nerf.field.bricks import ROWS, SIDE, Bricks
from pixelid.nerf.field.render import by_tensors, threads
from pixelid.parallel import map_threads, ranges

EMPTIEST = -6.0  # log density below which nothing is to be cleared


def variation(grid: torch.Tensor, bricks: Bricks, engine: str = "auto") -> torch.Tensor:
    """V, differentiable, of the log radiance in a grid (rows, 1 + C) of `bricks`; engine: as of `render`."""
    share = np.float32(1.0 / ((bricks.vertices - 1) * bricks.vertices**2 * (grid.shape[1] - 1)))
    if not by_tensors(engine, grid.device):
        return _Variation.apply(grid, bricks, share)
    values, total = grid[:, 1:], grid.new_zeros(())
    for here, after in bricks.neighbours_on(grid.device):
        total = total + (values.index_select(0, after) - values.index_select(0, here)).abs().sum()
    return total * float(share)


class _Variation(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, grid: torch.Tensor, bricks: Bricks, share: np.float32):
        values = grid.detach().numpy()
        by_grid, places = np.zeros_like(values), bricks.places()
        parts = map_threads(
            lambda some: _fill(values, places[some], bricks.index, bricks.vertices, share, by_grid),
            ranges(len(places), threads()), threads=threads(),
        )  # fmt: skip
        ctx.save_for_backward(torch.from_numpy(by_grid))
        return grid.new_tensor(np.sum(parts) * share)

    @staticmethod
    def backward(ctx: Any, *by_outputs: torch.Tensor):
        (by_grid,) = ctx.saved_tensors
        return by_grid * by_outputs[0], None, None


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
    """Σ of the absolute differences of log radiance that begin in bricks at places (k, 3).

    The gradient of their rows is filled in, times the share of each.
    """
    every = 0.0
    here = np.zeros((SIDE + 2, SIDE + 2, SIDE + 2), np.float32)  # a brick and the nearest vertices of its neighbours
    slopes = np.zeros((SIDE, SIDE, SIDE), np.float32)
    for p in range(len(places)):
        x, y, z = places[p]
        base = np.int64(index[x, y, z]) * ROWS
        nx, ny, nz = min(n - SIDE * x, SIDE), min(n - SIDE * y, SIDE), min(n - SIDE * z, SIDE)
        for feature in range(1, values.shape[1]):
            _gather(values, index, x, y, z, nx, ny, nz, feature, here)
            total = np.float32(0.0)
            for a in range(1, nx + 1):
                for b in range(1, ny + 1):
                    for c in range(1, nz + 1):
                        own = here[a, b, c]
                        in_x, in_y, in_z = here[a + 1, b, c] - own, here[a, b + 1, c] - own, here[a, b, c + 1] - own
                        total += abs(in_x) + abs(in_y) + abs(in_z)
                        slope = _sign(own - here[a - 1, b, c]) + _sign(own - here[a, b - 1, c])
                        slope += _sign(own - here[a, b, c - 1]) - _sign(in_x) - _sign(in_y) - _sign(in_z)
                        slopes[a - 1, b - 1, c - 1] = slope
            for a in range(nx):
                for b in range(ny):
                    for c in range(nz):
                        by_values[np.uintp(base + (a * SIDE + b) * SIDE + c), feature] = share * slopes[a, b, c]
            every += total
    return every


@njit(inline="always", error_model="numpy")
def _sign(x):
    return np.float32(x > 0) - np.float32(x < 0)


@njit(inline="always", error_model="numpy")
def _gather(values, index, x, y, z, nx, ny, nz, feature, here):
    """Fill here (6, 6, 6) with a feature of brick (x, y, z), and of its neighbours where they touch its nx × ny × nz
    vertices; where no neighbour is, with the brick's own, from which nothing differs."""
    base, bricks = np.int64(index[x, y, z]) * ROWS, len(index)
    for a in range(nx):
        for b in range(ny):
            for c in range(nz):
                here[a + 1, b + 1, c + 1] = values[np.uintp(base + (a * SIDE + b) * SIDE + c), feature]
    for axis in range(3):
        place, number = (x, nx) if axis == 0 else ((y, ny) if axis == 1 else (z, nz))
        sx, sy, sz = 1 if axis == 0 else 0, 1 if axis == 1 else 0, 1 if axis == 2 else 0
        for way in (-1, 1):
            other = np.int64(0)
            if 0 <= place + way < bricks and (way < 0 or number == SIDE):
                other = np.int64(index[x + way * sx, y + way * sy, z + way * sz]) * ROWS
            own, near, at = (0, SIDE - 1, 0) if way < 0 else (number - 1, 0, number + 1)  # own and other's layer, here
            layer, first = (near, other) if other > 0 else (own, base)
            wide, deep = ny if axis == 0 else nx, ny if axis == 2 else nz
            for b in range(wide):
                for c in range(deep):
                    i, j, k = _in_layer(axis, layer, b, c)
                    value = values[np.uintp(first + (i * SIDE + j) * SIDE + k), feature]
                    i, j, k = _in_layer(axis, at, b + 1, c + 1)
                    here[i, j, k] = value


@njit(inline="always", error_model="numpy")
def _in_layer(axis, layer, b, c):
    """(x, y, z) of place (b, c) in a layer across an axis."""
    return (layer if axis == 0 else b, b if axis == 0 else (layer if axis == 1 else c), layer if axis == 2 else c)
