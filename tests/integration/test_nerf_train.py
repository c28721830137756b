"""Training: the command end to end, exact resume, two processes, and (slow) that modelling the pixel pays."""

import base64
import hashlib
import json
import math
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from scipy.spatial.transform import Rotation
from skimage.io import imread, imsave
from test_schemas import check

import pixelid as px
from pixelid.cli.main import main
from pixelid.errors import InputError
from pixelid.model.files import save_model
from pixelid.model.shipped import find_model, shipped_models
from pixelid.nerf.data.calibration import FILE as CALIBRATION
from pixelid.nerf.data.calibration import of_fit
from pixelid.nerf.data.dataset import read_dataset
from pixelid.nerf.field import radiance as fields
from pixelid.nerf.field import render
from pixelid.nerf.options import Options
from pixelid.nerf.pixel import scan
from pixelid.nerf.pixel.model import Bandwidth, limits_bandwidth
from pixelid.nerf.reconstruct import Reconstruction, _left_open, _verdict, reconstruct
from pixelid.nerf.shown.evaluate import no_scores
from pixelid.nerf.synthetic import SETTINGS, make_dataset
from pixelid.nerf.training import checkpoint
from pixelid.nerf.training.losses import Weights
from pixelid.nerf.training.poses import Refinement
from pixelid.nerf.training.problem import problem_of
from pixelid.nerf.training.recipe import Recipe
from pixelid.nerf.training.state import State, start
from pixelid.nerf.training.train import held_out_residual, step, train
from pixelid.sensors import SensorFit
from pixelid.sensors.map import Map
from pixelid.sensors.shrinkage import Population
from pixelid.status import Status

SMALL = Recipe(iterations=24, batch=16, vertices=(9, 17))


@pytest.fixture(scope="module")
def made_bright(tmp_path_factory) -> Path:
    """Another, slow and bright."""
    return make_dataset(
        tmp_path_factory.mktemp("scene") / "easy", "easy", seed=5, side=16, revolutions=1.0, frames_per_turn=300
    )


@pytest.mark.parametrize("bandwidth", ["on", "off", "joint"])
def test_the_command_writes_its_contract(made, tmp_path, capsys, bandwidth):
    out = tmp_path / "out"
    words = ["reconstruct", str(made), "--out", str(out), "--bandwidth", bandwidth, "--iterations", "30", "--seed", "4"]
    words += ["--device", "cpu"]  # where a seed fixes every digit
    code = main(words)
    assert code in (0, 1)
    result = json.loads((out / "reconstruction.json").read_text())
    assert (code == 0) == (result["status"] == "converged")
    assert result["bandwidth"] == bandwidth
    assert set(result["views"]) == {"psnr", "ssim", "lpips", "per_view"}
    assert result["log_eps"] == 0.0
    assert len(result["views"]["per_view"]) == 8
    assert result["views"]["psnr"] == pytest.approx(np.mean([view["psnr"] for view in result["views"]["per_view"]]))
    assert set(result["correction"]) == {"a", "b", "c"}
    assert result["iterations"] == 30
    assert result["device"] == "cpu"
    assert result["rays_per_second"] > 0
    assert result["seed"] == 4
    assert {"raw_events.npz", "camera_poses.npz", "camera_calibration.npz"} <= set(result["inputs_sha256"])
    assert result["history"][-1]["running_psnr"] > 5
    for name in ("field.npz", "views.svg", "training.svg", "report.html"):
        assert (out / name).is_file()
    assert "dB" in capsys.readouterr().out
    saved = Reconstruction.load(out)
    assert saved.as_dict() == result
    assert len(saved.to_dataframe()) == 8
    with np.load(out / "field.npz") as scene:
        np.testing.assert_array_equal(saved.field.dense()[0].astype(np.float16), scene["grid"])
    saved.save(out.with_name("copy"))
    assert Reconstruction.load(out.with_name("copy")).summary() == saved.summary()
    assert main([*words, "--overwrite", "--quiet"]) == code
    again = json.loads((out / "reconstruction.json").read_text())
    assert again["views"] == result["views"]  # the same seed, the same scene
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize("bandwidth", ["on", "off", "joint"])
def test_the_command_trains_the_comparator_on_request(made, tmp_path, bandwidth):
    words = ["reconstruct", str(made), "--out", str(tmp_path / "out"), "--iterations", "20", "--quiet"]
    assert main([*words, "--bandwidth", bandwidth, "--train", "threshold", "--train", "refractory"]) == 1
    result = json.loads((tmp_path / "out" / "reconstruction.json").read_text())
    assert "mean threshold" in result["unidentified"][0]  # no fit tells it
    pixel = result["pixel"]
    assert pixel["on_threshold"] != 0.25
    assert pixel["on_threshold"] == pytest.approx(pixel["off_threshold"])  # the ratio was not asked for
    assert pixel["refractory_s"] > 0
    assert pixel["refractory_s"] != 1e-4
    assert (pixel["alpha"] != read_dataset(made).calibration.circuit.alpha) == (bandwidth == "joint")


