"""`pixelid biases`: laws of codes from simulated tables, whose formulas are written out here, and from public ones."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import pixelid as px
from pixelid.cli.main import main
from pixelid.errors import InputError
from pixelid.model.shipped import find_model
from pixelid.recordings import write_recording

PUBLIC = Path(__file__).resolve().parents[3] / "shared" / "recordings" / "imx636_bias"
CODES = (-20, -15, -10, -5, 0, 5, 10, 20, 30, 50, 80, 120, 160, 200)


def dead_time_us(code: float) -> float:
    """A capacitor charged by a current linear in the code, and 5 µs."""
    return 1000.0 / (code + 23.0) + 5.0


def threshold(own: float, amplifier: float) -> float:
    """A difference of voltages over a gain that falls with the amplifier's code."""
    return float(np.exp(0.008 * amplifier) * (0.25 + 0.0036 * own - 0.003 * amplifier))


def write(path: Path, header: str, rows) -> Path:
    path.write_text("\n".join([header, *(",".join(map(str, row)) for row in rows)]) + "\n")
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("biases")
    rng = np.random.default_rng(0)
    rows = [(code, round(dead_time_us(code) * np.exp(0.005 * rng.standard_normal()), 2)) for code in CODES]
    rows[6] = (CODES[6], 10 * rows[6][1])  # a slipped decimal point
    write(folder / "dead.csv", "bias_refr,dead_time_us", rows)
    rows = [
        (edge, d, own, f"{threshold(own, d) * np.exp(0.005 * rng.standard_normal()):.5f}", f"{spread:.5f}")
        for edge in ("on", "off")
        for d in (0, 10, 20)
        for own in (0, -10, -20, -35)
        for spread in [np.hypot(0.04, 0.02 * threshold(own, d)) * np.exp(0.02 * rng.standard_normal())]
    ]
    write(folder / "thresholds.csv", "polarity,bias_diff,bias_diff_on_off,threshold_median,mismatch_sd", rows)
    words = ["biases", folder / "dead.csv", folder / "thresholds.csv", "--at", "refr=15", "--at", "diff=5,diff_on=-15"]
    assert main([*map(str, words), "--out", str(folder / "laws"), "--quiet"]) == 0
    return folder


def written(folder: Path):
    return json.loads((folder / "biases.json").read_text())


def test_the_law_of_a_dead_time_is_that_of_its_circuit(folder):
    law = written(folder / "laws")["quantities"]["refractory_s"]
    assert law["law"] == "inverse of a linear current with a floor"
    for name, truth in (("scale", 1e-3), ("zero_current_code", -23.0), ("floor", 5e-6)):
        low, high = law["parameters"][name]["interval_95"]
        assert low < truth < high
        assert high - low < 0.2 * abs(truth)
    assert law["rivals"][1]["bic"] > 10.0


def test_a_mistyped_cell_is_named_and_moves_nothing(folder):
    sentences = written(folder / "laws")["quantities"]["refractory_s"]["sentences"]
    assert [s for s in sentences if "down-weighted" in s] == [s for s in sentences if "at bias_refr 10:" in s] != []


def test_settings_that_were_not_measured_are_predicted(folder):
    dead, on = written(folder / "laws")["predictions"]
    assert dead["value"] == pytest.approx(1e-6 * dead_time_us(15), rel=0.01)
    assert on["codes"] == {"bias_diff_on": -15.0, "bias_diff": 5.0}
    assert on["value"] == pytest.approx(threshold(-15, 5), rel=0.02)
    for one in (dead, on):
        assert one["interval_95"][0] < one["value"] < one["interval_95"][1]
        assert not one["extrapolated"]


def test_both_polarities_have_their_law_and_their_kind_of_mismatch(folder):
    content = written(folder / "laws")
    for edge in ("on", "off"):
        law = content["quantities"][f"{edge}_threshold"]
        assert list(law["codes"]) == [f"bias_diff_{edge}", "bias_diff"]
        assert law["law"] == "difference over a gain"
    for one in content["mismatch"]:
        assert one["kind"] in ("additive", "both")
        assert one["additive"]["interval_95"][0] < 0.04 < one["additive"]["interval_95"][1]


