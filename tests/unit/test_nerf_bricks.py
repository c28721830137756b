"""Fields of which only the bricks about what they show are held."""

from typing import Any

import numpy as np
import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from pixelid.errors import InputError
from pixelid.nerf.data.camera import pinhole
from pixelid.nerf.data.scenes import random_views
from pixelid.nerf.field import radiance as fields
from pixelid.nerf.field import render as renderer
from pixelid.nerf.field.bricks import CLEAR_DENSITY, ROWS, Bricks
from pixelid.nerf.field.radiance import Field
from pixelid.nerf.field.render import Box, Rays, render
from pixelid.nerf.field.smoothness import mean_log_density, mean_square, variation
from pixelid.nerf.shown.saved import read_field, write_field
from pixelid.nerf.training.recipe import Recipe
from pixelid.nerf.training.state import State, follow, optimiser_of

LOW, HIGH = np.full(3, -1.0), np.full(3, 1.0)
RADIUS = 0.35


def rays(n: int = 400) -> Rays:
    rng = np.random.default_rng(0)
    position, rotation = random_views(n, 0)
    inside = pinhole(64, 64, 0.6).directions(rng.uniform(0, 63, (n, 2)))
    world = np.einsum("nij,nj->ni", rotation, inside)
    return Rays(position.astype("f4"), world.astype("f4"), np.zeros(n, int), rng.random(n, dtype=np.float32))


def ball(vertices: int, radius: float = RADIUS, degree: int = 1) -> Field:
    """A fuzzy ball in clear space; its radiance and harmonics vary at random."""
    axis = torch.linspace(-1, 1, vertices)
    r = (axis[:, None, None] ** 2 + axis[None, :, None] ** 2 + axis[None, None, :] ** 2).sqrt()
    generator = torch.Generator().manual_seed(0)
    grid = 0.3 * torch.randn(vertices, vertices, vertices, 2, generator=generator)
    grid[..., 0] = (40.0 * (radius - r)).clamp(min=-12.0, max=3.0)
    coefficients = 0.1 * torch.randn(vertices, vertices, vertices, 1, (degree + 1) ** 2 - 1, generator=generator)
    field = Field(LOW, HIGH, vertices, 1, [0.4], degree=degree)
    field.hold_dense(grid, coefficients)
    field.look_for_empty_blocks()
    return field


@pytest.fixture
def sparse(monkeypatch) -> Field:
    """The ball, held where it is."""
    monkeypatch.setattr(fields, "WHOLE", 8)
    field = ball(33)
    assert field.follow() is not None
    return field


@pytest.mark.parametrize("vertices", [2, 9, 13, 16])
def test_rows_and_vertices_are_each_others_inverse(vertices):
    rng = np.random.default_rng(vertices)
    every = Bricks.every(vertices)
    assert every.whole
    some = Bricks.where(vertices, rng.random(every.index.shape) < 0.6)
    values = rng.normal(size=(vertices, vertices, vertices, 2))
    for bricks in (every, some):
        rows = bricks.gathered(torch.from_numpy(values)).numpy()
        assert rows.shape == (bricks.rows, 2)
        rows[:ROWS] = np.nan
        back = bricks.spread_out(rows)
        held = np.isfinite(back[..., 0])
        np.testing.assert_array_equal(back[held], values[held])
        place = np.argwhere(np.ones((vertices,) * 3, bool)).reshape(vertices, vertices, vertices, 3)
        at = bricks.rows_of(torch.from_numpy(place)).numpy()
        np.testing.assert_array_equal(at >= ROWS, held)
        np.testing.assert_array_equal(bricks.vertex_of_rows()[at[held]], place[held])
        assert np.array_equal(Bricks.of_index(vertices, bricks.index).index, bricks.index)


@pytest.mark.parametrize("engine", ["compiled", "tensors"])
def test_what_is_not_held_does_not_show(sparse, engine):
    whole = ball(33)
    assert 0 < sparse.bricks.number < 0.4 * whole.bricks.number
    with torch.no_grad():
        torch.testing.assert_close(sparse(rays(), engine), whole(rays(), engine), rtol=0.0, atol=0.0)


