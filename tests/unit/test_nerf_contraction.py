"""An unbounded field: the map by its published equation, both engines, their gradients, and what is far away."""

import numpy as np
import pytest
import torch
from test_nerf_render import assert_slopes_of_rays, random_rays, rays_from_inside

from pixelid.nerf.field import radiance as fields
from pixelid.nerf.field.bricks import Bricks
from pixelid.nerf.field.harmonics import number_of
from pixelid.nerf.field.radiance import Field, blocks, contraction
from pixelid.nerf.field.render import Box, Rays, render
from pixelid.nerf.shown.saved import read_field, write_field

LOW, HIGH = np.array([-1.0, -1.5, -1.0]), np.array([1.0, 0.5, 1.5])
MIDDLE, HALF = 0.5 * (LOW + HIGH), 0.5 * (HIGH - LOW)
CELLS = 16


def places(n: int = 400) -> np.ndarray:
    """(n, 3) from the middle of the box to 1000 half sides away, in half sides."""
    rng = np.random.default_rng(0)
    p = rng.uniform(-1, 1, (n, 3))
    return p / np.abs(p).max(axis=1, keepdims=True) * 10 ** rng.uniform(-1, 3, (n, 1))


def equation_10(p: np.ndarray) -> np.ndarray:
    """Barron et al. 2022, of the maximum norm, one point."""
    size = np.linalg.norm(p, np.inf)
    return p if size <= 1 else (2 - 1 / size) * (p / size)


def test_places_are_contracted_as_published_and_come_back():
    p = places()
    c, norm = contraction.contracted(torch.from_numpy(p))
    np.testing.assert_allclose(c.numpy(), [equation_10(each) for each in p], atol=1e-12)
    assert float(c.abs().max()) < contraction.SIDE
    back, size = contraction.expanded(c.numpy(), 10**7)
    np.testing.assert_allclose(back, p, rtol=1e-8)
    np.testing.assert_allclose(size, norm.numpy(), rtol=1e-8)


def test_cells_are_as_large_as_the_inverse_map_says():
    c, step = contraction.contracted(torch.from_numpy(places()))[0].numpy(), 1e-7
    slopes = contraction.expansion(c, 10**7)
    for axis in range(3):
        shift = step * np.eye(3)[axis]
        ahead, behind = (contraction.expanded(c + sign * shift, 10**7)[0] for sign in (1, -1))
        by_hand = (ahead - behind) / (2 * step)
        size = np.abs(slopes[:, :, axis]).max(axis=1, keepdims=True)
        assert (np.abs(by_hand - slopes[:, :, axis]) < 1e-3 * size).mean() > 0.99  # kinks between


