"""`pixelid latency` on tables simulated event by event: recovery, prediction of what was not fitted, public data."""

import csv
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest

from pixelid.cli.main import main
from pixelid.model.shipped import find_model, shipped_models
from pixelid.tables.fit import log_posterior_at
from pixelid.tables.latency.camera import load_camera
from pixelid.tables.latency.fit import fit_latency
from pixelid.tables.latency.posterior import log_posterior, sample_fit
from pixelid.tables.latency.reading import read_tables
from pixelid.tables.latency.settings import bias_of
from tests.oracles import latency_tables
from tests.oracles.latency_tables import DELAY_S, SETTINGS, TRUE, write_table

NIST = Path(__file__).resolve().parents[2] / "fits" / "nist_latency" / "nist_latency_median_over_roi.csv"


def run(*words: object) -> int:
    return main([str(word) for word in (*words, "--quiet")])


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("latency")
    write_table(folder / "table.csv")
    assert run("latency", folder / "table.csv", "--out", folder / "fit") in (0, 1)
    return folder


def result(folder: Path) -> dict:
    return json.loads((folder / "latency.json").read_text())


def test_rows_are_the_tables_rows(folder):
    rows = result(folder / "fit")["rows"]
    with (folder / "table.csv").open() as file:
        table = list(csv.DictReader(file))
    assert len(rows) == len(table)
    for row, cells in zip(rows, table, strict=True):
        assert row["bias_config"] == cells["bias_config"]
        assert row["measured"] == pytest.approx(1e-6 * float(cells["median"]))
        assert set(row["statistics"]) == {"median", "min", "max", "stdev"}


def test_medians_extremes_and_bandwidth_are_recovered(folder):
    found = result(folder / "fit")
    errors = found["errors"]["SIM"]
    assert errors["median"]["rms"] < 0.02
    assert errors["min"]["rms"] < 0.06
    assert errors["max"]["rms"] < 0.06
    corner = found["parameters"]["alpha_over_beta"]
    low, high = corner["interval_95"]
    assert low / 1.1 < TRUE["alpha"] / TRUE["beta"] < high * 1.1
    for edge, place in (("on", 0), ("off", 1)):
        values = [found["parameters"][f"{edge}_threshold[{name}]"]["value"] for name in SETTINGS]
        truth = [thresholds[place] for thresholds in SETTINGS.values()]
        np.testing.assert_allclose(values / np.mean(values), truth / np.mean(truth), rtol=0.1)


def test_other_irradiances_and_settings_are_predicted(folder, monkeypatch):
    monkeypatch.setattr(latency_tables, "SETTINGS", {"0.25MAX": (0.525, 0.475)})
    write_table(folder / "other.csv", (0.02, 0.1), edges=3)
    assert run("latency", folder / "other.csv", "--model", folder / "fit", "--predict", "--out", folder / "check") == 0
    assert result(folder / "check")["errors"]["SIM"]["median"]["rms"] < 0.05


def test_a_prediction_that_misses_every_row_or_many_is_a_misfit(folder):
    """Rows that the model disbelieves are marked as spoiled; that they are many is not left out with them."""
    lines = (folder / "table.csv").read_text().splitlines()
    at = [lines[0].split(",").index(name) for name in ("min", "median", "max")]

    def slower(factor: float, every: int) -> Path:
        rows = [line.split(",") for line in lines[1:]]
        for row in rows[::every]:
            for k in at:
                row[k] = str(factor * float(row[k])) if row[k] else ""
        path = folder / f"slower_{factor}_{every}.csv"
        path.write_text("\n".join([lines[0], *(",".join(row) for row in rows)]) + "\n")
        return path

    for factor, every, code in ((3.0, 1, 1), (10.0, 1, 1), (3.0, 3, 1), (3.0, 12, 0)):
        words = ["latency", slower(factor, every), "--model", folder / "fit", "--predict", "--out", folder / "slower"]
        assert run(*words, "--overwrite") == code, (factor, every)
        assert result(folder / "slower")["status"] == ("misfit" if code else "converged")


