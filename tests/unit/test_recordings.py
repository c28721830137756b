"""Readers and writers: what comes back, and what is refused in one plain line."""

import json
import os
import sqlite3
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from pixelid.errors import InputError
from pixelid.recordings import Events, Recording, open_recording, open_recordings, write_recording
from pixelid.stimuli.stimulus import Stimulus

SHARED = Path(os.environ.get("PIXELID_SHARED", Path(__file__).parents[3] / "shared"))
REAL = {
    "davis240_boxes.aedat": (162771, 240, 180),
    "davis240_rotdisk.aedat": (374296, 240, 180),
    "davis346_aps.aedat4": (78830, 346, 260),
    "davis346_flicker100.aedat4": (117667, 346, 260),
    "dvxplorer_scan.aedat4": (111954, 320, 240),
    "flicker120_gen31.npz": (343474, 640, 480),
    "gen3.evt2.raw": (539481, 640, 480),
    "gen41_saturated.evt3.raw": (219596, 1280, 720),
    "led_uart_3125hz_30m.h5": (738253, 1, 1),
    "led_uart_504hz_30m.h5": (858282, 1, 1),
}


def example(n=500, tick=1, stimulus=True, **more) -> Recording:
    rng = np.random.default_rng(1)
    t = np.sort(rng.choice(10**6, n, replace=False)) * tick
    events = Events.from_columns(
        t, rng.integers(0, 6, n), rng.integers(0, 4, n), rng.integers(0, 2, n), 6, 4, tick_ns=tick
    )
    light = (
        Stimulus.from_arrays(np.linspace(0, 2, 9), 1 + rng.random(9).astype(np.float32), "lux") if stimulus else None
    )
    return Recording(
        events, light, "a condition", "a sensor", attributes={"biases": {"diff": 80}, "lens_mm": 8}, **more
    )


def same(a: Recording, b: Recording) -> None:
    for column in "txyp":
        np.testing.assert_array_equal(getattr(a.events, column), getattr(b.events, column))
        assert getattr(a.events, column).dtype == getattr(b.events, column).dtype
    assert (a.events.width, a.events.height, a.events.tick_ns) == (b.events.width, b.events.height, b.events.tick_ns)
    assert (a.condition, a.sensor, a.pooled, a.attributes) == (b.condition, b.sensor, b.pooled, b.attributes)
    assert (a.stimulus is None) == (b.stimulus is None)
    if a.stimulus is not None and b.stimulus is not None:
        np.testing.assert_array_equal(a.stimulus.t, b.stimulus.t)
        np.testing.assert_array_equal(a.stimulus.radiance, b.stimulus.radiance)
        assert a.stimulus.radiance.dtype == b.stimulus.radiance.dtype
        assert (a.stimulus.unit, a.stimulus.interpolation) == (b.stimulus.unit, b.stimulus.interpolation)


@pytest.mark.parametrize("suffix", [".h5", ".npz", ".csv", ".txt"])
@pytest.mark.parametrize(
    "recording", [example(), example(tick=1000, stimulus=False), example(n=0), example(pooled=True)]
)
def test_round_trip_is_lossless(tmp_path, suffix, recording):
    write_recording(recording, tmp_path / f"r{suffix}")
    same(recording, open_recording(tmp_path / f"r{suffix}"))


@pytest.mark.parametrize("suffix", [".h5", ".npz"])
def test_per_pixel_stimulus_round_trip(tmp_path, suffix):
    light = Stimulus.from_arrays([0, 2.0], np.random.default_rng(0).random((2, 4, 6)) + 1)
    recording = replace(example(), stimulus=light)
    write_recording(recording, tmp_path / f"r{suffix}")
    same(recording, open_recording(tmp_path / f"r{suffix}"))
    with pytest.raises(InputError, match="per-pixel stimulus"):
        write_recording(recording, tmp_path / "r.csv")
    assert not (tmp_path / "r.csv").exists()


def test_folder_and_existing_output(tmp_path):
    write_recording(example(), tmp_path / "b.h5")
    write_recording(example(), tmp_path / "a.npz")
    (tmp_path / "notes.txt").write_text("not a recording")
    assert [r.name for r in open_recordings([tmp_path])] == ["a", "b"]
    with pytest.raises(InputError, match="exists already"):
        write_recording(example(), tmp_path / "b.h5")


