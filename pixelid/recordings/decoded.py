"""Camera makers' files: AEDAT4 and ES by the library faery, Prophesee's by `evt`, `evt21` and `dat`."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import chain, islice
from pathlib import Path
from typing import TypeAlias, TypeVar

import numpy as np

from pixelid.errors import InputError, first_line
from pixelid.recordings import dat, evt, evt21
from pixelid.recordings.columns import PART_EVENTS, to_nanoseconds, validated
from pixelid.recordings.events import Events
from pixelid.recordings.parts import joined
from pixelid.recordings.recording import Recording
from pixelid.recordings.triggers import Triggers

Block: TypeAlias = tuple[tuple, Triggers | None]  # (t µs, x, y, p) and trigger edges
Packet = TypeVar("Packet")

TYPES: dict = {".aedat4": "aedat", ".raw": "evt", ".dat": "dat", ".es": "es"}
AEDAT_EDGES = {1: True, 2: False, 3: True}  # external signal: rising edge, falling edge, pulse
FORMATS: dict = {"EVT2": "evt2", "EVT21": "evt2.1", "EVT3": "evt3"}  # of newer headers
MOST_PACKETS = 1 << 14  # of a part: packets of frames and samples hold no events
VERSIONS: dict = {"2.0": "evt2", "2.1": "evt2.1", "3.0": "evt3", "2": "evt2", "3": "evt3"}


def read(path: Path) -> Recording:
    """The first event stream of a camera maker's file, with external trigger edges; frames and IMU samples are skipped.

    Raises:
        InputError: when the file cannot be decoded.
    """
    return joined(*stream(path))


def stream(path: Path) -> tuple[Recording, Iterator[Recording]]:
    """The same in parts: the recording without events, and parts of it with their trigger edges.

    Raises:
        InputError: when the file cannot be decoded; also while the parts are taken.
    """
    header = _header(path)
    kind = TYPES.get(path.suffix.lower()) or ("aedat" if "source" in header else "evt")
    if kind == "evt":
        size = _size(header)
        blocks = decode_evt(path, header, path)
    elif kind == "aedat":
        size, blocks = _decode_aedat(path)
    elif kind == "dat" and header.get("Version") == "2":
        size, blocks = _size(header), ((columns, None) for columns in dat.decode(path, _header_bytes(path)))
    else:
        size, blocks = _decode_others(path, kind, header)
    sensor = header.get("plugin_name", "") or header.get("source", "")
    attributes: dict = {"header": header} if header else {}
    biases = path.with_suffix(".bias")
    if biases.is_file():
        attributes["biases"] = _bias_file(biases)
    return evt_recording(blocks, size, path, sensor=sensor, attributes=attributes)


def evt_recording(blocks: Iterator[Block], size: tuple[int, int], path: Path, **about) -> tuple[Recording, Iterator]:
    """The recording without events, and its parts, of blocks of columns with times in µs."""
    head = Recording(Events.empty(*size, tick_ns=1000), source=path, **about)
    where = f"{path}: events"
    edges: list[Triggers | None] = []

    def columns() -> Iterator[tuple]:
        for block, triggers in blocks:
            edges.append(triggers)
            yield block

    def parts() -> Iterator[Recording]:
        for events in validated(columns(), *size, unit="us", tick_ns=1000, where=where):
            yield replace(head, events=events, triggers=edges.pop())

    return head, parts()


def decode_evt(path: Path, header: dict[str, str], named: Path) -> Iterator[Block]:
    """Blocks of a Prophesee RAW file; errors name the file `named`.

    Raises:
        InputError: when the file cannot be decoded.
    """
    stated = header.get("format", "").partition(";")[0].upper()
    version = VERSIONS.get(header.get("evt", "")) or FORMATS.get(stated)
    if version == "evt2.1":
        said = re.search(r"endianness=(\w+)", header.get("format", ""))
        yield from evt21.decode(path, _header_bytes(path), said.group(1) == "legacy" if said else None)
        return

    if version is None:
        found = header.get("evt") or stated or "none"
        raise InputError(f"{named}: expected EVT 2.0, 2.1 or 3.0 in the header, found {found[:40]}")
    yield from evt.decode(path, _header_bytes(path), int(version[3]), named)


def _decode_aedat(path: Path) -> tuple[tuple[int, int], Iterator[Block]]:
    from faery.extension import aedat

    tracks = []

    def packets() -> Iterator[tuple]:
        with aedat.Decoder(path) as decoder:
            tracks.extend(decoder.tracks())
            for track, packet in decoder:
                if track.data_type in ("events", "triggers"):
                    yield track, packet

    found = checked_packets(packets, path)
    before: list[tuple] = []  # what comes ahead of the first events, which say whose the size is
    for entry in found:
        before.append(entry)
        if entry[0].data_type == "events":
            break
    streams = [track for track in tracks if track.data_type == "events"]
    if not streams:
        raise InputError(f"{path}: expected a stream of events, found {', '.join(t.data_type for t in tracks)}")
    first = before[-1][0] if before and before[-1][0].data_type == "events" else streams[0]
    size = next(track.dimensions for track in streams if track.id == first.id)

    def mine(entry: tuple):
        return entry[1] if entry[0].id == first.id else None

    def blocks() -> Iterator[Block]:
        for batch in _batches(chain(before, found), mine):
            edges = [packet for track, packet in batch if track.data_type == "triggers"]
            edges = [packet[np.isin(packet["source"], list(AEDAT_EDGES))] for packet in edges]
            triggers = None
            if sum(map(len, edges)):
                every = np.concatenate(edges)
                rising = np.array([AEDAT_EDGES[int(source)] for source in every["source"]])
                nanoseconds = to_nanoseconds(every["t"], "us", f"{path}: triggers")
                triggers = Triggers.from_columns(
                    nanoseconds, rising, np.zeros(len(every), np.uint8), where=f"{path}: triggers"
                )
            yield _columns([packet for packet in map(mine, batch) if packet is not None]), triggers

    return size, blocks()


def _decode_others(path: Path, kind, header: dict[str, str]) -> tuple[tuple[int, int], Iterator[Block]]:
    from faery.file_decoder import Decoder

    sizes = []

    def packets() -> Iterator[np.ndarray]:
        decoder = Decoder(path, dimensions_fallback=_size(header), file_type=kind, time_range_cache=None)
        sizes.append(decoder.dimensions())
        for packet in decoder:
            yield packet.copy()  # the decoder's own memory is overwritten

    found = checked_packets(packets, path)
    before = list(islice(found, 1))
    blocks = ((_columns(batch), None) for batch in _batches(chain(before, found), lambda packet: packet))
    return sizes[0], blocks


def checked_packets(packets: Callable[[], Iterator], path: Path) -> Iterator:
    """What `packets` yields; whatever the decoder raises becomes an InputError."""
    try:
        yield from packets()
    except InputError:
        raise
    except (Exception, SystemError) as error:
        reason = first_line(error)[:120]
        raise InputError(
            f"{path}: cannot be decoded; truncated, or not the format of its extension ({reason})"
        ) from None


def _batches(packets: Iterable[Packet], events_of: Callable[[Packet], np.ndarray | None]) -> Iterator[list[Packet]]:
    """Lists of packets that together hold about `PART_EVENTS` events."""
    batch, held = [], 0
    for packet in packets:
        batch.append(packet)
        events = events_of(packet)
        held += 0 if events is None else len(events)
        if held >= PART_EVENTS or len(batch) >= MOST_PACKETS:
            yield batch
            batch, held = [], 0
    if batch:
        yield batch


def _columns(parts: list) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(t, x, y, p) of packets of events."""
    parts = [part for part in parts if part is not None and len(part)]
    if not parts:
        return np.empty(0, np.int64), np.empty(0, np.uint16), np.empty(0, np.uint16), np.empty(0, np.uint8)
    t, x, y, p = (np.concatenate([part[name] for part in parts]) for name in ("t", "x", "y", "on"))
    return t, x, y, p.astype(np.uint8)


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


def _header_bytes(path: Path) -> int:
    """The byte at which what follows the header begins."""
    start = 0
    with path.open("rb") as file:
        for line in file:
            if not line.startswith(b"% "):
                break
            start += len(line)
            if line.rstrip() == b"% end":
                break
    return start


def _size(header: dict[str, str]) -> tuple[int, int]:
    """Sensor size: from the header where it says, else by the generation of the sensor."""
    text = " ".join(f"{name} {value}" for name, value in header.items())
    if found := re.search(r"geometry (\d+)x(\d+)", text):
        return int(found.group(1)), int(found.group(2))
    width, height = re.search(r"width[= ](\d+)", text, re.I), re.search(r"height[= ](\d+)", text, re.I)
    if width and height:
        return int(width.group(1)), int(height.group(1))
    return (640, 480) if re.search(r"gen3", text, re.I) else (1280, 720)