def test_a_prediction_of_zeros_or_of_extremes_alone_is_judged_too(folder):
    """Once `converged`: medians of zero were left out, and rows without medians said nothing."""
    lines = (folder / "table.csv").read_text().splitlines()
    names = lines[0].split(",")
    median = names.index("median")
    rows = [line.split(",") for line in lines[1:]]

    def code(made: list[list[str]]) -> int:
        path = folder / "judged.csv"
        path.write_text("\n".join([lines[0], *(",".join(row) for row in made)]) + "\n")
        words = ["latency", path, "--model", folder / "fit", "--predict", "--out", folder / "judged", "--overwrite"]
        return run(*words)

    zero = [[("0" if k == median and value else value) for k, value in enumerate(row)] for row in rows]
    assert code(zero) == 1
    bare = [[("" if k == median else value) for k, value in enumerate(row)] for row in rows]
    assert code(bare) == 0
    far = [names.index(name) for name in ("min", "max")]
    late = [[(str(5e6) if k in far and value else value) for k, value in enumerate(row)] for row in bare]
    assert code(late) == 1
    assert result(folder / "judged")["status"] == "misfit"


def test_what_a_prediction_rests_on_is_said(folder, capsys):
    table = folder / "far.csv"
    head = "camera,lens,polarity,irradiance_W_m2,bias_config\n"
    table.write_text(head + "SIM,lens,1,0.02,20\n")
    words = ["latency", table, "--model", folder / "fit", "--predict", "--overwrite", "--out", folder / "far"]
    assert run(*words) == 2
    assert "too far" in capsys.readouterr().err
    beyond = max(bias for name in SETTINGS if (bias := bias_of(name)) is not None) + 0.1
    table.write_text(head + f"SIM,lens,1,0.02,{beyond}\nSIM,lens,1,1e-9,0\n")
    run(*words)
    said = " ".join(result(folder / "far")["unidentified"])
    assert "extrapolated" in said
    assert "stands for never" in said
    table.write_text(head + "OTHER,fisheye,1,0.02,0\n")
    run(*words)
    said = " ".join(result(folder / "far")["unidentified"])
    assert "OTHER: predicted by the model of" in said
    assert "'fisheye' was not fitted" in said


def test_medians_of_zero_are_none(tmp_path, capsys):
    table = tmp_path / "zero.csv"
    rows = [f"{k % 2},{0.01 * (1 + k // 2)},0,{100e-6 if k == 0 else 0}" for k in range(8)]
    table.write_text("\n".join(["polarity,irradiance_W_m2,bias_config,median", *rows]) + "\n")
    assert run("latency", table, "--out", tmp_path / "out") == 2
    assert "with a median of 0.1 µs or more" in capsys.readouterr().err


def test_a_table_without_latencies_is_predicted(folder):
    bare = folder / "bare.csv"
    bare.write_text("camera,lens,polarity,irradiance_W_m2,bias_config\nSIM,lens,1,0.02,0\n")
    assert run("latency", bare, "--model", folder / "fit", "--predict", "--out", folder / "bare") == 0
    row = result(folder / "bare")["rows"][0]
    assert row["measured"] is None
    assert row["predicted"] > DELAY_S


def test_one_model_speaks_for_two_units(tmp_path):
    table = tmp_path / "units.csv"
    lines = ["camera,lens,polarity,irradiance_W_m2,bias_config", "A,lens1,1,0.02,0", "B,lens1,1,0.02,0"]
    table.write_text("\n".join(lines) + "\n")
    assert run("latency", table, "--model", "imx636", "--predict", "--out", tmp_path / "out") == 0
    first, second = result(tmp_path / "out")["rows"]
    assert first["predicted"] == second["predicted"] > 0


def test_the_model_opens_everywhere_and_keeps_its_settings(folder):
    model = find_model(folder / "fit")
    assert model.radiance_unit == "W/m2"
    assert model.parameters["alpha"].source
    camera = load_camera(folder / "fit" / "model.toml")
    assert [s.name for s in camera.settings] == list(SETTINGS)
    assert camera.settings[1].on_threshold == model.values["on_threshold"]


