"""ROS 1 and ROS 2 bags (.bag, .db3, .mcap), read by the library rosbags.

Two families of messages hold events:

- `dvs_msgs/EventArray` (also `prophesee_event_msgs`): one record per event with a time stamp of its own;
- `event_camera_msgs/EventPacket`: the camera's own bytes.  Encoding "evt3" is Prophesee's format (`evt`);
  "libcaer" is iniVation's, eight bytes per event: address word (bit 0 valid, bit 1 polarity, bits 2–16 row, bits 17–31
  column) and 31 bits of microseconds, which roll over after 36 minutes.

Records of events are read as arrays, not message by message: their layout is fixed by the message's definition
(ROS 1: packed; ROS 2: CDR, which aligns numbers to their size).
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pixelid.errors import InputError, first_line
from pixelid.recordings.columns import Rollovers, sensor_size, to_nanoseconds
from pixelid.recordings.decoded import decode_evt, evt_recording
from pixelid.recordings.events import Events
from pixelid.recordings.parts import joined
from pixelid.recordings.recording import Recording

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

RECORDS = ("dvs_msgs", "prophesee_event_msgs")
PACKETS = "event_camera_msgs/msg/EventPacket"
ROS1_RECORD = np.dtype([("x", "<u2"), ("y", "<u2"), ("s", "<u4"), ("ns", "<u4"), ("p", "u1")])
# CDR: the first record begins on a multiple of four, the others two bytes after one
CDR_FIRST = np.dtype([("x", "<u2"), ("y", "<u2"), ("s", "<i4"), ("ns", "<u4"), ("p", "u1"), ("", "u1")])
CDR_OTHERS = np.dtype([("x", "<u2"), ("y", "<u2"), ("", "u2"), ("s", "<i4"), ("ns", "<u4"), ("p", "u1"), ("", "u1")])
LIBCAER = np.dtype([("address", "<u4"), ("t", "<u4")])
ROLLOVER_US = 1 << 31


def read(path: Path) -> Recording:
    """The events of the first event topic of a bag, with trigger edges where the camera's bytes hold them.

    Raises:
        InputError: for a damaged bag, one without events, and encodings that are not read.
    """
    with opened_bag(path) as bag:
        topics = [c for c in bag.connections if c.msgtype == PACKETS or c.msgtype in record_types()]
        if not topics:
            found = ", ".join(sorted({c.msgtype for c in bag.connections})) or "nothing"
            raise InputError(f"{path}: expected a topic of events ({PACKETS}, {record_types()[0]}), found {found}")
        topic = topics[0]
        raw = (bytes(data) for connection, _, data in bag.messages(connections=[topic]))
        little = bag.is2
        if topic.msgtype == PACKETS:
            recording = _read_packets(path, raw, cdr=little)
        else:
            recording = _read_records(path, raw, cdr=little)
    recording.attributes["topic"] = topic.topic
    return recording


@contextmanager
def opened_bag(path: Path) -> Iterator[AnyReader]:
    """A bag of either ROS, open.

    Raises:
        InputError: for a file that is no bag or a damaged one, now or while it is read.
    """
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.rosbag1 import ReaderError as Ros1Error
    from rosbags.rosbag2 import ReaderError as Ros2Error
    from rosbags.typesys import Stores, get_typestore

    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as bag:
            yield bag
    except InputError:
        raise
    except (AnyReaderError, Ros1Error, Ros2Error, OSError, ValueError, KeyError, IndexError, AssertionError) as error:
        reason = first_line(error)[:120]
        raise InputError(f"{path}: expected a ROS bag, found a damaged or different file ({reason})") from None


def record_types() -> tuple[str, ...]:
    """The message types whose events are records."""
    return tuple(f"{package}/msg/EventArray" for package in RECORDS)


class _Message:
    """A serialised message, read field by field: ROS 1 packs numbers, CDR aligns each to its size."""

    def __init__(self, data: bytes, cdr: bool, path: Path) -> None:
        self.data, self.cdr, self.path = data, cdr, path
        self.order: str = "<" if not cdr or data[1:2] == b"\x01" else ">"
        self.start = self.at = 4 if cdr else 0  # after CDR's own header

    def number(self, size: int) -> int:
        if self.cdr:
            self.at += -(self.at - self.start) % size
        value = self.data[self.at : self.at + size]
        if len(value) < size:
            raise InputError(f"{self.path}: a message ends within its header")
        self.at += size
        return int.from_bytes(value, "little" if self.order == "<" else "big")

    def text(self) -> str:
        length = self.number(4)
        value = self.data[self.at : self.at + length]
        self.at += length
        return value.rstrip(b"\0").decode("latin1")

    def skip_header(self) -> None:
        """`std_msgs/Header`: in ROS 1 a sequence number, then time stamp and frame."""
        for _ in range(2 if self.cdr else 3):
            self.number(4)
        self.text()

    def rest(self, count: int) -> bytes:
        value = self.data[self.at : self.at + count]
        if len(value) < count:
            raise InputError(f"{self.path}: a message holds {len(value)} of the {count} bytes it declares")
        return value


def _read_packets(path: Path, raw: Iterator[bytes], cdr: bool) -> Recording:
    """Events of `EventPacket` messages, whose payloads follow each other as one stream of bytes."""
    size, encoding, payloads = (1, 1), "", []
    for data in raw:
        message = _Message(data, cdr, path)
        message.skip_header()
        height, width, _ = message.number(4), message.number(4), message.number(8)
        message.number(8)  # time_base: the payload says its own times
        here = message.text()
        if message.number(1) != 0:
            raise InputError(f"{path}: is_bigendian: expected little-endian payloads, found big-endian")
        encoding = encoding or here
        if here != encoding:
            raise InputError(f"{path}: encoding: expected {encoding!r} throughout, found {here!r}")
        size = (width, height)
        payloads.append(message.rest(message.number(4)))
    where = f"{path}: events"
    if encoding == "evt3":
        with tempfile.TemporaryDirectory() as folder:
            copy = Path(folder) / "payload.raw"
            with copy.open("wb") as file:
                file.write(f"% evt 3.0\n% geometry {size[0]}x{size[1]}\n% end\n".encode())
                file.writelines(payloads)
            recording = joined(*evt_recording(decode_evt(copy, {"evt": "3.0"}, path), size, path))
        return replace(recording, sensor=f"{encoding} camera")
    if encoding != "libcaer":
        raise InputError(f"{path}: encoding: expected evt3 or libcaer, found {encoding or 'no message'!r}")
    t, x, y, p = _libcaer(b"".join(payloads), where)
    events = Events.from_columns(to_nanoseconds(t, "us", where), x, y, p, *size, tick_ns=1000, where=where)
    return Recording(events, sensor=f"{encoding} camera", source=path)


def _libcaer(payload: bytes, where: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(t µs, x, y, p) of libcaer's polarity events, from the first event on, the clock's rollovers undone."""
    if len(payload) % LIBCAER.itemsize:
        raise InputError(f"{where}: expected 8 bytes per libcaer event, found {len(payload) % LIBCAER.itemsize} over")
    words = np.frombuffer(payload, LIBCAER)
    words = words[words["address"] & 1 == 1]
    address, t = words["address"], Rollovers(ROLLOVER_US).undone(words["t"])
    return t - t[:1].sum(), address >> 17, address >> 2 & 0x7FFF, address >> 1 & 1


