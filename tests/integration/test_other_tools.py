"""Files that other tools write are read event for event, and what pixelid writes is read by them; docs has the table.

Tools are not dependencies: those that are not installed are skipped (`pip install --target … event_stream evlib …`).
"""

from pathlib import Path

import numpy as np
import pytest

from pixelid.errors import InputError
from pixelid.recordings import Events, Recording, open_recording, write_recording

WIDTH, HEIGHT = 346, 260
PAGE = Path(__file__).parents[2] / "docs" / "formats.md"


def made() -> Events:
    rng = np.random.default_rng(0)
    t = np.sort(rng.choice(2_000_000, 500, replace=False)) * 1000
    x, y = rng.integers(0, WIDTH, 500), rng.integers(0, HEIGHT, 500)
    return Events.from_columns(t, x, y, rng.integers(0, 2, 500), WIDTH, HEIGHT, tick_ns=1000)


def with_faery(path: Path, e: Events) -> None:
    faery = pytest.importorskip("faery")
    events = np.zeros(len(e), faery.EVENTS_DTYPE)
    events["t"], events["x"], events["y"] = e.t // 1000, e.x, e.y
    events["p" if "p" in events.dtype.names else "on"] = e.p
    faery.events_stream_from_array(events, (WIDTH, HEIGHT)).to_file(path, zero_t0=False)


def with_event_stream(path: Path, e: Events) -> None:
    event_stream = pytest.importorskip("event_stream")
    events = np.zeros(len(e), event_stream.dvs_dtype)
    events["t"], events["x"], events["y"], events["on"] = e.t // 1000, e.x, HEIGHT - 1 - e.y, e.p  # y from the bottom
    with event_stream.Encoder(str(path), "dvs", WIDTH, HEIGHT) as encoder:
        encoder.write(events)