def test_unknown_settings_cameras_and_units_are_refused(folder, capsys):
    table = folder / "strange.csv"
    table.write_text("camera,lens,polarity,irradiance_W_m2,bias_config\nSIM,lens,1,0.02,night\n")
    assert run("latency", table, "--model", folder / "fit", "--predict", "--out", folder / "no") == 2
    assert "night" in capsys.readouterr().err
    assert run("latency", table, "--model", "dvs128", "--predict", "--out", folder / "no") == 2
    assert "W/m2" in capsys.readouterr().err
    assert run("latency", table, "--predict", "--out", folder / "no") == 2
    assert run("latency", table, "--out", folder / "no") == 2
    assert run("latency", folder / "table.csv", "--camera", "other", "--out", folder / "no") == 2


def test_nothing_is_drawn_where_the_fit_describes_nothing(tmp_path):
    """The scatter lies outside what the posterior allows, and looking for a start within it never ended."""
    rng = np.random.default_rng(1)
    lines = ["camera,lens,polarity,irradiance_W_m2,bias_config,median"]
    lines += [f"C,l,1,{E},0,{np.exp(rng.uniform(0, 12))}" for E in np.geomspace(0.01, 0.3, 12)]
    (tmp_path / "table.csv").write_text("\n".join(lines) + "\n")
    fit = fit_latency(read_tables([tmp_path / "table.csv"]))
    assert fit.fits[0].regression.scale > 1.0
    said = sample_fit(fit, 1, steps=12)[0]["C"]
    assert (said["status"], said["draws"], said["parameters"]) == ("misfit", 0, {})
    assert not (tmp_path / "posterior.npz").exists()


def test_the_posterior_is_that_of_the_fit_and_of_its_seed(tmp_path):
    lines = ["camera,lens,polarity,irradiance_W_m2,bias_config,median"]
    lines += [f"C,l,1,{E},0,{5 / E + 30}" for E in (0.01, 0.03, 0.1, 0.3)]
    (tmp_path / "table.csv").write_text("\n".join(lines) + "\n")
    fit = fit_latency(read_tables([tmp_path / "table.csv"]))
    said = sample_fit(fit, 1, steps=12)[0]["C"]
    again = sample_fit(fit, 1, steps=12)[0]["C"]
    assert said["parameters"] == again["parameters"]
    assert said["parameters"] != sample_fit(fit, 2, steps=12)[0]["C"]["parameters"]
    one = fit.fits[0]
    best = log_posterior(one, np.append(one.regression.x, np.log(0.05)))
    worse = log_posterior(one, np.append(one.regression.x + 1.0, np.log(0.05)))
    assert np.isfinite(best)
    assert worse < best


@pytest.mark.slow
def test_poles_that_can_be_exchanged_are_not_told_apart(tmp_path):
    """A photoreceptor's own pole near the follower's: the table is met as well with the two exchanged."""
    true = {**TRUE, "alpha": 2e5 * 2500.0, "beta": 2500.0, "sf_cutoff_hz": 1500.0, "diff_cutoff_hz": 2e4}
    table = read_tables([write_table(tmp_path / "table.csv", (0.006, 0.02, 0.05, 0.3), 3, true)])
    fit = fit_latency(table)
    entries = fit.fits[0].regression.as_dict()
    for name in ("beta", "sf_cutoff_hz"):
        low, high = entries[name]["interval_95"]
        assert low < true[name] < high
    again = fit_latency(table, start=fit.cameras)  # from there, the same end
    first, second = (log_posterior_at(one.fits[0].regression, one.fits[0].regression.x) for one in (fit, again))
    assert abs(first - second) < 0.5