def test_the_command_refines_poses_on_request(made, tmp_path, capsys):
    out = tmp_path / "out"
    words = ["reconstruct", str(made), "--out", str(out), "--iterations", "20"]
    assert main([*words, "--refine-time", "0.01", "--refine-poses", "0.02", "0.5"]) in (0, 1)
    assert "poses refined" in capsys.readouterr().out.replace("\n", " ")
    result = json.loads((out / "reconstruction.json").read_text())
    check("reconstruction", result)
    assert result["poses"]["time_offset_s"] != 0.0
    assert result["poses"]["time_resolution_s"] > 0.01  # an even flight
    assert "offset between the clocks" in result["unidentified"][0]
    assert 0.0 < result["poses"]["position_rms"] < 0.1
    with np.load(out / "camera_poses.npz") as file, np.load(made / "camera_poses.npz") as before:
        np.testing.assert_array_equal(file["T_wc_timestamp"], before["T_wc_timestamp"])
        away = np.linalg.norm(file["T_wc_position"] - before["T_wc_position"], axis=1)
    assert 0.0 < away.max() < 1.0
    assert main([*words[:-2], "--iterations", "2", "--refine-time", "-1", "--overwrite"]) == 2


def test_an_offset_that_hides_in_a_motion_of_the_scene_is_not_called_found(made):
    data = read_dataset(made)
    uneven = np.linspace(0.0, 1.0, len(data.trajectory.t))
    uneven = uneven + 0.7 * np.sin(10 * np.pi * uneven) / (10 * np.pi)
    for flight, sd, status in (
        (data.trajectory, 0.01, Status.not_identified), (data.trajectory, 0.0, Status.converged),
        (replace(data.trajectory, t=data.trajectory.t[-1] * uneven), 0.02, Status.converged),
    ):  # fmt: skip
        problem = problem_of(replace(data, trajectory=flight))
        state = start(problem, replace(SMALL, refinement=Refinement(sd)), Bandwidth("off"))
        views = no_scores(data.views["test"].some([]))
        assert _verdict(0.4, views, 24, True, {}, _left_open(problem, state))[0] is status


def test_another_reconstruction_beside(made, tmp_path, capsys):
    words = ["reconstruct", str(made), "--iterations", "3", "--quiet"]
    assert main([*words, "--out", str(tmp_path / "off"), "--bandwidth", "off"]) in (0, 1)
    assert main([*words, "--out", str(tmp_path / "on"), "--beside", str(tmp_path / "off")]) in (0, 1)
    off, on = (json.loads((tmp_path / name / "reconstruction.json").read_text()) for name in ("off", "on"))
    check("reconstruction", on)
    assert off["beside"] is None
    assert on["beside"] == {"status": off["status"], "bandwidth": "off", "psnr": off["views"]["psnr"]}
    names = ("slider_reference.png", "slider_reconstruction.png", "slider_beside.png")
    reference, own, other = (imread(tmp_path / "on" / name).astype(float) for name in names)
    assert max(reference.shape) >= 384
    np.testing.assert_array_equal(reference, imread(tmp_path / "off" / names[0]))
    # rendered again from the half precision of a saved scene
    assert np.abs(other - imread(tmp_path / "off" / names[1])).max() <= 2.0
    assert np.abs(other - own).max() > 4.0
    page = (tmp_path / "on" / "report.html").read_text()
    script = re.search(r"<script>(.*?)</script>", page, re.DOTALL)[1]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in page  # the only one that may run
    assert page.count('type="range"') == 2
    assert (tmp_path / "off" / "report.html").read_text().count('type="range"') == 1
    capsys.readouterr()
    changed = tmp_path / "changed"
    shutil.copytree(made, changed)
    with np.load(changed / CALIBRATION) as file:
        told = dict(file)
    np.savez_compressed(changed / CALIBRATION, **told)  # the same calibration, another file
    again = ["reconstruct", str(changed), "--quiet", "--out", str(tmp_path / "new"), "--beside", str(tmp_path / "off")]
    assert main(again) == 2
    assert "same data" in capsys.readouterr().err


def test_splines_between_poses_on_request(made, tmp_path):
    words = ["reconstruct", str(made), "--iterations", "3", "--quiet"]
    kinds = ("linear", "cubic")
    for kind in kinds:
        assert main([*words, "--out", str(tmp_path / kind), "--between-poses", kind]) in (0, 1)
    results = [json.loads((tmp_path / kind / "reconstruction.json").read_text()) for kind in kinds]
    for result, kind in zip(results, kinds, strict=True):
        check("reconstruction", result)
        assert result["recipe"]["between_poses"] == kind
    assert results[0]["held_out_residual"] != results[1]["held_out_residual"]
    with pytest.raises(InputError, match="expected linear or cubic"):
        px.reconstruct(made, between_poses="quadratic")


@pytest.mark.slow
def test_shaken_poses_are_mended_with_the_scene(tmp_path):
    """Held-out changes left unexplained: less than without refinement, and than with right poses but little more."""
    data = read_dataset(make_dataset(tmp_path / "medium", "medium", seed=0, side=32, revolutions=2.0))
    t = data.trajectory.t / data.trajectory.t[-1]
    wave = np.sin(2 * np.pi * t[:, None] * np.array([1, 2, 3]) + np.array([0.3, 1.1, 2.0]))
    turned = Rotation.from_rotvec(0.02 * wave) * Rotation.from_quat(data.trajectory.orientation)
    shaken = replace(data.trajectory, orientation=turned.as_quat())
    left = {}
    for name, trajectory, refinement in (
        ("right", data.trajectory, Refinement()), ("shaken", shaken, Refinement()),
        ("refined", shaken, Refinement(rotation_sd=0.02)),
    ):  # fmt: skip
        recipe = Recipe(iterations=400, refinement=refinement)
        result = reconstruct(replace(data, trajectory=trajectory), bandwidth=Bandwidth("off"), recipe=recipe)
        left[name] = result.held_out
    assert left["refined"] < 0.5 * (left["right"] + left["shaken"])


