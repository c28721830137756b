"""Exported parameters against what the simulators do with them, stated here anew from their equations."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from pixelid.cli.main import main
from pixelid.dynamics.of_circuit import dynamics_of
from pixelid.dynamics.trajectory import integrate
from pixelid.errors import InputError
from pixelid.export.circuit_values import circuit_values
from pixelid.export.export import TARGETS, export
from pixelid.export.light import Light
from pixelid.export.noise_rates import NoiseRates
from pixelid.model.files import save_model
from pixelid.model.shipped import find_model, shipped_models
from pixelid.nerf.data.calibration import CIRCUIT, COMPARATOR
from pixelid.parameters.gauge import Gauge
from pixelid.tables.latency.camera import Camera, save_camera

ONE_POLE = find_model("dvs128_low_light").without_effect("source_follower_pole").without_effect("differencing_pole")
FULL_LIGHT = 255.0


def parameters(model, to, light=None):
    return export(model, to, light or Light()).parameters


def mean_delay_of_step(model, level: float) -> float:
    """∫ (1 − y) dt [s] of a step of 1 % up to a light, from the trajectory that simulator and fit use."""
    t = np.concatenate([[0.0], np.geomspace(1e-9, 5.0, 40_000)])
    radiance = np.full(len(t), level)
    radiance[0] = level / 1.01
    path = integrate(t, radiance, dynamics_of(model.circuit()))
    y = 1.0 + (path.stage("differencing") - math.log(level)) / math.log(1.01)
    return float(np.trapezoid(1.0 - y, t))


@pytest.mark.parametrize("name", ["dvs128", "dvs128_low_light", "photoreceptor"])
@pytest.mark.parametrize("level", [FULL_LIGHT, 40.0])
def test_v2e_answers_as_late_as_the_trajectory(name, level):
    model = find_model(name)
    cutoff = parameters(model, "v2e", Light(level=level))["cutoff_hz"]
    theirs = 1.0 / (2 * math.pi * cutoff * (level + 20.0) / 275.0)  # the corner v2e gives DN = level
    assert theirs == pytest.approx(mean_delay_of_step(model, level), rel=2e-3)


@pytest.mark.parametrize("file", ["fit.json", "latency.json", "noise.json"])
def test_what_a_fit_left_open_is_said(tmp_path, file):
    save_model(ONE_POLE, tmp_path / "model.toml")
    (tmp_path / file).write_text(json.dumps({"unidentified": ["beta: anything"], "parameters": {}}))
    assert main(["export", str(tmp_path), "--to", "v2e", "--out", str(tmp_path / "v2e.txt"), "--quiet"]) == 0
    assert "not identified by the fit: beta: anything" in (tmp_path / "v2e.txt").read_text()


def test_what_a_fit_of_several_cameras_left_open_is_said_of_each(tmp_path):
    """Each camera has a folder of its own, and latency.json lies beside these."""
    (tmp_path / "a_b").mkdir()
    save_camera(Camera("a b", ONE_POLE, ()), tmp_path / "a_b" / "model.toml")
    left = {"unidentified": ["a b: beta: anything", "c: gamma: anything"], "parameters": {}}
    (tmp_path / "latency.json").write_text(json.dumps(left))
    assert main(["export", str(tmp_path / "a_b"), "--to", "v2e", "--out", str(tmp_path / "v2e.txt"), "--quiet"]) == 0
    said = (tmp_path / "v2e.txt").read_text()
    assert "not identified by the fit: a b: beta: anything" in said
    assert "gamma: anything" not in said


def test_of_a_folder_of_several_cameras_the_folders_are_named(tmp_path, capsys):
    for each in ("CAM1", "CAM3"):
        (tmp_path / each).mkdir()
        save_camera(Camera(each, ONE_POLE, ()), tmp_path / each / "model.toml")
    assert main(["export", str(tmp_path), "--to", "v2e", "--out", str(tmp_path / "v2e.txt"), "--quiet"]) == 2
    said = capsys.readouterr().err
    assert str(tmp_path / "CAM1") in said
    assert str(tmp_path / "CAM3") in said


def test_v2e_is_exact_at_every_light_for_its_own_pixel():
    model = ONE_POLE.with_effect("bandwidth_floor", {"radiance": 20.0})
    cutoff = parameters(model, "v2e")["cutoff_hz"]
    slope = model.values["alpha_over_beta"]
    for level in (30.0, 100.0, FULL_LIGHT):
        assert 2 * math.pi * cutoff * (level + 20.0) / 275.0 == pytest.approx(slope * (level + 20.0), rel=1e-12)


@pytest.mark.parametrize(
    ("knee", "slope", "told"), [(20.0, math.log(20.0), 0), (20.0, 1.0, 1), (5.0, math.log(20.0), 1)]
)
def test_v2e_has_the_linear_part_that_it_makes(knee, slope, told):
    """Of its own knee and slope nothing is lost; of others, which they are."""
    model = find_model("ideal").with_effect("linear_log", {"knee": 2.0 * knee, "slope": slope})
    lost = export(model, "v2e", Light(2.0 * FULL_LIGHT, 2.0 * FULL_LIGHT)).lost
    assert sum("linear" in sentence for sentence in lost) == told
    assert sum(f"the model has {knee:g} and {slope:.4g}" in sentence for sentence in lost) == told


def test_white_scales_the_light():
    dim = replace(ONE_POLE, parameters={**ONE_POLE.parameters})
    at_fifty = parameters(dim, "v2e", Light(50.0, 50.0))["cutoff_hz"]
    assert at_fifty == pytest.approx(dim.values["alpha_over_beta"] * 50.0 / (2 * math.pi))


def test_v2e_thresholds_leak_and_dead_time():
    model = find_model("dvs128").set({"on_threshold": 0.3, "off_threshold": 0.2}).with_effect("leak", {"rate_hz": 1.5})
    model = model.with_effect("parasitic_photocurrent", {"rate_hz_per_radiance": 0.01})
    p = parameters(model, "v2e", Light(level=100.0))
    assert (p["pos_thres"], p["neg_thres"], p["refractory_period"]) == (0.3, 0.2, model.values["refractory_s"])
    assert p["leak_rate_hz"] == pytest.approx(1.5 + 0.01 * 100.0)
    assert p["sigma_thres"] ** 2 == pytest.approx(np.mean([(0.03 * 0.3) ** 2, (0.03 * 0.2) ** 2]))
    assert p["leak_jitter_fraction"] == p["noise_rate_cov_decades"] == p["shot_noise_rate_hz"] == 0


def test_v2e_without_bandwidth_limit_has_no_cutoff():
    assert parameters(find_model("ideal"), "v2e")["cutoff_hz"] == 0


def test_shot_noise_rate_of_the_dark_is_scaled_as_v2e_scales_it_back(monkeypatch):
    monkeypatch.setattr("pixelid.export.v2e.shot_noise_rates", lambda model, radiance: NoiseRates(2.0, 1.0, ""))
    rate = parameters(find_model("dvs128").with_effect("shot_noise"), "v2e")["shot_noise_rate_hz"]
    factor = (0.25 - 1.0) * (1.0 + 20.0) / 275.0 + 1.0  # of a pixel of one grey level
    assert rate * factor == pytest.approx(3.0)


@pytest.mark.parametrize("level", [5.0, 60.0, FULL_LIGHT])
def test_iebcs_delay_is_right_at_every_light(level):
    model = find_model("dvs128").with_effect("dark_current", {"radiance": 4.0})
    p = parameters(model, "iebcs")
    value = level / 4.0  # image values are in units of the dark current
    theirs = 1e-6 * (1000.0 * p["tau"] / (value + 1.0) + p["lat"])
    assert theirs == pytest.approx(mean_delay_of_step(model.without_effect("dark_current"), level + 4.0), rel=2e-3)


def test_iebcs_intervals_on_a_ramp():
    """lat + ref of IEBCS is what follows each event here: amplifier's delay and dead time."""
    model = find_model("dvs128")
    p = parameters(model, "iebcs")
    after = 1.0 / (2 * math.pi * model.values["diff_cutoff_hz"]) + model.values["refractory_s"]
    assert p["lat"] + p["ref"] == pytest.approx(1e6 * after)
    assert p["th_noise"] == pytest.approx(0.04 * 0.25)
    assert p["bgnp"] > 0
    assert p["bgnn"] > 0


