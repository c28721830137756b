"""Bags of rpg_esim, and of its improved fork behind Deblur e-NeRF: /cam0/{events, pose, camera_info, image_raw}.

A folder holds one bag, perhaps the flags that the simulator ran with (`esim.conf`) and posed `views/`, there or one
level up, as the data sets of Robust e-NeRF and Deblur e-NeRF do.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from pixelid.errors import InputError
from pixelid.nerf.data.camera import Camera
from pixelid.nerf.data.published.esim_flags import notes_of, pixel_of, read_flags, renderer_of
from pixelid.nerf.data.published.source import Block, Pictures, Poses, Source, camera_of, poses_of
from pixelid.nerf.data.views import FOLDER
from pixelid.recordings.ros import RECORDS, header_stamp, opened_bag, record_columns

POSE, INFO, IMAGE = "geometry_msgs/msg/PoseStamped", "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/Image"
IMAGES = ("image_raw", "image_corrupted")  # sharp, and blurred by the exposure
# encoding → (type, channels, which of them are red, green, blue): alpha is no light, and left out
ENCODINGS = {
    "mono8": (np.uint8, 1, (0,)), "8UC1": (np.uint8, 1, (0,)), "mono16": (np.uint16, 1, (0,)),
    "rgb8": (np.uint8, 3, (0, 1, 2)), "bgr8": (np.uint8, 3, (2, 1, 0)), "8UC3": (np.uint8, 3, (2, 1, 0)),
    "rgba8": (np.uint8, 4, (0, 1, 2)), "bgra8": (np.uint8, 4, (2, 1, 0)), "8UC4": (np.uint8, 4, (2, 1, 0)),
}  # fmt: skip
BLOCK = 1 << 18  # events handed on together


def read(path: Path, camera: str = "") -> Source:
    """A simulated sequence.

    Args:
        path: a bag, or a folder with one.
        camera: the topics' first word, "cam0" by default (or that of the only topic of events).

    Returns:
        The sequence.

    Raises:
        InputError: no bag, a damaged one, or one that lacks a topic.
    """
    bag = _bag(path)
    with opened_bag(bag) as reader:
        cam, topics = _topics(bag, reader, camera)
        size = _sensor_size(bag, reader, topics["events"])
        sensor = _camera(bag, reader, topics["camera_info"], size)
        poses = _poses(bag, reader, topics["pose"])
        pictures = _pictures(bag, reader, cam, sensor)
    conf = _conf(bag)
    views = next((f for f in (bag.parent / FOLDER, bag.resolve().parent.parent / FOLDER) if f.is_dir()), None)
    threshold = 0.25  # assumed where there is no esim.conf: events leave a factor on all thresholds open
    pixel: dict[str, Any] = dict.fromkeys(("pos_contrast_threshold", "neg_contrast_threshold"), threshold)
    if conf is not None:
        flags = read_flags(conf)
        pixel, renderer, notes = pixel_of(conf, flags), renderer_of(conf, flags), notes_of(conf, flags)
    else:
        renderer, notes = None, (f"thresholds of {threshold} are assumed, and the circuit is unknown: no esim.conf",)
    return Source(
        "esim", sensor, poses, _events(bag, topics["events"].topic), pictures, pixel, views,
        renderer if views is not None else None, notes, (bag, *([conf] if conf else [])),
    )  # fmt: skip


def _bag(path: Path) -> Path:
    if path.is_file():
        return path
    bags = sorted(path.glob("*.bag"))
    if not path.is_dir() or len(bags) != 1:
        found = f"{len(bags)} bags" if path.is_dir() else "nothing of that name"
        raise InputError(f"{path}: expected a bag or a folder with one, found {found}")
    return bags[0]


def _conf(bag: Path) -> Path | None:
    """`esim.conf` (or one named like the bag) next to the bag."""
    return next((f for f in (bag.with_name("esim.conf"), bag.with_suffix(".conf")) if f.is_file()), None)


def _topics(bag: Path, reader, camera: str) -> tuple[str, dict[str, Any]]:
    """The camera's name, and its connections of events, pose and camera_info."""
    events = [c for c in reader.connections if c.msgtype in RECORDS]
    if not events:
        found = ", ".join(sorted({c.msgtype for c in reader.connections})) or "nothing"
        raise InputError(f"{bag}: expected a topic of {RECORDS[0]}, found {found}")
    names = sorted({c.topic.removesuffix("/events").strip("/") for c in events})
    cam = camera or ("cam0" if "cam0" in names or len(names) > 1 else names[0])
    topics = {}
    for suffix, kind in (("events", None), ("pose", POSE), ("camera_info", INFO)):
        topic = f"/{cam}/{suffix}"
        of_name = [c for c in reader.connections if c.topic == topic and kind in (None, c.msgtype)]
        if not of_name:
            there = ", ".join(sorted({c.topic for c in reader.connections}))
            raise InputError(f"{bag}: {topic} ({kind or RECORDS[0]}): missing; the bag has {there[:300]}")
        topics[suffix] = of_name[0]
    return cam, topics