@pytest.mark.parametrize("mode", ["on", "joint"])
def test_resuming_continues_with_the_same_numbers(made, tmp_path, mode):
    problem, bandwidth = problem_of(read_dataset(made)), Bandwidth(mode, 10)
    recipe = replace(SMALL, refinement=Refinement(0.01, 0.02, 0.01))
    whole = train(problem, recipe, start(problem, recipe, bandwidth))
    half = train(problem, recipe, start(problem, recipe, bandwidth), until=17)
    half.seconds = 3.25
    checkpoint.save(tmp_path / "half.pt", half, "mark")
    resumed = checkpoint.load(tmp_path / "half.pt", problem, recipe, bandwidth, "mark")
    assert resumed is not None
    assert (resumed.iteration, resumed.seconds) == (17, 3.25)
    train(problem, recipe, resumed)
    assert torch.equal(whole.field.grid, resumed.field.grid)
    assert torch.equal(whole.field.coefficients, resumed.field.coefficients)
    assert torch.equal(whole.poses.offset, resumed.poses.offset)
    assert torch.equal(whole.poses.moved, resumed.poses.moved)
    assert float(whole.poses.moved.detach().abs().max()) > 0
    assert torch.equal(whole.pixel.factors, resumed.pixel.factors)
    assert torch.equal(whole.pixel.added, resumed.pixel.added)


@pytest.mark.slow
def test_a_field_in_bricks_learns_what_a_whole_one_does_and_resumes(made, tmp_path, monkeypatch):
    """Bricks come and go on the way; a run that is continued across that has the same numbers."""
    problem, recipe = problem_of(read_dataset(made)), Recipe(iterations=256, batch=32, vertices=(17, 33))
    bandwidth = Bandwidth("off")

    def until(steps: int) -> State:
        return train(problem, recipe, start(problem, recipe, bandwidth), until=steps)

    whole = until(256)
    monkeypatch.setattr(fields, "WHOLE", 17)
    sparse, half = until(256), until(150)
    assert 0 < sparse.field.bricks.number < whole.field.bricks.number
    assert not np.array_equal(sparse.field.bricks.index, half.field.bricks.index)
    left = [held_out_residual(problem, state) for state in (whole, sparse)]
    assert left[1] == pytest.approx(left[0], rel=0.05)
    checkpoint.save(tmp_path / "half.pt", half, "mark")
    resumed = checkpoint.load(tmp_path / "half.pt", problem, recipe, bandwidth, "mark")
    assert resumed is not None
    train(problem, recipe, resumed)
    assert torch.equal(sparse.field.grid, resumed.field.grid)
    assert torch.equal(sparse.field.coefficients, resumed.field.coefficients)


def test_a_short_training_of_a_fine_field_keeps_what_has_not_grown_yet(made):
    """Nothing of an untrained field is dense; it stays coarse until clear space can be told from that."""
    problem, recipe = problem_of(read_dataset(made)), Recipe(iterations=30, batch=16).with_cells(200)
    state = train(problem, recipe, start(problem, recipe, Bandwidth("off")))
    assert recipe.vertices == (51, 101, 201)
    assert state.field.vertices == 101
    assert state.field.bricks.whole
    assert held_out_residual(problem, state) < 1.0


def test_a_checkpoint_of_another_run_or_a_damaged_one_is_set_aside(made, tmp_path, capsys):
    words = ["reconstruct", str(made), "--quiet", "--iterations", "5"]
    kept = ["--checkpoint", str(tmp_path / "state.pt")]
    plain_code = main([*words, "--out", str(tmp_path / "plain"), "--seed", "1"])
    main([*words, *kept, "--out", str(tmp_path / "one")])
    first = (tmp_path / "state.pt").read_bytes()
    assert main([*words, *kept, "--out", str(tmp_path / "two"), "--seed", "1"]) == plain_code
    assert "other data, options or seed; set aside as state.pt.other" in capsys.readouterr().err
    assert (tmp_path / "state.pt.other").read_bytes() == first
    (tmp_path / "state.pt").write_bytes(b"nothing")
    assert main([*words, *kept, "--out", str(tmp_path / "three"), "--seed", "1"]) == plain_code
    said = capsys.readouterr().err
    assert "damaged" in said
    assert said.count("\n") == 1
    assert (tmp_path / "state.pt.damaged").read_bytes() == b"nothing"
    views = [json.loads((tmp_path / n / "reconstruction.json").read_text())["views"] for n in ("plain", "two", "three")]
    assert views[0] == views[1] == views[2]


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_tensors_train_as_the_compiled_engine_does(made, seed, monkeypatch):
    """The torch path, which CUDA runs, follows the compiled one through all losses that are smooth.

    Absolute changes are not: where a level stays where it is within rounding, rounding decides their sign, and Adam
    takes a whole step by it.  `variation` is compared by itself.
    """
    problem = problem_of(read_dataset(made))
    states = []
    recipe = replace(SMALL, iterations=4, seed=seed, weights=Weights(tv=0.0), roughness=0.0, quiet=0)
    for tensors in (False, True):
        for module in (render, scan):
            monkeypatch.setattr(module, "by_tensors", lambda *_, answer=tensors: answer)
        states.append(train(problem, recipe, start(problem, recipe, Bandwidth("on", 10))))
    torch.testing.assert_close(states[0].field.grid, states[1].field.grid, rtol=1e-3, atol=1e-3)


