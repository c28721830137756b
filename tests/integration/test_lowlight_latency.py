"""`pixelid lowlight` with tables of latencies: poles of independently solved pixels, a broken law, bad input."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pixelid.cli.main import main
from pixelid.lowlight import latencies
from pixelid.lowlight.latency_source import read_source
from pixelid.model.shipped import find_model
from pixelid.tables.latency.camera import Camera, load_camera, save_camera
from pixelid.tables.latency.reading import read_tables
from pixelid.tables.latency.result import of_camera
from tests.oracles.latency_steps import Pixel, as_camera, write_table

FITS = Path(__file__).resolve().parents[2] / "fits"
PIXEL = Pixel(
    alpha=2e5 * 2e5, beta=2e5, gamma=0.034 * 2e5, follower=2e4, differencing=2e5, dark=3e-5, off_fraction=0.2,
    thresholds=((0.25, 0.2), (0.4, 0.35), (0.55, 0.5)), delays_s=((1e-5, 2e-5), (2e-5, 2e-5), (3e-5, 4e-5)),
)  # fmt: skip


def run(*words: object) -> int:
    return main([str(word) for word in (*words, "--quiet")])


def latency_of(folder: Path) -> dict:
    return json.loads((folder / "lowlight.json").read_text())["latency"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A table, its fit, and the low-light analysis of that fit's folder."""
    folder = tmp_path_factory.mktemp("lowlight")
    write_table(folder / "table.csv", PIXEL, 0.02, np.random.default_rng(3))
    assert run("latency", folder / "table.csv", "--out", folder / "fit") in (0, 1)
    assert run("lowlight", folder / "fit", "--out", folder / "out") in (0, 1)
    return folder


def test_a_fits_own_folder_brings_its_table_and_its_uncertainty(folder):
    found = latency_of(folder / "out")
    assert found["camera"] == "SIM"
    assert found["rows"] == 30
    assert found["model_misses_medians_by"] < 0.04
    assert len(found["levels"]) == 10
    for one in found["levels"]:
        low, high = one["interval_95"]
        true = PIXEL.dominant_pole(one["irradiance_W_m2"], one["edge"] == "on")
        assert low < true
        assert high is None or true < high
        assert one["model"]["interval_95"][0] < one["model"]["pole_rad_s"] < one["model"]["interval_95"][1]
    assert (folder / "out" / "latency_poles.svg").is_file()
    assert "from its latencies" in (folder / "out" / "report.html").read_text()


def test_one_cameras_folder_brings_the_table_and_uncertainty_of_the_fit_of_several(
    folder, tmp_path, capsys, monkeypatch
):
    """Each camera has a folder of its own, and latency.json lies beside these; they went without either."""
    said = json.loads((folder / "fit" / "latency.json").read_text())
    values, rows = said["parameters"], said["rows"]
    said["cameras"] = ["SIM", "other"]
    said["parameters"] = {
        of_camera(name, each, True): entry for each in said["cameras"] for name, entry in values.items()
    }
    said["rows"] = [{**row, "camera": each} for each in said["cameras"] for row in rows]
    (tmp_path / "latency.json").write_text(json.dumps(said))
    for each in said["cameras"]:
        (tmp_path / each).mkdir()
        save_camera(replace(load_camera(folder / "fit" / "model.toml"), name=each), tmp_path / each / "model.toml")
    asked = []

    def analysis(source, camera, drawn, seed):
        asked.append((source, camera, [model.values for model in drawn]))
        return latency_of(folder / "out")

    monkeypatch.setattr(latencies, "latency_analysis", analysis)
    for place in (tmp_path / "SIM", folder / "fit"):
        assert run("lowlight", place, "--out", tmp_path / "out", "--overwrite") in (0, 1)
    (several, camera, drawn), (alone, _, as_drawn) = asked
    assert (several.name, camera.name, several.files[0].parent) == ("SIM", "SIM", tmp_path)
    assert several.table.irradiance.tolist() == alone.table.irradiance.tolist()
    assert drawn == as_drawn
    assert len(drawn) > 1
    assert run("lowlight", tmp_path, "--out", tmp_path / "all") == 2
    assert str(tmp_path / "SIM") in capsys.readouterr().err


def test_half_of_a_latency_is_the_floor_where_it_is_twice_that_of_boundless_light(folder):
    for one in latency_of(folder / "out")["breaks"]:
        on, setting = one["edge"] == "on", int(one["setting"])
        low, high = one["half_is_floor_at"]["interval_95"]
        endless = PIXEL.latency_s(60.0, on, setting)  # 100 times the brightest row
        assert PIXEL.latency_s(low, on, setting) > 2.0 * endless > PIXEL.latency_s(high, on, setting)
        assert one["one_over_light_to"]["irradiance_W_m2"] < one["half_is_floor_at"]["irradiance_W_m2"]


