"""On a GPU: CUDA renders, filters and trains what the compiled engine does on CPU threads.

Skipped where there is no CUDA device.
"""

from dataclasses import replace

import numpy as np
import pytest
import torch

from pixelid.nerf.data.dataset import read_dataset
from pixelid.nerf.field import radiance as fields
from pixelid.nerf.field.smoothness import mean_log_density, mean_square, variation
from pixelid.nerf.options import Options
from pixelid.nerf.pixel.model import Bandwidth
from pixelid.nerf.pixel.scan import respond
from pixelid.nerf.reconstruct import reconstruct
from pixelid.nerf.shown.evaluate import render_views
from pixelid.nerf.shown.saved import SavedReconstruction
from pixelid.nerf.synthetic import make_dataset
from pixelid.nerf.training import checkpoint
from pixelid.nerf.training.losses import Weights
from pixelid.nerf.training.poses import Refinement
from pixelid.nerf.training.problem import problem_of
from pixelid.nerf.training.recipe import Recipe
from pixelid.nerf.training.state import start
from pixelid.nerf.training.train import train
from tests.unit.test_nerf_bricks import ball
from tests.unit.test_nerf_pixel import FLOOR, FULL, HARD, runs, tensor
from tests.unit.test_nerf_render import shown_with_gradients
from tests.unit.test_nerf_whole_pixel import ABSENT

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
DEVICES = ("cpu", "cuda")
SMALL = Recipe(iterations=24, batch=16, vertices=(9, 17))
SMOOTH = {"weights": Weights(tv=0.0), "roughness": 0.0, "quiet": 0.0}  # rounding decides the sign of no slope


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A dataset of 16 × 16 pixels."""
    folder = tmp_path_factory.mktemp("scene") / "hard"
    return read_dataset(make_dataset(folder, "hard", seed=3, side=16, revolutions=1.0, frames_per_turn=300))


@pytest.mark.parametrize(("channels", "degree"), [(1, 0), (3, 2)])
def test_a_field_looks_the_same_with_the_same_gradients(channels, degree):
    found = [shown_with_gradients(channels, degree, device=device) for device in DEVICES]
    for there, here in zip(*found, strict=True):
        torch.testing.assert_close(here, there, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("dynamics", [HARD, FULL, FLOOR, *ABSENT.values()], ids=["plain", "full", "floor", *ABSENT])
def test_the_pixel_answers_alike(dynamics):
    t, u, first = runs()
    found = []
    for device in DEVICES:
        light, numbers = torch.tensor(u, device=device, requires_grad=True), tensor(dynamics).to(device)
        level, output = respond(light, numbers, t, first)
        (level.sum() + (output**2).sum()).backward()
        assert light.grad is not None
        found.append([array.cpu() for array in (level.detach(), output.detach(), light.grad)])
    for there, here in zip(*found, strict=True):
        torch.testing.assert_close(here, there, rtol=1e-6, atol=1e-7)


def test_what_holds_a_field_smooth_is_the_same():
    found = []
    for device in DEVICES:
        field = ball(29).to(device)
        parts = (
            variation(field.grid, field.bricks), mean_log_density(field.grid, field.bricks),
            mean_square(field.coefficients, field.bricks),
        )  # fmt: skip
        torch.stack(parts).sum().backward()
        assert field.grid.grad is not None
        found.append([*(float(part.detach()) for part in parts), field.grid.grad.cpu().numpy()])
    for there, here in zip(*found, strict=True):
        np.testing.assert_allclose(here, there, rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("bandwidth", ["on", "off", "joint"])
def test_training_takes_the_same_steps(made, bandwidth):
    problem, states = problem_of(made), []
    for device in DEVICES:
        recipe = replace(SMALL, iterations=4, **SMOOTH)
        states.append(train(problem, recipe, start(problem, recipe, Bandwidth(bandwidth, 10), device)))
    torch.testing.assert_close(states[0].field.grid, states[1].field.grid.cpu(), rtol=1e-2, atol=1e-2)
    torch.testing.assert_close(states[0].pixel.factors, states[1].pixel.factors.cpu(), rtol=1e-2, atol=1e-3)


def test_a_fine_field_with_all_that_can_be_trained_is_saved_and_continued(made, tmp_path, monkeypatch):
    """Bricks follow the scene, poses and clocks are refined; a checkpoint of CUDA goes on there and on a CPU."""
    monkeypatch.setattr(fields, "WHOLE", 12)
    everything = Bandwidth("joint", 10, trained=("threshold", "ratio", "refractory", "leak", "threshold_drift"))
    recipe = Recipe(
        iterations=200, batch=32, vertices=(9, 25), refinement=Refinement.of(0.01, (0.02, 0.5)), between_poses="cubic",
        **SMOOTH,
    )  # fmt: skip
    problem = problem_of(made, trained=everything.moving)
    state = train(problem, recipe, start(problem, recipe, everything, "cuda"), until=190)
    assert state.finite
    assert not state.field.bricks.whole
    checkpoint.save(tmp_path / "state.pt", state, "mark")
    after = []
    for device in ("cuda", "cpu"):
        again = checkpoint.load(tmp_path / "state.pt", problem, recipe, everything, "mark", device)
        assert again is not None
        assert again.field.grid.device.type == device
        train(problem, recipe, again, until=191)
        after.append(again.field.grid.detach().cpu())
    torch.testing.assert_close(*after, rtol=1e-2, atol=1e-2)


@pytest.mark.parametrize("gap", [False, True])
def test_a_scene_is_reconstructed_and_opened_without_it(made, tmp_path, gap):
    result = reconstruct(made, Options(protocol="paper", gap=gap, device="cuda"), recipe=replace(SMALL, iterations=200))
    assert result.content["device"] == "cuda"
    assert np.isfinite(result.scores.psnr).all()
    result.save(tmp_path / "out")
    saved = SavedReconstruction.load(tmp_path / "out")
    assert saved.field.grid.device.type == "cpu"
    there, here = (
        render_views(field, result.truth, result.problem.dark) for field in (result.state.field, saved.field)
    )
    np.testing.assert_allclose(here, there, rtol=0.02, atol=1e-3)  # written in half precision