def test_the_level_gauge_pulls_the_views_to_their_brightness(made):
    data = read_dataset(made)
    problem = problem_of(data)
    dim = replace(problem, gauge=replace(problem.gauge, kind="level", level=problem.gauge.level - 1.0))
    recipe = replace(SMALL, iterations=10)
    state = start(dim, recipe, Bandwidth("off"))
    assert state.field.log_background.requires_grad
    before = float(state.field.log_background.detach())
    step(dim, recipe, state)
    assert float(state.field.log_background.detach()) != before


KEEPING = """
import os, sys
import numpy as np
from pixelid.cli.main import main
from pixelid.nerf import reconstruct as module
run = module.reconstruct
def kept(*arguments, **options):
    result = run(*arguments, **options)
    field = result.state.field
    held = [x.detach().numpy() for x in (field.grid, field.coefficients, field.log_background)]
    np.savez(f"{sys.argv[1]}/{os.environ['RANK']}.npz", *held, occupied=field.occupied)
    return result
module.reconstruct = kept
sys.exit(main(sys.argv[2:]))
"""


def test_two_processes_share_a_batch(made, tmp_path):
    """torchrun with gloo: the ranks average their gradients, end with one scene, and the first writes."""
    out, script = tmp_path / "out", tmp_path / "keeping.py"
    script.write_text(KEEPING)
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [
            sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", str(script),
            str(tmp_path), "reconstruct", str(made), "--out", str(out), "--iterations", "20", "--quiet", "--device",
            "cpu",
        ],
        env=environment, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert (out / "reconstruction.json").is_file(), done.stderr[-2000:]
    result = json.loads((out / "reconstruction.json").read_text())
    assert result["iterations"] == 20
    with np.load(tmp_path / "0.npz") as first, np.load(tmp_path / "1.npz") as second:
        assert set(first) == set(second)
        assert float(np.ptp(first["arr_0"][:, 1])) > 0.1  # it has learnt something
        for name in first.files:
            np.testing.assert_array_equal(first[name], second[name])


@pytest.mark.slow
def test_modelling_the_pixel_pays_on_the_hard_scene(tmp_path):
    """Less than half of the default training, 64 × 64 pixels in the dark: 25.5 and 19.4 dB when written."""
    data = read_dataset(make_dataset(tmp_path / "hard", "hard8", seed=0))
    recipe = Recipe(iterations=500)
    psnr = {
        mode: reconstruct(data, bandwidth=Bandwidth(mode), recipe=recipe).scores.psnr.mean() for mode in ("on", "off")
    }
    assert psnr["on"] > psnr["off"] + 5.0


@pytest.mark.slow
def test_sharp_bright_events_are_reconstructed(tmp_path):
    """At medium half of an edge's contrast falls into dead times: 23.5 dB (filter on) and 23.4 (off) when written, 20.2
    with every event an interval of its own."""
    data = read_dataset(make_dataset(tmp_path / "medium", "medium", seed=0, side=32, revolutions=2.0))
    scores = {
        mode: reconstruct(data, bandwidth=Bandwidth(mode), recipe=Recipe(iterations=400)) for mode in ("on", "off")
    }
    psnr = {mode: result.scores.psnr.mean() for mode, result in scores.items()}
    assert psnr["on"] > 22.5
    assert psnr["on"] > psnr["off"] - 0.2
    assert scores["on"].held_out < 0.6


@pytest.mark.slow
def test_a_scene_of_posed_images_stands_for_the_truth(shared):
    """Fitted to some of the posed pictures, it shows the others."""
    from posed import scene_of_images

    from pixelid.nerf.data.camera import Camera
    from pixelid.nerf.data.views import LUMA, OPENGL

    data = np.load(shared / "recordings" / "lego_views_100px.npz")
    images, poses, focal = data["images"], data["poses"], float(data["focal"])
    held = np.arange(0, len(images), 10)
    kept = np.setdiff1d(np.arange(len(images)), held)
    scene = scene_of_images(images[kept], poses[kept], focal)
    height, width = images.shape[1:3]
    intrinsics = np.array([[focal, 0, width / 2 - 0.5], [0, focal, height / 2 - 0.5], [0, 0, 1]])
    camera = Camera(intrinsics, width, height, np.empty(0))
    rendered = scene.render(camera, poses[held, :3, 3], poses[held, :3, :3] @ OPENGL)
    alpha = images[held, ..., 3:] / 255.0
    truth = (alpha * images[held, ..., :3] / 255.0 + 1 - alpha) @ LUMA
    assert 10 * np.log10(1 / ((rendered - truth) ** 2).mean()) > 31


def test_a_pixel_without_bandwidth_limit_is_the_pixel_without_filter(made):
    """Zero capacitances, infinite cutoffs: bandwidth on equals off, to the last bit, and nothing is NaN."""
    problem = problem_of(read_dataset(made))
    ideal = problem.circuit.with_(photoreceptor="unlimited", follower=math.inf, differencing=math.inf)
    grids = [
        train(of, SMALL, start(of, SMALL, Bandwidth(mode)), until=3).field.grid.detach()
        for of, mode in ((replace(problem, circuit=ideal), "on"), (replace(problem, circuit=ideal), "joint"),
                         (problem, "off"))
    ]  # fmt: skip
    assert torch.isfinite(grids[0]).all()
    assert torch.equal(grids[0], grids[1])
    assert torch.equal(grids[0], grids[2])


@pytest.mark.parametrize("present", [{"photoreceptor": "unlimited"}, {"follower": math.inf, "differencing": math.inf}])
def test_absent_stages_leave_a_finite_field(made, present):
    problem = problem_of(read_dataset(made))
    state = start(replace(problem, circuit=problem.circuit.with_(**present)), SMALL, Bandwidth("joint"))
    train(replace(problem, circuit=problem.circuit.with_(**present)), SMALL, state, until=3)
    assert state.finite
    assert state.iteration == 3