def with_dv_processing(path: Path, e: Events) -> None:
    dv = pytest.importorskip("dv_processing")
    store = dv.EventStore()
    for t, x, y, p in zip(e.t.tolist(), e.x.tolist(), e.y.tolist(), e.p.tolist(), strict=True):
        store.push_back(t // 1000, x, y, bool(p))
    config = dv.io.MonoCameraWriter.EventOnlyConfig("DAVIS346", (WIDTH, HEIGHT))
    writer = dv.io.MonoCameraWriter(str(path), config)
    writer.writeEvents(store)
    del writer


def with_expelliarmus(path: Path, e: Events) -> None:
    expelliarmus = pytest.importorskip("expelliarmus")
    events = np.zeros(len(e), [("t", "<i8"), ("x", "<i2"), ("y", "<i2"), ("p", "u1")])
    events["t"], events["x"], events["y"], events["p"] = e.t // 1000, e.x, e.y, e.p
    expelliarmus.Wizard(encoding=path.stem).save(str(path), events)


def with_evlib(path: Path, e: Events) -> None:
    evlib = pytest.importorskip("evlib")
    x, y, p = (column.astype(np.int64) for column in (e.x, e.y, e.p))
    evlib.save_events_to_hdf5(x, y, e.t * 1e-9, p, str(path))


def with_tonic(path: Path, e: Events) -> None:
    tonic = pytest.importorskip("tonic.io")
    np.savez(path, events=tonic.make_structured_array(e.x, e.y, e.t // 1000, e.p.astype(bool)))


def with_rosbags(path: Path, e: Events) -> None:
    """`dvs_msgs/EventArray` messages as rosbags serialises them."""
    rosbag1, rosbag2 = pytest.importorskip("rosbags.rosbag1"), pytest.importorskip("rosbags.rosbag2")
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    one = path.suffix == ".bag"
    store = get_typestore(Stores.ROS1_NOETIC if one else Stores.ROS2_HUMBLE)
    moment = "time" if one else "builtin_interfaces/Time"
    event = f"uint16 x\nuint16 y\n{moment} ts\nbool polarity\n"
    store.register(get_types_from_msg(event, "dvs_msgs/msg/Event"))
    array = "std_msgs/Header header\nuint32 height\nuint32 width\ndvs_msgs/Event[] events\n"
    store.register(get_types_from_msg(array, "dvs_msgs/msg/EventArray"))
    event, array, header, stamp = (
        store.types[f"{package}/msg/{name}"]
        for package, name in (("dvs_msgs", "Event"), ("dvs_msgs", "EventArray"), ("std_msgs", "Header"),
                              ("builtin_interfaces", "Time"))
    )  # fmt: skip
    plugin = rosbag2.StoragePlugin.MCAP if path.suffix == ".mcap" else rosbag2.StoragePlugin.SQLITE3
    folder = path.parent / "bag"
    writer = rosbag1.Writer(path) if one else rosbag2.Writer(folder, version=9, storage_plugin=plugin)
    number = {"seq": 0} if one else {}
    with writer as bag:
        connection = bag.add_connection("/events", "dvs_msgs/msg/EventArray", typestore=store)
        rows = list(zip(e.t.tolist(), e.x.tolist(), e.y.tolist(), e.p.tolist(), strict=True))
        for k in range(0, len(rows), 77):
            events = [event(x=x, y=y, ts=stamp(*divmod(t, 10**9)), polarity=bool(p)) for t, x, y, p in rows[k : k + 77]]
            message = array(header(stamp=stamp(1, 2), frame_id="dvs", **number), HEIGHT, WIDTH, events)
            serialise = store.serialize_ros1 if one else store.serialize_cdr
            bag.write(connection, rows[k][0], serialise(message, "dvs_msgs/msg/EventArray"))
    if not one:
        next(folder.glob(f"*{path.suffix}")).rename(path)


WRITTEN = [  # tool, what it calls the format, file, writer, what becomes of it
    ("faery", "ES", "a.es", with_faery, "event for event"),
    ("faery", "AEDAT4", "a.aedat4", with_faery, "event for event"),
    ("faery", "DAT", "a.dat", with_faery, "event for event"),
    ("faery", "EVT3", "a.raw", with_faery, "event for event"),
    ("faery", "CSV", "a.csv", with_faery, "event for event"),
    ("event_stream", "ES (y from the bottom)", "a.es", with_event_stream, "event for event, y from the top"),
    ("dv-processing", "AEDAT4", "a.aedat4", with_dv_processing, "event for event"),
    ("expelliarmus", "DAT", "dat.dat", with_expelliarmus, "event for event"),
    ("expelliarmus", "EVT2", "evt2.raw", with_expelliarmus, "event for event"),
    ("expelliarmus", "EVT3", "evt3.raw", with_expelliarmus, "refused: low times come before high ones"),
    ("evlib", "HDF5", "a.h5", with_evlib, "event for event"),
    ("rosbags", "dvs_msgs in .bag", "a.bag", with_rosbags, "event for event"),
    ("rosbags", "dvs_msgs in .db3", "a.db3", with_rosbags, "event for event"),
    ("rosbags", "dvs_msgs in .mcap", "a.mcap", with_rosbags, "event for event"),
    ("tonic", "structured array in .npz", "a.npz", with_tonic, "event for event"),
]  # fmt: skip


@pytest.mark.parametrize(("tool", "kind", "file", "write", "outcome"), WRITTEN)
def test_what_other_tools_write(tmp_path, tool, kind, file, write, outcome):
    assert f"| {tool} | {kind} | {outcome} |" in PAGE.read_text()
    events = made()
    write(tmp_path / file, events)
    if outcome.startswith("refused"):
        with pytest.raises(InputError, match="clock"):
            open_recording(tmp_path / file)
        return
    found = open_recording(tmp_path / file).events
    for name in "txyp":
        np.testing.assert_array_equal(getattr(found, name), getattr(events, name))


def test_what_evlib_reads_of_ours(tmp_path):
    evlib = pytest.importorskip("evlib")
    events = made()
    write_recording(Recording(events), tmp_path / "a.h5")
    found = evlib.load_events(str(tmp_path / "a.h5")).collect()
    np.testing.assert_array_equal(found["t"].dt.total_microseconds().to_numpy(), events.t // 1000)
    np.testing.assert_array_equal(found["x"].to_numpy(), events.x)
    np.testing.assert_array_equal(found["polarity"].to_numpy() > 0, events.p == 1)
