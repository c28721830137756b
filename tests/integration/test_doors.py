"""Foreign files are read as they are meant, or refused with the option that states what they leave out."""

import os
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from foreign_files import FORMATS, Spec, is_true, judged, write
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pixelid.errors import InputError, on_command_line
from pixelid.recordings import open_recording, open_recordings
from pixelid.recordings.source import ReadingOptions, Source

SHARED = Path(os.environ.get("PIXELID_SHARED", Path(__file__).parents[3] / "shared")) / "doors"
NUMBER_OF_FILES = int(os.environ.get("PIXELID_FOREIGN_FILES", "300"))
SPECS = st.builds(
    Spec, format=st.sampled_from(FORMATS), order=st.sampled_from(["txyp", "xypt", "xytp", "ptxy", "tpxy", "yxtp"]),
    named=st.booleans(), unit_named=st.booleans(), size_stated=st.booleans(),
    unit=st.sampled_from(["s", "ms", "us", "us", "ns"]), floats=st.sampled_from(["none", "none", "t", "all"]),
    polarity=st.sampled_from(["01", "01", "pm1", "bool", "three", "words"]),
    mark=st.sampled_from([",", ";", "\t", " "]),
    decimal=st.sampled_from([".", ".", ","]), comment=st.sampled_from(["", "# made by a lab", "% exported", "// t"]),
    quoted=st.booleans(), index=st.booleans(),
    clock=st.sampled_from(["rises", "rises", "rises", "ties", "swap", "back", "frames"]),
    empty_stream=st.booleans(), second_stream=st.booleans(), width=st.sampled_from([1, 2, 64, 304, 1280]),
    height=st.sampled_from([1, 2, 48, 240, 720]), events=st.sampled_from([30, 200, 2000]),
    seconds=st.sampled_from([0.02, 0.5, 20.0]), seed=st.integers(0, 1000), unit_comment=st.booleans(),
    size_as=st.sampled_from(["sides", "pair"]), from_one=st.sampled_from([False, False, False, True]),
    across=st.booleans(), brackets=st.sampled_from([False, False, False, True]),
    coding=st.sampled_from(["utf-8", "cp1252", "utf-16"]),
)  # fmt: skip
COUNTS: Counter = Counter()


@pytest.fixture(autouse=True)
def words_of_the_command_line():
    with on_command_line():
        yield


def possible(spec: Spec) -> Spec:
    """The nearest file that a program could write."""
    if spec.format != "text" or spec.mark == "," or spec.floats == "none":
        spec = replace(spec, decimal=".")
    if spec.unit == "s" and spec.floats == "none":
        spec = replace(spec, floats="t")  # whole seconds tell nothing
    if spec.format in ("npz_rows", "h5_rows") and spec.polarity == "bool":
        spec = replace(spec, polarity="01")
    rows = spec.format in ("npz_rows", "h5_rows")
    if spec.format != "text":
        spec = replace(spec, named=not rows)
    if spec.format != "text" and spec.polarity == "words":
        spec = replace(spec, polarity="01")
    if spec.mark == " " or spec.quoted:
        spec = replace(spec, brackets=False)
    if spec.format == "mat":  # which states nothing
        spec = replace(spec, unit_comment=False)
    if not spec.named or spec.mark == " ":
        spec = replace(spec, index=False, unit_named=spec.unit_named and spec.named)
    return spec


