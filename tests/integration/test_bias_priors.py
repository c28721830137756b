"""`pixelid fit --bias-priors` and `inspect` from a jAER file to a page."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import pixelid as px
from pixelid.cli.main import main
from pixelid.fit.result import FitResult
from pixelid.model.shipped import find_model
from pixelid.recordings import open_recording, write_recording

SETTINGS = {  # thresholds of 0.28 and 0.30, a dead time of 3.4 µs, a follower of 7.6 kHz
    "DiffBn": (3, 39), "OnBn": (2, 255), "OffBn": (5, 40), "PrBp": (2, 58), "PrSFBp": (5, 53), "RefrBp": (3, 25),
}  # fmt: skip
TRUTH = {"on_threshold": 0.2, "off_threshold": 0.22, "refractory_s": 4e-6}
HELD = ("alpha", "beta", "gamma", "sf_cutoff_hz", "diff_cutoff_hz", "threshold_sigma")


def write_aedat2(path: Path, events, settings=SETTINGS) -> None:
    """A file as jAER writes it for a DAVIS240C."""
    lines = ["#!AER-DAT2.0", "# AEChip: eu.seebetter.ini.chips.davis.DAVIS240C"]
    for name, bits in settings.items():
        for key, value in zip(("BitValueCoarse", "BitValueFine"), bits, strict=True):
            lines.append(f'#   <entry key="DAVIS240C.AddressedIPotCF.{name}.{key}" value="{value}"/>')
    address = events.y.astype(np.uint32) << 22 | events.x.astype(np.uint32) << 12 | events.p.astype(np.uint32) << 11
    words = np.stack([address, (events.t // 1000).astype(np.uint32)], axis=1).astype(">u4")
    path.write_bytes("".join(f"{line}\r\n" for line in lines).encode() + words.tobytes())


def run(*words: object) -> int:
    return main([*map(str, words), "--quiet"])


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Slow light: events are milliseconds apart, and a dead time of microseconds leaves no trace in them."""
    folder = tmp_path_factory.mktemp("biases")
    made = px.simulate(find_model("dvs128").set(TRUTH), "slow", pixels=9, seed=1)
    write_aedat2(folder / "slow.aedat", made.events)
    assert run("convert", folder / "slow.aedat", folder / "slow.h5", "--stimulus", "slow") == 0
    words = ["fit", folder / "slow.h5", "--model", "dvs128", "--between", "linear"]
    words += [word for name in HELD for word in ("--fix", f"{name}={find_model('dvs128').values[name]}")]
    for name, options in (("without", []), ("with", ["--bias-priors"])):
        assert run(*words, *options, "--out", folder / name) == 0
    return folder


def test_the_prior_fixes_what_the_events_cannot_tell(folder):
    without, told = (json.loads((folder / name / "fit.json").read_text()) for name in ("without", "with"))
    assert "bias_priors" not in without
    assert without["details"]["precision"]["refractory_s"] in ("not identified", "only an upper limit")
    prior, dead = told["bias_priors"]["priors"]["refractory_s"], told["parameters"]["refractory_s"]
    assert prior["sd"] == pytest.approx(0.55, abs=0.005)  # √(0.25² + 0.2² + 0.4² + 0.2²)
    assert dead["value"] == pytest.approx(3.369e-6, rel=0.05)
    assert dead["interval_95"] == pytest.approx(prior["interval_95"], rel=0.15)
    assert dead["interval_95"][0] < TRUTH["refractory_s"] < dead["interval_95"][1]
    alone = [text for text in told["unidentified"] if "that of the biases" in text]
    assert alone == ["refractory_s: its interval is that of the biases; the events add next to nothing"]
    for name in ("on_threshold", "off_threshold"):  # which the events know ten times better than the biases
        assert told["parameters"][name]["value"] == pytest.approx(TRUTH[name], rel=0.05)
        assert told["parameters"][name]["value"] == pytest.approx(without["parameters"][name]["value"], rel=0.01)


