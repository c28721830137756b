"""Rays rendered and differentiated, compiled beside torch's operations.

Rays of a sensor of so many pixels, through the grid that training ends with there; forward and backward, one thread.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import numpy as np
import torch

from paths.hash_grid import Hash
from paths.sizes import Sizes
from paths.timing import Counts, Other, Task, compared
from pixelid.nerf.data.camera import pinhole
from pixelid.nerf.data.scenes import spiral
from pixelid.nerf.field.bricks import Bricks
from pixelid.nerf.field.radiance import blocks
from pixelid.nerf.field.render import Box, Rays, render
from pixelid.nerf.training.recipe import Recipe

HALF = 1.44  # of the box
FIELD_OF_VIEW = 0.69
# Both engines work in float32.  A ray on the point of being opaque may end one sample earlier in one of them.
AGREEMENT, STRAY = 1e-5, 1e-3
# Per sample of a ray, counted in `render_kernels`: eight corners of two float32 are read forwards, read again and
# written backwards; 8 weights (16 flops), two sums of 8 products (32), compositing (about 12), and thrice that with
# the gradients; one exponential each for density, radiance and opacity, forwards.
PER_SAMPLE = Counts(bytes=3 * 8 * 2 * 4, flops=3 * 60, exponentials=3)


def tasks(sizes: Sizes) -> Iterator[Task]:
    """A row per size of sensor, and the smallest beside another kind of field."""
    for side in sizes.sensors:
        yield Task("rays", f"rendering, {side} × {side} pixels", lambda s=side: measured(s, sizes))
    yield Task("rays", "rendering beside a hash grid", lambda: beside_hash_grid(sizes))


@lru_cache(maxsize=1)
def problem(side: int, rays: int):
    """(grid, background, rays, box, samples along them)."""
    torch.manual_seed(0)
    vertices = Recipe().for_sensor(side).vertices[-1]
    high = np.full(3, HALF)
    bricks = Bricks.every(vertices)
    box = Box(-high, high, 2 * HALF / (vertices - 1), np.ones(blocks(vertices), np.uint8), bricks)
    rng = np.random.default_rng(0)
    inside = pinhole(side, side, FIELD_OF_VIEW).all_directions()[rng.integers(0, side * side, rays)]
    origins, directions = spiral(1.0, 1.0).rays(rng.random(rays), inside)
    some = Rays(origins, directions, np.zeros(rays, np.int64), rng.random(rays, dtype=np.float32))
    ends = np.stack([(-high - origins) / directions, (high - origins) / directions])
    near, far = np.maximum(ends.min(0).max(1), 0), ends.max(0).min(1)
    samples = int((np.maximum(far - near, 0) / box.step).sum())
    grid = (0.3 * torch.randn(bricks.rows, 2) - 1.5).requires_grad_()
    return grid, torch.tensor([0.4]), some, box, samples


def measured(side: int, sizes: Sizes) -> dict:
    """A row."""
    grid, behind, some, box, samples = problem(side, sizes.rays)

    def run(engine: str) -> torch.Tensor:
        grid.grad = None
        radiance = render(grid, behind, some, box, engine)[0]
        radiance.sum().backward()
        return radiance.detach()

    apart = (run("compiled") / run("tensors") - 1.0).abs()
    assert float((apart > AGREEMENT).double().mean()) < STRAY, "rendering: the two engines differ"
    per_ray = samples / sizes.rays
    counts = Counts(*(per_ray * n for n in (PER_SAMPLE.bytes, PER_SAMPLE.flops, PER_SAMPLE.exponentials)))
    return compared(
        lambda: run("compiled"),
        Other("torch operations", f"torch {torch.__version__}", lambda: run("tensors")),
        sizes.runs,
        size=f"{sizes.rays} rays, {box.bricks.vertices}³ vertices, {samples} samples",
        item="ray",
        items=sizes.rays,
        counts=counts,
        words="reading and adding to scattered corners of the grid",
        note="a ray that no longer lets light through ends early; samples are counted to the far side of the box",
    )


def beside_hash_grid(sizes: Sizes) -> dict:
    """Rendering and its gradient, beside the features alone of a hash grid at as many points, and their gradient."""
    grid, behind, some, box, samples = problem(sizes.sensors[0], sizes.rays)
    network, points = Hash(), torch.rand(5 * sizes.rays, 3)

    def ours() -> None:
        grid.grad = None
        render(grid, behind, some, box, "compiled")[0].sum().backward()

    def theirs() -> None:
        network.zero_grad()
        network(points).sum().backward()

    return compared(
        ours,
        Other("hash grid, features alone", f"torch {torch.__version__}", theirs, len(points) / samples),
        sizes.runs,
        size=f"{samples} samples",
        item="sample",
        items=samples,
        counts=PER_SAMPLE,
        words="as above",
    )
