"""The published layout: what is read, how, and what is refused in one or two plain lines."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from pixelid.cli.main import main
from pixelid.errors import InputError
from pixelid.model.files import save_model
from pixelid.model.shipped import find_model
from pixelid.nerf.data.calibration import CIRCUIT, of_fit, uncertainty_of_fit, unexplained_by
from pixelid.nerf.data.dataset import evaluation_views, read_dataset
from pixelid.nerf.data.published.convert import Conversion
from pixelid.nerf.data.scenes import BACKGROUND
from pixelid.nerf.data.trajectory import Trajectory
from pixelid.nerf.data.views import _peak_and_span
from pixelid.nerf.events.gauge import Gauge, gauge_of, scene_box
from pixelid.nerf.field.radiance import Field
from pixelid.nerf.options import Options
from pixelid.nerf.pixel.model import Bandwidth
from pixelid.nerf.synthetic import SETTINGS, camera_model
from pixelid.nerf.training.problem import problem_of
from pixelid.nerf.training.recipe import Recipe
from pixelid.nerf.training.state import start
from pixelid.nerf.training.train import EPSILON, _off_level


@pytest.fixture
def scene(made, tmp_path) -> Path:
    """A copy to break."""
    return Path(shutil.copytree(made, tmp_path / "scene"))


def edit(path: Path, **changes) -> None:
    """Replace keys of an npz file by change(array), or remove them (None)."""
    with np.load(path) as found:
        arrays = {key: found[key] for key in found.files}
    for key, change in changes.items():
        value = arrays.pop(key)
        if change is not None:
            arrays[key] = change(value)
    np.savez(path, **arrays)


def with_nan(values):
    values = np.array(values, dtype=float)
    values[5] = np.nan
    return values


def test_what_is_written_is_read(made):
    data = read_dataset(made)
    assert len(data.t) > 200
    assert 0.2 < data.on.mean() < 0.8
    assert data.t.min() >= 0
    assert data.t.max() <= data.trajectory.t[-1]
    assert set(data.views) == {"train", "val", "test"}
    assert data.views["test"].images.shape == (8, 16, 16, 1)
    # in the unit of the views, the circuit is the camera's with its radiance divided out
    model, circuit = camera_model(SETTINGS["hard"]), data.calibration.circuit
    assert circuit.alpha == pytest.approx(model.values["alpha"] * 20)
    assert circuit.beta == pytest.approx(model.values["beta"])
    assert circuit.gamma == pytest.approx(model.values["gamma"] * 20)
    assert circuit.dark == pytest.approx(0.2)
    assert circuit.refractory == pytest.approx(1e-4)


def test_gauge_box_and_views(made):
    data = read_dataset(made)
    gauge = gauge_of(data)
    assert gauge.kind == "background"
    assert gauge.background == pytest.approx([BACKGROUND], rel=1e-4)
    low, high = scene_box(data.trajectory, data.calibration.camera.half_angle)
    np.testing.assert_allclose(low + high, 0, atol=1e-4)
    assert 1.3 < high[0] < 1.6
    validation, test = evaluation_views(data)
    apart = np.linalg.norm(validation.position[:, None] - test.position[None], axis=2)
    assert apart.min() > 1e-3


@pytest.mark.parametrize("stages", [("test",), ("val", "train"), ("test", "val"), ("train",)])
def test_what_pins_the_radiance_is_never_a_view_that_is_scored(made, stages):
    data = read_dataset(made)
    data = replace(data, views={stage: data.views[stage] for stage in stages})
    gauge, (_, scored) = gauge_of(data, scale="level"), evaluation_views(data)
    dazzled = replace(scored, images=np.full_like(scored.images, 0.5))
    left = [stage for stage in stages if data.views[stage] is scored]
    views = {stage: dazzled if stage in left else data.views[stage] for stage in stages}
    if not left:  # a single stage, halved: those scored are every other one
        images = data.views[stages[0]].images.copy()
        images[::2] = 0.5
        views = {stages[0]: replace(data.views[stages[0]], images=images)}
    np.testing.assert_array_equal(gauge_of(replace(data, views=views), scale="level").level, gauge.level)


def test_a_camera_that_never_turns_needs_a_box(scene, tmp_path, capsys):
    """Parallel optical axes do not say how far the scene is."""
    edit(scene / "camera_poses.npz", T_wc_orientation=lambda q: np.tile(q[:1], (len(q), 1)))
    words = ["reconstruct", str(scene), "--out", str(tmp_path / "out"), "--steps", "1", "--quiet"]
    assert main(words) == 2
    assert "--box: missing" in capsys.readouterr().err
    main([*words, "--box", "-1.5", "-1.5", "-1.5", "1.5", "1.5", "1.5"])
    assert (tmp_path / "out" / "reconstruction.json").is_file()


def turned(directions: np.ndarray) -> np.ndarray:
    """(n, 4) orientations whose optical axes point along (n, 3)."""
    return np.array([Rotation.align_vectors(d[None], [[0.0, 0.0, 1.0]])[0].as_quat() for d in directions])


@pytest.mark.parametrize("radius", [0.0, 1e-3, 0.5])
def test_a_camera_that_turns_in_place_or_looks_outwards_needs_a_box(radius):
    """The point nearest to its axes is the camera itself, or behind it: a division by zero, or a box nobody sees."""
    angle = np.linspace(0.0, 2 * np.pi, 60)
    out = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(60)])
    jitter = np.random.default_rng(0).normal(size=out.shape)
    position = radius * (out if radius > 0.1 else jitter)
    with pytest.raises(InputError, match="no point lies ahead of all poses"):
        scene_box(Trajectory(angle, position, turned(out)), 0.3)


def test_one_picture_alone_is_not_scored(made):
    """It would be corrected on itself."""
    data = read_dataset(made)
    data = replace(data, views={"test": data.views["test"].some([0])})
    reference, scored = evaluation_views(data)
    assert (len(reference), len(scored)) == (1, 0)


def test_a_lens_that_cannot_be_undone_is_refused(scene, capsys):
    """Coefficients under which the corners are seen twice."""
    edit(scene / "camera_calibration.npz", distortion_params=lambda _: np.array([-2.0, 0.0, 0.0, 0.0]))
    assert main(["reconstruct", str(scene), "--out", str(scene / "out"), "--steps", "1", "--quiet"]) == 2
    said = capsys.readouterr().err
    assert "camera_calibration.npz: distortion_params: the lens cannot be undone at pixel (0, 0): its field" in said
    assert said.count("\n") == 1


def test_a_dead_time_is_not_longer_than_intervals(made):
    data = read_dataset(made)
    told = data.calibration.circuit
    longer = replace(data.calibration, circuit=told.with_(refractory=0.02))
    assert problem_of(data).circuit.refractory == told.refractory
    used = problem_of(data, longer).circuit.refractory
    assert told.refractory < used < 0.02


def test_positions_between_pixels_are_refused(scene, capsys):
    edit(scene / "raw_events.npz", position=lambda p: p + 0.99)
    assert main(["reconstruct", str(scene), "--out", str(scene / "out"), "--steps", "1", "--quiet"]) == 2
    assert "position: expected whole pixels, found" in capsys.readouterr().err


def test_a_highlight_does_not_move_the_white_behind_transparent_views(made):
    data = read_dataset(made)
    bright = {
        stage: replace(views, images=np.where(views.images > 0.8, 3.0, views.images), peak=3.0, transparent=True)
        for stage, views in data.views.items()
    }
    assert gauge_of(replace(data, views=bright)).background == pytest.approx([1.0])


def peak_of(images: np.ndarray) -> float:
    """Of unquantised pictures."""
    return _peak_and_span(images.astype(np.float32), images.size, np.dtype(np.float32), {})[0]


def test_white_of_linear_views_does_not_jump_with_their_brightest_value():
    rng = np.random.default_rng(0)
    image = rng.uniform(0.0, 1.0, (1, 40, 40, 1))
    brightest = np.geomspace(0.5, 4000.0, 800)
    peaks = np.array([peak_of(image * top / image.max()) for top in brightest])
    assert peaks[0] == 1.0
    assert (np.diff(np.log(peaks)) < 0.02).all()
    assert peaks[-1] == pytest.approx(1000.0)  # in another unit the same picture has the same PSNR
    assert (peaks[brightest <= 4.0] == 1.0).all()
    image[0, 3, 3] = 1000.0  # a single pixel says nothing of white
    assert peak_of(image) == 1.0


def test_the_unit_of_radiance_does_not_depend_on_how_long_views_were_exposed(made):
    data = read_dataset(made)
    longer = {
        stage: replace(views, images=np.float32(share) * views.images, exposure=np.full(len(views), share))
        for (stage, views), share in zip(data.views.items(), (0.5, 4.0, 0.25), strict=True)
    }
    for scale in ("auto", "level", "free"):
        told, expected = gauge_of(replace(data, views=longer), scale=scale), gauge_of(data, scale=scale)
        assert told.kind == expected.kind
        np.testing.assert_allclose(told.level, expected.level, rtol=1e-6)
        np.testing.assert_allclose(told.background, expected.background, rtol=1e-5)


def test_a_background_that_was_said_is_where_a_trained_one_begins(made):
    data = read_dataset(made)
    for scale in ("level", "free"):
        assert gauge_of(data, 7.0, scale).background == pytest.approx([7.0])
        assert gauge_of(data, 7.0, scale).kind == scale


@pytest.mark.parametrize("colours", [1, 3])
def test_every_colour_has_its_level(made, colours):
    """A clear field shows its background: off by a factor per colour, whose product is 1."""
    data = read_dataset(made)
    bayer = "" if colours == 1 else "RGGB"
    views = {
        stage: replace(each, images=np.full((*each.images.shape[:3], colours), 0.5, np.float32))
        for stage, each in data.views.items()
    }
    calibration = replace(data.calibration, bayer=bayer, dark=np.zeros(colours))
    problem = problem_of(replace(data, views=views, calibration=calibration), options=Options(scale="level"))
    state = start(problem, Recipe(vertices=(9,)), Bandwidth("on"))
    for factors in ([1.0] * colours, [4.0, 1.0, 0.25][:colours]):
        field = Field(problem.low, problem.high, 9, colours, (0.5 * np.array(factors)).tolist())
        field.hold_dense(torch.full((9, 9, 9, 1 + colours), -30.0))
        state.field = field
        off = float(_off_level(problem, state, np.random.default_rng(0)).detach())
        expected = np.log(0.5 * np.array(factors) + EPSILON) - np.log(0.5 + EPSILON)
        assert off == pytest.approx(np.mean(expected**2), abs=1e-4)


@pytest.mark.parametrize(
    "coding", [lambda p: p, lambda p: p.astype(np.uint8), lambda p: 2 * p.astype(np.int8) - 1, lambda p: p * 1.0]
)
def test_polarity_codings(made, scene, coding):
    edit(scene / "raw_events.npz", polarity=coding)
    np.testing.assert_array_equal(read_dataset(scene).on, read_dataset(made).on)


def test_orientations_as_matrices_and_other_clocks(made, scene):
    edit(scene / "camera_poses.npz", T_wc_orientation=lambda q: Rotation.from_quat(q).as_matrix())
    edit(scene / "camera_poses.npz", T_wc_timestamp=lambda t: t + 10**12)
    edit(scene / "raw_events.npz", timestamp=lambda t: t + 10**12)
    data, expected = read_dataset(scene), read_dataset(made)
    np.testing.assert_allclose(data.t, expected.t, atol=1e-12)
    times = np.linspace(0, data.trajectory.t[-1], 7)
    np.testing.assert_allclose(data.trajectory.at(times)[1], expected.trajectory.at(times)[1], atol=1e-9)


def test_times_in_a_unit_that_is_stated(made, scene):
    edit(scene / "camera_poses.npz", T_wc_timestamp=lambda t: t * 1e-9)
    edit(scene / "raw_events.npz", timestamp=lambda t: t // 1000)
    (scene / "camera_poses.source.toml").write_text('time_unit = "s"\n')
    (scene / "raw_events.source.toml").write_text('time_unit = "us"\n')
    data, expected = read_dataset(scene), read_dataset(made)
    np.testing.assert_allclose(data.t, expected.t, atol=1e-6)
    np.testing.assert_allclose(data.trajectory.t, expected.trajectory.t, atol=1e-9)


def test_views_one_level_up_and_quantised(scene):
    """8-bit RGBA over white, next to the dataset's folder."""
    from skimage.io import imsave

    views = scene / "views"
    document = json.loads((views / "transforms_test.json").read_text())
    picture = np.zeros((16, 16, 4), np.uint8)
    picture[4:9, 4:9] = (200, 100, 50, 255)
    for k in range(len(document["frames"])):
        (views / "test" / f"r_{k}.tiff").unlink()
        imsave(views / "test" / f"r_{k}.png", picture, check_contrast=False)
    shutil.move(views, scene.parent / "views")
    (scene / "renderer_params.npz").unlink()
    test_views = read_dataset(scene).views["test"]
    luma = 0.299 * 200 + 0.587 * 100 + 0.114 * 50
    assert test_views.images[0, 5, 5, 0] == pytest.approx((luma + 0.5) / 256)
    assert test_views.images[0, 0, 0, 0] == pytest.approx(255.5 / 256)
    assert test_views.transparent
    edit(scene / "camera_calibration.npz", bayer_pattern=lambda _: np.array("RGGB"))
    data = read_dataset(scene)
    assert data.views["test"].images[0, 5, 5] == pytest.approx((np.array([200, 100, 50]) + 0.5) / 256)
    assert data.calibration.channel_of(np.array([0, 1, 0, 1]), np.array([0, 0, 1, 1])).tolist() == [0, 1, 1, 2]
    assert gauge_of(data).kind == "background"