def _read_records(path: Path, raw: Iterator[bytes], cdr: bool) -> Recording:
    """Events of `EventArray` messages."""
    width = height = 0
    columns: list[tuple[np.ndarray, ...]] = []
    for data in raw:
        (width, height), found = record_columns(data, cdr, path)
        columns += found
    where = f"{path}: events"
    empty = np.empty(0, np.int64)
    t, x, y, p = (np.concatenate([c[k] for c in columns]) if columns else empty for k in range(4))
    late = np.flatnonzero(np.diff(t) < 0)
    if len(late):  # some drivers write a packet's events in the order of their rows
        order = np.argsort(t, kind="stable")
        t, x, y, p = t[order], x[order], y[order], p[order]
    width, height = sensor_size(x, y, width or None, height or None)
    tick_ns = 1000 if not np.any(t % 1000) else 1
    events = Events.from_columns(t, x, y, p != 0, width, height, tick_ns=tick_ns, where=where)
    return Recording(events, source=path, attributes={"reordered": len(late)} if len(late) else {})


def header_stamp(data: bytes, cdr: bool, path: Path) -> int:
    """The time [ns] in the `std_msgs/Header` that a message begins with."""
    message = _Message(data, cdr, path)
    if not cdr:
        message.number(4)
    return message.number(4) * 1_000_000_000 + message.number(4)


def record_columns(data: bytes, cdr: bool, path: Path) -> tuple[tuple[int, int], list[tuple[np.ndarray, ...]]]:
    """((width, height), columns (t ns, x, y, p) in one or two pieces) of an `EventArray` message."""
    message = _Message(data, cdr, path)
    message.skip_header()
    height, width, count = message.number(4), message.number(4), message.number(4)
    parts = _cdr_records(message, count) if cdr else [_ros1_records(message, count)]
    return (width, height), [
        (part["s"].astype(np.int64) * 1_000_000_000 + part["ns"], part["x"], part["y"], part["p"]) for part in parts
    ]


def _ros1_records(message: _Message, count: int) -> np.ndarray:
    return np.frombuffer(message.rest(count * ROS1_RECORD.itemsize), ROS1_RECORD)


def _cdr_records(message: _Message, count: int) -> list[np.ndarray]:
    """The first record, and the others; the message ends without the padding of the last."""
    if message.order != "<":
        raise InputError(f"{message.path}: expected little-endian messages, found big-endian")
    if count == 0:
        return []
    size = CDR_FIRST.itemsize + (count - 1) * CDR_OTHERS.itemsize
    data = message.rest(size - 1) + b"\0"
    return [np.frombuffer(data, CDR_FIRST, 1), np.frombuffer(data, CDR_OTHERS, count - 1, CDR_FIRST.itemsize)]
