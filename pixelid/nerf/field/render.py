"""Rendering rays of a voxel field: one function, two engines that agree, both differentiable.

"compiled"   `render_kernels` behind a `torch.autograd.Function`, on CPU threads: the default there
"tensors"    torch operations, on any device: the default on CUDA
"""

from __future__ import annotations

import math
import os
from typing import Any, NamedTuple

import numpy as np
import torch

from pixelid.nerf.field import contraction
from pixelid.nerf.field import render_kernels as kernels
from pixelid.nerf.field.bricks import ROWS, Bricks
from pixelid.nerf.field.harmonics import harmonics
from pixelid.parallel import map_threads, ranges


class Box(NamedTuple):
    """Where a field lives and how it is marched: corners (3,) each, step length, blocks worth visiting (b, b, b), where
    the vertices are, the distance from the camera before which nothing is seen, and whether the corners are those of
    the inner box of an unbounded field (`contraction`)."""

    low: np.ndarray
    high: np.ndarray
    step: float
    occupied: np.ndarray
    bricks: Bricks
    near: float = 0.0
    unbounded: bool = False


class Rays(NamedTuple):
    """origins, directions (n, 3) float32;  channels (n,) int64;  offsets (n,) float32 of the first sample, in steps.

    Origins and directions are tensors where their gradient is wanted.
    """

    origins: np.ndarray | torch.Tensor
    directions: np.ndarray | torch.Tensor
    channels: np.ndarray
    offsets: np.ndarray


def threads() -> int:
    """How many threads render and scan: as many as torch may use, which `torchrun` divides among its processes."""
    return max(1, min(torch.get_num_threads(), os.cpu_count() or 1))


POINTS_AT_ONCE = 1 << 17  # that a field is read off at: bounds memory, changes no more than rounding


def by_tensors(engine: str, device: torch.device) -> bool:
    """Whether an engine ("compiled", "tensors", or "auto" by device) is that of torch operations."""
    return engine == "tensors" or (engine == "auto" and device.type != "cpu")


class _Compiled(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, grid: torch.Tensor, coefficients: torch.Tensor, background: torch.Tensor, origins: torch.Tensor,
        directions: torch.Tensor, rays: Rays, box: Box, keep: bool,
    ):  # fmt: skip
        (densities, looks), behind = _side_by_side(grid, coefficients), background.detach().numpy()
        radiance, opacity = np.empty(len(rays.origins), np.float32), np.empty(len(rays.origins), np.float32)
        filled, away = np.empty(len(densities), np.uint8), np.empty(box.occupied.shape, np.int16)
        vertices, index = box.bricks.vertices, box.bricks.index
        kernels.filled_cells(densities, vertices, index, box.step, box.occupied, filled, away)

        kept_per_ray = 24  # room for samples to begin with, by some fields more and by most less than what is met

        def part(some: slice) -> tuple[np.ndarray, ...]:
            number = some.stop - some.start
            first = np.empty(number + 1 if keep else 0, np.int64)
            room = kept_per_ray * number if keep else 0
            samples, depths, colours = (np.empty(room, kind) for kind in (np.int32, np.float32, np.float32))
            kept = kernels.forward(
                *(column[some] for column in rays), densities, looks, vertices, index, filled, away, box.low, box.high,
                True if box.unbounded else None, box.near, box.step, behind, radiance[some], opacity[some], first,
                samples, depths, colours,
            )  # fmt: skip
            return first, *kept

        cuts = ranges(len(radiance), threads())
        ctx.kept = map_threads(part, cuts, threads=threads())
        ctx.values, ctx.rays, ctx.box, ctx.radiance, ctx.cuts = (densities, looks, behind), rays, box, radiance, cuts
        out, covered = torch.from_numpy(radiance), torch.from_numpy(opacity)
        ctx.mark_non_differentiable(covered)
        return out, covered

    @staticmethod
    def backward(ctx: Any, *by_outputs: torch.Tensor):
        (densities, looks, behind), rays, box, cuts = ctx.values, ctx.rays, ctx.box, ctx.cuts
        by_radiance = np.ascontiguousarray(by_outputs[0].numpy())
        by_densities, by_looks, by_behind = (
            [np.zeros(values.shape, np.float32) for _ in cuts] for values in ctx.values
        )  # fmt: skip
        moving = any(ctx.needs_input_grad[3:5])
        of_rays = [np.zeros((len(by_radiance), 3), np.float32) for _ in range(2)] if moving else [None, None]

        def part(k: int) -> None:
            some = cuts[k]
            kernels.backward(
                *(column[some] for column in rays), densities, looks, box.bricks.vertices, box.bricks.index, box.low,
                box.high, True if box.unbounded else None, box.near, box.step, behind, ctx.radiance[some],
                *ctx.kept[k], by_radiance[some], by_densities[k], by_looks[k], by_behind[k],
                *(None if by is None else by[some] for by in of_rays),
            )  # fmt: skip

        map_threads(part, range(len(cuts)), threads=threads())
        by_look = _total(by_looks)
        by_grid = torch.cat([_total(by_densities)[:, None], by_look[:, :, 0]], dim=1)
        by_rays = (None if by is None else torch.from_numpy(by) for by in of_rays)
        return by_grid, by_look[:, :, 1:].contiguous(), _total(by_behind), *by_rays, None, None, None