@pytest.mark.parametrize(
    ("ending", "white"), [("png", np.uint8(255)), ("tiff", np.uint16(65535)), ("tiff", np.float32(1.0))]
)
def test_an_alpha_channel_of_opaque_views_is_no_background(ending, white, scene):
    """One transparent pixel of one picture makes a stage transparent."""
    from skimage.io import imsave

    views = scene / "views"
    document = json.loads((views / "transforms_test.json").read_text())
    pictures = np.full((len(document["frames"]), 16, 16, 4), white)
    pictures[..., :3] = (np.random.default_rng(0).uniform(0.2, 0.4, (16, 16, 3)) * white).astype(pictures.dtype)

    def read():
        for k, picture in enumerate(pictures):
            for there in (views / "test").glob(f"r_{k}.*"):
                there.unlink()
            imsave(views / "test" / f"r_{k}.{ending}", picture, check_contrast=False)
        return read_dataset(scene).views["test"]

    opaque = read()
    assert not opaque.transparent
    assert gauge_of(replace(read_dataset(scene), views={"test": opaque})).kind == "level"
    pictures[-1, 3, 4, 3] = white * (254 / 255)
    assert read().transparent


def test_a_converted_dataset_has_no_views_but_its_own(scene):
    shutil.move(scene / "views", scene.parent / "views")
    assert read_dataset(scene).views
    (scene / Conversion.FILE).write_text("{}")
    assert not read_dataset(scene).views
    shutil.copytree(scene.parent / "views", scene / "views")
    assert read_dataset(scene).views