def test_iebcs_says_when_the_dead_time_is_too_short():
    exported = export(find_model("dvs128").set({"refractory_s": 1e-6}), "iebcs", Light())
    assert exported.parameters["ref"] == 0
    assert any("intervals are longer" in sentence for sentence in exported.lost)


def test_voltmeter_drift_of_a_slow_change():
    """μ Δt between two frames is the change of ln L in thresholds; the leak adds its events per second."""
    model = find_model("ideal").with_effect("dark_current", {"radiance": 8.0}).with_effect("leak", {"rate_hz": 3.0})
    p = parameters(model, "dvs-voltmeter")
    before, after, step_us = 100.0, 100.5, 1000.0
    mean = 0.5 * (before + after)
    drift = p["k1"] * (after - before) / (mean + p["k2"]) + (p["k4"] + p["k5"] * mean) * step_us
    change = math.log((after + 8.0) / (before + 8.0)) / model.values["on_threshold"]
    assert drift == pytest.approx(change + 3.0 * 1e-6 * step_us, rel=1e-5)


def test_voltmeter_noise_leaves_the_thresholds_at_the_circuits_rate(monkeypatch):
    rates = NoiseRates(1500.0, 1500.0, "")
    monkeypatch.setattr("pixelid.export.dvs_voltmeter.shot_noise_rates", lambda model, radiance: rates)
    p = parameters(find_model("dvs128").with_effect("shot_noise"), "dvs-voltmeter", Light(level=100.0))
    sigma = p["k3"] * math.sqrt(100.0) / (100.0 + p["k2"]) + p["k6"]
    rng, step_us = np.random.default_rng(0), 0.2
    walk = np.zeros(4000)
    events, steps = 0, 25_000
    for _ in range(steps):
        walk += sigma * math.sqrt(step_us) * rng.standard_normal(len(walk))
        crossed = np.abs(walk) >= 1.0
        events += int(crossed.sum())
        walk[crossed] = 0.0
    assert events / (len(walk) * steps * step_us * 1e-6) == pytest.approx(3000.0, rel=0.05)