def test_a_saved_law_is_evaluated_on_codes_kept_back(folder, tmp_path):
    kept = write(
        tmp_path / "kept.csv", "bias_refr,dead_time_us", [(c, round(dead_time_us(c), 2)) for c in (-12, 3, 90)]
    )
    assert main(["biases", str(kept), "--model", str(folder / "laws"), "--predict", "--out", str(tmp_path / "o")]) == 0
    law = written(tmp_path / "o")["quantities"]["refractory_s"]
    assert law["rms"] < 0.01
    wrong = write(tmp_path / "wrong.csv", "bias_refr,dead_time_ms", [(c, dead_time_us(c)) for c in (-12, 3, 90)])
    result = px.biases(wrong, laws=folder / "laws")
    assert result.status == "misfit"
    asked = write(tmp_path / "asked.csv", "bias_diff_off,bias_diff", [(-5, 5), (-15, 15)])
    values = [one["value"] for one in px.biases(asked, laws=folder / "laws").content["predictions"]]
    assert values == pytest.approx([threshold(-5, 5), threshold(-15, 15)], rel=0.02)


def test_far_outside_the_measured_codes_intervals_widen_and_are_said_to_be_extrapolated(folder):
    near, far, none = px.biases(
        [folder / "dead.csv"], at=["refr=210", "refr=900", "refr=-40"]
    ).content["predictions"]  # fmt: skip
    widths = [np.log(one["interval_95"][1] / one["interval_95"][0]) for one in (near, far)]
    assert widths[1] > 1.1 * widths[0]
    assert "only the law's form" in far["note"]
    assert none["value"] is None
    assert none["extrapolated"]


@pytest.mark.parametrize(
    ("law", "unit", "names"),
    [
        (lambda c: 300.0 * np.exp(-(c - 1350.0) / 40.0), "hz", "exponential"),
        (lambda c: 0.4 * (c - 900.0), "hz", "linear"),
        (lambda c: 1.0 / (1.0 / (2.0 * (c - 1190.0)) + 1.0 / 300.0), "hz", "saturating linear current"),
    ],
)
def test_other_quantities_have_laws_of_their_own(law, unit, names, tmp_path):
    codes = np.arange(1200, 1500, 20)
    noise = np.exp(0.005 * np.random.default_rng(1).standard_normal(len(codes)))
    path = write(tmp_path / "t.csv", f"bias_fo,cutoff_{unit}", zip(codes, np.round(law(codes) * noise, 4), strict=True))
    content = px.biases(path, at="fo=1333").content
    found = content["quantities"]["sf_cutoff_hz"]
    assert found["law"] == names
    assert content["predictions"][0]["value"] == pytest.approx(law(1333.0), rel=0.02)


def test_maps_of_two_settings_part_additive_from_relative_mismatch(folder, tmp_path):
    rng = np.random.default_rng(2)
    additive, relative = (rng.standard_normal((60, 60)) for _ in range(2))
    maps = {
        f"on_{name}": theta * (1.0 + 0.1 * relative) + 0.03 * additive + 0.002 * rng.standard_normal((60, 60))
        for name, theta in (("a", 0.4), ("b", 0.15))
    }
    np.savez(tmp_path / "maps.npz", **maps)
    (one,) = px.biases(tmp_path / "maps.npz").content["mismatch"]
    assert one["kind"] == "both"
    assert one["additive"]["value"] == pytest.approx(0.03, rel=0.05)
    assert one["relative"]["value"] == pytest.approx(0.1, rel=0.05)


