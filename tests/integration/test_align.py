"""From a camera's file and a light trace, each on its own clock, to a recording that a fit reads."""

import json
from dataclasses import replace

import h5py
import numpy as np
import pytest
from oracles.cameras import on_its_own_clock
from round_trip import clock_ns, write_camera
from test_schemas import check

from pixelid.cli.main import main as run
from pixelid.errors import InputError
from pixelid.fit import FitResult, fit
from pixelid.fit.engines import engine
from pixelid.fit.uncertainty.profiles import objective_of
from pixelid.model.shipped import find_model
from pixelid.outputs import plain
from pixelid.recordings import open_recording, write_recording
from pixelid.recordings.alignment import aligned, find_alignment
from pixelid.recordings.crop import Crop
from pixelid.recordings.triggers import Triggers
from pixelid.sample.sample import Target
from pixelid.simulate import simulate
from pixelid.stimuli import shapes
from pixelid.stimuli.files import load_stimulus

OFFSET, PPM = 1.6e9 + 0.123456, 50.0


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """(folder with camera.h5 and light.csv, the recording as simulated)."""
    folder = tmp_path_factory.mktemp("camera")
    light = shapes.steps(400.0, seed=3)
    recording = simulate(find_model("dvs128"), light, width=5, height=5, seed=0)
    write_recording(on_its_own_clock(recording, OFFSET, PPM), folder / "camera.h5")
    rows = "\n".join(f"{t:.9f},{r:.9g}" for t, r in zip(light.t - 7.5, light.radiance, strict=True))
    (folder / "light.csv").write_text(f"t_s,radiance_lux\n{rows}\n")  # the DAQ's clock shows -7.5 s at the begin
    return folder, recording


@pytest.mark.parametrize("how", ["auto", "trigger", "seconds"])
def test_the_light_finds_its_place(session, tmp_path, how):
    folder, recording = session
    say = f"{OFFSET + 7.5:.6f}" if how == "seconds" else how  # which knows nothing of the clocks' rates
    out = tmp_path / "aligned.h5"
    code = run(
        ["convert", str(folder / "camera.h5"), str(out), "--stimulus", str(folder / "light.csv"), "--align", say]
    )
    assert code == 0
    converted = open_recording(out)
    assert converted.stimulus is not None
    assert converted.stimulus.unit == "lux"
    # the same event and the same light, seen on both clocks
    k = len(recording.events) // 2
    when = recording.events.t[k] * 1e-9
    shifted = len(recording.events) - len(converted.events)
    assert shifted <= 5
    on_light = np.interp(converted.events.t[k - shifted] * 1e-9, converted.stimulus.t, recording.stimulus.t)
    assert on_light == pytest.approx(when, abs=2e-5 if how != "seconds" else 2e-5 + 1e-6 * PPM)
    with h5py.File(out) as file:
        told = json.loads(file.attrs["alignment"])
    assert told["method"] == ("given" if how == "seconds" else how)
    if how != "seconds":
        assert 1e6 * told["clock_rate_error"] == pytest.approx(PPM, abs=15)
        low, high = told["offset_interval_95"]
        assert low <= told["offset_s"] <= high
        assert (told["prior"]["delay_sd_s"] is None) == (how == "auto")
    assert "prior" in told


def edges_at(camera, seconds, channel=0):
    """The recording with rising edges at so many seconds of its clock after the light's begin."""
    t = np.rint((OFFSET + np.asarray(seconds) * (1.0 + 1e-6 * PPM)) * 1e9).astype(np.int64)
    return replace(camera, triggers=Triggers.from_columns(t, np.ones(len(t)), np.full(len(t), channel), where="edges"))


def test_of_many_edges_none_is_taken_for_the_last(session):
    """An edge each millisecond: the nearest to the light's end is any, and was said to tell the rate to 0.1 ppm."""
    folder, _ = session
    camera, light = open_recording(folder / "camera.h5"), load_stimulus(str(folder / "light.csv"))
    every = find_alignment(edges_at(camera, np.arange(0.0, 1.1 * light.duration_s, 5e-5)), light, "trigger")
    assert every.rate_error == 0.0
    assert every.prior is not None
    assert every.prior.rate_sd > 1e-5
    per_sample = find_alignment(edges_at(camera, light.t - light.t[0]), light, "trigger")
    assert 1e6 * per_sample.rate_error == pytest.approx(PPM, abs=15)


