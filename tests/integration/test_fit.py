"""Fits against the truth: independent practice data, our own simulator, and real pooled edges."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from pixelid.cli.main import main
from pixelid.errors import InputError
from pixelid.fit import fit
from pixelid.fit.uncertainty.profiles import profiled
from pixelid.model.shipped import find_model
from pixelid.parameters.gauge import Gauge
from pixelid.recordings import Recording, open_recordings, write_recording
from pixelid.simulate import simulate
from pixelid.stimuli.shapes import chirp, sine, steps
from pixelid.stimuli.stimulus import Stimulus

DVS128 = find_model("dvs128")


@pytest.fixture(scope="module")
def session():
    """(truth, recordings): four pixels of one camera under chirps at two levels and steps."""
    truth = DVS128.set(
        {"alpha": 5e4, "beta": 1500.0, "sf_cutoff_hz": 2500.0, "on_threshold": 0.2, "off_threshold": 0.23}
    )
    stimuli = [
        chirp(level=20.0, duration_s=0.4, stop_hz=200.0),
        chirp(level=300.0, duration_s=0.4, stop_hz=600.0),
        steps(level=60.0, duration_s=0.3),
    ]
    return truth, [simulate(truth, s, width=2, height=2, seed=5) for s in stimuli]


def test_practice_session_is_recovered_from_the_shipped_start(shared):
    truth = json.loads((shared / "gap_cases" / "truth.json").read_text())["null"]
    result = fit(open_recordings([shared / "gap_cases" / "null"]), DVS128)
    assert result.status == "converged"
    assert not result.unidentified
    within = dict.fromkeys(("alpha", "beta", "gamma", "sf_cutoff_hz"), 0.03)
    within |= {"diff_cutoff_hz": 0.10, "on_threshold": 0.02, "off_threshold": 0.02}
    for name, limit in within.items():
        assert result.estimates[name].value == pytest.approx(truth[name], rel=limit), name
        low, high = result.estimates[name].interval_95
        assert low < result.estimates[name].value < high
    assert result.estimates["refractory_s"].value == pytest.approx(truth["refractory_s"], abs=5e-6)
    # the practice light is smooth: a straight line between its samples loses hundreds of nats
    assert result.details["stimulus_between_samples"] == "smooth"


def test_own_session_lies_within_its_intervals(session):
    truth, recordings = session
    result = fit(recordings, DVS128, starts=1, between="linear")
    assert result.status == "converged"
    misses = 0
    for name, estimate in result.estimates.items():
        if estimate.fixed:
            continue
        z = abs(np.log(estimate.value / truth.values[name])) / (estimate.std / estimate.value)
        misses += z > 1.96
        assert z < 4.5, name
    assert misses <= 3


@pytest.mark.parametrize(
    ("base", "effect", "parameter", "value"),
    [
        ("dvs128_low_light", "bandwidth_floor", "bandwidth_floor.radiance", 12.0),
        ("dvs128", "polarity_memory", "polarity_memory.strength", 0.08),
        ("dvs128", "polarity_memory", "polarity_memory.strength", -0.08),
    ],
)
def test_an_effect_that_was_simulated_is_recovered_within_its_interval(base, effect, parameter, value):
    truth = find_model(base).with_effect(effect, {parameter: value})
    stimuli = [
        chirp(level=4.0, duration_s=0.4, stop_hz=200.0),
        chirp(level=60.0, duration_s=0.4, stop_hz=400.0),
        steps(level=12.0, duration_s=0.3),
    ]
    recordings = [simulate(truth, s, width=3, height=2, seed=11) for s in stimuli]
    start = truth.set({parameter: 0.7 * value})
    result = fit(recordings, start, starts=1, between="linear")
    assert result.status == "converged"
    low, high = result.estimates[parameter].interval_95
    assert low < value < high
    assert high - low < abs(value)


def test_fixed_parameters_stay_and_priors_pull(session):
    truth, recordings = session
    held = DVS128.fix({"gamma": truth.values["gamma"], "diff_cutoff_hz": truth.values["diff_cutoff_hz"]})
    result = fit(recordings, held, starts=0, between="linear")
    assert result.estimates["gamma"].fixed
    assert result.estimates["gamma"].value == truth.values["gamma"]
    assert result.model.values["diff_cutoff_hz"] == truth.values["diff_cutoff_hz"]


def test_one_level_gently_modulated_is_reported_as_not_identified():
    light = chirp(level=100.0, modulation=0.1, duration_s=0.4, stop_hz=100.0)
    model = DVS128.set({"on_threshold": 0.03, "off_threshold": 0.03})
    result = fit([simulate(model, light, width=2, height=2, seed=2)], model, starts=0, between="linear")
    assert result.unidentified
    assert not all(result.estimates[name].identified for name in ("alpha", "beta", "gamma"))


def test_a_single_free_parameter_is_profiled():
    """Nothing is left free where a profile holds it: the information of no coordinate is a matrix of none."""
    only = DVS128.fix({name: None for name in DVS128.free if name != "sf_cutoff_hz"})
    recording = simulate(only, sine(24.0, duration_s=0.3), width=2, height=1)
    result = fit([recording], only, starts=0)
    assert set(profiled(result, [recording]).details["profiles"]) == {"sf_cutoff_hz"}


def test_gauge_is_checked_before_anything_runs(session):
    _, recordings = session
    with pytest.raises(InputError, match="2 directions left flat"):
        fit(recordings, DVS128, gauge=Gauge.parse({"q_in": 0.875}))
    with pytest.raises(InputError, match="over-determined"):
        fit(recordings, DVS128, gauge=Gauge.parse({"q_in": 1, "q_mil": 1, "radiance_scale": 1}))


def test_input_that_cannot_be_fitted_is_refused(session):
    _, recordings = session
    with pytest.raises(InputError, match="no recordings"):
        fit([], DVS128)
    with pytest.raises(InputError, match="pooled"):
        fit([recordings[0], replace(recordings[1], pooled=True)], DVS128)
    with pytest.raises(InputError, match="threshold_noise"):
        fit(recordings, DVS128.without_effect("threshold_noise"))
    short = recordings[0].stimulus
    cut = Stimulus(short.t[:100], short.radiance[:100])
    with pytest.raises(InputError, match="cover"):
        fit([recordings[0].with_stimulus(cut)], DVS128)
    with pytest.raises(InputError, match="every parameter is fixed"):
        fit(recordings, DVS128.fix(dict.fromkeys(DVS128.parameters)))


def square_light(duration=2.0, seed=0):
    rng = np.random.default_rng(seed)
    t = np.arange(0, duration, 2e-3)
    return Stimulus(t, rng.integers(0, 2, len(t)).astype(float), "shape", "previous")


def test_pooled_rates_recover_bandwidth_and_delay_from_poisson_counts():
    """Counts drawn by NumPy from rates of an ODE solution, not from the project's own kernel."""
    from scipy.signal import lfilter

    light = square_light()
    delay, corner_hz, dt = 3.1e-4, 300.0, 1e-5
    fine = np.arange(0, light.t[-1] + 2e-3, dt)
    u = np.log(1 + 1.0 * light.radiance[np.searchsorted(light.t, fine, side="right") - 1])
    decay = np.exp(-2 * np.pi * corner_hz * dt)
    y = lfilter([0.0, 1.0 - decay], [1.0, -decay], u - u[0])
    rng = np.random.default_rng(1)
    rate = np.diff(y)
    times, signs = [], []
    for sign in (1, -1):
        counts = rng.poisson(400 * np.maximum(sign * rate, 0) + 200 * dt)
        at = np.repeat(fine[:-1], counts) + rng.uniform(0, dt, counts.sum()) + delay
        times.append(at)
        signs.append(np.full(len(at), sign == 1))
    order = np.argsort(np.concatenate(times))
    t = (np.concatenate(times)[order] * 1e9).astype(np.int64)
    from pixelid.recordings import Events

    zeros = np.zeros(len(t), int)
    events = Events.from_columns(t, zeros, zeros, np.concatenate(signs)[order].astype(np.uint8), 1, 1)
    recording = Recording(events, light, pooled=True)
    # a photoreceptor without limit and one pole: what the data contain
    model = find_model("ideal").with_effect("source_follower_pole")
    result = fit([recording], model, fixed={"stimulus.gain": 1.0})
    estimates = result.estimates
    assert result.status == "converged"
    assert result.observation == "pooled_rate"
    assert estimates["delay_s"].value == pytest.approx(delay, abs=4 * estimates["delay_s"].std + dt)
    assert estimates["sf_cutoff_hz"].value == pytest.approx(corner_hz, rel=0.02)
    ratio = estimates["on_threshold"].value / estimates["pooled.pixels"].value
    assert ratio == pytest.approx(1 / 400, rel=0.05)
    assert result.details["dispersion"] == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow
