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

from pixelid.nerf.bricks import ROWS, SIDE, Bricks
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
    here = np.zeros((SIDE + 2, SIDE + 2, SIDE + 2), np.float32)  # a brick and the nearest vertices of its neighbours
    slopes = np.zeros((SIDE, SIDE, SIDE), np.float32)
    for p in range(len(places)):
        x, y, z = places[p]
        base = np.int64(index[x, y, z]) * ROWS
        nx, ny, nz = min(n - SIDE * x, SIDE), min(n - SIDE * y, SIDE), min(n - SIDE * z, SIDE)
        for feature in range(start, depth):
            least = floor if feature == 0 else np.float32(-np.inf)
            _gather(values, index, x, y, z, nx, ny, nz, feature, least, here)
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
            share = shares[min(feature, 1)]
            for a in range(nx):
                for b in range(ny):
                    for c in range(nz):
                        at = np.uintp(base + (a * SIDE + b) * SIDE + c)
                        if values[at, feature] >= least:
                            by_values[at, feature] = share * slopes[a, b, c]
            if feature == 0:
                of_density += total
            else:
                of_radiance += total
    return of_density, of_radiance


@njit(inline="always", error_model="numpy")
def _sign(x):
    return np.float32(x > 0) - np.float32(x < 0)


@njit(inline="always", error_model="numpy")
def _gather(values, index, x, y, z, nx, ny, nz, feature, least, here):
    """Fill here (6, 6, 6) with a feature of brick (x, y, z), and of its neighbours where they touch its nx × ny × nz
    vertices; where no neighbour is, with the brick's own, from which nothing differs."""
    base, bricks = np.int64(index[x, y, z]) * ROWS, len(index)
    for a in range(nx):
        for b in range(ny):
            for c in range(nz):
                here[a + 1, b + 1, c + 1] = max(values[np.uintp(base + (a * SIDE + b) * SIDE + c), feature], least)
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
                    value = max(values[np.uintp(first + (i * SIDE + j) * SIDE + k), feature], least)
                    i, j, k = _in_layer(axis, at, b + 1, c + 1)
                    here[i, j, k] = value


@njit(inline="always", error_model="numpy")
def _in_layer(axis, layer, b, c):
    """(x, y, z) of place (b, c) in a layer across an axis."""
    return (layer if axis == 0 else b, b if axis == 0 else (layer if axis == 1 else c), layer if axis == 2 else c)