def test_falling_edges_are_said(session):
    folder, _ = session
    camera, light = open_recording(folder / "camera.h5"), load_stimulus(str(folder / "light.csv"))
    rising = edges_at(camera, [0.0])
    falling = replace(rising, triggers=replace(rising.triggers, rising=np.zeros(1, bool)))
    assert "no edge rises; falling ones are taken" in find_alignment(falling, light, "trigger").sentence()
    assert "falling" not in find_alignment(rising, light, "trigger").sentence()


def test_edges_at_two_inputs_are_told_apart(session):
    folder, _ = session
    camera, light = open_recording(folder / "camera.h5"), load_stimulus(str(folder / "light.csv"))
    here, there = edges_at(camera, [0.0]).triggers, edges_at(camera, [-0.5], channel=6).triggers
    both = replace(camera, triggers=Triggers.joined([here, there]))
    with pytest.raises(InputError, match="edges at the inputs 0, 6; say which, align trigger:0"):
        find_alignment(both, light, "trigger")
    alone = find_alignment(replace(camera, triggers=here), light, "trigger")
    assert find_alignment(both, light, "trigger:0").offset_s == alone.offset_s
    with pytest.raises(InputError, match="expected one of them, found '3'"):
        find_alignment(both, light, "trigger:3")


@pytest.mark.parametrize("how", [(), ("--align", "trigger")])
def test_light_ends_where_the_cut_does(session, tmp_path, how):
    """Beyond it pixels are not silent, nobody looks: 327 nats, and an unknown for a tick."""
    folder, recording = session
    source, light = folder / "camera.h5", folder / "light.csv"
    span = f"{OFFSET + 0.1:.6f}:{OFFSET + 0.31234:.6f}"
    if not how:
        source, span = tmp_path / "own.h5", "0.1:0.31234"
        write_recording(replace(recording, stimulus=None), source)
        light = tmp_path / "light.csv"
        rows = "".join(
            f"{t:.9f},{r:.9g}\n" for t, r in zip(recording.stimulus.t, recording.stimulus.radiance, strict=True)
        )
        light.write_text(f"t_s,radiance_lux\n{rows}")
    words = ["convert", str(source), str(tmp_path / "a.h5"), "--stimulus", str(light), "--time", span, *how]
    assert run(words) == 0
    found = open_recording(tmp_path / "a.h5")
    assert found.events.t[-1] * 1e-9 < 0.31234
    assert found.stimulus.end_s == pytest.approx(0.31234, abs=3e-5)


def test_trigger_edges_of_an_aedat4_file(session, tmp_path):
    """Events and edges written by the library faery, as of `benchmarks/round_trip.py`."""
    folder, recording = session
    end_s, offset_ns = float(recording.stimulus.t[-1]), int(OFFSET * 1e6) * 1000
    write_camera(tmp_path / "camera.aedat4", recording, [0.0, end_s], offset_ns, PPM)
    read = open_recording(tmp_path / "camera.aedat4")
    assert read.triggers is not None
    assert read.triggers.t.tolist() == [offset_ns, clock_ns(np.array([end_s]), offset_ns, PPM)[0]]
    light, out = str(folder / "light.csv"), tmp_path / "aligned.h5"
    assert run(["convert", str(tmp_path / "camera.aedat4"), str(out), "--stimulus", light, "--align", "trigger"]) == 0
    with h5py.File(out) as file:
        told = json.loads(file.attrs["alignment"])
    assert told["method"] == "trigger"
    assert 1e6 * told["clock_rate_error"] == pytest.approx(PPM, abs=15)


def fitted_after(folder, how: str, edges: int):
    """(recordings aligned by `how` with so many trigger edges, their fit)."""
    camera = open_recording(folder / "camera.h5")
    light = load_stimulus(str(folder / "light.csv"))
    camera = replace(camera, triggers=Triggers(*(column[:edges] for column in vars(camera.triggers).values())))
    recording = aligned(camera, light, find_alignment(camera, light, how))
    recording = Crop(pixels=9).applied(recording, 0)
    return [recording], fit([recording], find_model("dvs128"), starts=0, between="linear", engine="scipy")