def test_the_result_says_where_its_priors_are_from(folder):
    told = json.loads((folder / "with" / "fit.json").read_text())["bias_priors"]
    assert told["chip"] == "DAVIS240C"
    refractory = told["currents"]["refractory"]
    assert refractory == {"setting": "RefrBp", "bits": {"coarse": 3, "fine": 25}, "ampere": refractory["ampere"]}
    assert refractory["ampere"] == pytest.approx(4.7487e-9, rel=1e-4)
    assert told["values"]["refractory_s"]["formula"] == "C V / I_RefrBp, C = 20 fF, V = 0.8 V"
    assert told["unused"] == {"sf_cutoff_hz": "it is held"}
    result = FitResult.load(folder / "with")
    assert result.bias_priors == told
    assert result.model.parameters["refractory_s"].prior is not None
    assert "priors from the biases of the DAVIS240C" in result.summary()
    assert "sf_cutoff_hz: no prior from the biases: it is held" in result.summary()
    page = (folder / "with" / "report.html").read_text()
    assert "Priors from the biases of the DAVIS240C" in page
    assert "ln(I_OnBn / I_DiffBn)" in page


def test_inspect_says_what_biases_imply(folder, capsys):
    assert main(["inspect", str(folder / "slow.h5"), "--json", "--quiet"]) == 0
    biases = json.loads(capsys.readouterr().out)["biases"]
    assert biases["values"]["refractory_s"]["value"] == pytest.approx(3.369e-6, rel=1e-3)
    assert main(["inspect", str(folder / "slow.aedat")]) == 0
    assert "biases imply" in (shown := capsys.readouterr().out)
    assert "refractory_s 3.37e-06 s" in shown


def test_schemas(folder, capsys):
    jsonschema = pytest.importorskip("jsonschema")
    schemas = Path(__file__).resolve().parents[2] / "docs" / "schemas"
    if not schemas.is_dir():
        pytest.skip("needs a checkout")
    known = json.loads((schemas / "common.json").read_text())["$defs"]
    told = json.loads((folder / "with" / "fit.json").read_text())["bias_priors"]
    jsonschema.Draft202012Validator(known["bias_priors"]).validate(told)
    assert main(["inspect", str(folder / "slow.aedat"), "--json", "--quiet"]) == 0
    jsonschema.Draft202012Validator(known["biases"]).validate(json.loads(capsys.readouterr().out)["biases"])


def refused(capsys, out: Path, *words: object) -> str:
    assert run("fit", *words, "--model", "dvs128", "--bias-priors", "--out", out) == 2
    assert not out.exists()
    said = capsys.readouterr().err.strip()
    assert len(said.splitlines()) == 1, said
    return said


def test_recordings_that_give_no_priors_are_refused(folder, tmp_path, capsys):
    recording = open_recording(folder / "slow.h5")
    biases = recording.attributes["biases"]
    cases = {
        "none": (replace(recording, attributes={}), "expected the bias settings of a jAER header"),
        "other": (replace(recording, sensor="EVK4"), "expected the bias settings of a jAER header"),
        "nan": (
            replace(recording, attributes={"biases": biases | {"AddressedIPotCF.OnBn.BitValueFine": "nan"}}),
            "expected a whole number from 0 to 255, found 'nan'",
        ),
    }
    for name, (changed, words) in cases.items():
        write_recording(replace(changed, source=None), tmp_path / f"{name}.h5")
        said = refused(capsys, tmp_path / "out", tmp_path / f"{name}.h5")
        assert words in said
        assert name in said


def test_recordings_of_different_biases_are_refused(folder, tmp_path, capsys):
    recording = open_recording(folder / "slow.h5")
    other = recording.attributes["biases"] | {"AddressedIPotCF.RefrBp.BitValueFine": "26"}
    write_recording(replace(recording, attributes={"biases": other}), tmp_path / "other.h5")
    said = refused(capsys, tmp_path / "out", folder / "slow.h5", tmp_path / "other.h5")
    assert "other biases than slow (RefrBp" in said


def test_a_recipe_and_python_ask_for_them_too(folder, tmp_path):
    fixed = {name: find_model("dvs128").values[name] for name in HELD}
    result = px.fit(folder / "slow.h5", "dvs128", fixed=fixed, starts=0, between="linear", bias_priors=True)
    assert result.bias_priors is not None
    assert set(result.bias_priors["priors"]) == {"on_threshold", "off_threshold", "refractory_s"}
    recipe = tmp_path / "biases.toml"
    recipe.write_text(f'[fit]\nrecordings = ["{folder}/slow.h5"]\nmodel = "dvs128"\nbias_priors = "yes"\n')
    assert run("fit", recipe, "--out", tmp_path / "out") == 2
    from pixelid.fit.recipe import read_recipe

    recipe.write_text(recipe.read_text().replace('"yes"', "true"))
    assert read_recipe(recipe).bias_priors