def test_both_engines_agree_with_their_gradients_where_bricks_are_missing():
    """Bricks missing at random, also where it is dense."""
    rng, weight = np.random.default_rng(1), torch.linspace(-1, 1, 400)
    bricks = Bricks.where(17, rng.random((5, 5, 5)) < 0.7)
    values = rng.normal(0, 1, (bricks.rows, 2)).astype(np.float32)
    directional = rng.normal(0, 0.3, (bricks.rows, 1, 3)).astype(np.float32)
    values[:ROWS, 0], directional[:ROWS] = CLEAR_DENSITY, 0.0
    box, found = Box(LOW, HIGH, 0.1, np.ones((4, 4, 4), np.uint8), bricks), []
    for engine in ("compiled", "tensors"):
        grid, coefficients = torch.tensor(values, requires_grad=True), torch.tensor(directional, requires_grad=True)
        radiance, opacity = render(grid, torch.tensor([0.4]), rays(), box, engine, coefficients)
        (radiance * weight).sum().backward()
        slope = grid.grad
        assert slope is not None
        assert not slope[:ROWS].any()
        assert slope[ROWS:].any()
        found.append((radiance.detach(), opacity, slope, coefficients.grad))
    for compiled, tensors in zip(*found, strict=True):
        torch.testing.assert_close(compiled, tensors, rtol=1e-3, atol=1e-4)


def test_what_holds_a_field_smooth_is_that_of_the_whole_one(sparse):
    """Flat where nothing is held, so that both have the same variation; by hand from the dense values."""
    with torch.no_grad():
        sparse.grid[ROWS:, 1] = 0.1 * sparse.grid[ROWS:, 0]
    dense, coefficients = sparse.dense()
    held = sparse.bricks.spread_out(np.arange(sparse.bricks.rows)) >= ROWS
    by_hand = 0.0
    for axis in range(3):
        first, second = np.moveaxis(dense[..., 1], axis, 0), np.moveaxis(held, axis, 0)
        both = second[1:] & second[:-1]
        by_hand += np.abs(np.diff(first, axis=0))[both].sum() / both.size
    found = []
    for engine in ("compiled", "tensors"):
        grid = sparse.grid.detach().clone().requires_grad_()
        radiance = variation(grid, sparse.bricks, engine)
        (2.0 * radiance).backward()
        found.append((radiance.detach(), grid.grad))
    assert float(found[0][0]) == pytest.approx(by_hand, rel=1e-4)
    for compiled, tensors in zip(*found, strict=True):
        torch.testing.assert_close(compiled, tensors)
    emptiness = float(mean_log_density(sparse.grid, sparse.bricks).detach())
    assert emptiness == pytest.approx(np.maximum(dense[..., 0], -6.0).mean(), rel=1e-5)
    squares = float(mean_square(sparse.coefficients, sparse.bricks).detach())
    assert squares == pytest.approx((coefficients**2).mean(), rel=1e-5)


def test_a_fine_field_is_refined_where_something_shows(monkeypatch):
    whole, sparse = ball(33), ball(33)
    whole.refine(65)
    monkeypatch.setattr(fields, "WHOLE", 33)
    sparse.refine(65)
    assert sparse.bricks.number < 0.5 * whole.bricks.number
    held = sparse.bricks.spread_out(np.arange(sparse.bricks.rows)) >= ROWS
    for values, all_of_them in zip(sparse.dense(), whole.dense(), strict=True):
        np.testing.assert_array_equal(values[held], all_of_them[held])
    with torch.no_grad():
        shown, expected = sparse(rays())[0], whole(rays())[0]
    assert float((shown - expected).abs().max()) < 0.01


def test_refinement_holds_a_part_of_the_rows_corners_at_a_time(monkeypatch):
    """No tensor on the way is much larger than what comes out, and parts of any length give the same."""

    class Largest(TorchDispatchMode):
        size = 0

        def __torch_dispatch__(self, func, types, args=(), kwargs=None):
            out = func(*args, **(kwargs or {}))
            self.size = max([self.size, *(t.nbytes for t in tree_leaves(out) if isinstance(t, torch.Tensor))])
            return out

    field = ball(41)
    with Largest() as largest:
        field.refine(81)
    out = max(field.grid.nbytes, field.coefficients.nbytes)
    assert out <= largest.size < 6 * out
    other = ball(41)
    monkeypatch.setattr(renderer, "POINTS_AT_ONCE", 9999)
    other.refine(81)
    torch.testing.assert_close(other.grid, field.grid, rtol=1e-5, atol=1e-5)


