"""Every file that a command writes is what docs/schemas says, and so is every TOML file that the project ships."""

from __future__ import annotations

import json
import tomllib
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from pixelid.cli.main import main
from pixelid.demo.demo import BENCH

jsonschema = pytest.importorskip("jsonschema")
referencing = pytest.importorskip("referencing")

ROOT = Path(__file__).resolve().parents[2]
SCHEMAS = ROOT / "docs" / "schemas"
pytestmark = pytest.mark.skipif(not SCHEMAS.is_dir(), reason="needs a checkout")


@cache
def validator(name: str):
    documents = {path.name: json.loads(path.read_text()) for path in SCHEMAS.glob("*.json")}
    if find_spec("pixelid.status") is None:  # results still spell their status in their own ways
        documents["common.json"]["$defs"]["status"] = {"type": "string"}
    registry = referencing.Registry().with_resources(
        (key, referencing.Resource.from_contents(document)) for key, document in documents.items()
    )
    return jsonschema.Draft202012Validator(documents[f"{name}.json"], registry=registry)


def check(name: str, document) -> None:
    """Fails naming the place in the document that the schema does not allow."""
    errors = [f"{error.json_path}: {error.message[:200]}" for error in validator(name).iter_errors(document)]
    assert not errors, "\n".join(errors)


def run(*words: object) -> None:
    """A command that ends with a result, trustworthy or not."""
    assert main([str(word) for word in words]) in (0, 1)


def written(path: Path):
    return json.loads(path.read_text()) if path.suffix == ".json" else tomllib.loads(path.read_text())