@pytest.mark.parametrize("scale", [(1.0, 1.0, 1.0), (3.0, 0.4, 2.0), (1e-3, 1.0, 5.0)])
def test_circuit_values_make_the_same_events(scale):
    """Whatever picks them, the values give back the invariants, also where no gauge admits a solution."""
    model = find_model("dvs128")
    factors = dict(zip(("alpha", "beta", "gamma"), scale, strict=True))
    model = replace(model.set({k: model.values[k] * f for k, f in factors.items()}), gauge=Gauge(), physical=None)
    values = circuit_values(model)
    assert values is not None
    wanted = [model.values[name] for name in ("alpha", "beta", "gamma")]
    assert values.physical.invariants() == pytest.approx(wanted, rel=1e-7)
    assert min(values.physical.as_dict().values()) >= 0
    assert values.physical.A_loop > 0


def test_esim_flags_of_the_nominal_circuit():
    """The reference configuration of the DVS128: 35 fF, 0.6 fF, 25 mV, back gate 0.7, 140, 1815 µs."""
    p = parameters(find_model("dvs128"), "esim", Light(2000.0, 2000.0))
    expected = {"photodiode_cap_ff": 35.0, "miller_cap_ff": 0.6, "thermal_voltage_mv": 25.0, "back_gate_coeff": 0.7,
                "amplifier_gain": 140.0, "output_time_const_us": 1815.0, "I_p_to_intensity_ratio_fa": 2000.0,
                "sf_cutoff_freq_hz": 3122.0, "diff_amp_cutoff_freq_hz": 16000.0,
                "refractory_period_ns": 100000}  # fmt: skip
    assert {name: p[name] for name in expected} == pytest.approx(expected, rel=1e-6)


def test_esim_of_one_pole_has_its_corner():
    p = parameters(ONE_POLE, "esim")
    loop, charge = p["amplifier_gain"] * p["back_gate_coeff"], p["photodiode_cap_ff"] * 1e-3 * p["thermal_voltage_mv"]
    assert p["output_time_const_us"] == p["miller_cap_ff"] == 0
    assert (loop + 1.0) / charge == pytest.approx(ONE_POLE.values["alpha_over_beta"])


def test_esim_without_bandwidth_limit_keeps_the_dark_current():
    """Its black level is dark_current_fa over I_p_to_intensity_ratio_fa, infinite by default."""
    p = parameters(find_model("ideal").with_effect("dark_current", {"radiance": 8.0}), "esim", Light(2000.0, 2000.0))
    assert p["dark_current_fa"] / p["I_p_to_intensity_ratio_fa"] == pytest.approx(8.0 / 2000.0)
    assert not {"amplifier_gain", "photodiode_cap_ff"} & set(p)


def test_deblur_e_nerf_calibration_holds_the_keys_and_rates_that_its_readers_want():
    model, white = find_model("dvs128").with_effect("dark_current", {"radiance": 4.0}), 2000.0
    p = parameters(model, "deblur-e-nerf", Light(white, white))
    assert set(p) == {*CIRCUIT, *COMPARATOR}
    for intensity in (0.01, 0.3, 1.0):
        effective = intensity + p["black_level"]
        tau_in, tau_mil = (p[f"{name}_time_const_eff_it_prod"] / effective for name in ("input", "miller"))
        both = (tau_in + tau_mil) * p["output_time_const"]
        damping = (tau_in + p["output_time_const"] + (p["amplifier_gain"] + 1) * tau_mil) / both
        square = (p["amplifier_gain"] / p["closed_loop_gain"] + 1) / both
        radiance = intensity * white + 4.0
        assert square == pytest.approx(model.values["alpha"] * radiance)
        assert damping == pytest.approx(model.values["beta"] + model.values["gamma"] * radiance)