def test_a_fit_carries_the_clock(session):
    """With one edge the rate is unknown, 50 ppm are 20 µs either way of the middle: the fit has to find them."""
    folder, _ = session
    recordings, result = fitted_after(folder, "trigger", 1)
    assert result.status == "converged", result.advice
    check("fit", json.loads(json.dumps(plain(result.as_dict()))))
    told = result.alignment["camera"]
    low, high = told["clock_rate_ppm_interval_95"]
    assert low - (high - low) < PPM < high + (high - low)
    assert high - low < 30
    assert not any("common delay" in sentence for sentence in result.unidentified)
    # the engines' own arithmetic, and what is sampled, agree with what was maximised
    objective, x = objective_of(result, recordings), result.x
    assert objective.coordinates.names[-2:] == ("alignment.delay_s[camera]", "alignment.clock_rate")
    for name in ("casadi", "torch"):
        assert engine(name).value(objective, x) == pytest.approx(objective.value(x), abs=1e-6)
    scale = np.sqrt(np.diag(objective.local(x).information))
    apart = (engine("torch").gradient(objective, x) - objective.gradient(x)) / scale
    np.testing.assert_allclose(apart[-2:], 0.0, atol=1e-3)  # in standard errors
    assert Target(result, recordings).value(x) == pytest.approx(objective.value(x), abs=1e-9)
    exact = fit(recordings, find_model("dvs128"), starts=0, between="linear", engine="scipy",
                fixed={"alignment.delay_s[camera]": 0.0, "alignment.clock_rate": 0.0})  # fmt: skip
    assert exact.log_likelihood < result.log_likelihood - 2.0
    assert exact.estimates["alignment.clock_rate"].fixed


@pytest.mark.slow
def test_without_a_trigger_the_delay_is_the_clocks_and_the_readouts(session):
    folder, _ = session
    _, result = fitted_after(folder, "auto", 2)
    assert any("common delay" in sentence for sentence in result.unidentified)
    told = result.alignment["camera"]
    low, high = told["delay_interval_95"]
    assert low < told["delay_s"] < high
    result.save(folder / "fit", overwrite=True)
    assert FitResult.load(folder / "fit").alignment == json.loads(json.dumps(plain(result.as_dict())))["alignment"]


def test_results_without_alignments_have_none(session):
    _, recording = session
    result = fit([Crop(pixels=4).applied(recording)], find_model("dvs128"), starts=0, between="linear", engine="scipy")
    assert result.alignment == {}
    assert not result.coordinates.nuisances
    assert "clocks" not in result.details["curvature"]


def test_two_offsets_as_good_as_each_other_are_refused(tmp_path, capsys):
    light = shapes.sine(100.0, 0.5, 10.0, duration_s=1.0)
    recording = simulate(find_model("dvs128"), light, width=3, height=3, seed=0)
    write_recording(on_its_own_clock(recording, 5.0, 0.0), tmp_path / "camera.h5")
    words = ["convert", str(tmp_path / "camera.h5"), str(tmp_path / "out.h5"), "--stimulus", "sine", "--align", "auto"]
    assert run(words) == 2
    assert "cannot say which" in capsys.readouterr().err
    assert not (tmp_path / "out.h5").exists()


def test_crops(session):
    _, recording = session
    events = recording.events
    part = Crop(roi=(1, 2, 3, 5), time_s=(0.2, 0.6)).applied(recording)
    inside = (events.x >= 1) & (events.x < 3) & (events.y >= 2) & (events.t >= 2e8) & (events.t < 6e8)
    np.testing.assert_array_equal(part.events.t, events.t[inside])
    assert part.stimulus is not None
    assert 0.6 <= part.stimulus.t[-1] <= 0.61
    some = Crop(pixels=7).applied(recording, 1)
    assert len(np.unique(some.events.pixel)) == 7
    np.testing.assert_array_equal(some.events.t, Crop(pixels=7).applied(recording, 1).events.t)
    assert set(np.unique(Crop(pixels=7).applied(recording, 2).events.pixel)) != set(np.unique(some.events.pixel))