@settings(max_examples=NUMBER_OF_FILES, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(spec=SPECS)
def test_no_foreign_file_is_read_wrongly(tmp_path_factory, spec):
    spec = possible(spec)
    path = write(spec, tmp_path_factory.mktemp("foreign"))
    answer = judged(spec, path)
    COUNTS[answer] += 1
    assert not answer.startswith("wrong"), f"{spec}: {answer}"


def test_what_is_stated_is_read(tmp_path):
    """The same files with everything stated: all of them true, but for polarities that are none."""
    for k in range(24):
        spec = possible(Spec(
            format=FORMATS[k % len(FORMATS)], order=["xytp", "ptxy", "yxtp"][k % 3], named=False,
            unit=["s", "ms", "us", "ns"][k % 4], floats=["none", "t"][k % 2], polarity=["01", "pm1"][k % 2],
            clock=["rises", "frames"][k // 12], seed=k, mark=[",", ";", " "][k % 3],
        ))  # fmt: skip
        options = ReadingOptions.of({
            "size": (spec.width, spec.height), "time_unit": spec.unit, "columns": ",".join(spec.order),
            "polarity": spec.polarity, "clock": "sort",
        })  # fmt: skip
        recording = open_recording(write(spec, tmp_path), options)
        right = np.sort(np.asarray(recording.events.t))
        np.testing.assert_array_equal(recording.events.t, right)
        assert Source.from_dict(recording.attributes["source"]).stated["time_unit"] == spec.unit
        if spec.clock == "rises":
            assert is_true(recording, spec), spec


# --- the samples of public reports ------------------------------------------------------------------------------------

READ = {  # folder → (file, options that its truth needs)
    "02": ("events.csv", {}), "02d": ("events.csv", {}), "02f": ("events.txt", {}), "07": ("events.h5", {}),
    "07b": ("events.h5", {}), "08": ("v2e.aedat", {"chip": "DAVIS346"}), "09": ("v2e.h5", {}),
    "17": ("voltmeter.txt", {"columns": "t,x,y,p", "clock": "sort"}), "19h": ("none.bag", {}),
    "26": ("events.txt", {}), "28": ("e2vid.h5", {}), "32": ("rec.raw", {}), "34b": ("events.txt", {}),
    "36": ("events.txt", {}), "36b": ("events.csv", {}), "36c": ("events.csv", {}), "37": ("events.csv", {}),
    "39": ("td.dat", {}),
}  # fmt: skip
REFUSED = {  # folder → (file, what the line names)
    "08": ("v2e.aedat", "--chip"), "17": ("voltmeter.txt", "--columns.*--clock sort"), "18b": ("reset.bag", "--clock"),
    "30": ("events.csv", "polarity"), "31g": ("imu.aedat4", "imus"),
}  # fmt: skip


def door(name: str) -> Path:
    if not (SHARED / name).exists():
        pytest.skip("shared files absent")
    return SHARED / name


@pytest.mark.parametrize("name", READ)
def test_files_of_reports(name):
    folder = door(name)
    file, options = READ[name]
    recording = open_recording(folder / file, ReadingOptions.of(options))
    with np.load(folder / "truth.npz") as true:
        for letter in "txyp":
            np.testing.assert_array_equal(getattr(recording.events, letter), true[letter])
        if true["w"] > 0:
            assert (recording.events.width, recording.events.height) == (true["w"], true["h"])


@pytest.mark.parametrize("name", REFUSED)
def test_files_of_reports_that_need_a_word(name):
    file, says = REFUSED[name]
    with pytest.raises(InputError, match=says):
        open_recording(door(name) / file)


def test_a_clock_set_back_makes_two_recordings():
    one, two = open_recordings([door("18b") / "reset.bag"], options=ReadingOptions(clock="split"))
    assert (len(one.events), len(two.events)) == (300, 300)
    assert two.name == "reset (2)"
    both = open_recording(door("18b") / "reset.bag", ReadingOptions(clock="sort"))
    assert len(both.events) == 600
    assert "sorted" in Source.from_dict(both.attributes["source"]).line()


def test_lost_packets_and_biases_and_sizes_are_said():
    lost = open_recording(door("20c") / "lost.bag")
    assert "1 of 6 packets are missing" in Source.from_dict(lost.attributes["source"]).line()
    assert open_recording(door("32") / "rec.raw").attributes["biases"]["bias_hpf"] == 1500
    pixel = open_recording(door("40f") / "one.txt").events
    assert (set(pixel.x), set(pixel.y), pixel.t[0]) == ({5}, {7}, 1_000_000)
    session = open_recordings([door("39d") / f"nosize{k}.dat" for k in range(3)])
    assert {(r.events.width, r.events.height) for r in session} == {(304, 240)}
    assert "of the session" in Source.from_dict(session[0].attributes["source"]).line()


@pytest.mark.parametrize(
    ("name", "low", "high", "end_s"),
    [("10n", 61 / 65535, 499 / 65535, 0.16), ("60b", 20 / 255, 163 / 255, 0.16), ("11", 40 / 255, 167 / 255, 1.24),
     ("14b", 50 / 255, 100 / 255, 0.198134), ("16", 20 / 255, 163 / 255, 0.15)],
)  # fmt: skip
def test_pictures_of_reports(name, low, high, end_s):
    from pixelid.stimuli.files import load_stimulus

    if name == "11":
        pytest.importorskip("av")
    light = load_stimulus(door(name) / "light.toml")
    assert light.radiance.min() == pytest.approx(low, rel=0.01)
    assert light.radiance.max() == pytest.approx(high, rel=0.01)
    assert light.end_s == pytest.approx(end_s)
    assert np.all(np.diff(light.radiance.mean(axis=(1, 2))) >= 0)


@pytest.mark.parametrize("name", ["light_de", "light_iso", "scope", "scope2"])
def test_traces_of_reports(name):
    from pixelid.stimuli.files import load_stimulus

    light = load_stimulus(door("80") / f"{name}.csv")
    assert light.unit == ("lux" if "light" in name else "V")
    assert light.end_s == pytest.approx(0.5, rel=0.01)
    assert light.radiance[0] * (0.01 if "light" in name else 1.0) == pytest.approx(1.0)


def test_recordings_without_events_take_the_session_s_size(tmp_path):
    (tmp_path / "a.csv").write_text("t,x,y,p\n0.0010005,4,3,1\n0.0020005,1,0,0\n")
    (tmp_path / "b.csv").write_text("t,x,y,p\n")
    sizes = {(r.events.width, r.events.height) for r in open_recordings([tmp_path])}
    assert sizes == {(5, 4)}


def test_a_session_that_disagrees_is_refused(tmp_path):
    def session(**texts):
        for name, text in texts.items():
            (tmp_path / f"{name}.csv").write_text(text)
        return open_recordings([tmp_path])

    with pytest.raises(InputError, match=r"unit of time was inferred differently.*--time-unit"):
        session(a="t,x,y,p\n0.0010005,4,3,1\n0.0020005,1,0,0\n", b="t,x,y,p\n1000,4,3,1\n2001,1,0,0\n")
    with pytest.raises(InputError, match="polarities are coded differently"):
        session(a="t,x,y,p\n1000,4,3,1\n2001,1,0,-1\n")
    with pytest.raises(InputError, match="different sensors"):
        session(a="# width=5\n# height: 9\nt,x,y,p\n1000,4,3,1\n2001,1,0,0\n", c="%geometry:64,48\nt,x,y,p\n10,1,1,0\n")


def test_what_a_file_beside_states_holds_for_it(tmp_path):
    (tmp_path / "a.csv").write_text("t,x,y,p\n1000,4,3,1\n2000,1,0,0\n")
    (tmp_path / "a.source.toml").write_text('size = "304x240"\ntime_unit = "ns"\npolarity = "swapped"\n')
    recording = open_recording(tmp_path / "a.csv")
    e = recording.events
    assert (e.t.tolist(), e.p.tolist(), e.width, e.height) == ([1000, 2000], [0, 1], 304, 240)
    assert open_recording(tmp_path / "a.csv", ReadingOptions(time_unit="us")).events.t[0] == 1_000_000
    (tmp_path / "a.source.toml").write_text('sice = "304x240"\n')
    with pytest.raises(InputError, match="did you mean 'size'"):
        open_recording(tmp_path / "a.csv")


# --- published layouts, made by their descriptions -----------------------------------------------------------------


def _events(n: int = 300):
    rng = np.random.default_rng(4)
    t = np.sort(rng.choice(400_000, n, replace=False)) + 1
    x, y = rng.integers(0, 640, n), rng.integers(0, 480, n)
    x[0], y[0] = 639, 479
    return t, x, y, rng.integers(0, 2, n)


def _layout(name: str, file) -> None:
    t, x, y, p = _events()
    one = {"t": t.astype(np.uint32), "x": x.astype(np.uint16), "y": y.astype(np.uint16), "p": p.astype(np.uint8)}
    if name == "MVSEC":
        file["davis/left/events"] = np.stack([x, y, t * 1e-6, 2 * p - 1], axis=1)
        file["davis/right/events"] = np.empty((0, 4))
        file["davis/left/imu"] = np.zeros((5, 6))
    elif name == "M3ED":
        for letter, column in one.items():
            file[f"prophesee/left/{letter}"] = column
        file["prophesee/left/ms_map_idx"] = np.arange(400)
        file["prophesee/left/calib/resolution"] = np.array([1280, 720])
    elif name == "EDS":
        file.update(one)
        file["ms_to_idx"] = np.arange(400)
    elif name == "TUM-VIE":
        for letter, column in one.items():
            file[f"events/{letter}"] = column
        file["events/ms_to_idx"] = np.arange(400)
    elif name == "VECtor":
        for letter, column in one.items():
            file[f"events/{letter}"] = column
        file["t_offset"] = np.int64(7)
        file["ms_to_idx"] = np.arange(400)
    else:  # Prophesee's HDF5
        file["CD/events"] = np.rec.fromarrays(
            [x, y, p, t], dtype=[("x", "<u2"), ("y", "<u2"), ("p", "<i2"), ("t", "<i8")]
        )
        file["CD/indexes"] = np.zeros(3)


@pytest.mark.parametrize(
    ("name", "size", "offset"),
    [("MVSEC", (640, 480), 0), ("M3ED", (1280, 720), 0), ("EDS", (640, 480), 0), ("TUM-VIE", (640, 480), 0),
     ("VECtor", (640, 480), 7), ("Prophesee", (640, 480), 0)],
)  # fmt: skip
def test_published_layouts(tmp_path, name, size, offset):
    import h5py

    with h5py.File(tmp_path / "a.h5", "w") as file:
        _layout(name, file)
    e, (t, x, y, p) = open_recording(tmp_path / "a.h5").events, _events()
    np.testing.assert_array_equal(e.t, (t + offset) * 1000)
    for found, true in ((e.x, x), (e.y, y), (e.p, p)):
        np.testing.assert_array_equal(found, true)
    assert (e.width, e.height) == size


def test_one_of_two_cameras_is_chosen_by_name(tmp_path):
    import h5py

    with h5py.File(tmp_path / "a.h5", "w") as file:
        for side in ("left", "right"):
            for letter, column in zip("txyp", _events(), strict=True):
                file[f"prophesee/{side}/{letter}"] = column[: 100 if side == "right" else 300]
    with pytest.raises(InputError, match="prophesee/left, prophesee/right; --stream"):
        open_recording(tmp_path / "a.h5")
    assert len(open_recording(tmp_path / "a.h5", ReadingOptions(stream="right")).events) == 100


def test_a_filter_that_is_missing_is_named(tmp_path, monkeypatch):
    import h5py

    from pixelid.recordings import hdf5

    with h5py.File(tmp_path / "a.h5", "w") as file:
        _layout("Prophesee", file)
        records = file["CD/events"][:]
        del file["CD/events"]
        file.create_dataset("CD/events", data=records, compression="gzip")
    monkeypatch.setattr(h5py.h5z, "filter_avail", lambda code: False)
    monkeypatch.setattr(hdf5, "FILTERS", {1: "ECF (Prophesee's plugin)"})
    with pytest.raises(InputError, match="compressed by ECF"):
        hdf5.opened(tmp_path / "a.h5", ReadingOptions())


def test_a_gap_where_the_last_pixel_has_no_scored_event(tmp_path):
    from pixelid.gap.gap import gap
    from pixelid.model.shipped import find_model

    report = gap([open_recording(door("gap_crash_last_pixel.h5"))], find_model("dvs128"))
    assert report.verdict == "none"
