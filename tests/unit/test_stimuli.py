"""Built-in stimuli, the calibration session, and stimuli from files."""

import numpy as np
import pytest

from pixelid.errors import InputError
from pixelid.recordings import Recording, write_recording
from pixelid.recordings.events import Events
from pixelid.stimuli import shapes
from pixelid.stimuli.files import load_stimulus, shape
from pixelid.stimuli.stimulus import Stimulus


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


TABLES = {
    "comma.csv": ("t,radiance\n0,10\n0.5,20\n1.5,15\n", "relative"),
    "bracket.csv": ("Time [ms];Irradiance [W/m²]\n0;10\n500;20\n1500;15\n", "W/m2"),
    "suffix.csv": ("t_us, radiance_lux\n0, 10\n500000, 20\n1500000, 15\n", "lux"),
    "comment.txt": ("# photodiode, unit: fA\ntime light\n0 10\n0.5 20\n1.5 15\n", "fA"),
    "bom.csv": ("\ufefft,channel,photodiode\n0,7,10\n0.5,8,20\n1.5,9,15\n", "relative"),
}


@pytest.mark.parametrize("name", list(TABLES))
def test_tables_of_light(tmp_path, name):
    text, unit = TABLES[name]
    (tmp_path / name).write_text(text, encoding="utf-8")
    light = load_stimulus(tmp_path / name)
    np.testing.assert_allclose(light.t, [0, 0.5, 1.5])
    np.testing.assert_allclose(light.radiance, [10, 20, 15])
    assert light.unit == unit


def test_arrays_samples_and_start(tmp_path):
    t, radiance = np.array([0.0, 0.1, 0.3]), np.array([2.0, 5.0, 4.0])
    np.save(tmp_path / "a.npy", np.stack([t, radiance], axis=1))
    np.savez(tmp_path / "a.npz", t=t, radiance=radiance, unit="lux")
    (tmp_path / "samples.toml").write_text(
        '[stimulus]\nkind = "samples"\nt = [0, 0.1, 0.3]\nradiance = [2, 5, 4]\nunit = "lux"\nstart_s = 0.25\n'
    )
    (tmp_path / "file.toml").write_text('[stimulus]\nkind = "file"\npath = "a.npy"\nunit = "W/m2"\n')
    for name, unit, start in (
        ("a.npy", "relative", 0), ("a.npz", "lux", 0), ("samples.toml", "lux", 0.25), ("file.toml", "W/m2", 0),
    ):  # fmt: skip
        light = load_stimulus(tmp_path / name)
        np.testing.assert_allclose(light.t, t + start)
        np.testing.assert_allclose(light.radiance, radiance)
        assert light.unit == unit


def test_frames_of_a_folder(tmp_path):
    from skimage.io import imsave

    folder = tmp_path / "frames"
    folder.mkdir()
    grey = np.random.default_rng(0).integers(1, 255, (4, 5, 6), dtype=np.uint8)
    for k, picture in enumerate(grey):
        imsave(folder / f"{k:03}.png", picture, check_contrast=False)
    (tmp_path / "a.toml").write_text('[stimulus]\nkind = "file"\npath = "frames"\nfps = 50\ngamma = "display"\n')
    light = load_stimulus(tmp_path / "a.toml")
    np.testing.assert_allclose(light.t, np.arange(5) / 50)  # the last one is shown, too
    np.testing.assert_allclose(light.radiance[:4], (grey / 255.0) ** 2.2, rtol=1e-5)
    np.testing.assert_array_equal(light.radiance[4], light.radiance[3])
    assert light.interpolation == "previous"
    (folder / "timestamps.txt").write_text("0\n0.1\n0.3\n0.7\n")
    np.testing.assert_allclose(load_stimulus(folder).t, [0, 0.1, 0.3, 0.7, 1.1])


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("a.csv", "t_s,radiance\n0,1\n1,-2\n2,3\n", "offset off"),
        ("a.csv", "t_s,radiance\n0,1\n1,x\n2,3\n", "numbers in every row"),
        ("a.csv", "t_s,radiance\n0,1\n0,2\n2,3\n", "times must increase"),
        ("a.csv", "a,radiance\n0,1\n1,2\n2,3\n", "columns t and radiance"),
        ("a.npy", "nothing", "NumPy array"),
        ("a.toml", '[stimulus]\nkind = "samples"\nt = ["a"]\nradiance = [1]\n', "list of numbers"),
        ("a.toml", '[stimulus]\nkind = "file"\npath = "none.csv"\n', "does not exist"),
        ("a.toml", '[stimulus]\nkind = "sine"\nstart_s = "now"\n', "start_s"),
    ],
)
def test_bad_light_is_named(tmp_path, name, content, says):
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=says):
        load_stimulus(tmp_path / name)