def _side_by_side(grid: torch.Tensor, coefficients: torch.Tensor) -> tuple[np.ndarray, np.ndarray]:
    """(log densities (rows,), log radiance of every colour and of its harmonics (rows, C, 1 + K))."""
    looks = torch.cat([grid.detach()[:, 1:, None], coefficients.detach()], dim=2)
    return grid.detach()[:, 0].contiguous().numpy(), looks.numpy()


def _total(parts: list[np.ndarray]) -> torch.Tensor:
    """The sum of what threads have found, in the first one's place."""
    total = torch.from_numpy(parts[0])
    for other in parts[1:]:
        total += torch.from_numpy(other)
    return total


def _tensors(grid: torch.Tensor, coefficients: torch.Tensor, background: torch.Tensor, rays: Rays, box: Box):
    """The same sum over all samples at once, of which only those in occupied blocks are looked up."""
    device = grid.device
    o, d, offset = (torch.as_tensor(a, device=device) for a in (rays.origins, rays.directions, rays.offsets))
    channel = torch.as_tensor(rays.channels, device=device)
    low, high = (torch.as_tensor(a, dtype=torch.float32, device=device) for a in (box.low, box.high))
    ray, t, stretch = _samples(o.detach(), d.detach(), offset, low, high, box)
    point, norm = _in_box(o[ray] + t[:, None] * d[ray], low, high, box.unbounded)
    rows, shares = rows_and_shares(point, box.bricks)
    looked_up = interpolated(grid, rows, shares)
    shown = looked_up[:, 0] > math.log(kernels.CLEAR / box.step)
    depth = box.step * torch.exp(looked_up[:, 0].clamp(max=kernels.HIGHEST)) * shown
    if box.unbounded:
        depth = depth * stretch / norm**2
    value = looked_up[:, 1:].gather(1, channel[ray][:, None])[:, 0]
    if coefficients.shape[-1]:
        directional = interpolated(coefficients.flatten(1), rows, shares)
        own = channel[ray][:, None, None].expand(-1, 1, coefficients.shape[-1])
        directional = directional.reshape(-1, *coefficients.shape[1:]).gather(1, own)[:, 0]
        value = value + (directional * harmonics(d, coefficients.shape[-1]).index_select(0, ray)).sum(dim=1)
    colour = torch.exp(value.clamp(max=kernels.HIGHEST))
    after = depth.double().cumsum(dim=0)  # of all rays, one behind the other
    number = torch.bincount(ray, minlength=len(o))
    begin = torch.cat([after.new_zeros(1), after])[number.cumsum(dim=0) - number].index_select(0, ray)
    before = torch.exp(begin + depth - after)
    seen = (before >= kernels.OPAQUE).detach()
    weight = (before - torch.exp(begin - after)) * seen
    nothing = torch.zeros(len(o), device=device)
    radiance = nothing.index_add(0, ray, weight.float() * colour)
    T = torch.exp(-nothing.index_add(0, ray, depth * seen))  # where the march stopped
    return radiance + T * background[channel], (1 - T).detach()


def _in_box(place: torch.Tensor, low, high, unbounded: bool) -> tuple[torch.Tensor, torch.Tensor]:
    """(0 … 1 in the box or the grid (n, 3), n of `contraction` (n,)) of places in the world."""
    point = (place - low) / (high - low)
    if not unbounded:
        return point, torch.ones_like(point[:, 0])
    c, norm = contraction.contracted(2.0 * point - 1.0)
    return 0.5 + c / (2.0 * contraction.SIDE), norm