@pytest.mark.parametrize("setting", ["hard", "easy"])
@pytest.mark.parametrize(("name", "file"), shipped_models().items(), ids=shipped_models())
def test_every_shipped_model_trains(made, made_bright, name, file, setting):
    """On, off and joint stay finite; without bandwidth limit they are one and the same."""
    data = read_dataset(made if setting == "hard" else made_bright)
    white_fa = SETTINGS[setting].white_fa
    calibration = of_fit(data.calibration, file, scale=None if name == "ideal" else white_fa)
    problem = problem_of(data, calibration)
    states = [train(problem, SMALL, start(problem, SMALL, Bandwidth(mode)), until=4) for mode in ("on", "off", "joint")]
    assert all(state.finite and state.iteration == 4 for state in states)
    alike = [torch.equal(states[0].field.grid, other.field.grid) for other in states[1:]]
    assert alike == ([True, True] if name == "ideal" else [False, False])


@pytest.mark.parametrize("setting", ["hard", "easy"])
def test_a_file_with_zero_capacitances_is_a_pixel_without_bandwidth_limit(made, made_bright, tmp_path, setting):
    """On and off reach the same scores, to 0.05 dB and in fact to the last bit, and no view is NaN."""
    folder = tmp_path / "scene"
    shutil.copytree(made if setting == "hard" else made_bright, folder)
    with np.load(folder / CALIBRATION) as file:
        arrays = dict(file)
    zero = ("input_time_const_eff_it_prod", "miller_time_const_eff_it_prod", "output_time_const", "lower_cutoff_freq")
    arrays |= dict.fromkeys(zero, np.array(0.0)) | dict.fromkeys(("sf_cutoff_freq", "diff_amp_cutoff_freq"), np.inf)
    np.savez(folder / CALIBRATION, **arrays)
    data = read_dataset(folder)
    assert not limits_bandwidth(data.calibration.circuit)
    psnr = [
        reconstruct(data, Options(bandwidth=mode, device="cpu"), recipe=SMALL).scores.psnr for mode in ("on", "off")
    ]
    assert np.isfinite(psnr).all()
    np.testing.assert_array_equal(psnr[0], psnr[1])


def test_thresholds_of_pixels_are_trained_when_the_fit_has_mismatch(made, tmp_path):
    """They are part of the state, and a resumed run continues with them."""
    model = find_model("dvs128").set({"threshold_mismatch.sigma": 0.1})
    save_model(model, tmp_path / "model.toml")
    data = read_dataset(made)
    problem = problem_of(data, of_fit(data.calibration, tmp_path / "model.toml"))
    whole = train(problem, SMALL, start(problem, SMALL, Bandwidth("on", 10)), until=12)
    assert whole.pixel.departures.abs().max() > 0.05
    assert 0.001 < whole.pixel.threshold_spread()[0] < 0.1
    half = train(problem, SMALL, start(problem, SMALL, Bandwidth("on", 10)), until=7)
    checkpoint.save(tmp_path / "half.pt", half, "mark")
    resumed = checkpoint.load(tmp_path / "half.pt", problem, SMALL, Bandwidth("on", 10), "mark")
    assert resumed is not None
    train(problem, SMALL, resumed, until=12)
    assert torch.equal(whole.pixel.departures, resumed.pixel.departures)


def test_size_and_length_of_a_training_are_chosen_or_follow_the_data(made, tmp_path):
    out = tmp_path / "out"
    words = ["reconstruct", str(made), "--out", str(out), "--cells", "12", "--steps", "3", "--batch", "5", "--quiet"]
    main([*words, "--protocol", "paper"])
    result = json.loads((out / "reconstruction.json").read_text())
    assert result["iterations"] == 3
    with np.load(out / "field.npz") as scene:
        assert scene["grid"].shape[0] == 13
    published = result["published_protocol"]
    assert published["psnr"] == pytest.approx(result["views"]["psnr"], abs=6)
    assert "by the paper's protocol" in Reconstruction.load(out).headline
    open_recipe = replace(Recipe(), iterations=0, batch=0)
    few, many = open_recipe.for_data(5_000), open_recipe.for_data(40_000_000)
    assert (few.batch, few.iterations) == (320, 600)
    assert (many.batch, many.iterations) == (4096, 30_000)
    small = open_recipe.for_data(40_000_000, samples=30, memory=1 << 30)
    assert 1000 < small.batch < 2000
    assert small.iterations == 30_000
    assert open_recipe.for_data(40_000_000, samples=300, memory=1 << 30).batch < small.batch / 5
    assert replace(open_recipe, batch=4096).for_data(40_000_000, 30, 1 << 30).batch == 4096  # what was asked for
    assert open_recipe.for_data(40_000_000, 30, 16 << 30) == many
    usual = open_recipe.for_data(100_000)
    assert (usual.batch, usual.iterations) == (Recipe().batch, Recipe().iterations)