def test_a_fit_takes_priors_from_laws_at_the_codes_of_its_recording(folder, tmp_path):
    from dataclasses import replace

    model = find_model("dvs128").set({"on_threshold": 0.2, "off_threshold": 0.22})
    made = px.simulate(model, "slow", pixels=4, seed=1)
    codes = {"bias_refr": 20, "bias_diff": 10, "bias_diff_on": -12, "bias_diff_off": -9}
    write_recording(replace(made, attributes={**made.attributes, "biases": codes}), tmp_path / "slow.h5")
    words = ["fit", tmp_path / "slow.h5", "--model", "dvs128", "--between", "linear", "--bias-laws", folder / "laws"]
    for name in ("alpha", "beta", "gamma", "sf_cutoff_hz", "diff_cutoff_hz", "threshold_sigma"):
        words += ["--fix", f"{name}={model.values[name]}"]
    assert main([*map(str, words), "--out", str(tmp_path / "fit"), "--quiet"]) in (0, 1)
    fit = json.loads((tmp_path / "fit" / "fit.json").read_text())
    prior = fit["bias_priors"]["priors"]["refractory_s"]
    assert np.exp(prior["mean"]) == pytest.approx(1e-6 * dead_time_us(20), rel=0.01)
    assert fit["parameters"]["refractory_s"]["identified"]
    write_recording(replace(made, attributes={}), tmp_path / "bare.h5")
    words[1] = tmp_path / "bare.h5"
    assert main([*map(str, words), "--out", str(tmp_path / "no"), "--quiet"]) == 2


def test_a_shipped_circuit_at_a_setting_of_its_biases(capsys):
    values = {}
    for setting in ("refr=0", "refr=20,diff_on=-20"):
        assert main(["models", "imx636", "--bias", setting, "--quiet"]) == 0
        lines = capsys.readouterr().out.split("\n")
        values[setting] = {name: float(value) for name, _, value in (line.partition(" = ") for line in lines if line)}
    default, other = values.values()
    assert default["refractory_s"] == pytest.approx(52e-6, rel=0.03)  # as measured
    assert other["refractory_s"] == pytest.approx(29e-6, rel=0.03)
    assert default["on_threshold"] == pytest.approx(0.2525, rel=0.02)
    assert other["on_threshold"] == pytest.approx(0.1783, rel=0.02)
    assert other["off_threshold"] == default["off_threshold"]
    assert main(["models", "imx636", "--bias", "refr=-40"]) == 2  # no current
    assert main(["models", "dvs128", "--bias", "refr=0"]) == 2
    assert "--bias" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("header", "rows", "options", "says"),
    [
        ("bias_refr,dead", [(0, 1), (1, 2), (2, 3)], {}, "or unit; found none"),
        ("refr,dead_us", [(0, 1), (1, 2), (2, 3)], {}, "state them by bias"),
        ("bias_a,dead_us,latency_us", [(0, 1, 1), (1, 2, 2), (2, 3, 3)], {}, "choose by quantity"),
        ("bias_a,bias_b,bias_c,dead_us", [(0, 0, 0, 1), (1, 2, 1, 2), (2, 1, 5, 3)], {}, "choose by bias"),
        ("bias_a,dead_us", [(0, 1), (1, 2)], {}, "3 or more settings"),
        ("bias_a,dead_us", [(0, 1), (1, -2), (2, 3)], {}, "row 2"),
        ("bias_a,dead_us", [(0, 1), ("x", 2), (2, 3)], {}, "row 2"),
        ("bias_a,camera,dead_us", [(0, "A", 1), (1, "B", 2), (2, "A", 3)], {}, "camera"),
        ("bias_a,polarity,threshold", [(0, "up", 1), (1, "on", 2), (2, "on", 3)], {}, "polarity"),
        ("bias_a,dead_us", [(0, 1), (1, 2), (2, 3), (5, 4)], {"at": "b=1"}, "^at: "),
        ("bias_a,dead_us", [(0, 1), (1, 2), (2, 3), (5, 4)], {"at": "a=x"}, "^at: "),
    ],
)  # fmt: skip
def test_what_is_ambiguous_is_refused_with_the_option_that_states_it(header, rows, options, says, tmp_path):
    path = write(tmp_path / "t.csv", header, rows)
    with pytest.raises(InputError, match=says):
        px.biases(path, **options)