def test_infinite_cutoffs_are_absent_stages(scene):
    inf = lambda _: np.array(np.inf)  # noqa: E731
    edit(scene / "camera_calibration.npz", sf_cutoff_freq=inf, diff_amp_cutoff_freq=inf, amplifier_gain=inf)
    circuit = read_dataset(scene).calibration.circuit
    assert circuit.photoreceptor == "unlimited"
    assert np.isinf(circuit.follower)


def test_a_fit_replaces_the_pixel_in_the_datasets_unit(made, tmp_path):
    (tmp_path / "fit").mkdir()
    model = find_model("dvs128").set({"alpha": 3e4, "sf_cutoff_hz": 1500.0, "on_threshold": 0.3, "refractory_s": 2e-4})
    save_model(model, tmp_path / "fit" / "model.toml")
    data = read_dataset(made)
    circuit = of_fit(data.calibration, tmp_path / "fit").circuit
    assert circuit.alpha == pytest.approx(3e4 * 20)
    assert circuit.gamma == pytest.approx(model.values["gamma"] * 20)
    assert circuit.follower == pytest.approx(2 * np.pi * 1500)
    assert (circuit.on_threshold, circuit.off_threshold, circuit.refractory) == (0.3, 0.25, 2e-4)
    assert circuit.dark == pytest.approx(0.2)  # the fit has no dark current: the file's stays
    assert of_fit(data.calibration, tmp_path / "fit", 40.0).circuit.alpha == pytest.approx(3e4 * 40)


