"""What files state in passing is read, and what fits twice is refused: text, arrays, light, pictures, biases."""

import warnings

import h5py
import numpy as np
import pytest

from pixelid.errors import InputError, on_command_line
from pixelid.recordings import open_recording
from pixelid.recordings.bias_files import biases_beside
from pixelid.recordings.source import ReadingOptions, Source
from pixelid.stimuli.files import load_stimulus
from pixelid.time_units import unit_in, with_unit

N = 300
RNG = np.random.default_rng(1)
T = np.sort(RNG.choice(50_000, N, replace=False)) + 1007
X, Y, P = RNG.integers(0, 320, N), RNG.integers(0, 200, N), RNG.integers(0, 2, N)
X[:2], Y[:2] = (319, 0), (0, 199)


@pytest.fixture(autouse=True)
def words_of_the_command_line():
    with on_command_line():
        yield


def table(*columns, mark=",", head="", wrap="{}") -> str:
    rows = zip(*(np.asarray(column).tolist() for column in columns), strict=True)
    return head + "".join(wrap.format(mark.join(map(str, row))) + "\n" for row in rows)


def holds(recording, t=T, x=X, y=Y, size=(320, 200)) -> bool:
    e = recording.events
    same = all(map(np.array_equal, (e.t, e.x, e.y, e.p), (t * 1000, x, y, P)))
    return same and (e.width, e.height) == size


WORDS = np.where(P == 1, "ON", "OFF")
MS = np.char.replace(np.char.mod("%.3f", T * 1e-3), ".", ",")
TEXTS = {
    "timestamp (microseconds),x [px],y [px],polarity\n": (T, X, Y, P),
    "usec,pixel_x,pixel_y,pol\n": (T, X, Y, P),
    "# timestamps in nanoseconds\nt,x,y,p\n": (T * 1000, X, Y, P),
    "t,x,y,p\nns,px,px,-\n": (T * 1000, X, Y, P),
    "t,x,y,p\nus,px,px,1\n": (T, X, Y, P),
    "width: 320\nheight: 200\nt,x,y,p\n": (T, X, Y, P),
    "t,x,y,p\n": (T, X, Y, WORDS),
    "320,200\n": (T, X, Y, P),
    "# size: 320x200\n": (T, Y, X, P),  # rows first: only that fits the size
    "t,x,y,p\n\n": (T, X, Y, np.where(P == 1, "up", "down")),
    "event_t,event_x,event_y,event_p\n": (T, X, Y, P),
    "# Zeit in \xb5s\n# H=200 W=320\nt,x,y,p\n": (T, X + 1, Y + 1, P),  # counted from one: the last is the size
}


@pytest.mark.parametrize("head", TEXTS)
def test_texts(tmp_path, head):
    (tmp_path / "a.csv").write_text(table(*TEXTS[head], head=head), encoding="latin1")
    assert holds(open_recording(tmp_path / "a.csv"))


def test_rows_in_brackets_of_any_suffix(tmp_path):
    (tmp_path / "a.log").write_text(table(T, X, Y, P, mark=", ", wrap="[{}]"))
    assert holds(open_recording(tmp_path / "a.log"))
    (tmp_path / "b.csv").write_text(table(MS, X, Y, P, wrap='"{}"', mark='","', head='"t[ms]","x","y","p"\n'))
    assert holds(open_recording(tmp_path / "b.csv"))


