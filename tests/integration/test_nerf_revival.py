"""Bricks of a fine field that were given up too early, and that events ask for again."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch

from pixelid.nerf import checkpoint
from pixelid.nerf import field as fields
from pixelid.nerf.bricks import ROWS, SIDE
from pixelid.nerf.camera import Camera, sub_pixel_directions
from pixelid.nerf.dataset import read_dataset
from pixelid.nerf.pixel import Bandwidth
from pixelid.nerf.problem import problem_of
from pixelid.nerf.recipe import Recipe
from pixelid.nerf.revival import asked_for
from pixelid.nerf.state import State, follow, optimiser_of, start
from pixelid.nerf.synthetic import make_dataset
from pixelid.nerf.train import held_out_residual, train

ROD = np.array([0.8, 0.75, 0.1]), np.array([0.12, 0.12, 0.8])  # centre and half axes: three pixels, four cells thick
BODY = np.array([-0.45, -0.4, 0.0]), np.array([0.6, 0.5, 0.5])
RECIPE = Recipe(iterations=512, batch=192, vertices=(49,), rate=0.03)
BEGIN = 128


@dataclass(frozen=True)
class Hanging:
    """A body, and a thin dark rod beside it that nothing connects with it, before grey; opaque, met analytically."""

    background: float = 0.5

    def render(self, camera: Camera, position, rotation, supersample: int = 1) -> np.ndarray:
        position, rotation = np.atleast_2d(position), np.asarray(rotation).reshape(-1, 3, 3)
        inside, each = sub_pixel_directions(camera, supersample), supersample**2
        images = np.full((len(position), len(inside)), self.background)
        for k, (o, turn) in enumerate(zip(position, rotation, strict=True)):
            d, nearest = inside @ turn.T, np.full(len(inside), np.inf)
            for (centre, half), radiance in ((BODY, 1.0), (ROD, 0.1)):
                p, q = (o - centre) / half, d / half
                a, b, c = (q**2).sum(axis=1), q @ p, p @ p - 1.0
                inner = b**2 - a * c
                t = np.where(inner > 0, (-b - np.sqrt(np.maximum(inner, 0.0))) / a, np.inf)
                shade = radiance * (1.0 + 0.5 * np.sin(9.0 * (o[2] + np.where(np.isfinite(t), t, 0.0) * d[:, 2])))
                closer = (t > 0) & (t < nearest)
                nearest[closer], images[k, closer] = t[closer], shade[closer]
        return images.reshape(len(position), -1, each).mean(axis=2).reshape(len(position), camera.height, camera.width)


@pytest.fixture(scope="module")
def problem(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scene") / "hanging"
    make_dataset(folder, "easy", seed=0, side=32, revolutions=2.0, frames_per_turn=300, scene=Hanging())
    return problem_of(read_dataset(folder))


def inside(which: tuple[np.ndarray, np.ndarray], positions: np.ndarray) -> np.ndarray:
    """How far positions (n, 3) are inside an ellipsoid: 1 at its centre, 0 at its surface."""
    return 1.0 - np.sqrt((((positions - which[0]) / which[1]) ** 2).sum(axis=1))


def without_the_rod(problem) -> tuple[State, np.ndarray]:
    """(a state that shows all of the scene but the rod, and holds no bricks there; which bricks these are)."""
    state = start(problem, RECIPE, Bandwidth("off"))
    field, bricks = state.field, state.field.bricks
    at = field.positions()
    grid = field.grid.detach().clone()
    density = np.clip(100.0 * inside(BODY, at) * 0.5, -12.0, 4.0)
    shade = np.log(1.0 + 0.5 * np.sin(9.0 * at[:, 2]))
    grid[:] = torch.as_tensor(np.column_stack([density, shade]), dtype=grid.dtype)
    field.hold(bricks, grid, field.coefficients)
    state.optimiser = optimiser_of(field, state.pixel, state.poses, RECIPE)
    state.iteration = BEGIN
    field.look_for_empty_blocks()
    follow(state)
    rod = np.zeros(bricks.index.shape, bool)
    of_rod = (inside(ROD, at) > 0) & (np.arange(len(at)) >= ROWS)
    rod[tuple((bricks.vertex_of_rows()[of_rod] // SIDE).T)] = True
    return state, rod & (field.bricks.index == 0)


def test_events_ask_for_what_was_given_up_too_early(problem, monkeypatch):
    monkeypatch.setattr(fields, "WHOLE", 17)
    state, gone = without_the_rod(problem)
    missing = state.field.bricks.index == 0
    assert gone.sum() >= 4
    grid, bricks = state.field.grid.detach().clone(), state.field.bricks
    wanted = np.zeros(missing.shape)
    for seed in range(12):
        asked = asked_for(problem, RECIPE, state, np.random.default_rng(seed))
        if asked is not None:
            assert not (asked.where & ~missing).any()
            assert asked.log_radiance.shape == (asked.where.sum(), 1)
            wanted += asked.where
    assert torch.equal(state.field.grid, grid)  # only looked at
    assert state.field.bricks is bricks
    assert state.field.grid.grad is None
    assert wanted[gone].mean() > 3 * wanted[missing & ~gone].mean()


@pytest.mark.slow
def test_a_thin_object_given_up_too_early_comes_back(problem, monkeypatch):
    monkeypatch.setattr(fields, "WHOLE", 17)
    left, back = {}, {}
    for revival in (True, False):
        state, rod = without_the_rod(problem)
        train(problem, replace(RECIPE, revival=revival), state)
        left[revival] = held_out_residual(problem, state)
        shown = np.zeros(rod.shape, bool)
        shown[tuple(slice(k) for k in state.field.occupied.shape)] = state.field.occupied
        back[revival] = (shown & rod).sum() / rod.sum()
    assert back[True] > back[False] + 0.5
    assert left[True] < 0.8 * left[False]


def test_a_run_with_revival_that_is_continued_has_the_same_numbers(problem, tmp_path, monkeypatch):
    """Also with bricks that have just come back, which are kept for a while."""
    monkeypatch.setattr(fields, "WHOLE", 17)
    recipe = replace(RECIPE, revival=True)
    whole, half = (train(problem, recipe, without_the_rod(problem)[0], until=until) for until in (330, 270))
    assert half.field.young.any()
    checkpoint.save(tmp_path / "half.pt", half, "mark")
    resumed = checkpoint.load(tmp_path / "half.pt", problem, recipe, Bandwidth("off"), "mark")
    assert resumed is not None
    train(problem, recipe, resumed, until=330)
    np.testing.assert_array_equal(whole.field.bricks.index, resumed.field.bricks.index)
    assert torch.equal(whole.field.grid, resumed.field.grid)
