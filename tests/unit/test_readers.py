"""Readers of bags, MATLAB files and triggers, on files written here by other means and on real ones."""

from dataclasses import replace

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from pixelid.errors import InputError
from pixelid.recordings import Events, Recording, open_recording, write_recording
from pixelid.recordings.triggers import Triggers

HEADER_ROS1 = (7).to_bytes(4, "little") + (0).to_bytes(8, "little") + (3).to_bytes(4, "little") + b"cam"


def columns(n=200, seed=0):
    rng = np.random.default_rng(seed)
    t = np.sort(rng.integers(0, 3_000_000, n)) * 1000 + 1_600_000_000_000_000_000
    return t, rng.integers(0, 30, n), rng.integers(0, 20, n), rng.integers(0, 2, n)


def equal(events: Events, t, x, y, p):
    for found, expected in ((events.t, t), (events.x, x), (events.y, y), (events.p, p)):
        np.testing.assert_array_equal(found, expected)


def records(t, x, y, p) -> bytes:
    """`dvs_msgs/Event` records as ROS 1 writes them."""
    parts = []
    for row in zip(t.tolist(), x.tolist(), y.tolist(), p.tolist(), strict=True):
        seconds, rest = divmod(row[0], 10**9)
        parts.append(
            row[1].to_bytes(2, "little") + row[2].to_bytes(2, "little") + seconds.to_bytes(4, "little")
            + rest.to_bytes(4, "little") + row[3].to_bytes(1, "little")
        )  # fmt: skip
    return b"".join(parts)


def test_ros1_event_arrays(tmp_path):
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("uint16 x\nuint16 y\ntime ts\nbool polarity\n", "dvs_msgs/msg/Event"))
    array = "std_msgs/Header header\nuint32 height\nuint32 width\ndvs_msgs/Event[] events\n"
    store.register(get_types_from_msg(array, "dvs_msgs/msg/EventArray"))
    t, x, y, p = columns()
    with Writer(tmp_path / "events.bag") as bag:
        connection = bag.add_connection("/dvs/events", "dvs_msgs/msg/EventArray", typestore=store)
        for k in range(0, 200, 50):
            s = slice(k, k + 50)
            size = (20).to_bytes(4, "little") + (30).to_bytes(4, "little") + (50).to_bytes(4, "little")
            bag.write(connection, int(t[k]), HEADER_ROS1 + size + records(t[s], x[s], y[s], p[s]))
    recording = open_recording(tmp_path / "events.bag")
    equal(recording.events, t, x, y, p)
    assert (recording.events.width, recording.events.height, recording.events.tick_ns) == (30, 20, 1000)