def _of_topic(reader, connection) -> Iterator[bytes]:
    same = [c for c in reader.connections if c.topic == connection.topic]
    return (bytes(data) for _, _, data in reader.messages(connections=same))


def _sensor_size(bag: Path, reader, connection) -> tuple[int, int]:
    for data in _of_topic(reader, connection):
        return record_columns(data, reader.is2, bag)[0]
    raise InputError(f"{bag}: {connection.topic}: no message")


def _camera(bag: Path, reader, connection, size: tuple[int, int]) -> Camera:
    for data in _of_topic(reader, connection):
        info = reader.deserialize(data, INFO)
        matrix, lens = (info.k, info.d) if reader.is2 else (info.K, info.D)
        matrix, stated = np.asarray(matrix).reshape(3, 3), (info.width, info.height)
        if min(size) > 0 and min(stated) > 0 and size != stated:
            raise InputError(f"{bag}: {connection.topic}: {stated[0]} × {stated[1]} pixels, but events of {size}")
        size = stated if min(stated) > 0 else size
        focal, centre = matrix[[0, 1], [0, 1]], matrix[:2, 2]
        return camera_of(Path(f"{bag}: {connection.topic}"), focal, centre, size, lens, info.distortion_model)
    raise InputError(f"{bag}: {connection.topic}: no message")


def _poses(bag: Path, reader, connection) -> Poses:
    t, rows = [], []
    for data in _of_topic(reader, connection):
        message = reader.deserialize(data, POSE)
        p, q = message.pose.position, message.pose.orientation
        t.append(message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec)
        rows.append((p.x, p.y, p.z, q.x, q.y, q.z, q.w))
    table = np.array(rows, dtype=np.float64).reshape(-1, 7)
    return poses_of(Path(f"{bag}: {connection.topic}"), np.array(t, dtype=np.int64), table[:, :3], table[:, 3:])


def _events(bag: Path, topic: str) -> Callable[[int, int], Iterator[Block]]:
    after_ns = 1_000_000_000  # how much later than asked for a message may be before nothing else is expected

    def blocks(begin: int, end: int) -> Iterator[Block]:
        with opened_bag(bag) as reader:
            connections = [c for c in reader.connections if c.topic == topic]
            waiting: list[Block] = []
            number = 0
            for _, _, data in reader.messages(connections=connections):
                t, x, y, p = record_columns(bytes(data), reader.is2, bag)[1]
                if len(t) and t.min() > end + after_ns:
                    yield from _joined(waiting)
                    return
                if len(t) and t.max() >= begin:
                    waiting.append(Block(t, x, y, p != 0))
                    number += len(t)
                if number >= BLOCK:
                    yield from _joined(waiting)
                    waiting, number = [], 0
            yield from _joined(waiting)

    return blocks


def _joined(blocks: list[Block]) -> Iterator[Block]:
    """One block of the events of some messages, of which the simulator writes thousands a second."""
    if blocks:
        yield Block(*(np.concatenate(columns) for columns in zip(*blocks, strict=True)))


def _pictures(bag: Path, reader, cam: str, camera: Camera) -> Pictures | None:
    """The frames of the sensor itself: sharp ones, else blurred ones."""
    there = {c.topic for c in reader.connections if c.msgtype == IMAGE}
    topic = next((f"/{cam}/{name}" for name in IMAGES if f"/{cam}/{name}" in there), None)
    if topic is None:
        return None
    connection = next(c for c in reader.connections if c.topic == topic)
    t = np.array([header_stamp(data, reader.is2, bag) for data in _of_topic(reader, connection)], dtype=np.int64)
    if len(t) == 0:
        return None

    def read_some(which: np.ndarray) -> Iterator[np.ndarray]:
        asked = set(which.tolist())
        with opened_bag(bag) as again:
            connections = [c for c in again.connections if c.topic == topic]
            for k, (_, _, data) in enumerate(again.messages(connections=connections)):
                if k in asked:
                    yield _image(f"{bag}: {topic}", again.deserialize(data, IMAGE))

    names = tuple(f"frame_{k:06d}" for k in range(len(t)))
    return Pictures(t, names, np.ones(len(t)), camera, np.eye(4), read_some)


def _image(where: str, message) -> np.ndarray:
    """(H, W) or (H, W, channels) of a `sensor_msgs/Image`."""
    if message.encoding not in ENCODINGS:
        raise InputError(f"{where}: encoding: expected one of {', '.join(ENCODINGS)}, found {message.encoding!r}")
    kind, channels, order = ENCODINGS[message.encoding]
    kind = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    row = message.width * channels * kind.itemsize
    if message.step < row or len(message.data) < message.step * message.height:
        raise InputError(
            f"{where}: data: expected {message.height} rows of {row} bytes, found {len(message.data)} bytes"
        )
    rows = np.asarray(message.data[: message.step * message.height]).reshape(message.height, message.step)[:, :row]
    image = np.ascontiguousarray(rows).view(kind).reshape(message.height, message.width, channels)
    return np.ascontiguousarray(image[..., list(order)].astype(kind.newbyteorder("="))).squeeze()
