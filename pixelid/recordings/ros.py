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

import io
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pixelid.errors import InputError
from pixelid.recordings import evt
from pixelid.recordings.columns import Rollovers
from pixelid.recordings.damage import refusing
from pixelid.recordings.events import Events
from pixelid.recordings.raw import Block, RawEvents
from pixelid.recordings.recording import Recording
from pixelid.recordings.rules import chosen_name
from pixelid.recordings.source import ReadingOptions

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

RECORDS = ("dvs_msgs/msg/EventArray", "prophesee_event_msgs/msg/EventArray")
PACKETS = "event_camera_msgs/msg/EventPacket"
ROS1_RECORD = np.dtype([("x", "<u2"), ("y", "<u2"), ("s", "<u4"), ("ns", "<u4"), ("p", "u1")])
# CDR: two bytes after a multiple of four; only the first record begins on one, and lacks the two before its time
CDR_RECORD = np.dtype([("x", "<u2"), ("y", "<u2"), ("", "u2"), ("s", "<i4"), ("ns", "<u4"), ("p", "u1"), ("", "u1")])
LIBCAER = np.dtype([("address", "<u4"), ("t", "<u4")])
ROLLOVER_US = 1 << 31


def opened(path: Path, options: ReadingOptions) -> RawEvents:
    """The events of a topic of a bag, with trigger edges where the camera's bytes hold them.

    Raises:
        InputError: for a damaged bag, one without events, and encodings that are not read.
    """
    with opened_bag(path) as bag:
        topics = [c for c in bag.connections if c.msgtype == PACKETS or c.msgtype in RECORDS]
        if not topics:
            found = ", ".join(sorted({c.msgtype for c in bag.connections})) or "nothing"
            raise InputError(f"{path}: expected a topic of events ({PACKETS}, {RECORDS[0]}), found {found}")
        every = list(dict.fromkeys(c.topic for c in topics))
        filled = list(dict.fromkeys(c.topic for c in topics if c.msgcount))
        if len(filled) > 1 and options.stream is None:
            filled = [topic for topic in filled if _has_events(bag, [c for c in topics if c.topic == topic], path)]
        name = chosen_name(filled, every, options, str(path))
        mine = [c for c in topics if c.topic == name]
        messages = [bytes(data) for _, _, data in bag.messages(connections=mine)]
        cdr = bag.is2
    head = Recording(Events.empty(1, 1), source=path, attributes={"topic": name})
    raw = RawEvents(head, lambda: iter(()), f"{path}: events", polarity="01", streams=tuple(every[1:] and every))
    return (_packets if mine[0].msgtype == PACKETS else _records)(path, messages, cdr, raw)


def _has_events(bag: AnyReader, topic: list, path: Path) -> bool:
    """Whether any message of a topic holds events."""
    read = _packet if topic[0].msgtype == PACKETS else _record_head
    return any(read(_Message(bytes(data), bag.is2, path))[-1] for _, _, data in bag.messages(connections=topic))


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

    kinds = AnyReaderError, Ros1Error, Ros2Error, OSError, ValueError, KeyError, IndexError, AssertionError
    store = get_typestore(Stores.ROS2_HUMBLE)
    what = "expected a ROS bag, found a damaged or different file"
    with refusing(path, what, *kinds), AnyReader([path], default_typestore=store) as bag:
        yield bag


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


def _packets(path: Path, messages: list[bytes], cdr: bool, raw: RawEvents) -> RawEvents:
    """Events of `EventPacket` messages, whose payloads follow each other as one stream of bytes."""
    size, encoding, payloads, numbers = (1, 1), "", [], []
    for data in messages:
        message = _Message(data, cdr, path)
        size, number, stated, length = _packet(message)
        encoding = encoding or stated
        if stated != encoding:
            raise InputError(f"{path}: encoding: expected {encoding!r} throughout, found {stated!r}")
        numbers.append(number)
        payloads.append(message.rest(length))
    if encoding not in ("evt3", "libcaer"):
        raise InputError(f"{path}: encoding: expected evt3 or libcaer, found {encoding or 'no message'!r}")
    lost = sum(after - before - 1 for before, after in pairwise(numbers) if after > before + 1)
    notes = (f"{lost} of {len(numbers) + lost} packets are missing (seq jumps): events are lost",) if lost else ()
    head = replace(raw.head, sensor=f"{encoding} camera")
    payload = b"".join(payloads)

    def blocks() -> Iterator[Block]:
        if encoding == "libcaer":
            return iter([_libcaer(payload, raw.where)])
        return evt.decode(io.BytesIO(payload), "3.0", path)

    return replace(raw, head=head, blocks=blocks, unit="us", tick_ns=1000, size=size, notes=notes)