@pytest.mark.parametrize("to", TARGETS)
@pytest.mark.parametrize("name", shipped_models())
def test_every_effect_is_expressed_or_named_as_lost(name, to):
    model = find_model(name).with_effect("threshold_drift").with_effect("mains_flicker").with_effect("polarity_memory")
    exported = export(model, to, Light())
    said = " ".join(exported.lost)
    for effect in ("threshold_drift", "mains_flicker", "polarity_memory"):
        assert effect in said
    assert all(not math.isnan(value) for value in exported.parameters.values())


@pytest.mark.parametrize(("to", "described", "twin", "entry"), [
    ("v2e", "described.leak.none.constant", ("leak", "leak.rate_hz"), "leak_rate_hz"),
    ("v2e", "described.low_pass.none.constant", ("extra_pole", None), "cutoff_hz"),
    ("deblur-e-nerf", "described.high_pass.none.constant", ("lower_cutoff", "lower_cutoff.cutoff_hz"), None),
])  # fmt: skip
def test_a_description_with_a_name_in_the_library_is_carried_like_that(to, described, twin, entry):
    """It was exported, and said to be lost."""
    strength = 5e-4 if "low_pass" in described else 0.5
    named = {twin[1].split(".", 1)[1]: strength} if twin[1] else {"cutoff_hz": 1 / (2 * math.pi * strength)}
    ours = export(find_model("dvs128").with_effect(described, {"strength": strength}), to, Light())
    theirs = export(find_model("dvs128").with_effect(twin[0], named), to, Light())
    assert ours.parameters == pytest.approx(theirs.parameters)
    assert sorted(one.replace(described, twin[0]) for one in ours.lost) == sorted(theirs.lost)
    if entry is not None:
        assert ours.parameters[entry] != pytest.approx(export(find_model("dvs128"), to, Light()).parameters[entry])


@pytest.mark.parametrize("to", TARGETS)
def test_files_hold_parameters_and_losses(to, tmp_path, capsys):
    assert main(["export", "dvs128", "--to", to, "--out", str(tmp_path / "own")]) == 0
    printed = capsys.readouterr().out
    assert main(["export", "dvs128", "--to", to, "--out", str(tmp_path / "own.json"), "--quiet"]) == 0
    document = json.loads((tmp_path / "own.json").read_text())
    assert document["lost"]
    for sentence in document["lost"]:
        assert sentence in printed
    if to == "deblur-e-nerf":
        with np.load(tmp_path / "own") as arrays:
            assert list(arrays["lost"]) == document["lost"]
            assert float(arrays["sf_cutoff_freq"]) == pytest.approx(3122.0)
    elif to != "iebcs":
        text = (tmp_path / "own").read_text()
        assert all(sentence in text for sentence in document["lost"])


def test_v2e_lines_are_its_options(tmp_path):
    assert main(["export", "dvs128", "--to", "v2e", "--out", str(tmp_path / "v2e.args"), "--quiet"]) == 0
    lines = [line for line in (tmp_path / "v2e.args").read_text().splitlines() if line and not line.startswith("#")]
    options = dict(line.removeprefix("--").split("=") for line in lines)
    assert float(options["pos_thres"]) == 0.25
    assert set(options) >= {"cutoff_hz", "leak_rate_hz", "shot_noise_rate_hz", "sigma_thres", "refractory_period"}


def test_what_cannot_be_exported_is_refused(tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["export", "dvs128", "--to", "dvs", "--out", str(out)]) == 2
    assert main(["export", "dvs128", "--to", "v2e", "--white", "0", "--out", str(out)]) == 2
    assert main(["export", "dvs128", "--to", "v2e", "--level", "300", "--out", str(out)]) == 2
    assert "--level: expected a radiance above 0 and at most white (255), found 300" in capsys.readouterr().err
    assert not out.exists()
    with pytest.raises(InputError):
        Light(-1.0)


def test_shot_noise_through_two_poles_is_named_as_lost():
    """White noise through two poles crosses a threshold infinitely often: no rate stands for it."""
    model = find_model("photoreceptor").with_effect("shot_noise")
    exported = export(model, "v2e", Light())
    assert exported.parameters["shot_noise_rate_hz"] == 0
    assert any("at least three poles" in sentence for sentence in exported.lost)


def test_a_white_of_255_watts_is_told(tmp_path):
    """In units of irradiance the grey level of a white pixel is no level of light that anybody meant."""
    for model, words, told in (("imx636", [], 1), ("imx636", ["--white", "0.5"], 0), ("dvs128", [], 0)):
        out = tmp_path / "voltmeter.json"
        assert main(["export", model, "--to", "dvs-voltmeter", *words, "--out", str(out), "--overwrite"]) == 0
        assert out.read_text().count("since --white does not say") == told