def test_dsec_style_file(tmp_path):
    with h5py.File(tmp_path / "events.h5", "w") as file:
        for name, column in (("t", [0, 5, 9]), ("x", [1, 639, 2]), ("y", [0, 479, 3]), ("p", [True, False, True])):
            file[f"events/{name}"] = np.array(column)
        file["t_offset"] = np.int64(1000)
        file["ms_to_idx"] = np.array([0])
    events = open_recording(tmp_path / "events.h5").events
    assert events.t.tolist() == [1_000_000, 1_005_000, 1_009_000]
    assert (events.width, events.height, events.tick_ns) == (640, 480, 1000)
    assert events.p.tolist() == [1, 0, 1]


def test_text_of_seconds_and_named_columns(tmp_path):
    (tmp_path / "events.txt").write_text("0.003811 96 133 0\n0.0038111 96 134 1\n")
    assert open_recording(tmp_path / "events.txt").events.t.tolist() == [3_811_000, 3_811_100]
    (tmp_path / "epoch.txt").write_text("1700000000.123457 96 133 0\n1700000000.200003 96 134 1\n")
    written = [1_700_000_000_123_457_000, 1_700_000_000_200_003_000]
    assert open_recording(tmp_path / "epoch.txt").events.t.tolist() == written
    np.savez(tmp_path / "epoch.npz", t=1e-9 * np.array(written), x=[96, 96], y=[133, 134], p=[0, 1])
    assert open_recording(tmp_path / "epoch.npz").events.t.tolist() == written
    (tmp_path / "events.csv").write_text("x,y,polarity,timestamp\n3,4,1,17\n")
    events = open_recording(tmp_path / "events.csv").events
    assert (events.t[0], events.x[0], events.y[0], events.p[0]) == (17_000, 3, 4, 1)


@pytest.mark.parametrize(
    ("text", "t"),
    [
        ("t_us,x,y,p\n5,3,4,1\n17,3,4,0\n", [5_000, 17_000]),
        ("timestamp [ns],x,y,polarity\n5,3,4,1\n17,3,4,0\n", [5, 17]),
        ("x y t_ms p\n3 4 5 1\n3 4 17 0\n", [5_000_000, 17_000_000]),
        ("t (µs),x,y,p\n5.0,3,4,1\n17.5,3,4,0\n", [5_000, 17_500]),
        ("ts,x,y,p\n5,3,4,1\n17,3,4,0\n", [5_000, 17_000]),
        ("3,4,1,5\n3,4,0,17\n", [5_000, 17_000]),  # Metavision's, without names
        ("5,3,4,1\n17,3,4,0\n", [5_000, 17_000]),
        ("0,3,4,1\n1,3,4,0\n", [0, 1_000]),
    ],
)
def test_text_in_the_orders_and_units_that_programs_write(tmp_path, text, t):
    (tmp_path / "events.csv").write_text(text)
    events = open_recording(tmp_path / "events.csv").events
    assert events.t.tolist() == t
    assert (events.x.tolist(), events.y.tolist(), events.p.tolist()) == ([3, 3], [4, 4], [1, 0])


def test_aedat2_bits_and_biases(tmp_path):
    header = b"#!AER-DAT2.0\n# AEChip: eu.seebetter.ini.chips.davis.DAVIS240C\n"
    header += b'#<entry key="DAVIS240C.Bias.PrBp" value="7"/>\n'
    dvs = (100 << 22) | (200 << 12) | (1 << 11)
    words = np.array([[dvs, 2**32 - 5], [1 << 31, 2**32 - 4], [dvs ^ (1 << 11), 3]], ">u4")
    (tmp_path / "r.aedat").write_bytes(header + words.tobytes())
    recording = open_recording(tmp_path / "r.aedat")
    assert recording.events.t.tolist() == [(2**32 - 5) * 1000, (2**32 + 3) * 1000]
    assert (recording.events.x[0], recording.events.y[0]) == (200, 100)
    assert recording.events.p.tolist() == [1, 0]
    assert recording.attributes["biases"] == {"Bias.PrBp": "7"}


