"""Built-in stimuli, the calibration session, and stimuli from files."""

import numpy as np
import pytest

from pixelid.errors import InputError
from pixelid.recordings import Recording, write_recording
from pixelid.recordings.events import Events
from pixelid.stimuli import shapes
from pixelid.stimuli.files import load_stimulus, shape


@pytest.mark.parametrize("name", list(shapes.SHAPES))
def test_every_shape_is_valid_and_scales_with_its_level(name):
    small = {"width": 8, "height": 6} if name == "grating" else {}
    one = shapes.SHAPES[name](level=20.0, **small)
    two = shapes.SHAPES[name](level=40.0, **small)
    assert one.radiance.min() > 0
    assert one.t[0] == 0
    np.testing.assert_allclose(two.radiance, 2 * one.radiance, rtol=1e-6)
    assert one.full_field == (name != "grating")


def test_shapes_follow_their_formulas():
    sine = shapes.sine(10.0, 0.3, 7.0, duration_s=0.5, dt=1e-3)
    np.testing.assert_allclose(sine.radiance, 10 * (1 + 0.3 * np.sin(2 * np.pi * 7 * sine.t)))
    assert len(sine.t) == 501
    chirp = shapes.chirp(10.0, 0.5, 5.0, 500.0, duration_s=1.0, dt=2e-5)
    up = np.flatnonzero(np.diff(np.sign(chirp.radiance - 10)) > 0)
    rate = 1 / np.diff(chirp.t[up])
    assert rate[0] == pytest.approx(5 * 100 ** (0.1), rel=0.2)
    assert rate[-1] == pytest.approx(500, rel=0.03)
    pulse = shapes.pulse(10.0, 4.0, 5e-3)
    assert pulse.radiance.max() == pytest.approx(50.0, rel=1e-3)
    grating = shapes.grating(10.0, 0.5, 50.0, 16.0, width=32, height=4)
    np.testing.assert_allclose(grating.radiance[:, 0, 3], grating.radiance[:, 3, 19], rtol=1e-6)


def test_seeds_give_other_steps():
    a, b, again = (shapes.steps(seed=seed).radiance for seed in (1, 2, 1))
    np.testing.assert_array_equal(a, again)
    assert (a != b).any()


def test_session_covers_conditions_and_levels():
    session = shapes.session((3.0, 400.0), seed=5)
    assert set(session) == {f"{kind}_{level}" for kind in ("chirp", "steps", "slow", "constant") for level in (3, 400)}
    for name, stimulus in session.items():
        level = float(name.split("_")[1])
        assert 0.1 * level < np.exp(np.log(stimulus.radiance).mean()) < 10 * level


def test_files_and_names(tmp_path):
    assert len(load_stimulus("constant").t) == 2
    toml = tmp_path / "light.toml"
    toml.write_text('[stimulus]\nkind = "sine"\nlevel = 24\nduration_s = 0.1\n')
    light = load_stimulus(str(toml))
    np.testing.assert_array_equal(light.radiance, shapes.sine(24.0, duration_s=0.1).radiance)
    recording = tmp_path / "rec.h5"
    write_recording(Recording(Events.empty(2, 2), light), recording)
    np.testing.assert_array_equal(load_stimulus(recording).radiance, light.radiance)
    bare = tmp_path / "bare.h5"
    write_recording(Recording(Events.empty(2, 2)), bare)
    with pytest.raises(InputError, match="no stimulus"):
        load_stimulus(bare)


@pytest.mark.parametrize(
    ("kind", "parameters", "says"),
    [
        ("sinus", {}, "sine"),
        ("sine", {"frequency": 3.0}, "frequency_hz"),
        ("sine", {"level": "bright"}, "number"),
        ("sine", {"level": -3.0}, "positive"),
        ("sine", {"modulation": 1.5}, "positive"),
        ("sine", {"level": float("nan")}, "NaN"),
        ("sine", {"dt": 0.0}, "dt"),
        ("sine", {"dt": 1e-12}, "samples"),
        ("steps", {"seed": 1.5}, "whole"),
        ("steps", {"hold_s": 0.0}, "hold_s"),
        ("chirp", {"start_hz": 0.0}, "start_hz"),
        ("pulse", {"width_s": 0.0}, "width_s"),
        ("grating", {"width": 0}, "grating"),
        ("grating", {"period_px": 0.0}, "period_px"),
        ("slow", {"level": 0.0}, "positive"),
    ],
)
def test_bad_parameters_are_named(kind, parameters, says):
    with pytest.raises(InputError, match=says):
        shape(kind, parameters)


def test_unknown_names_list_the_known():
    with pytest.raises(InputError, match="chirp"):
        load_stimulus("no-such-light")