def _packet(message: _Message) -> tuple[tuple[int, int], int, str, int]:
    """((width, height), sequence number, encoding, bytes that follow) of an `EventPacket`."""
    message.skip_header()
    height, width, number = message.number(4), message.number(4), message.number(8)
    message.number(8)  # time_base: the payload says its own times
    encoding = message.text()
    if message.number(1) != 0:
        raise InputError(f"{message.path}: is_bigendian: expected little-endian payloads, found big-endian")
    return (width, height), number, encoding, message.number(4)


def _libcaer(payload: bytes, where: str) -> Block:
    """Columns, t in µs, of libcaer's polarity events, from the first event on, the clock's rollovers undone."""
    if len(payload) % LIBCAER.itemsize:
        raise InputError(f"{where}: expected 8 bytes per libcaer event, found {len(payload) % LIBCAER.itemsize} over")
    words = np.frombuffer(payload, LIBCAER)
    words = words[words["address"] & 1 == 1]
    address, t = words["address"], Rollovers(ROLLOVER_US).undone(words["t"])
    return Block(t - t[:1].sum(), address >> 17, address >> 2 & 0x7FFF, address >> 1 & 1)


def _records(path: Path, messages: list[bytes], cdr: bool, raw: RawEvents) -> RawEvents:
    """Events of `EventArray` messages; some drivers write those of a message in the order of their rows."""
    size, blocks, reordered = (0, 0), [], 0
    for data in messages:
        stated, (t, x, y, p) = record_columns(data, cdr, path)
        size = max(size[0], stated[0]), max(size[1], stated[1])
        fallen = int(np.count_nonzero(np.diff(t) < 0))
        if fallen:
            order = np.argsort(t, kind="stable")
            t, x, y, p = t[order], x[order], y[order], p[order]
        reordered += fallen
        blocks.append(Block(t, x, y, (p != 0).astype(np.uint8)))
    notes = (f"{reordered} events were earlier than the one before within their messages: sorted",) if reordered else ()
    tick_ns = 1 if any(np.any(block.t % 1000) for block in blocks) else 1000
    attributes = {**raw.head.attributes, **({"reordered": reordered} if reordered else {})}
    stated = (size[0] or None, size[1] or None)
    return replace(raw, head=replace(raw.head, attributes=attributes), blocks=lambda: iter(blocks), unit="ns",
                   tick_ns=tick_ns, size=stated, notes=notes)  # fmt: skip


def header_stamp(data: bytes, cdr: bool, path: Path) -> int:
    """The time [ns] in the `std_msgs/Header` that a message begins with."""
    message = _Message(data, cdr, path)
    if not cdr:
        message.number(4)
    return message.number(4) * 1_000_000_000 + message.number(4)


def record_columns(data: bytes, cdr: bool, path: Path) -> tuple[tuple[int, int], tuple[np.ndarray, ...]]:
    """((width, height), columns (t ns, x, y, p)) of an `EventArray` message."""
    message = _Message(data, cdr, path)
    size, count = _record_head(message)
    packed = count * ROS1_RECORD.itemsize
    events = _cdr_records(message, count) if cdr else np.frombuffer(message.rest(packed), ROS1_RECORD)
    return size, (events["s"].astype(np.int64) * 1_000_000_000 + events["ns"], events["x"], events["y"], events["p"])


def _record_head(message: _Message) -> tuple[tuple[int, int], int]:
    """((width, height), number of events) of an `EventArray`."""
    message.skip_header()
    height, width, count = message.number(4), message.number(4), message.number(4)
    return (width, height), count


def _cdr_records(message: _Message, count: int) -> np.ndarray:
    """Records of a message that ends without the padding of the last."""
    if message.order != "<":
        raise InputError(f"{message.path}: expected little-endian messages, found big-endian")
    data = message.rest(count * CDR_RECORD.itemsize - 3) if count else b""
    return np.frombuffer(data[:4] + b"\0\0" + data[4:] + b"\0" if count else b"", CDR_RECORD)