def test_the_maps_of_a_sensor_are_reconstructed_with(made, tmp_path, capsys):
    """The command takes the folder of `pixelid sensor`: thresholds with their uncertainty, bandwidth, a hot pixel."""
    rng = np.random.default_rng(0)
    model, shape = find_model("dvs128"), (16, 16)
    maps = {}
    for name, sd in (("on_threshold", 0.02), ("off_threshold", 0.02), ("sf_cutoff_hz", 0.1)):
        log = np.log(model.values[name]) + 0.1 * rng.normal(size=shape)
        error = np.full(shape, sd)
        maps[name] = Map(name, "", log, error, log, error, Population(float(log.mean()), 0.1, 256), (0, 0), (0, 0))
    events = np.full(shape, 200)
    events[4, 9] = 50_000
    SensorFit(maps, events, 1, 1, model, 1.0, 0, {}).save(tmp_path / "maps")
    words = ["reconstruct", str(made), "--out", str(tmp_path / "out"), "--sensor", str(tmp_path / "maps"), "--quiet"]
    main([*words, "--steps", "3", "--bandwidth", "off"])
    written = json.loads((tmp_path / "out" / "reconstruction.json").read_text())
    assert not written["pixels"]["bandwidth_mapped"]
    noise = "threshold_noise of the maps' model"  # which no data set quotes
    assert written["ignored"] == [noise, "map of sf_cutoff_hz"]
    assert "map of sf_cutoff_hz" in capsys.readouterr().err
    main([*words, "--steps", "3", "--overwrite"])
    written = json.loads((tmp_path / "out" / "reconstruction.json").read_text())
    assert written["ignored"] == [noise]
    assert written["pixels"]["bandwidth_mapped"]
    assert written["pixels"]["hot"] == {"count": 1, "xy": [[9, 4]]}
    assert written["pixels"]["threshold_spread"]["on"] == pytest.approx(0.1, rel=0.2)
    assert {"sensor.json", "maps.npz"} <= set(written["inputs_sha256"])


def test_what_a_search_for_the_gap_found_is_reconstructed_with(made, tmp_path, capsys):
    """The grown model of its folder is the pixel; a remainder that nothing explains is said."""
    folder = tmp_path / "gap"
    folder.mkdir()
    model = find_model("dvs128").with_effect("leak", {"rate_hz": 40.0}).with_effect("hot_pixels", {"count": 3.0})
    save_model(model, folder / "model.toml")
    (folder / "gap.json").write_text(json.dumps({"verdict": "named", "remainder": True, "unknown_term": None}))
    words = ["reconstruct", str(made), "--out", str(tmp_path / "out"), "--fit", str(folder), "--quiet"]
    main([*words, "--steps", "2"])
    written = json.loads((tmp_path / "out" / "reconstruction.json").read_text())
    assert written["ignored"] == ["what no effect explains in gap.json"]
    assert written["pixels"]["thresholds_trained"]  # the shipped model has mismatch
    assert "what no effect explains" in capsys.readouterr().err
    calibration = of_fit(read_dataset(made).calibration, folder)
    assert calibration.circuit.leak_hz == 40.0


def test_numbers_that_run_away_end_as_diverged(made, tmp_path):
    data = read_dataset(made)
    wrong = replace(data.calibration, circuit=data.calibration.circuit.with_(on_threshold=1e300))
    result = reconstruct(data, calibration=wrong, recipe=replace(SMALL, rate=1e4))
    assert result.status is Status.diverged
    assert "no number" in result.advice
    result.save(tmp_path)
    written = json.loads((tmp_path / "reconstruction.json").read_text())
    assert written["status"] == "diverged"
    assert written["views"]["psnr"] is None
    unseen = reconstruct(replace(data, views={}), calibration=wrong, recipe=replace(SMALL, rate=1e4))
    assert unseen.status is Status.diverged  # without a view to score there is no score to be no number


def test_a_pixel_alone_judges_nothing(made):
    data = read_dataset(made)
    pixel = data.y * data.calibration.camera.width + data.x
    mine = pixel == np.bincount(pixel).argmax()
    one = replace(data, t=data.t[mine], x=data.x[mine], y=data.y[mine], on=data.on[mine])
    with pytest.raises(InputError, match="held out"):
        reconstruct(one, Options(gap=True), recipe=SMALL)
    alone = reconstruct(one, recipe=replace(SMALL, iterations=2))
    assert alone.status is Status.not_identified
    assert "nothing was judged" in alone.advice


def test_a_search_that_names_nothing_leaves_the_pixel_as_told(made):
    """Its own training is no prior: the scene is that of a run without a search."""
    data, told = read_dataset(made), Bandwidth("joint", 10, {"alpha": 0.05, "threshold": 0.05}, ("threshold",))
    searched = reconstruct(data, Options(gap=True, device="cpu"), bandwidth=told, recipe=SMALL)
    assert searched.gap is not None
    assert searched.gap["effects"] == []
    plain = reconstruct(data, Options(device="cpu"), bandwidth=told, recipe=SMALL)
    assert searched.problem.circuit == plain.problem.circuit
    assert torch.equal(searched.state.pixel.factors, plain.state.pixel.factors)
    assert torch.equal(searched.state.field.grid, plain.state.field.grid)


def test_a_threshold_that_has_left_its_fit_is_no_result(made):
    data = read_dataset(made)
    told = Bandwidth("joint", 10, {"alpha": 0.01, "threshold": 0.04}, ("threshold", "ratio"))
    state = start(problem_of(data, trained=told.moving), SMALL, told)
    with torch.no_grad():
        state.pixel.factors.copy_(torch.tensor([0.2, 0.0, 0.0, 0.0, -0.4, 1.0]))
    far = state.pixel.thresholds_from_told()
    assert far == pytest.approx({"threshold": -10.0})  # nothing is told of the ratio
    status, advice = _verdict(0.4, no_scores(data.views["test"].some([])), 24, True, far)
    assert status is Status.misfit
    assert "threshold -10 of its standard deviations" in advice
    assert _verdict(0.4, no_scores(data.views["test"].some([])), 24, True, {"ratio": 4.0})[0] is Status.converged


