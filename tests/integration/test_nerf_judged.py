"""Held-out events choose: how smooth a field is held, when training stops, and which of its states is kept."""

import json
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from test_schemas import check

import pixelid as px
from pixelid.cli.main import main
from pixelid.errors import InputError
from pixelid.nerf.data.dataset import read_dataset
from pixelid.nerf.field import radiance as field
from pixelid.nerf.pixel.model import Bandwidth
from pixelid.nerf.reconstruct import reconstruct
from pixelid.nerf.training import checkpoint, judged
from pixelid.nerf.training import train as training
from pixelid.nerf.training.held_out import FACTORS, LOOKS
from pixelid.nerf.training.judged import keep_best, train_judged
from pixelid.nerf.training.problem import problem_of
from pixelid.nerf.training.recipe import Recipe
from pixelid.nerf.training.state import State, start
from pixelid.nerf.training.train import held_out_residual

RECIPE = Recipe(iterations=96, batch=32, vertices=(9, 17))


@pytest.fixture(scope="module")
def problem(made):
    return problem_of(read_dataset(made), held_out=0.1)


def trained(problem, recipe: Recipe, until: int | None = None) -> State:
    """To the end; with `until`, interrupted after so many steps."""
    state = start(problem, recipe, Bandwidth("off"))

    def report(now: State, measured: dict[str, float]) -> None:
        if now.iteration == until:
            raise InterruptedError

    try:
        return train_judged(problem, recipe, state, report=report)
    except InterruptedError:
        return state


@pytest.mark.parametrize("until", [20, 48, 54, 60, 95])
def test_a_run_that_is_continued_comes_to_the_same_choices(problem, tmp_path, until):
    """Interrupted before the last stage, at its begin, at a look, between two looks and before the last step."""
    recipe = replace(RECIPE, regularisation="auto")
    whole, part = trained(problem, recipe), trained(problem, recipe, until)
    assert part.iteration == until
    checkpoint.save(tmp_path / "part.pt", part, "mark")
    resumed = checkpoint.load(tmp_path / "part.pt", problem, recipe, Bandwidth("off"), "mark")
    assert resumed is not None
    train_judged(problem, recipe, resumed)
    assert torch.equal(whole.field.grid, resumed.field.grid)
    assert whole.stopping.as_dict(96) == resumed.stopping.as_dict(96)
    assert whole.regularisation == resumed.regularisation
    assert [trial.factor for trial in whole.regularisation.trials] == [1.0, *FACTORS]
    assert len(whole.stopping.looks) == LOOKS
    checkpoint.save(tmp_path / "whole.pt", whole, "mark")  # finished, and read back: nothing is trained or looked at
    again = checkpoint.load(tmp_path / "whole.pt", problem, recipe, Bandwidth("off"), "mark")
    assert again is not None
    train_judged(problem, recipe, again, report=lambda *_: pytest.fail("a step too many"))
    for state in (whole, again):
        keep_best(state)
    assert torch.equal(whole.field.grid, again.field.grid)


def test_looking_changes_no_step(problem):
    from pixelid.nerf.training.train import train

    judged = trained(problem, RECIPE)
    plain = train(problem, RECIPE, start(problem, RECIPE, Bandwidth("off")))
    assert torch.equal(judged.field.grid, plain.field.grid)
    assert judged.regularisation.trials == ()


def test_the_factor_scales_both_variations(problem):
    """A step under a factor is the step of a recipe whose weights are as many times larger."""
    from pixelid.nerf.training.train import step

    scaled = replace(RECIPE, roughness=3 * RECIPE.roughness)
    states = [start(problem, recipe, Bandwidth("off")) for recipe in (RECIPE, scaled, RECIPE)]
    states[0].regularisation = replace(states[0].regularisation, factor=3.0)
    for _ in range(3):
        for state, recipe in zip(states, (RECIPE, scaled, RECIPE), strict=True):
            step(problem, recipe, state)
    torch.testing.assert_close(states[0].field.grid, states[1].field.grid, rtol=1e-4, atol=1e-4)
    assert not torch.allclose(states[0].field.grid, states[2].field.grid, rtol=1e-2, atol=1e-2)


