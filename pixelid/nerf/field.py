"""The radiance field: log density and log radiance at the vertices of a dense grid, refined as training goes on.

Log radiance may depend on the direction it is seen from (`harmonics`), which is what highlights ask for.

Chosen by measurement (docs/results/speed.md): on a CPU the compiled march through a dense grid is an order of
magnitude faster than a hash grid with a small network, and 64 × 64 pixels do not ask for more resolution.
"""

from __future__ import annotations

import math

import numpy as np
import torch
import torch.nn.functional as F

from pixelid.nerf import render_kernels
from pixelid.nerf.harmonics import number_of
from pixelid.nerf.render import Box, Rays, render

EMPTY = 0.02  # opacity of one step below which a block is skipped


class Field(torch.nn.Module):
    """A box of vertices.

    low, high: (3,) corners;  vertices: per side;  channels: colours;  background: (C,) radiance behind the box, held
    unless `free_background`;  level: radiance that the grid starts from;  degree: of the spherical harmonics by which
    log radiance depends on the direction, 0 to 2

    grid: (n, n, n, 1 + C);  coefficients: (n, n, n, C, K) of the harmonics beside the constant
    """

    def __init__(
        self, low, high, vertices: int, channels: int, background, *, free_background=False, level=None, degree=0
    ) -> None:
        super().__init__()
        self.low, self.high = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
        grid = torch.empty(vertices, vertices, vertices, 1 + channels)
        side = float((self.high - self.low).max())
        grid[..., 0] = math.log(0.3 / side)
        grid[..., 1:] = math.log(level if level is not None else 0.5 * float(np.mean(background)))
        self.grid = torch.nn.Parameter(grid)
        coefficients = torch.zeros(vertices, vertices, vertices, channels, number_of(degree))
        self.coefficients = torch.nn.Parameter(coefficients, requires_grad=degree > 0)
        log_background = torch.log(torch.as_tensor(np.atleast_1d(background), dtype=torch.float32))
        self.log_background = torch.nn.Parameter(log_background, requires_grad=free_background)
        self.occupied = np.ones(blocks(vertices), np.uint8)

    @property
    def vertices(self) -> int:
        """Per side."""
        return self.grid.shape[0]

    @property
    def step(self) -> float:
        """Of the march: one cell."""
        return float((self.high - self.low).max()) / (self.vertices - 1)

    @property
    def finite(self) -> bool:
        """Whether it holds numbers only."""
        return all(bool(torch.isfinite(held).all()) for held in (self.grid, self.coefficients, self.log_background))

    def box(self) -> Box:
        """What the renderer needs beside the grid."""
        return Box(self.low, self.high, self.step, self.occupied)

    def forward(self, rays: Rays, engine: str = "auto") -> tuple[torch.Tensor, torch.Tensor]:
        """(radiance, opacity), (n,) each."""
        return render(self.grid, torch.exp(self.log_background), rays, self.box(), engine, self.coefficients)

    def look_for_empty_blocks(self) -> float:
        """Renew which blocks are visited; the share of them."""
        floor = math.log(-math.log1p(-EMPTY) / self.step)
        values = self.grid.detach().cpu().numpy()
        render_kernels.occupancy(values, floor, self.occupied)
        return float(self.occupied.mean())

    def refine(self, vertices: int) -> None:
        """Interpolate to more vertices, in place."""
        with torch.no_grad():
            self.grid = torch.nn.Parameter(_finer(self.grid, vertices))
            per_vertex, trained = self.coefficients.shape[3:], self.coefficients.requires_grad
            fine = _finer(self.coefficients.flatten(3), vertices).reshape(*(vertices,) * 3, *per_vertex)
            self.coefficients = torch.nn.Parameter(fine, requires_grad=trained)
        self.occupied = np.ones(blocks(vertices), np.uint8)


def _finer(values: torch.Tensor, vertices: int) -> torch.Tensor:
    """(nx, ny, nz, features) interpolated to `vertices` per side; there may be no features."""
    if values.shape[3] == 0:
        return values.new_zeros((vertices, vertices, vertices, 0))
    fine = F.interpolate(values.permute(3, 0, 1, 2)[None], size=(vertices,) * 3, mode="trilinear", align_corners=True)
    return fine[0].permute(1, 2, 3, 0).contiguous()


def blocks(vertices: int) -> tuple[int, int, int]:
    number = -(-(vertices - 1) // render_kernels.BLOCK)
    return number, number, number
