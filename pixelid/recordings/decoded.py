"""Camera makers' files (AEDAT4, Prophesee RAW and DAT, ES), decoded by the library faery."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from pixelid.errors import InputError
from pixelid.recordings.columns import to_nanoseconds
from pixelid.recordings.events import Events
from pixelid.recordings.recording import Recording
from pixelid.recordings.triggers import Triggers

TYPES: dict = {".aedat4": "aedat", ".raw": "evt", ".dat": "dat", ".es": "es"}
AEDAT_EDGES = {1: True, 2: False, 3: True}  # external signal: rising edge, falling edge, pulse
VERSIONS: dict = {"2.0": "evt2", "2.1": "evt2.1", "3.0": "evt3", "2": "evt2", "3": "evt3"}


def read(path: Path) -> Recording:
    """The first event stream of a camera maker's file, with external trigger edges; frames and IMU samples are skipped.

    Raises:
        InputError: when the file cannot be decoded.
    """
    header = _header(path)
    kind = TYPES.get(path.suffix.lower()) or ("aedat" if "source" in header else "evt")
    if kind == "evt":
        size = _size(header)
        t, x, y, p, triggers = decode_evt(path, size, VERSIONS.get(header.get("evt", "")), path)
    elif kind == "aedat":
        t, x, y, p, triggers, size = _decode_aedat(path)
    else:
        t, x, y, p, size = _decode_others(path, kind, header)
        triggers = None
    where = f"{path}: events"
    nanoseconds = to_nanoseconds(t, "us", where)
    events = Events.from_columns(nanoseconds, x, y, p, *size, tick_ns=1000, where=where)
    sensor = header.get("plugin_name", "") or header.get("source", "")
    attributes: dict = {"header": header} if header else {}
    biases = path.with_suffix(".bias")
    if biases.is_file():
        attributes["biases"] = _bias_file(biases)
    return Recording(events, sensor=sensor, source=path, attributes=attributes, triggers=triggers)


def decode_evt(path: Path, size: tuple[int, int], version, named: Path) -> tuple:
    """(t µs, x, y, p, triggers or None) of a Prophesee RAW file; errors name the file `named`.

    Raises:
        InputError: when the file cannot be decoded.
    """
    from faery.extension import evt

    def packets() -> Iterator[dict]:
        with evt.Decoder(path, size, version) as decoder:
            yield from decoder

    parts, edges = [], []
    for packet in _decoded(packets, named):
        parts.append(packet.get("events"))
        edges.append(packet.get("triggers"))
    return *_columns(parts), _triggers(edges, "source", "rising", f"{named}: triggers")


def _decode_aedat(path: Path) -> tuple:
    from faery.extension import aedat

    tracks = []

    def packets() -> Iterator[tuple]:
        with aedat.Decoder(path) as decoder:
            tracks.extend(decoder.tracks())
            yield from decoder

    parts, edges = [], []
    first = None
    for track, packet in _decoded(packets, path):
        if track.data_type == "events" and first in (None, track.id):
            first = track.id
            parts.append(packet)
        elif track.data_type == "triggers":
            edges.append(packet[np.isin(packet["source"], list(AEDAT_EDGES))])
    streams = [track for track in tracks if track.data_type == "events"]
    if not streams:
        raise InputError(f"{path}: expected a stream of events, found {', '.join(t.data_type for t in tracks)}")
    size = next(track.dimensions for track in streams if first in (None, track.id))
    triggers = None
    if sum(map(len, edges)):
        every = np.concatenate(edges)
        rising = np.array([AEDAT_EDGES[int(source)] for source in every["source"]])
        nanoseconds = to_nanoseconds(every["t"], "us", f"{path}: triggers")
        triggers = Triggers.from_columns(nanoseconds, rising, np.zeros(len(every)), where=f"{path}: triggers")
    return *_columns(parts), triggers, size


def _decode_others(path: Path, kind, header: dict[str, str]) -> tuple:
    from faery.file_decoder import Decoder

    sizes = []

    def packets() -> Iterator[np.ndarray]:
        decoder = Decoder(path, dimensions_fallback=_size(header), file_type=kind, time_range_cache=None)
        sizes.append(decoder.dimensions())
        yield from decoder

    return *_columns([packet.copy() for packet in _decoded(packets, path)]), sizes[0]


def _decoded(packets: Callable[[], Iterator], path: Path) -> Iterator:
    """What `packets` yields; whatever the decoder raises becomes an InputError."""
    try:
        yield from packets()
    except InputError:
        raise
    except (Exception, SystemError) as error:
        reason = str(error).splitlines()[0][:120] if str(error) else type(error).__name__
        raise InputError(
            f"{path}: cannot be decoded; truncated, or not the format of its extension ({reason})"
        ) from None


def _columns(parts: list) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(t, x, y, p) of packets of events."""
    parts = [part for part in parts if part is not None and len(part)]
    if not parts:
        return np.empty(0, np.int64), np.empty(0, np.uint16), np.empty(0, np.uint16), np.empty(0, np.uint8)
    t, x, y, p = (np.concatenate([part[name] for part in parts]) for name in ("t", "x", "y", "on"))
    return t, x, y, p.astype(np.uint8)


def _triggers(parts: list, channel: str, rising: str, where: str) -> Triggers | None:
    parts = [part for part in parts if part is not None and len(part)]
    if not parts:
        return None
    every = np.concatenate(parts)
    return Triggers.from_columns(to_nanoseconds(every["t"], "us", where), every[rising], every[channel], where=where)


def _bias_file(path: Path) -> dict[str, int | str]:
    """Prophesee's `.bias` file beside a RAW file: lines `value % name`."""
    biases: dict[str, int | str] = {}
    for line in path.read_text("latin1").splitlines()[:200]:
        value, _, name = line.partition("%")
        if name.strip():
            value = value.strip()
            biases[name.strip()] = int(value) if re.fullmatch(r"-?\d{1,9}", value) else value[:80]
    return biases


def _header(path: Path) -> dict[str, str]:
    """The `% name value` lines of a Prophesee file, or the camera's name in an AEDAT4 file."""
    with path.open("rb") as file:
        head = file.read(1 << 16)
    if head.startswith(b"#!AER-DAT4"):
        source = re.search(rb'key="source"[^>]*>([^<]+)<', head)
        return {"source": source.group(1).decode("latin1")} if source else {}
    header = {}
    for line in head.split(b"\n"):
        if not line.startswith(b"% "):
            break
        name, _, value = line[2:].decode("latin1").strip().partition(" ")
        header[name] = value
    return header


def _size(header: dict[str, str]) -> tuple[int, int]:
    """Sensor size: from the header where it says, else by the generation of the sensor."""
    text = " ".join(f"{name} {value}" for name, value in header.items())
    if found := re.search(r"geometry (\d+)x(\d+)", text):
        return int(found.group(1)), int(found.group(2))
    width, height = re.search(r"width[= ](\d+)", text, re.I), re.search(r"height[= ](\d+)", text, re.I)
    if width and height:
        return int(width.group(1)), int(height.group(1))
    return (640, 480) if re.search(r"gen3", text, re.I) else (1280, 720)
