"""Files whose obvious reading would be wrong: refused, or read as they are meant."""

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from pixelid.errors import InputError
from pixelid.nerf.data.view_cameras import camera_of_document
from pixelid.recordings import open_recording, open_recordings
from pixelid.recordings.source import ReadingOptions
from pixelid.stimuli.sampled import read_light

T_US = 1003 * np.arange(1, 401)
X, Y, P = np.arange(400) % 30, np.arange(400) % 20, np.arange(400) % 2


def lines(row, p=P):
    """Every event as a line of text, by its t, x, y, p."""
    return "".join(row(*event) + "\n" for event in zip(T_US, X, Y, p, strict=True))


@pytest.mark.parametrize(
    ("header", "row", "says"),
    [
        ("time_s,supply_voltage,photocurrent_nA", "{t},5.0,{l}", "supply_voltage, photocurrent_nA"),
        ("time_s,lux_setpoint,ch1_V", "{t},100,{l}", "lux_setpoint, ch1_V"),
        ("time_s,log10_lux", "{t},{l}", "logarithm"),
        ("t_s,light_V", "{t},9.91E+37", "overflow"),
        ("t_s,light_V", "{t},nan", "overflow"),
        ("time_ms,lux", "{k},1,{k}", "decimal commas"),
    ],
)
def test_light_that_may_be_another_is_refused(tmp_path, header, row, says):
    rows = (row.format(t=1e-3 * k, l=1.0 + k % 3, k=k) for k in range(50))
    path = tmp_path / "light.csv"
    path.write_text("\n".join([header, *rows]) + "\n")
    with pytest.raises(InputError, match=says):
        read_light(path)


@pytest.mark.parametrize("comment", ["# Time (s): 30", "# clock: ms accuracy (NTP)", "# exp: time (ms) 10"])
def test_a_unit_in_other_words_is_no_unit_of_the_times(tmp_path, comment):
    path = tmp_path / "events.txt"
    path.write_text(f"{comment}\n# t x y p\n" + lines("{} {} {} {}".format))
    np.testing.assert_array_equal(open_recording(path).events.t, T_US * 1000)


def test_text_without_numbers_is_refused_whatever_is_stated(tmp_path):
    path = tmp_path / "events.txt"
    path.write_text(lines("t={} x={} y={} p={}".format))
    with pytest.raises(InputError, match="lines of numbers"):
        open_recording(path, ReadingOptions(columns=("t", "x", "y", "p")))


def test_a_row_of_units_may_have_empty_cells(tmp_path):
    path = tmp_path / "events.csv"
    path.write_text("time,x,y,p\nms,,,\n" + lines(lambda t, x, y, p: f"{t / 1000:.3f},{x},{y},{p}"))
    np.testing.assert_array_equal(open_recording(path).events.t, T_US * 1000)


def test_trailing_blanks_of_words(tmp_path):
    path = tmp_path / "events.csv"
    words = ("off ", "on ")
    path.write_text("t_us,x,y,p\n" + lines(lambda t, x, y, p: f"{t},{x},{y},{words[p]}"))
    np.testing.assert_array_equal(open_recording(path).events.p, P)


def test_times_with_fractions_are_not_in_the_unit_of_their_layout(tmp_path):
    savemat(tmp_path / "a.mat", {"TD": {"ts": T_US * 1e-6 + 1e-7, "x": X + 1, "y": Y + 1, "p": P}})
    with h5py.File(tmp_path / "b.h5", "w") as file:
        for name, column in zip("txyp", (T_US * 1e-6 + 1e-7, X, Y, P), strict=True):
            file[f"events/{name}"] = column
        file["ms_to_idx"] = np.arange(400)
    for name in ("a.mat", "b.h5"):
        np.testing.assert_allclose(open_recording(tmp_path / name).events.t, T_US * 1000 + 100, atol=1)


def test_a_layout_without_events_is_empty(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name in "txyp":
            file[f"events/{name}"] = np.zeros(0, np.int64)
        file["ms_to_idx"] = np.zeros(1, np.int64)
    assert len(open_recording(tmp_path / "a.h5").events) == 0


def test_links_within_a_file_and_named_types_are_no_data_elsewhere(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name, column in zip("txyp", (T_US, X, Y, P), strict=True):
            file[f"v1/events/{name}"] = column
        file["events"] = h5py.SoftLink("/v1/events")
        file["again"] = h5py.SoftLink("/")
        file["kind"] = np.dtype("u2")
    assert len(open_recording(tmp_path / "a.h5").events) == 400


def test_codes_of_polarity_that_are_stated_file_by_file_agree(tmp_path):
    for name, codes in (("one", P), ("two", 2 * P - 1)):
        (tmp_path / f"{name}.csv").write_text("t_us,x,y,p\n" + lines("{},{},{},{}".format, codes))
        (tmp_path / f"{name}.source.toml").write_text(f'polarity = "{"01" if name == "one" else "pm1"}"\n')
    for recording in open_recordings([tmp_path / "one.csv", tmp_path / "two.csv"]):
        np.testing.assert_array_equal(recording.events.p, P)


def test_cameras_beside_a_matrix(tmp_path):
    matrix = [[60.0, 0, 30], [0, 61.0, 20], [0, 0, 1]]
    bent = camera_of_document(tmp_path, {"intrinsics": matrix, "k1": 0.1}, 64, 48)
    assert bent.distortion[0] == 0.1
    half = camera_of_document(tmp_path, {"intrinsics": matrix, "w": 128, "h": 96}, 64, 48)
    assert half.intrinsics[0, 0] == 30.0
    for name in ("K", "camera_matrix", "principal_point"):
        with pytest.raises(InputError, match=name):
            camera_of_document(tmp_path, {"camera_angle_x": 0.7, name: matrix}, 64, 48)