def test_led_edges_end_with_a_fit_and_an_honest_list(shared, tmp_path):
    names = ("led_uart_504hz_30m.h5", "led_uart_3125hz_30m.h5")
    files = [str(shared / "recordings" / name) for name in names]
    code = main(["fit", *files, "--model", "dvs128", "--out", str(tmp_path / "led"), "--quiet"])
    written = json.loads((tmp_path / "led" / "fit.json").read_text())
    assert (code, written["status"]) == (1, "misfit")  # counts scatter far more than Poisson counts about any circuit
    assert written["observation"] == "pooled_rate"
    assert written["parameters"]["delay_s"]["interval_95"]
    assert any("gauge" in sentence for sentence in written["unidentified"])
    assert (tmp_path / "led" / "edges.svg").stat().st_size > 10_000


def test_fit_command_writes_a_folder_that_is_a_model(session, tmp_path, capsys):
    _, recordings = session
    for i, recording in enumerate(recordings[:2]):
        write_recording(recording, tmp_path / f"r{i}.h5")
    (tmp_path / "recipe.toml").write_text(
        '[fit]\nrecordings = ["r0.h5", "r1.h5"]\nmodel = "dvs128"\nbetween = "linear"\nfix = ["gamma=1.12"]\nseed = 4\n'
    )
    assert main(["fit", str(tmp_path / "recipe.toml"), "--out", str(tmp_path / "fit"), "--quiet"]) == 0
    written = json.loads((tmp_path / "fit" / "fit.json").read_text())
    keys = "status advice model engine observation parameters physical gauge unidentified log_likelihood events pixels"
    assert set(keys.split()) <= set(written)
    assert written["seed"] == 4
    assert set(written["inputs_sha256"]) == {"r0.h5", "r1.h5"}
    assert find_model(tmp_path / "fit").values["gamma"] == 1.12
    assert "<svg" in (tmp_path / "fit" / "report.html").read_text()
    assert capsys.readouterr().err == ""
    assert main(["fit", str(tmp_path / "recipe.toml"), "--out", str(tmp_path / "fit"), "--quiet"]) == 2
    assert "exists already" in capsys.readouterr().err
