"""Camera makers' files: AEDAT4 and ES by the library faery, Prophesee's by `evt`."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from pixelid.errors import InputError
from pixelid.recordings import evt
from pixelid.recordings.bias_files import biases_beside
from pixelid.recordings.columns import PART_EVENTS, to_nanoseconds
from pixelid.recordings.damage import refusing
from pixelid.recordings.events import Events
from pixelid.recordings.raw import Block, RawEvents
from pixelid.recordings.recording import Recording
from pixelid.recordings.rules import chosen_name
from pixelid.recordings.source import ReadingOptions
from pixelid.recordings.statements import Likely, Size, stated_size
from pixelid.recordings.triggers import Triggers

Packet = TypeVar("Packet")

TYPES: dict = {".aedat4": "aedat", ".raw": "evt", ".dat": "dat", ".es": "es"}
AEDAT_EDGES = {1: True, 2: False, 3: True}  # external signal: rising edge, falling edge, pulse
NO_SIZE = (65535, 65535)  # of a file that states none
VERSIONS = {"2": "2.0", "20": "2.0", "21": "2.1", "3": "3.0", "30": "3.0"}  # of EVT, by their digits
# Sizes by the system number of older headers (Prophesee's OpenEB, `psee_raw_file_header.cpp` and `device_system_id.h`).
VGA_SYSTEMS = (0x15, 0x1C, 0x17, 0x19, 0x1D, 0x23, 0x21, 0x97, 0x99, 0xA1)
HD_SYSTEMS = (0x1A, 0x1E, 0x20, 0x2E, 0x9A)


def opened(path: Path, options: ReadingOptions) -> RawEvents:
    """The event stream of a camera maker's file, with external trigger edges; frames and IMU samples are skipped.

    Raises:
        InputError: when the file cannot be decoded, or holds several streams of which none is stated.
    """
    header, start = _header(path)
    kind = TYPES.get(path.suffix.lower()) or ("aedat" if "source" in header else "evt")
    attributes: dict = {"header": header} if header else {}
    if found := biases_beside(path):
        attributes["biases"] = found
    sensor = header.get("plugin_name", "") or header.get("source", "")
    head = Recording(Events.empty(1, 1), sensor=sensor, source=path, attributes=attributes)
    raw = RawEvents(head, lambda: iter(()), f"{path}: events", "us", 1000, polarity="01")
    if kind == "aedat":
        return _aedat(path, raw, options)
    size, likely = _sizes(header, f"{path}: header")
    if kind == "evt":
        return replace(raw, blocks=lambda: _evt(path, header, start), size=size, likely_sizes=likely)
    if kind == "dat" and header.get("Version") == "2":
        return replace(raw, blocks=lambda: evt.decode_dat(path, start), size=size, likely_sizes=likely)
    wide, high = size
    return _others(path, kind, raw, None if wide is None or high is None else (wide, high))


def _evt(path: Path, header: dict[str, str], start: int) -> Iterator[Block]:
    """Blocks of a Prophesee RAW file.

    Raises:
        InputError: when the file cannot be decoded.
    """
    stated, *more = header.get("format", "").split(";")
    found = header.get("evt", "") or stated.upper()
    version = VERSIONS.get(found.removeprefix("EVT").replace(".", ""))
    if version is None:
        raise InputError(
            f"{path}: expected EVT 2.0, 2.1 or 3.0 in the header, found {found[:40] or 'none'}; add a line: % evt 3.0"
        )
    order = next((word.partition("=")[2] for word in more if word.startswith("endianness=")), "")
    with path.open("rb") as file:
        file.seek(start)
        yield from evt.decode(file, version, path, order == "legacy" if order else None)


def _aedat(path: Path, raw: RawEvents, options: ReadingOptions) -> RawEvents:
    """An AEDAT4 file, of whose streams of events one is read."""
    from faery.extension import aedat

    def packets(kinds: tuple[str, ...], first: list) -> Iterator[tuple]:
        with aedat.Decoder(path) as decoder:
            first.extend(decoder.tracks())
            for track, packet in decoder:
                if track.data_type in kinds:
                    yield track, packet

    tracks: list = []
    next(checked_packets(lambda: packets(("events",), tracks), path), None)
    streams = {str(track.id): track for track in tracks if track.data_type == "events"}
    if not streams:
        raise InputError(f"{path}: expected a stream of events, found {', '.join(t.data_type for t in tracks)}")
    filled = set(list(streams)[:1])
    if options.stream is None and len(streams) > 1:
        every = checked_packets(lambda: packets(("events",), []), path)
        filled = {str(track.id) for track, packet in every if len(packet)}
    name = chosen_name([name for name in streams if name in filled], list(streams), options, str(path))

    def blocks() -> Iterator[Block]:
        def mine(entry: tuple):
            return entry[1] if str(entry[0].id) == name else None

        for batch in _batches(checked_packets(lambda: packets(("events", "triggers"), []), path), mine):
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
            yield Block.of(_columns(list(map(mine, batch))), triggers)

    names = tuple(streams) if len(streams) > 1 else ()
    return replace(raw, blocks=blocks, size=streams[name].dimensions, streams=names)


def _others(path: Path, kind, raw: RawEvents, size: tuple[int, int] | None) -> RawEvents:
    """A file that faery decodes."""
    from faery.file_decoder import Decoder

    sizes: list[tuple[int, int]] = []

    def packets() -> Iterator[np.ndarray]:
        decoder = Decoder(path, dimensions_fallback=size or NO_SIZE, file_type=kind, time_range_cache=None)
        sizes.append(decoder.dimensions())
        for packet in decoder:
            yield packet.copy()  # the decoder's own memory is overwritten

    def blocks() -> Iterator[Block]:
        return (Block.of(_columns(batch)) for batch in _batches(checked_packets(packets, path), lambda packet: packet))

    next(blocks(), None)
    return replace(raw, blocks=blocks, size=sizes[0] if sizes and sizes[0] != NO_SIZE else (None, None))


def checked_packets(packets: Callable[[], Iterator], path: Path) -> Iterator:
    """What `packets` yields; whatever the decoder raises becomes an InputError."""
    with refusing(path, "cannot be decoded; truncated, or not the format of its extension", Exception):
        yield from packets()


def _batches(packets: Iterable[Packet], events_of: Callable[[Packet], np.ndarray | None]) -> Iterator[list[Packet]]:
    """Lists of packets that together hold about `PART_EVENTS` events."""
    batch, held = [], 0
    most_packets = 1 << 14  # of a part: packets of frames and samples hold no events
    for packet in packets:
        batch.append(packet)
        events = events_of(packet)
        held += 0 if events is None else len(events)
        if held >= PART_EVENTS or len(batch) >= most_packets:
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


def _header(path: Path) -> tuple[dict[str, str], int]:
    """The `% name value` lines of a Prophesee file, or the camera's name in an AEDAT4 file; the bytes they take."""
    with path.open("rb") as file:
        head = file.read(1 << 16)
        file.seek(0)
        if head.startswith(b"#!AER-DAT4"):
            source = re.search(rb'key="source"[^>]*>([^<]+)<', head)
            return ({"source": source.group(1).decode("latin1")} if source else {}), 0
        header, start = {}, 0
        while (line := file.readline(1 << 16)).startswith(b"% "):
            start += len(line)
            name, _, value = line[2:].decode("latin1").strip().partition(" ")
            if name == "end":
                break
            header[name] = value
    return header, start


def _sizes(header: dict[str, str], where: str) -> tuple[Size, Likely]:
    """Sensor size that a header states, or what its sensor's generation, system number or plugin suggest."""
    words = dict(word.split("=", 1) for word in header.get("format", "").split(";") if "=" in word)
    stated = {"sensor": f"gen{header.get('sensor_generation', '')}", **header, **words}
    values = {name: int(value) if value.isdecimal() and len(value) < 6 else value for name, value in stated.items()}
    size, likely = stated_size([values], where)
    number = values.get("system_ID")
    system = (640, 480) if number in VGA_SYSTEMS else (1280, 720) if number in HD_SYSTEMS else None
    return size, likely if system is None else (*likely, (system, f" of the maker's system {number}"))