def _samples(o, d, offset, low, high, box: Box) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """(ray, distance, growth of the step) of the samples that lie in occupied blocks, ray by ray and outwards.

    Samples stay at their distances, whatever moves the rays.
    """
    x, y, z = box.occupied.shape
    occupied = (torch.as_tensor(box.occupied, device=o.device) > 0) & (box.bricks.index_on(o.device)[:x, :y, :z] > 0)
    safe = torch.where(d.abs() < 1e-9, torch.full_like(d, 1e-9), d)
    a, b = (low - o) / safe, (high - o) / safe
    near = torch.minimum(a, b).amax(dim=1).clamp(min=box.near)
    far = torch.maximum(a, b).amin(dim=1)
    hit = (near < far) & (far < kernels.FARTHEST * box.step)
    entry, length, wide, reach = near, near, near, near
    if box.unbounded:
        near, far, entry, length, wide, reach = contraction.ways(o, d, low, high, near, far, box.near, box.step)
        hit = entry < kernels.FARTHEST * box.step
    most = max(int(torch.ceil(((far - near) * hit).nan_to_num().max() / box.step).item()), 1) + 1
    steps = torch.arange(most, device=o.device)
    found = []
    samples_at_once = 1 << 24  # of which occupied ones are looked for at a time: bounds memory, changes nothing
    for some in torch.arange(len(o), device=o.device).split(max(samples_at_once // most, 1)):
        t = near[some, None] + (offset[some, None] + steps) * box.step
        ray, sample = torch.nonzero((t < far[some, None]) & hit[some, None], as_tuple=True)
        ray, t = some[ray], t[ray, sample]
        stretch = torch.ones_like(t)
        if box.unbounded:
            t, stretch = contraction.distances(t, entry[ray], length[ray], wide[ray], reach[ray])
        point, _ = _in_box(o[ray] + t[:, None] * d[ray], low, high, box.unbounded)
        block = cells_at(point, box.bricks.vertices) // kernels.BLOCK
        keep = occupied[block[:, 0], block[:, 1], block[:, 2]]
        found.append((ray[keep], t[keep], stretch[keep]))
    ray, t, stretch = (torch.cat(column) for column in zip(*found, strict=True))
    return ray, t, stretch


def cells_at(point: torch.Tensor, vertices: int) -> torch.Tensor:
    """(n, 3) cells in which points (n, 3) are, 0 … 1 in the box."""
    return (point * (vertices - 1)).long().clamp(min=0, max=vertices - 2)


def rows_and_shares(point: torch.Tensor, bricks: Bricks) -> tuple[torch.Tensor, torch.Tensor]:
    """(rows (8, n) of the corners about points (n, 3), their shares (8, n)), z fastest; points 0 … 1 in the box."""
    cell = cells_at(point, bricks.vertices)
    x, y, z = (point * (bricks.vertices - 1) - cell).unbind(dim=1)
    ends = ((1 - x, x), (1 - y, y), (1 - z, z))
    return bricks.corner_rows(cell), torch.stack([a * b * c for a in ends[0] for b in ends[1] for c in ends[2]])


def interpolated(values: torch.Tensor, rows: torch.Tensor, shares: torch.Tensor) -> torch.Tensor:
    """(n, features) trilinear values of (rows, features); those of no place have no gradient."""
    held = torch.cat([values[:ROWS].detach(), values[ROWS:]]) if values.requires_grad else values
    # `index_select`: what CUDA adds up for its gradient needs no sorting
    corners = held.index_select(0, rows.flatten()).reshape(*rows.shape, values.shape[1])
    return (shares.to(values.dtype)[..., None] * corners).sum(dim=0)


def read_off(values: torch.Tensor, points: np.ndarray, bricks: Bricks) -> torch.Tensor:
    """(n, features) trilinear values, without gradient, of (rows, features) at points (n, 3), 0 … 1 in the box."""
    values, out = values.detach(), values.new_empty((len(points), values.shape[1]))
    for first in range(0, len(points), POINTS_AT_ONCE):
        some = slice(first, first + POINTS_AT_ONCE)
        point = torch.as_tensor(points[some], device=values.device)
        out[some] = interpolated(values, *rows_and_shares(point, bricks))
    return out


def render(
    grid: torch.Tensor, background: torch.Tensor, rays: Rays, box: Box, engine: str = "auto",
    coefficients: torch.Tensor | None = None,
):  # fmt: skip
    """(radiance (n,), opacity (n,)) of rays through grid (rows of `box.bricks`, 1 + C) before background (C,).

    coefficients: (rows, C, K) of the harmonics by which log radiance depends on the direction.  Radiance is
    differentiable in grid, coefficients and background, and in origins and directions that are tensors.  engine:
    "compiled", "tensors" or "auto" (by device).
    """
    if coefficients is None:
        coefficients = grid.new_zeros((len(grid), len(background), 0))
    if by_tensors(engine, grid.device):
        return _tensors(grid, coefficients, background, rays, box)
    origins, directions = torch.as_tensor(rays.origins), torch.as_tensor(rays.directions)
    plain = rays._replace(origins=origins.detach().numpy(), directions=directions.detach().numpy())
    asked = any(of.requires_grad for of in (grid, coefficients, background, origins, directions))
    keep = asked and torch.is_grad_enabled()
    return _Compiled.apply(grid, coefficients, background, origins, directions, plain, box, keep)