@pytest.mark.parametrize(
    ("columns", "head", "way"),
    [((T, Y, X, P), "", "--columns"), ((T // 1000, X, Y, P), "t,x,y,p\n", "--time-unit"),
     ((T // 10000, X, Y, P), "t,x,y,p\n", "--time-unit")],
)  # fmt: skip
def test_what_fits_twice_is_refused(tmp_path, columns, head, way):
    (tmp_path / "a.csv").write_text(table(*columns, head=head))
    with pytest.raises(InputError, match=way):
        open_recording(tmp_path / "a.csv")


def test_joined_files_and_rows_without_numbers(tmp_path):
    half, rest = (table(*(c[part] for c in (T, X, Y, P)), head="t,x,y,p\n") for part in (np.s_[:100], np.s_[100:]))
    (tmp_path / "a.csv").write_text(f"{half}{rest}nan,nan,nan,nan\n,,,\n")
    assert holds(open_recording(tmp_path / "a.csv"))


def test_joined_traces(tmp_path):
    (tmp_path / "a.csv").write_text("t_s,lux\n0,1\n1,2\nt_s,lux\n2,3\nnan,nan\n")
    light = load_stimulus(tmp_path / "a.csv")
    assert (light.t.tolist(), light.radiance.tolist()) == ([0.0, 1.0, 2.0], [1.0, 2.0, 3.0])
    (tmp_path / "a.csv").write_text("timestamp,lux\n\ntimestamp,lux\n")
    with pytest.raises(InputError, match="found the header only"):
        load_stimulus(tmp_path / "a.csv")


def test_samples_that_are_counted_by_nothing_finite(tmp_path):
    (tmp_path / "a.csv").write_text("X,CH1,Start,Increment,\nSequence,Volt,0.0,1e999\n0,1.0,\n1,1.5,\n")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(InputError):
            load_stimulus(tmp_path / "a.csv")


def test_times_of_two_clocks_are_refused(tmp_path):
    (tmp_path / "a.csv").write_text(table(T // 1000, T % 1000 * 1000, X, Y, P, head="msecs,nsecs,x,y,p\n"))
    with pytest.raises(InputError, match="--columns"):
        open_recording(tmp_path / "a.csv")


@pytest.mark.parametrize("codes", [(1, 2), (0, 255), (255, 0)])
def test_polarities_of_other_codes_are_stated(tmp_path, codes):
    (tmp_path / "a.csv").write_text(table(T, X, Y, np.where(P == 1, codes[1], codes[0]), head="t,x,y,p\n"))
    with pytest.raises(InputError, match="OFF/ON"):
        open_recording(tmp_path / "a.csv")
    off_on = f"{codes[0]}/{codes[1]}"
    assert holds(open_recording(tmp_path / "a.csv", ReadingOptions.of({"polarity": off_on})))
    with pytest.raises(InputError, match="polarity must be 7"):
        open_recording(tmp_path / "a.csv", ReadingOptions.of({"polarity": "5/7"}))


def test_what_no_rule_reads_says_what_to_do(tmp_path):
    objects = np.array([[1, 2, 3, True], [2, 2, 3, False]], object)
    np.save(tmp_path / "a.npy", objects)
    (tmp_path / "a.json").write_text('{"t": [1]}')
    (tmp_path / "cut.csv").write_text(table(T, X, Y, P, head="t,x,y,p\n") + "912")
    (tmp_path / "half.csv").write_text(table(T, X + 0.5, Y, P, head="t,x,y,p\n"))
    (tmp_path / "date.csv").write_text("t,x,y,p\n2024-01-01 12:00:00.5,1,2,0\n")
    (tmp_path / "a.raw").write_bytes(bytes(range(40)))
    ways = {"a.npy": "astype", "a.json": r"\.npz are read", "cut.csv": "correct that line",
            "half.csv": "whole pixels", "date.csv": "write numbers", "a.raw": "% evt 3.0"}  # fmt: skip
    for name, way in ways.items():
        with pytest.raises(InputError, match=way):
            open_recording(tmp_path / name)


@pytest.mark.parametrize("names", [("timestamp", "position", "polarity"), ("events_t", "events_xy", "events_p")])
def test_addresses_in_one_array(tmp_path, names):
    """As in EVIMO2 and Robust e-NeRF."""
    columns = dict(zip(names, (T, np.stack([X, Y], axis=1), P), strict=True))
    np.savez(tmp_path / "a.npz", **columns)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.update(columns)
    for suffix in (".npz", ".h5"):
        assert holds(open_recording(tmp_path / f"a{suffix}"))


def test_times_in_single_precision_show_their_clock(tmp_path):
    np.save(tmp_path / "a.npy", np.stack([T * 1e-6 + 30.0, X, Y, P], axis=1).astype(np.float32))
    e = open_recording(tmp_path / "a.npy").events
    assert e.tick_ns == 10_000  # 30 s are known to 1.9 us
    np.testing.assert_array_equal(e.t % 10_000, 0)
    assert np.abs(e.t - T * 1000 - 30 * 10**9).max() <= 6_000


def test_the_clock_shows_where_everything_is_stated(tmp_path):
    (tmp_path / "a.csv").write_text(table(T * 1e-6, X, Y, P, head="t [s],x,y,p\n"))
    stated = ReadingOptions(size=(320, 200), time_unit="s", polarity="01", columns=("t", "x", "y", "p"))
    recording = open_recording(tmp_path / "a.csv", stated)
    assert holds(recording)
    assert recording.events.tick_ns == 1


def test_a_unit_that_is_none_is_stated(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name, column in zip(("t", "x", "y", "p"), (T * 1000, X, Y, P), strict=True):
            file[name] = column
        file["t"].attrs["units"] = "nanoseconds since start"
    assert holds(open_recording(tmp_path / "a.h5"))
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        file["t"].attrs["units"] = "ticks"
    with pytest.raises(InputError, match="--time-unit"):
        open_recording(tmp_path / "a.h5")
    assert holds(open_recording(tmp_path / "a.h5", ReadingOptions(time_unit="ns")))


def test_addresses_that_may_count_from_one_are_said(tmp_path):
    (tmp_path / "a.csv").write_text(table(T, X + 1, Y + 1, P, head="t,x,y,p\n"))
    line = Source.from_dict(open_recording(tmp_path / "a.csv").attributes["source"]).line()
    assert "addresses begin at 1" in line
    assert "--size" in line
    assert holds(open_recording(tmp_path / "a.csv", ReadingOptions(size=(320, 200))))


@pytest.mark.parametrize(
    ("attributes", "t", "size"),
    [({"resolution": [320, 200]}, T, (320, 200)), ({"sensor_resolution": (480, 640)}, T, (640, 480)),
     ({"geometry": "640x480", "format": "ECF"}, T, (640, 480)), ({"camera": "DAVIS346"}, T, (346, 260)),
     ({"time_unit": "nanoseconds", "W": 320, "H": 200}, T * 1000, (320, 200))],
)  # fmt: skip
def test_what_attributes_state(tmp_path, attributes, t, size):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name, column in zip(("t", "x", "y", "p"), (t, X, Y, P), strict=True):
            file[f"dvs/{name}"] = column
        file.attrs.update(attributes)
    assert holds(open_recording(tmp_path / "a.h5"), size=size)


def test_rows_of_an_array_and_parts_of_a_stream_s_name(tmp_path):
    rows = np.stack([T, X, Y, P])
    np.save(tmp_path / "a.npy", rows)
    np.savez(tmp_path / "b.npz", events=rows, time_unit="us")
    assert holds(open_recording(tmp_path / "a.npy"))
    assert holds(open_recording(tmp_path / "b.npz"))
    with h5py.File(tmp_path / "c.h5", "w") as file:
        for side in ("left", "right"):
            file[f"davis/{side}/events"] = rows.T
    assert holds(open_recording(tmp_path / "c.h5", ReadingOptions(stream="right")))
    with h5py.File(tmp_path / "d.h5", "w") as file:
        file["events"] = np.column_stack([np.arange(N), rows.T])
    assert holds(open_recording(tmp_path / "d.h5", ReadingOptions.of({"columns": "k,t,x,y,p"})))


def test_topics_whose_messages_are_empty_are_passed_over(tmp_path):
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("uint16 x\nuint16 y\ntime ts\nbool polarity\n", "dvs_msgs/msg/Event"))
    array = "std_msgs/Header header\nuint32 height\nuint32 width\ndvs_msgs/Event[] events\n"
    store.register(get_types_from_msg(array, "dvs_msgs/msg/EventArray"))
    records = np.zeros(N, [("x", "<u2"), ("y", "<u2"), ("s", "<u4"), ("ns", "<u4"), ("p", "u1")])
    records["x"], records["y"], records["ns"], records["p"] = X, Y, T * 1000, P
    with Writer(tmp_path / "a.bag") as bag:
        for topic, events in (("/left/events", records[:0]), ("/right/events", records)):
            connection = bag.add_connection(topic, "dvs_msgs/msg/EventArray", typestore=store)
            size = (200).to_bytes(4, "little") + (320).to_bytes(4, "little") + len(events).to_bytes(4, "little")
            bag.write(connection, 0, bytes(16) + size + events.tobytes())
    assert holds(open_recording(tmp_path / "a.bag"))


SECONDS = np.arange(50) * 1e-3
LIGHT = 1.5 + np.sin(100 * SECONDS)
LIGHTS = {
    "Zeit [ms];U [V]\n": ("V", 1e3, ";", ","),
    "in s,C1 in V\n": ("V", 1.0, ",", "."),
    "Vertical Units,V\nModel,1\nTIME,CH1\n": ("V", 1.0, ",", "."),
    "Source,CH1\nSecond,Value\n": ("relative", 1.0, ",", "."),
    "# t_ms lux\n": ("lux", 1e3, " ", "."),
}


@pytest.mark.parametrize("head", LIGHTS)
def test_light(tmp_path, head):
    unit, scale, mark, point = LIGHTS[head]
    rows = "".join(f"{a * scale:.6f}{mark}{b:.6f}\n".replace(".", point) for a, b in zip(SECONDS, LIGHT, strict=True))
    (tmp_path / "a.csv").write_text(head + rows, encoding="latin1")
    light = load_stimulus(tmp_path / "a.csv")
    np.testing.assert_allclose(light.t, SECONDS, atol=1e-9)
    np.testing.assert_allclose(light.radiance, LIGHT, rtol=1e-5)
    assert light.unit == unit


def test_light_of_dates_and_of_counted_samples(tmp_path):
    rows = "".join(f"10:00:00.{round(a * 1e6):06d},{b:.6f}\n" for a, b in zip(SECONDS, LIGHT, strict=True))
    (tmp_path / "a.csv").write_text("time,lux\n" + rows)
    np.testing.assert_allclose(load_stimulus(tmp_path / "a.csv").t, SECONDS, atol=1e-9)
    rows = "".join(f"{b:.6f},,\n" for b in LIGHT)
    (tmp_path / "b.csv").write_text("CH1V,t0 = 0.0s, tInc = 1e-3,\n" + rows)
    np.testing.assert_allclose(load_stimulus(tmp_path / "b.csv").t, SECONDS, atol=1e-9)
    (tmp_path / "c.csv").write_text("timestamp,lux\n0,1\n100,2\n200,3\n")
    with pytest.raises(InputError, match="time_unit"):
        load_stimulus(tmp_path / "c.csv")


def frames(folder, levels, stamps=None, kind=np.uint8) -> None:
    from imageio.v3 import imwrite

    (folder / "f").mkdir()
    for k, level in enumerate(levels):
        imwrite(folder / "f" / f"{'Frame' if k % 2 else 'frame'}{k}.tif", np.full((4, 5), level, kind))
    if stamps is not None:
        (folder / "f" / "frame_timestamps.csv").write_text(stamps)
    (folder / "light.toml").write_text('[stimulus]\nkind = "file"\npath = "f"\n' + ("" if stamps else "fps = 100.0\n"))


def test_times_and_order_of_pictures(tmp_path):
    frames(tmp_path, 20 * np.arange(1, 13), "name,t_us\n" + "".join(f"{k},{7000 * k}\n" for k in range(12)))
    light = load_stimulus(tmp_path / "light.toml")
    np.testing.assert_allclose(light.t[:12], 7e-3 * np.arange(12))
    assert np.all(np.diff(light.radiance[:12, 0, 0]) > 0)


def test_fewer_bits_than_the_type_are_said(tmp_path):
    from pixelid.recordings.source import NOTHING, stating

    frames(tmp_path, 300 * np.arange(1, 13), kind=np.uint16)
    lines: list[str] = []
    with stating(NOTHING, lines.append):
        load_stimulus(tmp_path / "light.toml")
    assert any("full_scale = 4095.0" in line for line in lines)


@pytest.mark.parametrize(
    "text",
    ["% system_ID 28\n-20  %   bias_fo   %  v\n", "bias_fo = -20\n",
     '{"ll_biases_state": {"bias": [{"name": "bias_fo", "value": -20}]}}'],
)  # fmt: skip
def test_biases(tmp_path, text):
    (tmp_path / "a.bias").write_text(text)
    assert biases_beside(tmp_path / "a.raw") == {"bias_fo": -20}


def test_units_in_names_and_comments():
    assert with_unit("t/us") == ("t", "us")
    assert with_unit("ts") == ("ts", None)
    assert unit_in("time unit: ns") == "ns"
    assert unit_in("exposure time in ms: 3") is None
