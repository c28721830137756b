"""The unit of the light keeps its name: in recordings, models, fits and their files."""

from dataclasses import replace

import numpy as np
import pytest

import pixelid as px
from pixelid.errors import InputError
from pixelid.model.files import load_model
from pixelid.parameters.units import in_light_unit
from pixelid.recordings import open_recording, write_recording
from pixelid.results import read_result
from pixelid.stimuli.shapes import chirp
from pixelid.stimuli.stimulus import Stimulus, unit_named

ENDS = {"lux": "lux", "W/m2": "(W/m2)", "V": "V", "fA": "fA"}


@pytest.mark.parametrize("unit", ENDS)
@pytest.mark.parametrize("suffix", [".h5", ".npz", ".csv"])
def test_a_recording_keeps_the_unit_by_name(unit, suffix, tmp_path):
    light = chirp(24.0, duration_s=0.1, stop_hz=50.0)
    recording = replace(px.simulate("ideal", light, pixels=4), stimulus=replace(light, unit=unit))
    write_recording(recording, tmp_path / f"r{suffix}")
    assert open_recording(tmp_path / f"r{suffix}").stimulus.unit == unit


@pytest.mark.parametrize(("unit", "end"), ENDS.items())
def test_a_fit_has_the_unit_in_table_json_and_model_alike(unit, end, tmp_path):
    camera = px.find_model("dvs128").with_effect("dark_current", {"radiance": 1.0})
    light = chirp(24.0, duration_s=0.3, stop_hz=200.0)
    recording = px.simulate(camera, light, pixels=4)
    held = {name: None for name in camera.free if name not in ("alpha", "dark_current.radiance")}
    result = px.fit(replace(recording, stimulus=replace(light, unit=unit)), camera.fix(held), starts=0)
    result.save(tmp_path / "fit")
    model = load_model(tmp_path / "fit" / "model.toml")
    assert model.radiance_unit == unit
    parameters = read_result(tmp_path / "fit", "fit.json")["parameters"]
    for name, expected in (("alpha", f"1/s²/{end}"), ("gamma", f"1/s/{end}"), ("dark_current.radiance", unit)):
        assert result.estimates[name].unit == parameters[name]["unit"] == model.parameters[name].unit == expected
        row = next(line for line in result.summary().splitlines() if line.startswith(name))
        assert expected in row
    assert model.parameters["on_threshold"].unit == "log radiance"


def test_effects_of_the_library_take_the_unit_of_the_model():
    model = px.find_model("dvs128").with_radiance_in("V").with_effect("parasitic_photocurrent")
    assert model.parameters["parasitic_photocurrent.rate_hz_per_radiance"].unit == "Hz/V"
    assert model.with_radiance_in("lux").parameters["alpha"].unit == "1/s²/lux"
    assert model.with_radiance_in(None) is model
    assert model.with_radiance_in("W/m2").with_radiance_in("fA").parameters["alpha"].unit == "1/s²/fA"


def test_priors_in_another_unit_are_left_out():
    model = px.find_model("imx636")
    other = model.with_radiance_in("lux")
    assert model.parameters["alpha"].prior is not None
    assert other.parameters["alpha"].prior is None
    assert other.parameters["beta"].prior == model.parameters["beta"].prior


def test_units_by_other_names_and_what_is_none():
    named = {"lx": "lux", "Lux": "lux", "W/m²": "W/m2", "V": "V", "mV": "mV", "cd/m²": "cd/m²", "radiance": "relative"}
    assert {text: unit_named(text) for text in named} == named
    for wrong in ("two words", "12", "x" * 40, 3, None, "V\n", "\x1b[2J"):
        with pytest.raises(InputError, match="unit must be"):
            Stimulus.from_arrays([0.0, 1.0], np.ones(2), unit=wrong)
    assert in_light_unit("1/s²/(W/m2)", "W/m2", "V") == "1/s²/V"