def test_the_state_before_training_goes_wrong_is_kept(problem):
    """From step 85 on something scatters the scene."""
    good: dict = {}

    def scatter(now: State, measured: dict[str, float]) -> None:
        if now.iteration == 84:
            good["grid"] = now.field.grid.detach().clone()
        if now.iteration > 84:
            now.field.grid.detach()[:, 1] += 3.0 * torch.randn(len(now.field.grid))

    state = train_judged(problem, RECIPE, start(problem, RECIPE, Bandwidth("off")), report=scatter)
    last = held_out_residual(problem, state)
    said = state.stopping.as_dict(state.iteration)
    assert said["kept"] < state.iteration
    assert "demonstrably worse" in said["reason"]
    keep_best(state)
    assert said["kept"] == 84
    assert torch.equal(state.field.grid, good["grid"])
    assert held_out_residual(problem, state) < last


def test_a_kept_state_on_a_coarser_grid_is_read_back(problem, tmp_path, monkeypatch):
    """Fine grids wait until clear space can be told, in short trainings beyond the begin of the last stage."""
    for module in (field, training):
        monkeypatch.setattr(module, "WHOLE", 9)
    recipe, states = replace(RECIPE, iterations=72), []

    def note(now: State, measured: dict[str, float]) -> None:
        if now.iteration == 66:
            checkpoint.save(tmp_path / "part.pt", now, "mark")
            states.append((now.field.vertices, now.stopping.scene["vertices"], now.stopping.kept))

    train_judged(problem, recipe, start(problem, recipe, Bandwidth("off")), report=note)
    assert states[0][:2] == (17, 9)
    resumed = checkpoint.load(tmp_path / "part.pt", problem, recipe, Bandwidth("off"), "mark")
    assert resumed is not None
    assert (resumed.field.vertices, resumed.stopping.scene["vertices"], resumed.stopping.kept) == states[0]


@pytest.mark.parametrize("at", [20, 80, 96])
def test_a_training_that_diverges_says_so(problem, at):
    """Before the first look, after some, and in the last step: nothing kept is brought back, and the reason is told."""

    def spoil(now: State, measured: dict[str, float]) -> None:
        if now.iteration == at:
            now.field.grid.detach()[:, 1] = np.nan

    state = train_judged(problem, RECIPE, start(problem, RECIPE, Bandwidth("off")), report=spoil)
    assert state.diverged == (at < 96)
    assert not state.finite
    spoiled = state.field.grid.detach().clone()
    keep_best(state)
    torch.testing.assert_close(state.field.grid.detach(), spoiled, rtol=0, atol=0, equal_nan=True)
    said = state.stopping.as_dict(state.iteration, diverged=not state.finite)
    assert len(said["looks"]) == len(state.stopping.looks) == {20: 0, 80: 5, 96: LOOKS}[at]
    assert (said["kept"], said["stopped_early"]) == (at, False)
    assert said["reason"] == "training diverged"


def test_weights_under_which_training_diverges_are_not_chosen(problem, monkeypatch):
    """Its state is the one before the step, whose held-out loss is a number and may be the least."""

    def diverging(problem, recipe, state, until=None, report=None):
        state.diverged = state.regularisation.factor == FACTORS[1]
        if not state.diverged:
            state.field.grid.detach()[:, 1] += 3.0 * torch.randn(len(state.field.grid))
        return state

    monkeypatch.setattr(judged, "train", diverging)
    recipe = replace(RECIPE, regularisation="auto")
    found = judged._choose(problem, recipe, start(problem, recipe, Bandwidth("off")))
    assert found.factor != FACTORS[1]
    assert np.isnan(found.trials[2].loss)
    assert found.trials[2].p_value == 1.0