@pytest.fixture(scope="module")
def session(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("session")
    for stimulus in ("chirp", "steps"):
        words = ["simulate", "dvs128", "--stimulus", stimulus, "--pixels", 4, "--with", "leak:rate_hz=3", "--quiet"]
        run(*words, "--out", folder / f"{stimulus}.h5")
    return folder


@pytest.fixture(scope="module")
def fitted(session, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("fits") / "fit"
    run("fit", session, "--model", "dvs128", "--out", out, "--quiet")
    return out


@pytest.mark.parametrize("path", sorted(SCHEMAS.glob("*.json")), ids=lambda path: path.stem)
def test_schemas_are_schemas(path):
    jsonschema.Draft202012Validator.check_schema(json.loads(path.read_text()))


def test_a_missing_or_misspelt_key_is_refused(fitted):
    document = written(fitted / "fit.json")
    for changed in ({**document, "statuss": "converged"}, {k: v for k, v in document.items() if k != "status"}):
        assert list(validator("fit").iter_errors(changed))


@pytest.mark.parametrize(
    ("schema", "path"),
    [("model", path) for path in sorted((ROOT / "models").glob("*.toml"))] + [("recipe", ROOT / "fits" / "demo.toml")],
    ids=lambda value: getattr(value, "stem", value),
)
def test_shipped_files(schema, path):
    check(schema, written(path))


def test_fit(fitted):
    check("fit", written(fitted / "fit.json"))
    check("model", written(fitted / "model.toml"))


def test_calibrate_and_check(calibration, capsys):
    _, folder = calibration
    check("calibration", written(folder / "calibration.json"))
    check("model", written(folder / "model.toml"))
    run("check", folder.parent / "bench", "--pixels", 4, "--json")
    check("check", json.loads(capsys.readouterr().out))


def test_check(capsys):
    run("check", BENCH, "--json")
    check("check", json.loads(capsys.readouterr().out))


@pytest.mark.slow
def test_demo_and_calibration(tmp_path):
    run("demo", "--out", tmp_path / "out", "--quiet")
    for name in ("calibration", "demo"):
        check(name, written(tmp_path / "out" / f"{name}.json"))
    check("model", written(tmp_path / "out" / "model.toml"))
    document = written(tmp_path / "out" / "demo.json")
    assert document["effects_named"] == document["effects_hidden"] == ["leak"]
    inside = [value["inside"] for value in document["hidden_and_found"]]
    assert sum(x is True for x in inside) >= len(inside) - 1  # of a dozen at 95 %, two outside in one of eight sessions
    page = (tmp_path / "out" / "report.html").read_text()
    assert document["sentence"] in page
    assert "What was hidden, and what was found" in page


def test_inspect(session, tmp_path, capsys):
    run("inspect", session / "chirp.h5", "--out", tmp_path / "out", "--quiet")
    check("inspect", written(tmp_path / "out" / "inspect.json"))
    run("inspect", session / "chirp.h5", "--json")
    check("inspect", json.loads(capsys.readouterr().out))


def test_inspect_of_histograms(tmp_path):
    below = np.zeros((30, 72), int)
    below[:, 30:71] = 12
    for polarity in ("pos", "neg"):
        np.save(tmp_path / f"noise_{polarity}_1lux.npy", below)
    run("inspect", *sorted(tmp_path.glob("*.npy")), "--out", tmp_path / "out", "--quiet")
    check("static_noise", written(tmp_path / "out" / "static_noise.json"))


def test_lowlight(session, fitted, tmp_path):
    run("lowlight", fitted, session / "steps.h5", "--out", tmp_path / "out", "--quiet")
    check("lowlight", written(tmp_path / "out" / "lowlight.json"))


def test_design(tmp_path):
    menu = '[[stimulus]]\nname = "dim"\nkind = "steps"\nlevel = 3.0\n\n[[stimulus]]\nkind = "constant"\nlevel = 24.0\n'
    (tmp_path / "menu.toml").write_text(menu)
    check("menu", written(tmp_path / "menu.toml"))
    words = ["--menu", tmp_path / "menu.toml", "--draws", 1, "--pixels", 2, "--quiet"]
    run("design", "dvs128", "--out", tmp_path / "out", *words)
    check("design", written(tmp_path / "out" / "design.json"))
    check("stimulus", written(tmp_path / "out" / "next.toml"))


def test_sensor(session, tmp_path):
    run("sensor", session / "chirp.h5", "--model", "dvs128", "--out", tmp_path / "out", "--bootstrap", 5, "--quiet")
    check("sensor", written(tmp_path / "out" / "sensor.json"))


def test_rates(tmp_path):
    rows = [(f, 70 * f * np.tanh(300 / f), 70 * f * np.tanh(5e3 / f)) for f in (1, 10, 50, 100, 200, 500, 1e3, 5e3)]
    table = "freq_hz,slow,fast\n" + "\n".join(",".join(f"{value:g}" for value in row) for row in rows)
    (tmp_path / "table.csv").write_text(table + "\n")
    run("rates", tmp_path / "table.csv", "--out", tmp_path / "out", "--quiet")
    check("rates", written(tmp_path / "out" / "rates.json"))


def test_latency(tmp_path):
    lines = ["camera,lens,polarity,irradiance_W_m2,bias_config,median"]
    lines += [f"C,l,{on},{E},0,{5 / E + 30 + 9 * on}" for on in (0, 1) for E in (0.01, 0.03, 0.1, 0.3)]
    (tmp_path / "table.csv").write_text("\n".join(lines) + "\n")
    run("latency", tmp_path / "table.csv", "--out", tmp_path / "out", "--quiet")
    check("latency", written(tmp_path / "out" / "latency.json"))
    run(
        "latency",
        tmp_path / "table.csv",
        "--model",
        tmp_path / "out",
        "--predict",
        "--out",
        tmp_path / "two",
        "--quiet",
    )
    check("latency", written(tmp_path / "two" / "latency.json"))


def test_biases(tmp_path):
    lines = ["polarity,bias_diff,bias_diff_on_off,threshold,mismatch"]
    lines += [f"{edge},{d},{own},{0.3 + 0.004 * own - 0.002 * d},0.0{4 + own % 2}" for edge in ("on", "off")
              for d in (0, 10, 20) for own in (0, -10, -20, -35)]  # fmt: skip
    (tmp_path / "table.csv").write_text("\n".join(lines) + "\n")
    words = ["biases", tmp_path / "table.csv", "--at", "diff=5,diff_on=-90", "--quiet"]
    run(*words, "--out", tmp_path / "out")
    check("biases", written(tmp_path / "out" / "biases.json"))
    (tmp_path / "codes.csv").write_text("bias_diff,bias_diff_on\n5,-5\n0,-99\n")
    predict = ["--model", tmp_path / "out", "--predict", "--quiet"]
    run("biases", tmp_path / "codes.csv", *predict, "--out", tmp_path / "check")
    check("biases", written(tmp_path / "check" / "biases.json"))
    page = (tmp_path / "out" / "report.html").read_text()
    assert "on_threshold" in page
    assert "Forms compared" in page


def test_noise(tmp_path):
    rows = "0.5,0.4,0.5\n2,1,0.8\n10,0.5,0.4\n50,0.01,0.008\n"
    (tmp_path / "noise.csv").write_text("lux,on_events_per_s,off_events_per_s\n" + rows)
    run("noise", tmp_path / "noise.csv", "--model", "dvs128", "--predict", "--out", tmp_path / "out", "--quiet")
    check("noise", written(tmp_path / "out" / "noise.json"))


def test_flicker(tmp_path):
    run("simulate", "dvs128", "--stimulus", lamp(tmp_path), "--pixels", 36, "--out", tmp_path / "lamp.h5", "--quiet")
    run("flicker", tmp_path / "lamp.h5", "--groups", "1x1", "--out", tmp_path / "out", "--quiet")
    check("flicker", written(tmp_path / "out" / "flicker.json"))


def lamp(folder: Path) -> Path:
    text = '[stimulus]\nkind = "sine"\nlevel = 400.0\nmodulation = 0.6\nfrequency_hz = 120.0\nduration_s = 1.5\n'
    (folder / "lamp.toml").write_text(text)
    check("stimulus", written(folder / "lamp.toml"))
    return folder / "lamp.toml"


def test_reconstruct(made, tmp_path):
    run("reconstruct", made, "--out", tmp_path / "out", "--iterations", 5, "--quiet")
    check("reconstruction", written(tmp_path / "out" / "reconstruction.json"))


@pytest.mark.parametrize("to", ["v2e", "iebcs", "esim", "deblur-e-nerf", "dvs-voltmeter"])
def test_export(to, tmp_path):
    run("export", "dvs128", "--to", to, "--out", tmp_path / "out.json", "--quiet")
    check("export", written(tmp_path / "out.json"))


@pytest.mark.slow
def test_conform(session, tmp_path):
    run("conform", session, "--model", "dvs128", "--out", tmp_path / "out", "--quiet")
    document = written(tmp_path / "out" / "conform.json")
    check("conform", document)
    assert {row["effect"]: row["verdict"] for row in document["rows"]}["leak"] == "present"
    check("gap", written(tmp_path / "out" / "gap.json"))
    assert (tmp_path / "out" / "report.html").is_file()


@pytest.mark.slow
def test_gap(session, tmp_path):
    run("gap", session, "--model", "dvs128", "--out", tmp_path / "out", "--quiet")
    check("gap", written(tmp_path / "out" / "gap.json"))
    check("model", written(tmp_path / "out" / "model.toml"))


@pytest.mark.slow
def test_compare(session, tmp_path):
    words = ["--model", "dvs128", "--model", "photoreceptor", "--out", tmp_path / "out", "--quiet"]
    run("compare", session / "chirp.h5", *words)
    check("compare", written(tmp_path / "out" / "compare.json"))


def test_recordings_have_the_documented_layout(session):
    import h5py

    with h5py.File(session / "chirp.h5") as file:
        assert file.attrs["format"] == "pixelid-recording"
        assert file.attrs["version"] == 1
        events, stimulus = file["events"], file["stimulus"]
        assert {name: events[name].dtype.str for name in events} == {"t": "<i8", "x": "<u2", "y": "<u2", "p": "|u1"}
        assert events["t"].attrs["unit"] in ("ns", "us")
        assert {"width", "height", "tick_ns"} <= set(events.attrs)
        assert set(stimulus) == {"t", "radiance"}
        assert stimulus.attrs["unit"] in ("relative", "lux", "fA", "shape")
        assert stimulus.attrs["interpolation"] in ("linear", "previous")