@pytest.mark.slow
@pytest.mark.skipif(not NIST.is_file(), reason="needs a checkout")
def test_public_table_of_a_gen31(tmp_path):
    assert run("latency", NIST, "--camera", "CAM3", "--out", tmp_path / "out") in (0, 1)
    found = result(tmp_path / "out")
    on = [row for row in found["rows"] if row["polarity"] == 1]
    logs = [np.log(row["predicted"] / row["measured"]) for row in on]
    assert np.sqrt(np.mean(np.square(logs))) < 0.03
    assert_limited_like_a_gen31(found)


def assert_limited_like_a_gen31(found: dict) -> None:
    """By the photoreceptor in the dimmest light, by a later stage in the brightest."""
    last = max((e for e in found["limits"] if e["edge"] == "on"), key=lambda e: e["irradiance_W_m2"])
    first = min((e for e in found["limits"] if e["edge"] == "on"), key=lambda e: e["irradiance_W_m2"])
    assert first["stage"] == "photoreceptor"
    assert last["stage"] != "photoreceptor"


@pytest.mark.slow
@pytest.mark.skipif(not NIST.is_file(), reason="needs a checkout")
@pytest.mark.parametrize(("name", "cameras", "least"), [("gen31", ["CAM3"], 0.03), ("imx636", ["CAM1", "CAM2"], 0.08)])
def test_a_shipped_sensor_is_what_its_recipe_gives(name, cameras, least, tmp_path):
    assert run("latency", NIST.parent.parent / f"{name}.toml", "--out", tmp_path / "out") == 0
    found, shipped = load_camera(tmp_path / "out" / "model.toml"), load_camera(shipped_models()[name])
    assert found.model.name == name
    assert found.model.effects == shipped.model.effects
    parameters = result(tmp_path / "out")["parameters"]
    for key, entry in parameters.items():
        if key in found.model.values and entry["identified"]:
            low, high = entry["interval_95"]
            assert low < shipped.model.values[key] < high
    # What the table hardly tells moves with the rounding of a computer's linear algebra, within what is known.
    for mine, theirs in zip(found.settings, shipped.settings, strict=True):
        for side in ("on", "off"):
            low, high = parameters[f"{side}_threshold[{mine.name}]"]["interval_95"]
            sd = math.log(high / low) / (2 * 1.96)
            away = math.log(getattr(mine, f"{side}_threshold") / getattr(theirs, f"{side}_threshold"))
            assert abs(away) < 0.5 * sd
    errors = result(tmp_path / "out")["errors"]
    assert sorted(errors) == cameras
    assert all(errors[camera]["median"]["rms_without_spoiled"] < least for camera in cameras)
    if name == "gen31":
        assert_limited_like_a_gen31(result(tmp_path / "out"))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[rates]\n", "expected a \\[latency\\] table"),
        ('[latency]\ntables = []\ncameras = ["A"]\nname = "a"\nsummary = "s"\n', "tables: expected a list of texts"),
        ('[latency]\ntables = ["t.csv"]\ncameras = ["B"]\nname = "a"\nsummary = "s"\n', "have A, found 'B'"),
        ('[latency]\ntables = ["t.csv"]\ncameras = ["A"]\nname = 3\nsummary = "s"\n', "name: expected a text"),
        ('[latency]\nname = "a"\nkind = 1\n', "expected one of tables"),
        ('[latency]\ntables = ["t.csv"]\ncameras = ["A"]\nname = "a"\nsummary = "s"\nwithout = ["leek"]\n',
         "did you mean .*leak"),
    ],
)  # fmt: skip
def test_a_wrong_recipe_is_said(text, words, tmp_path, capsys):
    lines = ["camera,lens,polarity,irradiance_W_m2,bias_config,median", "A,l,1,0.01,0,500", "A,l,1,0.1,0,80"]
    (tmp_path / "t.csv").write_text("\n".join(lines) + "\n")
    (tmp_path / "r.toml").write_text(text)
    assert run("latency", tmp_path / "r.toml", "--out", tmp_path / "out") == 2
    said = capsys.readouterr().err
    assert re.search(words, said)
    assert said.count("\n") <= 2
    assert not (tmp_path / "out").exists()