def test_an_aedat2_header_of_anything_gets_one_line(tmp_path):
    path = tmp_path / "r.aedat"
    for chip in (b"davis.DAVIS\x00C\x0b\x1c\x85\r19\x1b[31m", b" \r", b"x" * 9000):
        path.write_bytes(b"#!AER-DAT2.0\n# AEChip: eu.seebetter." + chip + b"\n" + bytes(8))
        with pytest.raises(InputError, match="AEChip: expected one of") as caught:
            open_recording(path)
        assert len(str(caught.value).splitlines()) == 1
        assert len(str(caught.value)) < 300 + len(str(path))


def change(path, **columns):
    with h5py.File(path, "r+") as file:
        for name, value in columns.items():
            group, _, column = name.partition("_")
            attrs = dict(file[group][column].attrs)
            del file[group][column]
            file[group][column] = value
            file[group][column].attrs.update(attrs)


T = example().events.t


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"events_t": T[::-1]}, "events/t: timestamps must not decrease"),
        ({"events_t": T - 10**7}, "events/t: times must not be negative"),
        ({"events_t": T.astype(float)}, "events/t: expected integers, found float64"),
        ({"events_t": T.astype(np.uint64) + np.uint64(2**63)}, "fit 64 bits"),
        ({"events_p": example().events.p.astype(np.int8) * 2 - 1}, "coding looks like -1/1"),
        ({"events_x": np.full(500, 6)}, "events/x: event 0 has x = 6, expected 0..5"),
        ({"events_y": np.full(500, -1)}, "events/y: event 0 has y = -1"),
        ({"events_x": np.zeros(3, int)}, "must have one length"),
        ({"events_t": np.zeros(500, int)}, "duplicates"),
        ({"stimulus_radiance": np.full(9, np.nan)}, "stimulus/radiance: contains NaN"),
        ({"stimulus_radiance": np.full(9, -1.0)}, "stimulus/radiance: must be positive, found -1"),
        ({"stimulus_radiance": np.zeros(9)}, "stimulus/radiance: must be positive, found 0"),
        ({"stimulus_t": np.linspace(0, 1e-4, 9)}, "stimulus: expected to cover the events"),
        ({"stimulus_t": np.zeros(9)}, "stimulus/t: times must increase"),
    ],
)
def test_bad_columns_are_named(tmp_path, columns, message):
    write_recording(replace(example(), events=replace(example().events, t=T * 1000)), tmp_path / "r.h5")
    change(tmp_path / "r.h5", events_t=T)
    with h5py.File(tmp_path / "r.h5", "r+") as file:
        file["events/t"].attrs["unit"] = "us"
    change(tmp_path / "r.h5", **columns)
    with pytest.raises(InputError, match=message) as error:
        open_recording(tmp_path / "r.h5")
    assert str(tmp_path / "r.h5") in str(error.value)
    assert "\n" not in str(error.value)


def test_microseconds_beyond_64_bits(tmp_path):
    np.savez(tmp_path / "r.npz", t=np.array([2**60]), x=[0], y=[0], p=[1])
    with pytest.raises(InputError, match=r"found numbers up to 1.15292e.18: no µs that fit 64 bits .* time.unit"):
        open_recording(tmp_path / "r.npz")


@pytest.mark.parametrize(
    ("attribute", "value", "message"),
    [
        ("stimulus:unit", "no unit", "unit must be relative, lux, W/m2, fA, shape or another short word as V, found"),
        ("stimulus:unit", 7, "unit must be relative, lux"),
        ("stimulus:interpolation", "cubic", "interpolation must be one of"),
        ("events:width", 0, "attribute width: expected a positive integer, found 0"),
        ("events/t:unit", "days", "expected unit 'ns' or 'us', found 'days'"),
        ("/:version", 2, "version: expected 1, found 2"),
        ("/:format", "pixelid-model", "format: expected 'pixelid-recording', found 'pixelid-model'"),
    ],
)
def test_bad_attributes_are_named(tmp_path, attribute, value, message):
    write_recording(example(), tmp_path / "r.h5")
    group, name = attribute.split(":")
    with h5py.File(tmp_path / "r.h5", "r+") as file:
        file[group].attrs[name] = value
    with pytest.raises(InputError, match=message):
        open_recording(tmp_path / "r.h5")