def test_a_scene_of_few_steps_or_of_little_explained_is_not_called_converged(made):
    """By the steps that are missing, and by half a threshold."""
    scores = no_scores(read_dataset(made).views["test"].some([]))
    short, advice = _verdict(0.41, scores, 150, True, {}, (), 450)
    assert short is Status.not_converged
    assert "41 %" in advice
    assert "150 of the 600 steps" in advice
    assert _verdict(0.33, scores, 600, True, {})[0] is Status.converged
    status, advice = _verdict(0.51, scores, 600, True, {})
    assert status is Status.misfit
    assert advice.startswith("51 % of what events of held-out pixels show is unexplained")


def test_what_the_pixel_has_and_the_scene_ignores_is_said(made, tmp_path, capsys):
    (tmp_path / "fit").mkdir()
    model = find_model("dvs128").with_effect("leak", {"rate_hz": 5.0})
    model = model.with_effect("threshold_drift", {"per_s": 0.05}).with_effect("slew_limit")
    model = model.with_effect("timestamp_jitter")
    save_model(model, tmp_path / "fit" / "model.toml")
    words = ["reconstruct", str(made), "--out", str(tmp_path / "out"), "--fit", str(tmp_path / "fit"), "--quiet"]
    main([*words, "--iterations", "2"])
    assert json.loads((tmp_path / "out" / "reconstruction.json").read_text())["ignored"] == [
        "slew_limit",
        "timestamp_jitter",
    ]
    assert "does not model slew_limit, timestamp_jitter" in capsys.readouterr().err


@pytest.mark.parametrize("views", [True, False])
def test_a_preview_shows_the_scene_come_and_changes_no_number(made, tmp_path, views):
    data = read_dataset(made)
    data = data if views else replace(data, views={})
    plain = reconstruct(data, Options(device="cpu"), recipe=SMALL)
    seen = []

    def remember(what: str, share: float) -> None:
        if (tmp_path / "scene.png").is_file():
            seen.append(imread(tmp_path / "scene.png"))

    watched = reconstruct(data, Options(device="cpu"), recipe=SMALL, preview=tmp_path / "scene.png", progress=remember)
    assert torch.equal(watched.state.field.grid, plain.state.field.grid)
    np.testing.assert_array_equal(watched.scores.psnr, plain.scores.psnr)
    last = imread(tmp_path / "scene.png")
    assert last.shape == (16, 16)
    assert len({picture.tobytes() for picture in seen}) > 5
    assert [file.name for file in tmp_path.iterdir()] == ["scene.png"]
    if views:
        validation = data.views["val"]
        truth = validation.images[-1, ..., 0] / validation.peak
        errors = [np.abs(picture / 255 - truth).mean() for picture in (seen[0], last)]
        assert errors[1] < errors[0]


def test_the_command_keeps_the_last_preview_in_its_folder(made, tmp_path):
    words = ["reconstruct", str(made), "--out", str(tmp_path / "out"), "--iterations", "4", "--quiet"]
    assert main(words) in (0, 1)
    assert imread(tmp_path / "out" / "preview.png").shape == (16, 16)
    assert [file.name for file in tmp_path.iterdir()] == ["out"]


def test_another_picture_is_not_replaced_by_a_preview(made, tmp_path, capsys):
    """One that an interrupted run has left is."""
    from pixelid.nerf.shown.preview import _save, refuse_preview

    file = tmp_path / "out.preview.png"
    _save(file, np.linspace(0, 1, 60).reshape(5, 12, 1))
    refuse_preview(file)
    with Image.open(file) as picture:  # an independent reader finds the mark, and what it stands beside
        picture.verify()
        assert picture.info["Software"] == "pixelid reconstruct, preview"
    assert imread(file).tolist() == np.round(255 * np.linspace(0, 1, 60)).reshape(5, 12).tolist()
    imsave(file, np.zeros((4, 4), np.uint8), check_contrast=False)
    own = file.read_bytes()
    words = ["reconstruct", str(made), "--out", str(tmp_path / "out"), "--iterations", "1", "--quiet"]
    assert main(words) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "out.preview.png: is not a preview" in line
    assert file.read_bytes() == own
    refuse_preview(file, overwrite=True)


@pytest.mark.parametrize("file", ["scene", "scene.jpg", "nowhere/scene.png"])
def test_a_preview_that_cannot_be_written_is_refused_before_training(made, tmp_path, file):
    begun: list[str] = []
    with pytest.raises(InputError, match="scene"):
        px.reconstruct(
            made, iterations=3, preview=tmp_path / file, device="cpu", progress=lambda what, share: begun.append(what)
        )
    assert not begun


