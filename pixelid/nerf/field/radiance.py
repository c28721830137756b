"""The radiance field: log density and log radiance at the vertices of a box, refined as training goes on.

Log radiance may depend on the direction it is seen from (`harmonics`), which is what highlights ask for.

Chosen by measurement (docs/results/speed.md): on a CPU the compiled march through a grid is an order of magnitude
faster than a hash grid with a small network, and 64 × 64 pixels do not ask for more resolution.  Vertices lie in bricks
(`bricks`).  A fine field keeps those about what it shows; they follow it as it grows, and are given up where it clears.
"""

from __future__ import annotations

import math

import numpy as np
import torch

from pixelid.nerf.field import contraction, render_kernels
from pixelid.nerf.field.bricks import CLEAR_DENSITY, ROWS, Bricks
from pixelid.nerf.field.harmonics import number_of
from pixelid.nerf.field.render import Box, Rays, read_off, render

EMPTY = 0.02  # opacity of one step below which a block is skipped
WHOLE = 161  # vertices per side up to which no brick is given up: 90 MB where there is one colour


class Field(torch.nn.Module):
    """A box of vertices.

    low, high: (3,) corners;  vertices: per side;  channels: colours;  background: (C,) radiance behind the box, held
    unless `free_background`;  level: radiance that the grid starts from;  degree: of the spherical harmonics by which
    log radiance depends on the direction, 0 to 2;  near: distance from the camera before which rays meet nothing;
    unbounded: whether the corners are those of the inner box, beyond which space is contracted (`contraction`)

    bricks: where the rows are;  grid: (rows, 1 + C);  coefficients: (rows, C, K) of the harmonics in addition to the
        constant
    """

    def __init__(
        self, low, high, vertices: int, channels: int, background, *, free_background=False, level=None, degree=0,
        near=0.0, unbounded=False,
    ) -> None:  # fmt: skip
        super().__init__()
        self.low, self.high = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
        self.near, self.unbounded = float(near), bool(unbounded)
        bricks = Bricks.every(vertices)
        grid = torch.empty(bricks.rows, 1 + channels)
        side = float((self.high - self.low).max())
        grid[:, 0] = math.log(0.3 / side)
        grid[:, 1:] = math.log(level if level is not None else 0.5 * float(np.mean(background)))
        self._hold(bricks, grid, torch.zeros(bricks.rows, channels, number_of(degree)), degree > 0)
        log_background = torch.log(torch.as_tensor(np.atleast_1d(background), dtype=torch.float32))
        self.log_background = torch.nn.Parameter(log_background, requires_grad=free_background)

    def _hold(self, bricks: Bricks, grid: torch.Tensor, coefficients: torch.Tensor, trained: bool) -> None:
        """Take these rows for its own, of which those of no place and beyond the field are clear; visit every block."""
        nowhere = torch.as_tensor((bricks.vertex_of_rows() >= bricks.vertices).any(axis=1), device=grid.device)
        nowhere[:ROWS] = True
        grid[nowhere, 0], coefficients[nowhere] = CLEAR_DENSITY, 0.0
        self.bricks = bricks
        self.grid = torch.nn.Parameter(grid)
        self.coefficients = torch.nn.Parameter(coefficients, requires_grad=trained)
        self.occupied = np.ones(blocks(bricks.vertices), np.uint8)

    def hold(self, bricks: Bricks, grid: torch.Tensor, coefficients: torch.Tensor | None = None) -> None:
        """Take other rows for its own, in place; the values are copied, and coefficients zero where none are given."""
        device, channels = self.grid.device, grid.shape[1] - 1
        own = torch.zeros(len(grid), channels, 0) if coefficients is None else coefficients.detach().clone()
        self._hold(bricks, grid.detach().clone().to(device), own.to(device), own.shape[-1] > 0)

    def hold_dense(self, grid: torch.Tensor, coefficients: torch.Tensor | None = None) -> None:
        """The same from values at all vertices, (n, n, n, 1 + C) and (n, n, n, C, K)."""
        bricks = Bricks.every(grid.shape[0])
        self.hold(bricks, bricks.gathered(grid), None if coefficients is None else bricks.gathered(coefficients))

    def dense(self) -> tuple[np.ndarray, np.ndarray]:
        """(grid (n, n, n, 1 + C), coefficients (n, n, n, C, K)) at all vertices; clear where no brick is."""
        held = (self.grid.detach().cpu().numpy(), self.coefficients.detach().cpu().numpy())
        return self.bricks.spread_out(held[0]), self.bricks.spread_out(held[1])

    @property
    def vertices(self) -> int:
        """Per side."""
        return self.bricks.vertices

    @property
    def step(self) -> float:
        """Of the march: one cell, of the inner box."""
        return float(self._spacing.max())

    @property
    def _spacing(self) -> np.ndarray:
        """(3,) sides of a cell, of the inner box."""
        return (contraction.SIDE if self.unbounded else 1.0) * (self.high - self.low) / (self.vertices - 1)

    @property
    def finite(self) -> bool:
        """Whether it holds numbers only."""
        return all(bool(torch.isfinite(held).all()) for held in (self.grid, self.coefficients, self.log_background))

    def box(self) -> Box:
        """What the renderer needs in addition to the grid."""
        return Box(self.low, self.high, self.step, self.occupied, self.bricks, self.near, self.unbounded)

    def forward(self, rays: Rays, engine: str = "auto") -> tuple[torch.Tensor, torch.Tensor]:
        """(radiance, opacity), (n,) each."""
        return render(self.grid, torch.exp(self.log_background), rays, self.box(), engine, self.coefficients)

    def positions(self) -> np.ndarray:
        """(rows, 3) where the rows are."""
        return self.places(self.bricks.vertex_of_rows())

    def places(self, vertex: np.ndarray) -> np.ndarray:
        """(n, 3) where vertices (n, 3) are, whole or not; of an unbounded field the outermost ones in the last cell."""
        if not self.unbounded:
            return self.low + vertex * self._spacing
        p, _ = contraction.expanded(self._contracted(vertex), self.vertices)
        return self.low + 0.5 * (p + 1.0) * (self.high - self.low)

    def cells(self, vertex: np.ndarray) -> np.ndarray:
        """(n, 3, 3) change of the place (second index) per cell along each axis (third), at vertices (n, 3)."""
        if not self.unbounded:
            return np.broadcast_to(np.diag(self._spacing), (len(vertex), 3, 3))
        per_cell = 2.0 * contraction.SIDE / (self.vertices - 1)
        slopes = contraction.expansion(self._contracted(vertex), self.vertices)
        return 0.5 * (self.high - self.low)[:, None] * slopes * per_cell

    def _contracted(self, vertex: np.ndarray) -> np.ndarray:
        """(n, 3) places of `contraction` of vertices (n, 3)."""
        return contraction.SIDE * (2.0 * vertex / (self.vertices - 1) - 1.0)

    def look_for_empty_blocks(self) -> float:
        """Renew which blocks are visited; the share of them."""
        floor = math.log(-math.log1p(-EMPTY) / self.step)
        values = self.grid.detach().cpu().numpy()
        render_kernels.occupancy(values, self.vertices, self.bricks.index, floor, self.occupied)
        return float(self.occupied.mean())

    def refine(self, vertices: int) -> None:
        """Interpolate to more vertices, in place; beyond `WHOLE` only about blocks that were found occupied last."""
        self.follow()
        bricks = Bricks.every(vertices)
        if vertices > WHOLE:
            ratio, shown = (vertices - 1) / (self.vertices - 1), np.zeros(bricks.index.shape, np.uint8)
            for corner in np.floor(np.argwhere(self.occupied) * ratio).astype(int):
                shown[tuple(slice(k, k + math.ceil(ratio)) for k in corner)] = 1
            bricks = Bricks.where(vertices, bricks.around(shown))
        grid, coefficients = (self._interpolated(held, bricks) for held in (self.grid, self.coefficients))
        self._hold(bricks, grid, coefficients, self.coefficients.requires_grad)

    def _interpolated(self, held: torch.Tensor, bricks: Bricks) -> torch.Tensor:
        """Rows of other bricks, read off its own."""
        points = np.minimum(bricks.vertex_of_rows() / (bricks.vertices - 1), 1.0)
        return read_off(held.flatten(1), points, self.bricks).reshape(len(points), *held.shape[1:])

    def follow(self) -> np.ndarray | None:
        """Give up bricks far from what is shown, and add those that it grows into, of their neighbours' colour.

        Returns:
            (rows,) which row each was before, −1 for those that are new;  None when nothing has changed.
        """
        was, there = self.bricks.index > 0, self.bricks.around(self.occupied)
        if self.vertices <= WHOLE or (there == was).all():
            return None
        bricks, occupied = Bricks.where(self.vertices, there), self.occupied
        before = self.bricks.index[there].astype(np.int64)
        source = np.concatenate([np.zeros(1, np.int64), np.where(before > 0, before, -1)])
        rows = np.where(source[:, None] < 0, -1, source[:, None] * ROWS + np.arange(ROWS)).ravel()
        kept = torch.as_tensor(np.maximum(rows, 0), device=self.grid.device)
        new = torch.as_tensor(rows < 0, device=self.grid.device)
        grid, coefficients = self.grid.detach()[kept], self.coefficients.detach()[kept]
        radiance = self._colour_beside(there & ~was)
        grown = 0.01  # opacity of one step that a brick begins with where a scene grows into it: not clear, hardly seen
        uniform = np.column_stack([np.full(len(radiance), math.log(grown / self.step)), radiance])
        uniform = torch.as_tensor(uniform, dtype=grid.dtype, device=grid.device)
        grid[new] = uniform.repeat_interleave(ROWS, dim=0)
        coefficients[new] = 0.0
        self._hold(bricks, grid, coefficients, self.coefficients.requires_grad)
        self.occupied = occupied
        return rows

    def _colour_beside(self, new: np.ndarray) -> np.ndarray:
        """(k, C) mean log radiance of the bricks that are there in addition to new ones (b, b, b)."""
        means = self.grid.detach().cpu().numpy()[:, 1:].reshape(-1, ROWS, self.grid.shape[1] - 1).mean(axis=1)
        around, at = np.pad(self.bricks.index, 1), np.argwhere(new)
        beside = np.stack([around[tuple((at + shift).T)] for shift in np.ndindex(3, 3, 3)])  # (27, k)
        there = (beside > 0)[..., None]
        return (means[beside] * there).sum(axis=0) / np.maximum(there.sum(axis=0), 1)


def blocks(vertices: int) -> tuple[int, int, int]:
    number = -(-(vertices - 1) // render_kernels.BLOCK)
    return number, number, number