def test_bad_files_are_named(tmp_path):
    write_recording(example(), tmp_path / "whole.h5")
    whole = (tmp_path / "whole.h5").read_bytes()
    with h5py.File(tmp_path / "without.h5", "w") as file:
        file["events/t"] = [1]
    sqlite3.connect(tmp_path / "bag.db3").execute("create table a (b)").connection.close()
    np.savez(tmp_path / "other.npz", a=1)
    cases = {
        "absent.h5": (None, "no such file"),
        "empty.h5": (b"", "empty file"),
        "cut.h5": (whole[: len(whole) // 2], "truncated or damaged HDF5"),
        "fake.h5": (b"hello there, not HDF5", "expected an HDF5 file"),
        "fake.npz": (b"PK\x03\x04 cut", "expected a .npz archive"),
        "fake.raw": (b"\x00", "cannot be decoded|found"),
        "fake.aedat4": (b"#!AER-DAT4.0\r\nxxxx", "cannot be decoded"),
        "words.csv": (b"1,2,three,1\n", "expected lines of t x y p"),
        "binary.txt": (b"\xff\xf0\x00\x01", "expected text"),
        "old.aedat": (b"#!AER-DAT1.0\r\n", "AER-DAT2.0 or AER-DAT4.0"),
        "what.xyz": (b"abc", "expected a recording"),
    }
    for name, (content, message) in cases.items():
        if content is not None:
            (tmp_path / name).write_bytes(content)
        if name == "fake.raw":
            continue
        with pytest.raises(InputError, match=message) as error:
            open_recording(tmp_path / name)
        assert name in str(error.value)
    for name, message in (("without.h5", "columns t, x, y, p"), ("bag.db3", "ROS bag"), ("other.npz", "found 'a'")):
        with pytest.raises(InputError, match=message):
            open_recording(tmp_path / name)
    (tmp_path / "none").mkdir()
    with pytest.raises(InputError, match="found none"):
        open_recordings([tmp_path / "none"])


def test_duplicates_of_another_source_survive_conversion(tmp_path):
    np.savez(tmp_path / "r.npz", t=[5, 5], x=[0, 0], y=[0, 0], p=[1, 1])
    recording = open_recording(tmp_path / "r.npz")
    write_recording(recording, tmp_path / "r.h5")
    same(recording, open_recording(tmp_path / "r.h5"))


def test_a_queue_may_drain_after_the_stimulus():
    early = np.sort(np.random.default_rng(0).choice(10**6, 300, replace=False)) * 1000
    t = np.concatenate([early, 10**9 + np.arange(1000) * 1000])
    zeros = np.zeros(len(t), int)
    light = Stimulus.from_arrays([0, 0.9999], [1.0, 1.0])
    Recording(Events.from_columns(t, zeros, zeros, zeros, 1, 1), light).check_stimulus_covers_events()
    late = np.concatenate([early, early + 10**9])
    zeros = np.zeros(len(late), int)
    with pytest.raises(InputError, match="expected to cover"):
        Recording(Events.from_columns(late, zeros, zeros, zeros, 1, 1), light).check_stimulus_covers_events()


@pytest.mark.parametrize("name", REAL)
def test_real_files_open(name):
    if not (SHARED / "recordings" / name).exists():
        pytest.skip("shared recordings absent")
    events = open_recording(SHARED / "recordings" / name).events
    assert (len(events), events.width, events.height) == REAL[name]
    assert events.t.dtype == np.int64


def test_every_bias_of_an_aedat2_header_is_kept():
    if not (SHARED / "recordings" / "davis240_boxes.aedat").exists():
        pytest.skip("shared recordings absent")
    biases = open_recording(SHARED / "recordings" / "davis240_boxes.aedat").attributes["biases"]
    for name in ("PrBp", "PrSFBp", "DiffBn", "OnBn", "OffBn", "RefrBp"):
        assert any(f".{name}." in key for key in biases), (name, json.dumps(sorted(biases))[:300])