def ways(origin: np.ndarray, nearest: float = 0.0, step: float = 0.25):
    """(rays, way of each): from one place, in all directions."""
    rng = np.random.default_rng(1)
    d = rng.normal(size=(300, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    a, b = (LOW - origin) / d, (HIGH - origin) / d
    near, far = np.maximum(np.minimum(a, b).max(axis=1), nearest), np.maximum(a, b).min(axis=1)
    o = np.broadcast_to(origin, d.shape)
    origins, directions, low, high, first, last = (torch.from_numpy(np.array(x)) for x in (o, d, LOW, HIGH, near, far))
    return d, contraction.ways(origins, directions, low, high, first, last, nearest, step), near, far


@pytest.mark.parametrize("origin", [(0.2, -0.3, 0.1), (3.0, 2.0, 1.0), (0.0, 0.0, -20.0)])
def test_rays_go_outwards_by_steps_of_the_grid(origin):
    """Each step is the integral of dt/dτ; within the box it is the distance, and none is longer than 2.5 cells."""
    step, nearest = 2.0 * contraction.SIDE * HALF.max() / 64, 0.05
    d, found, near, far = ways(np.array(origin), nearest, step)
    begin, until, *rest = (x.numpy() for x in found)
    for k in range(0, len(d), 7):
        tau = np.arange(float(begin[k]), float(until[k]), step)
        one = [x[k] for x in rest]
        t, stretch = (x.numpy() for x in contraction.distances(torch.from_numpy(tau), *map(torch.tensor, one)))
        scalar = [contraction.distance.py_func(x, *one) for x in tau]
        by_hand = contraction.way.py_func(np.array(origin), d[k], LOW, HIGH, near[k], far[k], nearest, step)
        np.testing.assert_allclose(by_hand, [begin[k], until[k], *one], rtol=1e-9)
        np.testing.assert_allclose(np.column_stack([t, stretch]), scalar, rtol=1e-9)
        assert t[0] == pytest.approx(nearest, abs=1e-9)
        fine = np.linspace(tau[0], tau[-1], 200_001)
        grown = contraction.distances(torch.from_numpy(fine), *map(torch.tensor, one))[1].numpy()
        assert np.trapezoid(grown, fine) == pytest.approx(t[-1] - t[0], rel=1e-3)
        if far[k] > near[k]:
            inside = (t > near[k]) & (t < far[k])
            np.testing.assert_allclose(stretch[inside], 1.0)
        p = (np.array(origin) + t[:, None] * d[k] - MIDDLE) / HALF
        c = np.array([equation_10(each) for each in p]) * HALF.max()
        assert np.abs(np.diff(c, axis=0)).max() < 2.5 * step
        assert tau[-1] + step > until[k]
        assert np.abs(p[-1]).max() > 16  # half of the half sides that a grid of so many cells tells apart


def unbounded(vertices: int = CELLS + 1, occupied=None) -> Box:
    bricks = Bricks.every(vertices)
    occupied = np.ones(blocks(vertices), np.uint8) if occupied is None else occupied
    return Box(LOW, HIGH, contraction.SIDE * 2 * HALF.max() / (vertices - 1), occupied, bricks, 0.1, True)


def shown_with_gradients(engine: str, channels: int, degree: int, inside: bool, density: float) -> list[torch.Tensor]:
    """Radiance and opacity of some rays, and the gradients of a sum over them by all that can move."""
    rng, shape = np.random.default_rng(0), (CELLS + 1,) * 3
    values = rng.normal(0, 1, (*shape, 1 + channels)).astype(np.float32)
    values[..., 0] += density
    directional = 0.3 * rng.normal(0, 1, (*shape, channels, number_of(degree))).astype(np.float32)
    box = unbounded(occupied=(rng.random(blocks(CELLS + 1)) < 0.8).astype(np.uint8))
    rays = random_rays(500, channels)
    if inside:
        rays = rays._replace(origins=(0.2 * rays.origins).astype(np.float32))
    arrays = (values, np.full(channels, 0.4, np.float32), directional, *rays[:2])
    moved = [torch.tensor(array, requires_grad=True) for array in arrays]
    grid, behind, coefficients, origins, directions = moved
    rows = box.bricks.gathered(grid), box.bricks.gathered(coefficients)
    moving = rays._replace(origins=origins, directions=directions)
    radiance, opacity = render(rows[0], behind, moving, box, engine, rows[1])
    (radiance * torch.linspace(-1, 1, len(radiance))).sum().backward()
    return [radiance.detach(), opacity, *(of.grad for of in moved if of.grad is not None and of.numel())]


@pytest.mark.parametrize(
    ("channels", "degree", "inside", "density"), [(1, 0, False, 0.0), (3, 2, True, -1.0), (1, 1, False, 13.0)]
)
def test_both_engines_agree_with_their_gradients(channels, degree, inside, density):
    found = [shown_with_gradients(engine, channels, degree, inside, density) for engine in ("compiled", "tensors")]
    for compiled, tensors in zip(*found, strict=True):
        scale = float(tensors.abs().max()) or 1.0  # nothing behind an opaque field
        torch.testing.assert_close(compiled / scale, tensors / scale, rtol=2e-3, atol=2e-4)


@pytest.mark.parametrize("of", ["origins", "directions"])
def test_gradients_of_rays_are_those_of_finite_differences(of):
    """From inside the box in a thin haze: where marches begin and end comes and goes by a sample, in some rays."""
    rng = np.random.default_rng(2)
    box = unbounded()
    grid = box.bricks.gathered(torch.tensor(rng.normal(0, 0.5, (CELLS + 1,) * 3 + (2,)).astype(np.float32)))
    grid[64:, 0] -= 1.0

    def value(given):
        return render(grid, torch.tensor([1.0]), given, box._replace(step=0.05))[0]

    assert_slopes_of_rays(value, rays_from_inside(rng, 60), of, 1e-3, 0.05)


@pytest.mark.parametrize("engine", ["compiled", "tensors"])
@pytest.mark.parametrize("away", [0.5, 3.0, 20.0])
def test_a_wall_far_away_is_seen_there(engine, away):
    """A wall at x = away half sides and beyond, from the middle of the box; depth by the renderer's own sum."""
    vertices = 129
    field = Field(LOW, HIGH, vertices, 1, [0.3], unbounded=True)
    there = (field.positions() - MIDDLE) / HALF
    field.grid.data[:, 0] = torch.as_tensor(np.where(there[:, 0] > away, 9.0, -12.0))
    field.grid.data[:, 1] = np.log(2.0)
    origins = np.tile(MIDDLE, (2, 1)).astype(np.float32)
    rays = Rays(origins, np.array([[1, 0, 0], [-1, 0, 0]], np.float32), np.zeros(2, int), np.full(2, 0.5, np.float32))
    with torch.no_grad():
        radiance, opacity = field(rays, engine)
        distance = np.linalg.norm(field.positions() - MIDDLE, axis=1)
        field.grid.data[:, 1] = torch.as_tensor(np.log(np.maximum(distance, 1e-6)))
        depth = float(field(rays, engine)[0][0])
    assert radiance.tolist() == pytest.approx([2.0, 0.3], rel=1e-2)
    assert opacity.tolist() == pytest.approx([1.0, 0.0], abs=2e-3)
    half = HALF[0]
    cell = contraction.SIDE * 2 * half / (vertices - 1) * max(away, 1.0) ** 2
    assert abs(depth - away * half) < 2 * cell


def test_a_haze_that_thins_with_the_square_of_n_is_as_opaque_as_its_integral():
    """σ = e^g/n² along the x axis from the middle: ∫ dx/n² = 1 inside + 1 outside half sides, to the horizon."""
    field = Field(LOW, HIGH, 129, 1, [1.0], unbounded=True)
    field.grid.data[64:, 0] = np.log(0.4)
    field.grid.data[64:, 1] = -20.0
    rays = Rays(
        MIDDLE[None].astype(np.float32), np.array([[1, 0, 0]], np.float32), np.zeros(1, int),
        np.full(1, 0.5, np.float32),
    )  # fmt: skip
    for engine in ("compiled", "tensors"):
        assert float(field(rays, engine)[0].detach()[0]) == pytest.approx(np.exp(-0.4 * 2 * HALF[0]), rel=0.02)


def test_skipping_empty_blocks_changes_nothing_that_shows():
    rng = np.random.default_rng(4)
    field = Field(LOW, HIGH, 33, 1, [0.4], unbounded=True)
    seen = rng.random(len(field.grid)) < 0.003
    field.grid.data[:, 0] = torch.as_tensor(np.where(seen, 4.0, -12.0))
    rays = random_rays(2000, 1)
    with torch.no_grad():
        every = field(rays)[0]
        share = field.look_for_empty_blocks()
        some = field(rays)[0]
    assert share < 0.9
    torch.testing.assert_close(some, every, atol=1e-3, rtol=1e-3)


def test_of_an_unbounded_field_only_what_shows_is_held(monkeypatch, tmp_path):
    """A ball in the inner box and another outside; nothing changes what shows, nor the field that is read back."""
    field = Field(LOW, HIGH, 33, 1, [0.4], degree=1, unbounded=True)
    there = (field.positions() - MIDDLE) / HALF
    near, far = np.linalg.norm(there, axis=1), np.linalg.norm(there - [8.0, 0.0, 0.0], axis=1)
    dense = np.maximum(20.0 * (0.5 - near), 4.0 * (3.0 - far)).clip(-12.0, 3.0)
    field.grid.data[64:, 0] = torch.as_tensor(dense, dtype=torch.float32)[64:]
    field.grid.data[:, 1] = torch.as_tensor(0.1 * np.sin(9.0 * there[:, 0]))
    field.coefficients.data[64:] = 0.1
    field.look_for_empty_blocks()
    rays = random_rays(2000, 1)
    engines = ("compiled", "tensors")
    with torch.no_grad():
        whole, number = [field(rays, engine) for engine in engines], field.bricks.number
        monkeypatch.setattr(fields, "WHOLE", 8)
        assert field.follow() is not None
        for engine, (radiance, opacity) in zip(engines, whole, strict=True):
            assert 0.02 < float((opacity > 0.9).float().mean()) < 0.98
            torch.testing.assert_close(field(rays, engine), (radiance, opacity), rtol=0.0, atol=0.0)
        assert 0 < field.bricks.number < 0.5 * number
        held = field.positions()[64:] - MIDDLE
        assert np.abs(held / HALF).max(axis=1).min() < 1 < np.abs(held / HALF).max()
        write_field(field, tmp_path)
        read = read_field(tmp_path)
        assert (read.unbounded, read.bricks.number) == (True, field.bricks.number)
        torch.testing.assert_close(read(rays)[0], whole[0][0], rtol=1e-2, atol=1e-2)