def test_the_function_takes_what_the_command_takes(made, tmp_path):
    out = tmp_path / "out"
    words = ["reconstruct", str(made), "--out", str(out), "--cells", "12", "--steps", "3", "--batch", "5", "--quiet"]
    main([*words, "--harmonics", "0", "--protocol", "paper", "--device", "cpu"])
    asked = px.reconstruct(made, cells=12, iterations=3, batch=5, harmonics=0, protocol="paper", device="cpu")
    result = json.loads((out / "reconstruction.json").read_text())
    assert asked.recipe.as_dict() == Reconstruction.load(out).content["recipe"]
    assert asked.published is not None
    assert result["published_protocol"]["psnr"] == asked.published.means()["psnr"]
    assert result["views"]["psnr"] == asked.scores.means()["psnr"]
    auto = Recipe.of(Options(iterations="auto"))
    assert (auto.iterations, auto.batch) == (0, 0)
    assert Recipe.of(Options(iterations="auto", batch=7)).batch == 7
    assert Recipe.of(Options()) == Recipe()
    counted: dict[str, Any] = {name: np.int64(9) for name in ("iterations", "batch", "cells")}
    assert repr(Recipe.of(Options(**counted))) == repr(Recipe.of(Options(iterations=9, batch=9, cells=9)))
    with pytest.raises(InputError, match="iterations: expected"):
        px.reconstruct(made, iterations=0)
    wrongs: tuple[dict[str, Any], ...] = (
        {"cells": 7},
        {"harmonics": 3},
        {"batch": 0},
        {"iterations": "many"},
        {"protocol": "kind"},
        {"scale": "levle"},
        {"background": -1.0},
        {"background": 0.0},
        {"box": (0, 0, 0)},
        {"box": (0, 0, 0, 1, 1, "x")},
        {"near": -1.0},
        {"refine_poses": (1.0,)},
        {"refine_poses": (1.0, float("nan"))},
        {"refine_time": -1.0},
        {"refine_time": float("nan")},
        {"samples": 0},
        {"device": "gpu"},
        {"seed": -1},
        {"fit": "dvs128.toml", "radiance_scale": -1.0},
    )
    save_model(find_model("dvs128"), tmp_path / "dvs128.toml")
    for wrong in wrongs:
        wrong = wrong | ({"fit": tmp_path / wrong["fit"]} if "fit" in wrong else {})
        with pytest.raises(InputError, match=rf"^(--)?{[*wrong][-1]}: expected[^\n]*$"):
            px.reconstruct(made, **wrong)


def test_a_near_distance_is_trained_with_stored_and_rendered_with(made, tmp_path):
    words = ["reconstruct", str(made), "--out", str(tmp_path / "out"), "--iterations", "3", "--quiet", "--near", "3.5"]
    assert main(words) in (0, 1)
    result = json.loads((tmp_path / "out" / "reconstruction.json").read_text())
    check("reconstruction", result)
    assert result["box"]["near"] == 3.5
    assert Reconstruction.load(tmp_path / "out").field.near == 3.5
    plain = px.reconstruct(made, iterations=3, device="cpu")
    near = px.reconstruct(made, iterations=3, near=3.5, device="cpu")
    assert not torch.equal(plain.state.field.grid, near.state.field.grid)
    plain.save(tmp_path / "plain")
    with np.load(tmp_path / "plain" / "field.npz") as file:
        assert "near" not in file


def test_an_unbounded_fine_scene_is_trained_in_bricks_and_resumed(made, tmp_path, monkeypatch):
    """Interrupted once bricks are given up, also far away; what is written shows what training came to."""
    from pixelid.nerf.training import train as training

    for module in (fields, training):
        monkeypatch.setattr(module, "WHOLE", 9)
    problem, bandwidth = problem_of(read_dataset(made)), Bandwidth("off")
    recipe = Recipe(iterations=130, batch=24, vertices=(17, 33), unbounded=True)
    whole = train(problem, recipe, start(problem, recipe, bandwidth))
    assert whole.finite
    half = train(problem, recipe, start(problem, recipe, bandwidth), until=110)
    bricks = half.field.bricks
    assert 0 < bricks.number < bricks.index.size
    checkpoint.save(tmp_path / "half.pt", half, "mark")
    resumed = checkpoint.load(tmp_path / "half.pt", problem, recipe, bandwidth, "mark")
    assert resumed is not None
    train(problem, recipe, resumed)
    assert np.array_equal(whole.field.bricks.index, resumed.field.bricks.index)
    assert torch.equal(whole.field.grid, resumed.field.grid)


def test_an_unbounded_scene_is_trained_stored_and_resumed(made, tmp_path):
    words = ["reconstruct", str(made), "--out", str(tmp_path / "out"), "--iterations", "3", "--quiet", "--unbounded"]
    assert main([*words, "--device", "cpu"]) in (0, 1)
    result = json.loads((tmp_path / "out" / "reconstruction.json").read_text())
    check("reconstruction", result)
    assert result["recipe"]["unbounded"] is True
    asked = px.reconstruct(made, iterations=3, unbounded=True, device="cpu")
    cells = max(read_dataset(made).calibration.camera.width, 32)
    assert asked.recipe.vertices[-1] == 2 * cells + 1  # the inner box has as many as a bounded one
    assert asked.recipe.cells == cells == Recipe().for_sensor(cells).cells
    read = Reconstruction.load(tmp_path / "out").field
    assert read.unbounded
    np.testing.assert_allclose(read.dense()[0], asked.state.field.dense()[0], atol=0.01)  # half precision
    problem, bandwidth = problem_of(read_dataset(made)), Bandwidth("on", 10)
    recipe = replace(SMALL, unbounded=True, refinement=Refinement(0.01, 0.02, 0.01))
    whole = train(problem, recipe, start(problem, recipe, bandwidth))
    half = train(problem, recipe, start(problem, recipe, bandwidth), until=17)
    checkpoint.save(tmp_path / "half.pt", half, "mark")
    resumed = checkpoint.load(tmp_path / "half.pt", problem, recipe, bandwidth, "mark")
    assert resumed is not None
    assert resumed.field.unbounded
    train(problem, recipe, resumed)
    assert torch.equal(whole.field.grid, resumed.field.grid)
    assert torch.equal(whole.poses.moved, resumed.poses.moved)
    marks = {checkpoint.run_identity(problem, r, bandwidth, {}) for r in (recipe, replace(recipe, unbounded=False))}
    assert len(marks) == 2