@pytest.mark.parametrize(
    ("header", "last_s"),
    [
        ("time [\u00b5s],lux", 2e-4), ("time [\u03bcs],lux", 2e-4), ("time_usec,lux", 2e-4), ("time_msec,lux", 0.2),
        ("time (milliseconds),lux", 0.2), ("# time in ms\nt,lux", 0.2), ("time [min],lux", 12000.0), ("t,lux", None),
        ("time since start,lux", None),
        ("# exposure time in ms: 3\nt,lux", None), ("# integration time is in ms\nseconds,lux", 200.0),
        ("# rise time in air\nt,lux", None), ("# lamp 3; time in ms\nt,lux", 0.2),
    ],
)  # fmt: skip
def test_the_unit_of_times_is_read_however_it_is_spelt(tmp_path, header, last_s):
    """A unit that was not known counted as seconds, and a light that is too long covers all events."""
    (tmp_path / "a.csv").write_text(f"{header}\n0,1\n100,2\n200,1\n", encoding="utf-8")
    if last_s is None:
        with pytest.raises(InputError, match=r"unit of the times not stated, found whole numbers.*time_unit"):
            load_stimulus(str(tmp_path / "a.csv"))
        return
    assert load_stimulus(str(tmp_path / "a.csv")).end_s == pytest.approx(last_s)
    (tmp_path / "b.csv").write_text("time [foo],lux\n0,1\n100,2\n")
    with pytest.raises(InputError, match="unit of the times: expected s, ms, us, ns or min, found 'foo'"):
        load_stimulus(str(tmp_path / "b.csv"))


@pytest.mark.parametrize("interpolation", ["linear", "previous"])
def test_light_until_a_time_ends_there(interpolation):
    light = Stimulus.from_arrays([0.0, 1.0, 2.0], [1.0, 3.0, 5.0], "lux", interpolation)
    cut = light.until(1.5)
    np.testing.assert_allclose(cut.t, [0.0, 1.0, 1.5])
    np.testing.assert_allclose(cut.radiance, [1.0, 3.0, 4.0 if interpolation == "linear" else 3.0])
    np.testing.assert_allclose(light.until(1.0).t, [0.0, 1.0])
    assert light.until(7.0) is light
    assert len(light.until(-1.0).t) == 2
    frames = Stimulus.from_arrays([0.0, 1.0], np.stack([np.ones((2, 2)), np.full((2, 2), 3.0)]), "lux", interpolation)
    assert frames.until(0.5).radiance.shape == (2, 2, 2)


TRACES = {  # what oscilloscopes and spreadsheets write → unit
    "pico.csv": ("Time,Channel A\n(ms),(V)\n\n0.0,1.0\n500,1.5\n1500,1.2\n", "V"),
    "keysight.csv": ("x-axis,1\nsecond,Volt\n0.0,1.0\n0.5,1.5\n1.5,1.2\n", "V"),
    "rigol.csv": ("X,CH1,Start,Increment,\nSequence,Volt,0.0,5e-1\n0,1.0,\n1,1.5,\n3,1.2,\n", "V"),
    "german.csv": ("t_s;radiance_lux\n0,0;1,0\n0,5;1,5\n1,5;1,2\n", "lux"),
    "dates.csv": (
        "timestamp,lux\n2024-01-01 12:00:00,1\n2024-01-01 12:00:00.5,1.5\n2024-01-01 12:00:01.5,1.2\n",
        "lux",
    ),
    "volts.csv": ("t_s,radiance_V\n0,1.0\n0.5,1.5\n1.5,1.2\n", "V"),
    "counts.csv": ("t [s],light [counts]\n0,1.0\n0.5,1.5\n1.5,1.2\n", "counts"),
}


@pytest.mark.parametrize("name", list(TRACES))
def test_traces_of_oscilloscopes_and_spreadsheets(tmp_path, name):
    text, unit = TRACES[name]
    (tmp_path / name).write_text(text, encoding="utf-8")
    light = load_stimulus(tmp_path / name)
    np.testing.assert_allclose(light.t, [0, 0.5, 1.5])
    np.testing.assert_allclose(light.radiance, [1.0, 1.5, 1.2])
    assert light.unit == unit


def test_columns_of_light_are_stated_where_two_may_be_meant(tmp_path):
    (tmp_path / "a.csv").write_text("t_s,photodiode_V,light_set\n0,1,2\n1,2,3\n2,1,1\n")
    with pytest.raises(InputError, match=r"NAME\.source\.toml"):
        load_stimulus(tmp_path / "a.csv")
    (tmp_path / "a.source.toml").write_text('columns = ["t_s", 3]\nunit = "lux"\ntime_unit = "ms"\n')
    light = load_stimulus(tmp_path / "a.csv")
    assert (light.radiance.tolist(), light.unit, light.end_s) == ([2.0, 3.0, 1.0], "lux", 0.002)
    (tmp_path / "b.csv").write_text("t_s,radiance_furlongs\n0,1\n1,2\n2,1\n")
    with pytest.raises(InputError, match="unit of the light: 'furlongs'"):
        load_stimulus(tmp_path / "b.csv")


@pytest.mark.parametrize(("kind", "top"), [(np.uint8, 255), (np.uint16, 65535), (np.float32, 1.0)])
def test_pictures_are_scaled_by_their_type(tmp_path, kind, top):
    from tifffile import imwrite

    levels = (np.array([10, 60, 200]) / 255 * top).astype(kind)
    for k, level in enumerate(levels):
        imwrite(tmp_path / f"frame_{8 + k}.tif", np.full((4, 5, 3), level, kind), photometric="rgb")
    (tmp_path / "timestamps.txt").write_text("0\n0.5\n1\n")
    light = load_stimulus(tmp_path)
    np.testing.assert_allclose(light.radiance[:3, 0, 0], levels / top, rtol=1e-5)  # frame_8, _9, _10
    assert light.t.tolist() == [0, 0.5, 1.0, 1.5]