def test_without_circuit_constants_only_the_pixel_of_a_fit_or_none_will_do(scene, tmp_path, capsys):
    """Data sets of Robust e-NeRF."""
    edit(scene / "camera_calibration.npz", **dict.fromkeys(CIRCUIT))
    data = read_dataset(scene)
    assert data.calibration.circuit.photoreceptor == "unlimited"
    assert main(["reconstruct", str(scene), "--out", str(tmp_path / "out")]) == 2
    assert "input_time_const_eff_it_prod: missing" in capsys.readouterr().err
    words = ["--bandwidth", "off", "--iterations", "2", "--quiet"]
    assert main(["reconstruct", str(scene), "--out", str(tmp_path / "out"), *words]) in (0, 1)


EVENTS, POSES, CALIBRATION = "raw_events.npz", "camera_poses.npz", "camera_calibration.npz"
BROKEN = {
    "no events file": (lambda s: (s / EVENTS).unlink(), (EVENTS, "no such file")),
    "no npz": (lambda s: (s / EVENTS).write_text("x"), (EVENTS, "npz")),
    "truncated": (lambda s: (s / EVENTS).write_bytes((s / EVENTS).read_bytes()[:1000]), (EVENTS, "npz")),
    "no polarity": (lambda s: edit(s / EVENTS, polarity=None), (EVENTS, "polarity: missing")),
    "no timestamp": (lambda s: edit(s / EVENTS, timestamp=None), (EVENTS, "timestamp: missing")),
    "fewer polarities": (lambda s: edit(s / EVENTS, polarity=lambda p: p[:-3]), (EVENTS, "polarity: expected")),
    "fewer positions": (lambda s: edit(s / EVENTS, position=lambda p: p[:-3]), (EVENTS, "position: expected")),
    "transposed positions": (lambda s: edit(s / EVENTS, position=lambda p: p.T), (EVENTS, "position: expected")),
    "pixel outside": (lambda s: edit(s / EVENTS, position=lambda p: p + 9), (EVENTS, "position: row")),
    "polarity of 2": (lambda s: edit(s / EVENTS, polarity=lambda p: 2 * p.astype(int)), (EVENTS, "polarity")),
    "NaN timestamps": (lambda s: edit(s / EVENTS, timestamp=with_nan), (EVENTS, "timestamp: row 5")),
    "no event": (
        lambda s: edit(s / EVENTS, timestamp=lambda t: t[:0], position=lambda p: p[:0], polarity=lambda p: p[:0]),
        (EVENTS, "no events"),
    ),
    "no poses": (lambda s: (s / POSES).unlink(), (POSES, "no such file")),
    "no orientation": (lambda s: edit(s / POSES, T_wc_orientation=None), (POSES, "T_wc_orientation: missing")),
    "NaN position": (lambda s: edit(s / POSES, T_wc_position=with_nan), (POSES, "T_wc_position: row 5")),
    "NaN orientation": (lambda s: edit(s / POSES, T_wc_orientation=with_nan), (POSES, "T_wc_orientation: row 5")),
    "fewer positions of poses": (lambda s: edit(s / POSES, T_wc_position=lambda p: p[:-1]), (POSES, "T_wc_position")),
    "fewer orientations": (lambda s: edit(s / POSES, T_wc_orientation=lambda q: q[:-1]), (POSES, "T_wc_orientation")),
    "no unit quaternions": (lambda s: edit(s / POSES, T_wc_orientation=lambda q: 2 * q), (POSES, "unit quaternions")),
    "poses that stop early": (
        lambda s: edit(s / POSES, T_wc_timestamp=lambda t: t // 2),
        (POSES, "T_wc_timestamp: poses cover"),
    ),
    "poses that start late": (
        lambda s: edit(s / POSES, T_wc_timestamp=lambda t: t + 10**8),
        (POSES, "T_wc_timestamp: poses cover"),
    ),
    "poses in seconds": (
        lambda s: edit(s / POSES, T_wc_timestamp=lambda t: t * 1e-9),
        ("must increase", 'time_unit = "s"', "camera_poses.source.toml"),
    ),
    "poses out of order": (lambda s: edit(s / POSES, T_wc_timestamp=np.flip), (POSES, "must increase")),
    "no intrinsics": (lambda s: edit(s / CALIBRATION, intrinsics=None), (CALIBRATION, "intrinsics: missing")),
    "no threshold": (
        lambda s: edit(s / CALIBRATION, pos_contrast_threshold=None),
        (CALIBRATION, "pos_contrast_threshold: missing"),
    ),
    "negative threshold": (
        lambda s: edit(s / CALIBRATION, neg_contrast_threshold=np.negative),
        (CALIBRATION, "neg_contrast_threshold"),
    ),
    "no gain": (lambda s: edit(s / CALIBRATION, amplifier_gain=None), (CALIBRATION, "amplifier_gain: missing")),
    "unknown colours": (lambda s: edit(s / CALIBRATION, bayer_pattern=lambda _: np.array("XYZW")), ("bayer_pattern",)),
    "NaN cutoff": (lambda s: edit(s / CALIBRATION, sf_cutoff_freq=lambda f: f * np.nan), ("sf_cutoff_freq",)),
    "no transforms": (
        lambda s: [path.unlink() for path in (s / "views").glob("*.json")],
        ("transforms_test.json", "missing"),
    ),
    "transforms of nonsense": (
        lambda s: (s / "views" / "transforms_test.json").write_text("{"),
        ("transforms_test.json", "not valid JSON"),
    ),
    "transforms without angle": (
        lambda s: (s / "views" / "transforms_val.json").write_text(
            json.dumps({"frames": json.loads((s / "views" / "transforms_val.json").read_text())["frames"]})
        ),
        ("transforms_val.json", "camera_angle_x"),
    ),
    "missing picture": (lambda s: (s / "views" / "test" / "r_3.tiff").unlink(), ("r_3", "no such picture")),
    "damaged picture": (lambda s: (s / "views" / "test" / "r_3.tiff").write_bytes(b"II*\x00x"), ("r_3.tiff",)),
    "unknown colour space": (
        lambda s: edit(s / "renderer_params.npz", interm_color_space=lambda _: np.array("sRGB")),
        ("renderer_params.npz", "interm_color_space"),
    ),
    "no folder": (shutil.rmtree, ("expected the folder of a dataset", "found nothing")),
}


@pytest.mark.parametrize("wrong", BROKEN)
def test_a_broken_dataset_is_refused(wrong, scene, capsys):
    change, says = BROKEN[wrong]
    change(scene)
    assert main(["reconstruct", str(scene), "--out", str(scene.parent / "out")]) == 2
    printed = capsys.readouterr().err
    lines = printed.splitlines()
    assert 1 <= len(lines) <= 2, printed
    assert lines[0].startswith("pixelid: ")
    assert "Traceback" not in printed
    for word in says:
        assert word in printed
    assert not (scene.parent / "out").exists()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--fit", "nowhere"], "nowhere"),
        (["--sensor", "nowhere"], "nowhere"),
        (["--steps", "some"], "--steps"),
        (["--cells", "3"], "--cells"),
        (["--bandwidth", "maybe"], "maybe"),
        (["--samples", "0"], "--samples"),
        (["--box", "1", "1", "1", "0", "0", "0"], "--box"),
        (["--checkpoint", "missing/x.pt"], "does not exist"),
        (["--seed", "-1"], "--seed"),
        (["--train", "alpha"], "--train"),
    ],
)
def test_bad_usage_is_refused(made, tmp_path, capsys, options, says):
    assert main(["reconstruct", str(made), "--out", str(tmp_path / "out"), *options]) == 2
    printed = capsys.readouterr().err
    assert says in printed
    assert 1 <= len(printed.splitlines()) <= 2
    assert not (tmp_path / "out").exists()


