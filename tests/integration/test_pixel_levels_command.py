"""`pixelid fit --pixel-levels` from a file to a page."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pixelid.cli.main import main
from pixelid.errors import InputError
from pixelid.fit.result import FitResult
from pixelid.fit.uncertainty.profiles import profiled
from pixelid.model.shipped import find_model
from pixelid.recordings import open_recording, write_recording
from pixelid.sample.sample import sample
from pixelid.simulate import simulate
from pixelid.stimuli.shapes import grating

HELD = ("beta", "gamma", "sf_cutoff_hz", "diff_cutoff_hz", "refractory_s")
GAIN = np.array([0.7, 1.2, 1.0, 1.4, 0.9, 1.1])


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder, model = tmp_path_factory.mktemp("levels"), find_model("dvs128")
    video = grating(60.0, 0.6, 25.0, 8.0, width=3, height=2, duration_s=0.4, dt=2e-4)
    seen = replace(video, radiance=video.radiance * GAIN.reshape(2, 3))
    write_recording(simulate(model, seen, seed=1).with_stimulus(video), folder / "six.h5")
    fixed = [f"{name}={model.values[name]}" for name in HELD]
    words = [
        "fit",
        folder / "six.h5",
        "--model",
        "dvs128",
        "--pixel-levels",
        "gain",
        "--out",
        folder / "fit",
        "--quiet",
    ]
    words += [word for text in fixed for word in ("--fix", text)]
    assert main([str(word) for word in words]) == 0
    return folder


def test_levels_reach_json_and_page(folder):
    content = json.loads((folder / "fit" / "fit.json").read_text())
    levels = content["pixel_levels"]
    assert set(levels["pixels"]) == {"x", "y", "gain", "ln_gain_sd"}
    assert (
        levels["scales"]["gain"]["interval_95"][0]
        < np.log(GAIN).std(ddof=1)
        < levels["scales"]["gain"]["interval_95"][1]
    )
    gain, place = np.log(levels["pixels"]["gain"]), 3 * np.array(levels["pixels"]["y"]) + levels["pixels"]["x"]
    error = gain - gain.mean() - (np.log(GAIN) - np.log(GAIN).mean())[place]
    assert (np.abs(error) < 4.0 * np.array(levels["pixels"]["ln_gain_sd"])).all()
    assert levels["camera"]["alpha"]["growth"] > 1.5
    assert levels["notes"][0] in content["unidentified"]
    page = (folder / "fit" / "report.html").read_text()
    assert "Gain and background of pixels" in page
    assert 'id="figure-levels"' in page


def test_schema(folder):
    jsonschema = pytest.importorskip("jsonschema")
    schemas = Path(__file__).resolve().parents[2] / "docs" / "schemas"
    if not schemas.is_dir():
        pytest.skip("needs a checkout")
    entry = json.loads((schemas / "common.json").read_text())["$defs"]["pixel_levels"]
    jsonschema.Draft202012Validator(entry).validate(
        json.loads((folder / "fit" / "fit.json").read_text())["pixel_levels"]
    )


def test_a_loaded_fit_says_the_same_and_is_not_sampled(folder):
    result = FitResult.load(folder / "fit")
    assert result.pixel_levels is not None
    assert "gain over pixels" in result.summary()
    recordings = [open_recording(folder / "six.h5")]
    for refused in (sample, profiled):
        with pytest.raises(InputError, match="pixel_levels"):
            refused(result, recordings)
    result.plot_residuals(recordings)