def test_the_table_of_a_folder_is_the_table_it_was_fitted_to(folder):
    camera = Camera("SIM", find_model("gen31"), ())
    mine, theirs = read_source([folder / "fit"], camera).table, read_tables([folder / "table.csv"])
    for name in ("camera", "lens", "setting", "on", "irradiance", "bias"):
        assert getattr(mine, name).tolist() == getattr(theirs, name).tolist()
    np.testing.assert_allclose(mine.latency_s["median"], theirs.latency_s["median"])


@pytest.mark.slow
def test_a_photoreceptor_that_is_not_one_over_the_light_is_said_to_be(folder):
    """α falls as E^−0.3: the model does not meet the table, and the delay goes as E^−0.7 instead of E^−1."""
    write_table(folder / "broken.csv", PIXEL, 0.02, np.random.default_rng(4), lambda E: (E / 0.06) ** -0.3)
    save_camera(as_camera(PIXEL), folder / "true.toml")
    assert run("lowlight", folder / "true.toml", "--latency", folder / "broken.csv", "--out", folder / "broken") == 1
    written = json.loads((folder / "broken" / "lowlight.json").read_text())
    assert written["status"] == written["latency"]["status"] == "misfit"
    assert "fit it to this table" in written["advice"]
    for found in written["latency"]["exponents"].values():
        low, high = found["interval_95"]
        assert low < 0.7 < high < 1.0
    assert any("not as one over the light" in said for said in written["latency"]["sentences"])


@pytest.mark.skipif(not FITS.is_dir(), reason="needs a checkout")
@pytest.mark.slow
def test_a_shipped_sensor_by_its_recipe(tmp_path):
    """gen31: known poles in the dim, later stages in front of them in the bright, the model within the intervals."""
    assert run("lowlight", "gen31", "--latency", FITS / "gen31.toml", "--out", tmp_path / "out") == 0
    found = latency_of(tmp_path / "out")
    assert found["model_misses_medians_by"] < 0.03
    dim = [one for one in found["levels"] if one["irradiance_W_m2"] == 0.006]
    assert len(dim) == 4
    for one in dim:
        assert one["identified"]
        assert one["interval_95"][0] < one["model"]["pole_rad_s"] < one["interval_95"][1]
        assert one["interval_95"][1] / one["interval_95"][0] < 1.3
    bright = max(found["levels"], key=lambda one: one["light_W_m2"])
    assert not bright["identified"]
    assert any("later stages hide it" in said for said in found["sentences"])


@pytest.mark.skipif(not FITS.is_dir(), reason="needs a checkout")
def test_a_camera_without_medians_is_refused(tmp_path, capsys):
    lines = (FITS / "nist_latency" / "nist_latency_median_over_roi.csv").read_text().splitlines()
    median = lines[0].split(",").index("median")
    rows = [line.split(",") for line in lines[1:]]
    made = [[("" if k == median and row[0] == "CAM3" else value) for k, value in enumerate(row)] for row in rows]
    assert any(row[0] == "CAM3" for row in made)
    table = tmp_path / "t.csv"
    table.write_text("\n".join([lines[0], *(",".join(row) for row in made)]) + "\n")
    assert run("lowlight", "gen31", "--latency", table, "--camera", "CAM3", "--out", tmp_path / "out") == 2
    assert "CAM3: no latency has a median above 0" in capsys.readouterr().err


def test_a_damaged_fit_is_refused(folder, tmp_path, capsys):
    fit = tmp_path / "fit"
    fit.mkdir()
    (fit / "model.toml").write_bytes((folder / "fit" / "model.toml").read_bytes())
    content = json.loads((folder / "fit" / "latency.json").read_text())
    for damage in ({"rows": []}, {"rows": 3}, {"parameters": []}, {"rows": [{**content["rows"][0], "polarity": "x"}]}):
        (fit / "latency.json").write_text(json.dumps({**content, **damage}))
        assert run("lowlight", fit, "--out", tmp_path / "out") == 2
        assert "latency.json" in capsys.readouterr().err


def test_a_folder_of_a_fit_without_latencies_is_as_before(folder, tmp_path):
    assert run("lowlight", "dvs128", "--out", tmp_path / "out") == 0
    assert latency_of(tmp_path / "out") is None


def test_the_json_is_what_its_schema_says(folder):
    from tests.integration.test_schemas import check

    check("lowlight", json.loads((folder / "out" / "lowlight.json").read_text()))