@pytest.mark.parametrize(
    ("key", "value"),
    [("form", "cubic"), ("x", [1.0]), ("weight", 0), ("freedom", -1), ("covariance", None), ("high", [-30.0])],
)
def test_damaged_laws_are_refused(key, value, folder, tmp_path):
    content = written(folder / "laws")
    content["quantities"]["refractory_s"]["rivals"][0]["fit"][key] = value
    (tmp_path / "biases.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"biases\.json"):
        px.biases(folder / "dead.csv", laws=tmp_path)


def test_columns_and_unit_can_be_stated(tmp_path):
    rows = [(c, dead_time_us(c), 1) for c in CODES]
    path = write(tmp_path / "t.csv", "register,reset,other", rows)
    content = px.biases(path, bias="register", quantity="reset", unit="us", at="register=7").content
    assert content["predictions"][0]["value"] == pytest.approx(1e-6 * dead_time_us(7), rel=1e-3)


@pytest.mark.skipif(not PUBLIC.is_dir(), reason="needs the public tables")
def test_half_of_the_public_dead_times_are_predicted_from_the_other(tmp_path):
    lines = (PUBLIC / "refractory_vs_bias_refr.csv").read_text().split()
    codes = sorted({line.split(",")[0] for line in lines[1:]})
    half = set(np.random.default_rng(0).permutation(codes)[: len(codes) // 2].tolist())
    for name, inside in (("half", True), ("kept", False)):
        rows = [line for line in lines[1:] if (line.split(",")[0] in half) == inside]
        (tmp_path / f"{name}.csv").write_text("\n".join([lines[0], *rows]) + "\n")
    px.biases(tmp_path / "half.csv").save(tmp_path / "laws")
    law = px.biases(tmp_path / "kept.csv", laws=tmp_path / "laws").content["quantities"]["refractory_s"]
    assert law["rms"] < 0.04


@pytest.mark.skipif(not PUBLIC.is_dir(), reason="needs the public tables")
@pytest.mark.parametrize("amplifier", ["0", "10", "20"])
def test_public_thresholds_of_a_setting_are_predicted_from_the_other_two(amplifier, tmp_path):
    lines = (PUBLIC / "thresholds_vs_bias.csv").read_text().split()
    for name, inside in (("rest", False), ("kept", True)):
        rows = [line for line in lines[1:] if (line.split(",")[1] == amplifier) == inside]
        (tmp_path / f"{name}.csv").write_text("\n".join([lines[0], *rows]) + "\n")
    px.biases(tmp_path / "rest.csv").save(tmp_path / "laws")
    for edge in ("on", "off"):
        rows = [line for line in (tmp_path / "kept.csv").read_text().split() if line.startswith(f"{edge},")]
        kept = tmp_path / f"{edge}.csv"
        kept.write_text(
            f"polarity,bias_diff,bias_diff_{edge},threshold\n" + "\n".join(r.rpartition(",")[0] for r in rows)
        )
        law = px.biases(kept, laws=tmp_path / "laws").content["quantities"][f"{edge}_threshold"]
        assert law["rms"] < 0.05


def test_cutoffs_of_a_finished_fit_of_rates_are_a_table(tmp_path):
    entries = {
        f"cutoff_hz[fo{code}]": {"value": 300.0 * np.exp(-(code - 1350) / 40.0), "unit": "Hz", "std": std,
                                 "identified": std is not None, "interval_95": [1.0, 2.0]}
        for code, std in ((1250, 30.0), (1300, 10.0), (1350, 3.0), (1400, 1.0), (1450, None))
    }  # fmt: skip
    (tmp_path / "rates.json").write_text(json.dumps({"parameters": entries | {"dead_time_s": entries.copy()}}))
    content = px.biases(tmp_path, at="fo=1450").content
    law = content["quantities"]["sf_cutoff_hz"]
    assert law["law"] == "exponential"
    assert law["parameters"]["log_slope.x"]["value"] == pytest.approx(-1 / 40.0, rel=0.01)
    assert content["predictions"][0]["value"] == pytest.approx(300.0 * np.exp(-100.0 / 40.0), rel=0.05)
    assert "without fo1450" in content["inferred"][0]