LOOKING = """
import sys
from dataclasses import replace
import numpy as np
import pixelid as px
from pixelid.nerf.effects import search
from pixelid.nerf.training import judged, parallel

# rounding, and more: processes that each decided by themselves would part
plain, suggestions = judged.loss_of_pixels, search.suggestions
judged.loss_of_pixels = lambda rows: plain(rows) * (1.0 + 1e-3 * parallel.rank())
search.MOST_ROUNDS = 1
for name, addition in search.ADDITIONS.items():
    search.ADDITIONS[name] = addition._replace(searched=name == "leak")
gains = [search.Gain(-0.1 * parallel.rank(), 1.0, 99)] * 5 + [search.Gain(0.5, 1e-9, 99)] * (parallel.rank() == 0)
search.compare = lambda before, after: gains.pop()  # the first process names the leak, and the other nothing

def apart(problem, state):
    of = suggestions(problem, state)
    return replace(of, rest=of.slopes["leak"] * (1.0 + parallel.rank()))

search.suggestions = apart
found = px.reconstruct(sys.argv[1], iterations=24, regularisation="auto", gap=True, device="cpu")
state = found.state
looks = [look.losses for look in state.stopping.looks]
trials = [(trial.loss, trial.heldout_gain, trial.p_value) for trial in state.regularisation.trials]
effects = [value for effect in found.gap["effects"] for value in effect["values"].values()]
np.savez(f"{sys.argv[2]}/{parallel.rank()}.npz", looks=looks, trials=trials, effects=effects,
         gap=found.gap["heldout_gain"], grid=state.field.grid.detach().numpy())
"""


@pytest.mark.slow
def test_processes_decide_by_the_same_numbers(made, tmp_path):
    """What one decides, all do, though sums of theirs differ in the last digits on GPUs: looks, and a search."""
    script = tmp_path / "looking.py"
    script.write_text(LOOKING)
    launch = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", str(script)]
    done = subprocess.run(
        [*launch, str(made), str(tmp_path)], env={**os.environ, "OMP_NUM_THREADS": "1"}, capture_output=True, text=True,
        timeout=300,
    )  # fmt: skip
    assert (tmp_path / "1.npz").is_file(), done.stderr[-2000:]
    with np.load(tmp_path / "0.npz") as first, np.load(tmp_path / "1.npz") as second:
        assert len(first["looks"]) == LOOKS
        assert len(first["effects"]) == 1
        for name in first.files:
            np.testing.assert_array_equal(first[name], second[name])


def test_a_training_that_stands_still_is_stopped(made):
    """At a learning rate of nothing the looks left can win nothing, and the result says so."""
    recipe = replace(RECIPE, iterations=400, last_rate=1e-12)
    result = reconstruct(read_dataset(made), recipe=recipe, bandwidth=Bandwidth("off"))
    said = result.as_dict()
    check("reconstruction", json.loads(json.dumps(said, default=lambda x: np.asarray(x).tolist())))
    assert said["stopping"]["stopped_early"]
    assert said["iterations"] < recipe.iterations
    assert said["stopping"]["kept"] == said["iterations"] == said["stopping"]["looks"][-1]["iteration"]


def test_the_command_chooses_on_request(made, tmp_path):
    words = ["reconstruct", str(made), "--iterations", "24", "--batch", "32", "--quiet", "--bandwidth", "off"]
    for kind in ("usual", "auto"):
        assert main([*words, "--out", str(tmp_path / kind), "--regularisation", kind]) in (0, 1)
        result = json.loads((tmp_path / kind / "reconstruction.json").read_text())
        check("reconstruction", result)
        assert result["recipe"]["regularisation"] == kind
        assert result["stopping"]["looks"][-1]["iteration"] == result["iterations"] == 24
        factors = [trial["factor"] for trial in result["regularisation"]["trials"]]
        assert factors == ([1.0, *FACTORS] if kind == "auto" else [])
    with pytest.raises(InputError, match="expected usual or auto"):
        px.reconstruct(made, regularisation="never")