def test_an_existing_result_is_kept(made, tmp_path, capsys):
    (tmp_path / "out").mkdir()
    assert main(["reconstruct", str(made), "--out", str(tmp_path / "out")]) == 2
    assert "exists already" in capsys.readouterr().err


def test_what_a_fit_leaves_uncertain_is_the_prior(tmp_path):
    entries = {
        "alpha": {"value": 5e4, "std": 500.0, "fixed": False},
        "beta": {"value": 1800.0, "std": None, "fixed": True},
        "gamma": {"value": 1.1, "std": None, "fixed": False},
    }
    (tmp_path / "fit.json").write_text(json.dumps({"parameters": entries}))
    assert uncertainty_of_fit(tmp_path) == pytest.approx({"alpha": 0.01, "beta": 1e-3})
    one_pole = {
        "alpha_over_beta": {"value": 33.0, "std": 0.33, "fixed": False, "identified": True},
        "sf_cutoff_hz": {"value": 3000.0, "std": 6000.0, "fixed": False, "identified": False},
    }
    (tmp_path / "fit.json").write_text(json.dumps({"parameters": one_pole}))
    assert uncertainty_of_fit(tmp_path) == pytest.approx({"alpha": 0.01})
    (tmp_path / "fit.json").write_text("{}")
    with pytest.raises(InputError, match=r"fit\.json: parameters"):
        uncertainty_of_fit(tmp_path)