def test_bricks_follow_a_scene_that_grows_and_shrinks(sparse):
    before = sparse.bricks.number
    dense, coefficients = (values.copy() for values in sparse.dense())
    larger = ball(33, 0.6)
    at_surface = sparse.bricks.spread_out(np.arange(sparse.bricks.rows)) >= ROWS
    dense[at_surface] = larger.dense()[0][at_surface]
    rows = [sparse.bricks.gathered(torch.from_numpy(values)) for values in (dense, coefficients)]
    sparse.hold(sparse.bricks, *rows)
    sparse.look_for_empty_blocks()
    source = sparse.follow()
    assert source is not None
    assert sparse.bricks.number > before
    new = source < 0
    assert new.any()
    opacity = -np.expm1(-np.exp(sparse.grid.detach().numpy()[new, 0]) * sparse.step)
    np.testing.assert_allclose(opacity, 0.01, rtol=0.01)  # neither clear nor visited for itself
    assert np.abs(sparse.grid.detach().numpy()[new, 1]).max() < 0.3  # like its neighbours, whose mean is near 0
    with torch.no_grad():
        sparse.grid[ROWS:, 0] = -12.0
    sparse.look_for_empty_blocks()
    sparse.follow()
    assert sparse.bricks.number == 0
    assert sparse.grid.shape == (ROWS, 2)
    assert torch.equal(sparse(rays())[0], torch.full((400,), 0.4))


def test_the_optimiser_follows_with_what_it_has_noted(sparse):
    class Nothing(torch.nn.Module):
        factors = added = departures = offset = moved = torch.zeros(0)

    state = State(sparse, Nothing(), Nothing(), None, np.zeros(0), 0)  # type: ignore[arg-type]
    state.optimiser = optimiser_of(sparse, state.pixel, state.poses, Recipe())
    sparse(rays())[0].sum().backward()
    state.optimiser.step()
    was = {id(p): state.optimiser.state[p]["exp_avg"].clone() for p in (sparse.grid, sparse.coefficients)}
    parts = sparse.bricks.spread_out(was[id(sparse.grid)].numpy())
    with torch.no_grad():  # what is at one side clears, and there is nothing to be seen of it
        away = sparse.positions()[:, 0] > 0.1
        sparse.grid[torch.from_numpy(away), 0] = -12.0
    sparse.look_for_empty_blocks()
    number = sparse.bricks.number
    follow(state)
    assert sparse.bricks.number < number
    noted = state.optimiser.state[sparse.grid]["exp_avg"]
    assert noted.shape == sparse.grid.shape
    held = sparse.bricks.spread_out(np.arange(sparse.bricks.rows)) >= ROWS
    np.testing.assert_array_equal(sparse.bricks.spread_out(noted.numpy())[held], parts[held])
    assert [p is q for p, q in zip(
        [group["params"][0] for group in state.optimiser.param_groups], (sparse.grid, sparse.coefficients), strict=True
    )] == [True, True]  # fmt: skip
    sparse(rays())[0].sum().backward()
    state.optimiser.step()


def test_a_scene_that_has_outgrown_its_bricks_is_refined_with_those_it_grows_into(sparse, monkeypatch):
    with torch.no_grad():
        sparse.grid[ROWS:, 0] = 3.0
    sparse.look_for_empty_blocks()
    sparse.refine(65)
    inside = (sparse.bricks.vertex_of_rows() < 65).all(axis=1)
    inside[:ROWS] = False
    assert float(sparse.grid.detach()[torch.from_numpy(inside), 0].min()) > -6.0


def test_what_a_scene_has_just_grown_into_shows_neither_in_training_nor_once_written(sparse, tmp_path):
    with torch.no_grad():
        sparse.grid[ROWS:, 0] = 3.0
    sparse.look_for_empty_blocks()
    assert sparse.follow() is not None
    sparse.look_for_empty_blocks()  # as training does every few steps
    with torch.no_grad():
        shown = sparse(rays())[0]
    write_field(sparse, tmp_path)
    with torch.no_grad():
        torch.testing.assert_close(read_field(tmp_path)(rays())[0], shown, rtol=1e-2, atol=1e-3)


def test_a_field_in_bricks_is_written_and_read(sparse, tmp_path):
    write_field(sparse, tmp_path)
    read = read_field(tmp_path)
    assert np.array_equal(read.bricks.index, sparse.bricks.index)
    np.testing.assert_allclose(read.grid.detach().numpy(), sparse.grid.detach().numpy(), rtol=1e-3, atol=1e-4)
    arrays: dict[str, Any] = dict(np.load(tmp_path / "field.npz"))
    index = arrays["bricks"]
    nothing = {"bricks": np.zeros((300, 300, 300), np.uint8), "vertices": 1200, "grid": arrays["grid"][:ROWS]}
    nothing["coefficients"] = arrays["coefficients"][:ROWS]  # a small file that would spread out to gigabytes
    for wrong in (
        {"bricks": index[:-1]},
        {"bricks": 2 * index},
        {"vertices": 40},
        nothing,
        {"grid": arrays["grid"][:-1]},
    ):
        changed: dict[str, Any] = arrays | wrong
        np.savez(tmp_path / "field.npz", **changed)
        with pytest.raises(InputError):
            read_field(tmp_path)