def test_ros2_event_arrays_in_cdr(tmp_path):
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    event = get_types_from_msg("uint16 x\nuint16 y\nbuiltin_interfaces/Time ts\nbool polarity\n", "dvs_msgs/msg/Event")
    store.register(event)
    array = "std_msgs/Header header\nuint32 height\nuint32 width\ndvs_msgs/Event[] events\n"
    store.register(get_types_from_msg(array, "dvs_msgs/msg/EventArray"))
    kinds = store.types
    t, x, y, p = columns()
    stamp = kinds["builtin_interfaces/msg/Time"]
    for plugin, name in ((StoragePlugin.SQLITE3, "sqlite"), (StoragePlugin.MCAP, "mcap")):
        with Writer(tmp_path / name, version=9, storage_plugin=plugin) as bag:
            connection = bag.add_connection("/events", "dvs_msgs/msg/EventArray", typestore=store)
            for k in range(0, 200, 67):
                rows = zip(*(c[k : k + 67].tolist() for c in (t, x, y, p)), strict=True)
                events = [
                    kinds["dvs_msgs/msg/Event"](x=b, y=c, ts=stamp(sec=a // 10**9, nanosec=a % 10**9), polarity=bool(d))
                    for a, b, c, d in rows
                ]
                header = kinds["std_msgs/msg/Header"](stamp=stamp(sec=1, nanosec=2), frame_id="camera")
                message = kinds["dvs_msgs/msg/EventArray"](header=header, height=20, width=30, events=events)
                bag.write(connection, int(t[k]), store.serialize_cdr(message, "dvs_msgs/msg/EventArray"))
        file = next(f for f in (tmp_path / name).iterdir() if f.suffix in (".db3", ".mcap"))
        equal(open_recording(file).events, t, x, y, p)


def test_the_clock_of_a_dvxplorer_that_rolls_over(shared):
    recording = open_recording(shared / "recordings" / "ros" / "libcaer_rollover_0.db3")
    with np.load(shared / "recordings" / "ros" / "libcaer_rollover_dvxplorer.npz") as file:
        equal(recording.events, file["t"] * 1000, file["x"], file["y"], file["p"])


def test_trigger_edges_of_a_bag(shared):
    recording = open_recording(shared / "recordings" / "ros" / "evt3_trigger_0.db3")
    assert recording.triggers is not None
    np.testing.assert_array_equal(np.diff(recording.triggers.t), [2_000_000])
    flicker = open_recording(shared / "recordings" / "flicker120_gen31.db3")
    with np.load(shared / "recordings" / "flicker120_gen31.npz") as file:
        equal(flicker.events, file["t"] * 1000, file["x"], file["y"], file["p"])
        assert flicker.triggers is not None
        np.testing.assert_array_equal(flicker.triggers.t, file["trig"][:, 0] * 1000)
        np.testing.assert_array_equal(flicker.triggers.rising, file["trig"][:, 1] == 1)


def test_triggers_of_prophesee_raw(tmp_path):
    words = [0x8000, 0x600A, 0xA201, 0x0005, 0x2807, 0x6014, 0xA200, 0x601E, 0x3864, 0x4005]
    (tmp_path / "a.raw").write_bytes(b"% evt 3.0\n% geometry 640x480\n% end\n" + np.array(words, "<u2").tobytes())
    (tmp_path / "a.bias").write_text("299  % bias_diff\n30 % bias_fo\n")
    recording = open_recording(tmp_path / "a.raw")
    equal(recording.events, [10_000, 30_000, 30_000], [7, 100, 102], [5, 5, 5], [1, 1, 1])
    assert recording.triggers is not None
    np.testing.assert_array_equal(recording.triggers.t, [10_000, 20_000])
    np.testing.assert_array_equal(recording.triggers.rising, [True, False])
    assert recording.attributes["biases"] == {"bias_diff": 299, "bias_fo": 30}


def test_prophesee_hdf5(tmp_path):
    t, x, y, p = columns()
    t = (t - t[0]) // 1000
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.attrs["geometry"] = "640x480"
        kinds = [("x", "<u2"), ("y", "<u2"), ("p", "<i2"), ("t", "<i8")]
        file["CD/events"] = np.rec.fromarrays([x, y, p, t], dtype=kinds)
        file["EXT_TRIGGER/events"] = np.array([(1, 500, 6), (0, 900, 6)], [("p", "<i2"), ("t", "<i8"), ("id", "<i2")])
    recording = open_recording(tmp_path / "a.h5")
    equal(recording.events, t * 1000, x, y, p)
    assert (recording.events.width, recording.triggers.edges_s().tolist()) == (640, [5e-4])


def test_matlab_of_an_atis(tmp_path, shared):
    t, x, y, p = columns()
    t = (t - t[0]) // 1000
    table = {"ts": t[:, None], "x": x[:, None] + 1, "y": y[:, None] + 1, "p": p[:, None]}
    savemat(tmp_path / "a.mat", {"TD": table, "EM": table})
    recording = open_recording(tmp_path / "a.mat")
    equal(recording.events, t * 1000, x, y, p)
    assert recording.exposures is not None
    equal(recording.exposures, t * 1000, x, y, p)
    real = open_recording(shared / "recordings" / "atis" / "gorchard_example_data.mat")
    assert (len(real.events), len(real.exposures), real.events.width) == (242040, 442382, 304)


def test_triggers_and_exposures_stay_in_the_file(tmp_path):
    t, x, y, p = columns()
    events = Events.from_columns(t, x, y, p, 30, 20, tick_ns=1000)
    triggers = Triggers.from_columns([5, 9], [True, False], [1, 1])
    recording = Recording(events, triggers=triggers, exposures=replace(events, x=events.x[::-1]))
    write_recording(recording, tmp_path / "a.h5")
    again = open_recording(tmp_path / "a.h5")
    np.testing.assert_array_equal(again.triggers.t, [5, 9])
    np.testing.assert_array_equal(again.triggers.rising, [True, False])
    np.testing.assert_array_equal(again.exposures.x, events.x[::-1])
    np.testing.assert_array_equal(again.exposures.t, events.t)


@pytest.mark.parametrize("name", ["a.bag", "a.db3", "a.mcap", "a.mat"])
@pytest.mark.parametrize(
    "content", [b"SQLite format 3\0", b"#ROSBAG V2.0\n", b"MATLAB 5.0", b"\x89MCAP0\r\n", b"x" * 500]
)
def test_damaged_files_are_answered_in_one_line(tmp_path, name, content):
    (tmp_path / name).write_bytes(content + bytes(range(256)))
    with pytest.raises(InputError, match="expected"):
        open_recording(tmp_path / name)


@pytest.mark.parametrize(
    ("row", "says"),
    [
        ("5,70000,3,1", "65536 columns"),  # became 4464, modulo 2^16
        ("5,3,70000,1", "65536 columns"),
        ("5,65535,65535,1", "16777216 pixels"),  # a map of which takes 32 GiB
        ("5,4294967299,3,1", "65536 columns"),
        ("5,3,3,257", "polarity must be 1"),
        ("99999999999999999999,3,3,1", "64 bits"),
        ("-5,3,3,1", "negative"),
    ],
)
def test_numbers_beyond_their_column_are_refused(tmp_path, row, says):
    (tmp_path / "a.csv").write_text(f"t,x,y,p\n1,1,1,0\n{row}\n" if row[0] != "-" else f"t,x,y,p\n{row}\n9,1,1,0\n")
    with pytest.raises(InputError, match=says) as refused:
        open_recording(tmp_path / "a.csv")
    assert str(tmp_path / "a.csv") in str(refused.value)


def test_a_byte_order_mark_is_no_part_of_a_table(tmp_path):
    (tmp_path / "a.csv").write_bytes("\ufefft,x,y,p\r\n1,2,3,1\r\n".encode())
    (tmp_path / "b.txt").write_bytes("\ufeffx y p t\n2 3 1 1\n".encode())
    for name in ("a.csv", "b.txt"):
        equal(open_recording(tmp_path / name).events, [1000], [2], [3], [1])


DAVIS = b"#!AER-DAT2.0\r\n# AEChip: eu.seebetter.ini.chips.davis.DAVIS240C\r\n"


@pytest.mark.parametrize("end", [b"#End Of ASCII Header\r\n", "# by Jürgen Öztürk – 事件\r\n".encode(), b""])
@pytest.mark.parametrize("row", [100, 141])
def test_events_of_aedat2_that_look_like_a_header(tmp_path, end, row):
    """The address of an event in rows 140 to 143 of a DAVIS begins with a #; its bytes may hold an end of line."""
    address = np.full(50, row << 22 | 10 << 12 | 1 << 11)
    stamps = 2570 + np.arange(50)  # the first ends in two ends of lines
    data = np.column_stack([address, stamps]).astype(">u4").tobytes()
    (tmp_path / "a.aedat").write_bytes(DAVIS + end + data)
    e = open_recording(tmp_path / "a.aedat").events
    equal(e, stamps * 1000, np.full(50, 10), np.full(50, row), np.ones(50))


@pytest.mark.parametrize(
    ("times", "unit", "tick_ns"),
    [
        (np.array([0.0, 1000.0, 2500.0]), "us", 1),
        (np.array([0, 1000, 2500]), "us", 1000),
        (np.array([0, 1, 2]), "ms", 1_000_000),
        (np.array([0, 1000, 2500], np.float32), "us", 1),
        (np.array([0.0, 1e-3, 2.5e-3]), None, 1),
    ],
)
def test_the_unit_that_an_npz_states_counts(tmp_path, times, unit, tick_ns):
    x = np.arange(3)
    stated = {} if unit is None else {"unit": unit}
    np.savez(tmp_path / "a.npz", t=times, x=x, y=x, p=x % 2, **stated)
    e = open_recording(tmp_path / "a.npz").events
    np.testing.assert_array_equal(e.t, [0, 1_000_000, 2_000_000 if unit == "ms" else 2_500_000])
    assert e.tick_ns == tick_ns
    np.savez(tmp_path / "b.npz", t=times, x=x, y=x, p=x % 2, unit="fortnight")
    with pytest.raises(InputError, match="unit ns or us or ms or s, found 'fortnight'"):
        open_recording(tmp_path / "b.npz")


def test_text_in_seconds_may_begin_at_a_whole_one(tmp_path):
    (tmp_path / "a.csv").write_text("0,10,7,1\n0.25,11,7,1\n1,11,9,0\n")
    np.testing.assert_array_equal(open_recording(tmp_path / "a.csv").events.t, [0, 250_000_000, 1_000_000_000])
    (tmp_path / "b.csv").write_text("x,y,p,t\n1,2\n")
    with pytest.raises(InputError, match="expected 4 numbers a line at least, found 2 in event 0"):
        open_recording(tmp_path / "b.csv")