@pytest.mark.parametrize(
    ("written", "says"),
    [
        ({"verdict": "named", "remainder": False, "unknown_term": None}, ()),
        ({"verdict": "unknown", "remainder": True}, ("what no effect explains",)),
        ({"verdict": "ambiguous", "recommended_next": {"why": "to tell leak from dark_current"}},
         ("ambiguous", "to tell leak from dark_current")),
        ({"verdict": "ambiguous", "recommended_next": None}, ("ambiguous",)),
    ],
)  # fmt: skip
def test_what_a_search_for_the_gap_left_open_is_named(written, says, tmp_path):
    (tmp_path / "gap.json").write_text(json.dumps({"remainder": False, "unknown_term": None, **written}))
    told = unexplained_by(tmp_path)
    assert len(told) == bool(says)
    assert all(word in told[0] for word in says)


@pytest.mark.parametrize(("correlation", "mean", "ratio"), [(0.0, 0.0283, 0.0566), (0.96, 0.0396, 0.0113)])
def test_mean_and_ratio_of_the_thresholds_are_as_uncertain_as_the_fit_left_them(correlation, mean, ratio, tmp_path):
    """Of two thresholds known to 4 %, the ratio is known well where they move together."""
    entries = {name: {"value": 0.25, "std": 0.01, "fixed": False} for name in ("on_threshold", "off_threshold")}
    matrix = [[0.04**2, 0.0, correlation * 0.04**2], [0.0, 1.0, 0.0], [correlation * 0.04**2, 0.0, 0.04**2]]
    covariance = {"names": ["off_threshold", "leak.rate_hz", "on_threshold"], "matrix": matrix}
    (tmp_path / "fit.json").write_text(json.dumps({"parameters": entries, "covariance": covariance}))
    assert uncertainty_of_fit(tmp_path) == pytest.approx({"threshold": mean, "ratio": ratio}, rel=2e-3)
    entries["on_threshold"]["identified"] = False
    (tmp_path / "fit.json").write_text(json.dumps({"parameters": entries, "covariance": covariance}))
    assert uncertainty_of_fit(tmp_path) == {}


def test_a_threshold_that_a_fit_knows_stays_near_it_while_it_is_trained(made, tmp_path):
    """A scene that still lacks contrast would have it at a quarter of what it is."""
    save_model(find_model("dvs128").without_effect("threshold_mismatch"), tmp_path / "model.toml")
    entries = {name: {"value": 0.25, "std": 0.0005, "fixed": False} for name in ("on_threshold", "off_threshold")}
    (tmp_path / "fit.json").write_text(json.dumps({"parameters": entries}))
    words = ["reconstruct", str(made), "--fit", str(tmp_path), "--train", "threshold", "--train", "ratio", "--quiet"]
    assert main([*words, "--out", str(tmp_path / "out"), "--steps", "100", "--batch", "64", "--cells", "16"]) in (0, 1)
    pixel = json.loads((tmp_path / "out" / "reconstruction.json").read_text())["pixel"]
    assert (pixel["on_threshold"], pixel["off_threshold"]) == pytest.approx((0.25, 0.25), rel=0.02)


@pytest.mark.parametrize(("level", "expected"), [(1.0, 0.5), (0.9, 0.5), (1.1, 2.0), (0.3, 0.3), (3.0, 3.0)])
def test_a_scene_begins_apart_from_its_background(level, expected):
    """Haze of the background's colour would make no event, whatever its density."""
    gauge = Gauge("background", np.ones(1), np.log([level]), None)
    assert gauge.start == pytest.approx(expected)
    assert Gauge("level", np.ones(1), np.log([level]), None).start == pytest.approx(level)
