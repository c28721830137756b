"""Recordings in HDF5: the project's own format, and DSEC-style files with `events/{p,t,x,y}`.

    attrs      format="pixelid-recording", version=1, condition, sensor, [pooled, temperature_k, biases (JSON), …]
    events/    attrs width, height, [tick_ns, duplicates]
               t int64 (attr unit "ns" | "us", default "us"), x uint16, y uint16, p uint8 (1 ON, 0 OFF)
    triggers/  t int64 ns, rising uint8, channel uint8: edges on the camera's trigger inputs, where there are any
    exposures/ t, x, y, p as in events/: exposure measurements of an ATIS, where there are any
    stimulus/  t float64 [s], radiance (n,) or (n, height, width); attrs unit, interpolation

`events.attrs["duplicates"]` states how many events repeat an earlier one exactly.  Without it such events are
refused, because they usually mean a file joined to itself; pooled recordings have no addresses and are exempt.
DSEC (Gehrig et al., RA-L 2021): t in µs from the scalar `t_offset`, 640 × 480.  Prophesee's own HDF5 has the records
`CD/events` (t µs, x, y, p) and `EXT_TRIGGER/events` (t, p, id).
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pixelid.errors import InputError, first_line, shown
from pixelid.recordings.columns import (
    PART_EVENTS,
    RepeatCounter,
    duplicated,
    sensor_size,
    to_nanoseconds,
    validated,
)
from pixelid.recordings.events import Events
from pixelid.recordings.metadata import FORMAT, MOST_SIZE, MOST_TICK_NS, VERSION, whole, yes_or_no
from pixelid.recordings.recording import Recording
from pixelid.recordings.triggers import Triggers
from pixelid.stimuli.pixel_lights import Light, light_from_arrays

BLOCK = 1 << 22  # events looked at together
MOST_OBJECTS = 1000  # groups of a file
SMALL_BYTES, MOST_RATIO = 1 << 26, 2000  # deflate compresses a thousandfold at most
NAMED = {"format", "version", "condition", "sensor", "pooled"}


def read(path: Path) -> Recording:
    """The recording in an HDF5 file; raises InputError for anything that docs/formats.md does not allow."""
    import h5py

    if not h5py.is_hdf5(path):
        raise InputError(f"{path}: expected an HDF5 file, found something else")
    try:
        with h5py.File(path, "r") as file:
            refuse_foreign_storage(file, path)
            return _read(file, path)
    except OSError as error:
        raise InputError(f"{path}: truncated or damaged HDF5 ({first_line(error)[:120]})") from error


def stream(path: Path) -> tuple[Recording, Iterator[Recording]] | None:
    """The same in parts: the recording without events, and its parts; None where it must be read whole.

    Exposure measurements are only read whole, and so are columns compressed in pieces too large to be taken one by one.
    """
    import h5py

    if not h5py.is_hdf5(path):
        raise InputError(f"{path}: expected an HDF5 file, found something else")
    try:
        file = h5py.File(path, "r")
        refuse_foreign_storage(file, path)
        if "exposures" in file or _in_large_pieces(file):
            return None
        head, columns, settings, declared = _opened(file, path)
    except OSError as error:
        raise InputError(f"{path}: truncated or damaged HDF5 ({first_line(error)[:120]})") from error

    def parts() -> Iterator[Recording]:
        repeats, counter = 0, RepeatCounter()
        edges = head.triggers
        try:
            for events in validated(columns, head.events.width, head.events.height, **settings):
                repeats += 0 if declared is None else counter.add(events)
                if declared is not None and repeats > declared:
                    raise InputError(
                        f"{path}: events: expected each event once, found duplicates, the first of them "
                        f"at or before t = {events.t[-1]} ns"
                    )
                yield replace(head, events=events, triggers=edges)
                edges = None
        except OSError as error:
            raise InputError(f"{path}: truncated or damaged HDF5 ({first_line(error)[:120]})") from error

    return replace(head, triggers=None), parts()


def _in_large_pieces(file) -> bool:
    """Whether taking part of a column means to decompress much more than the part."""
    sets = [file[group][name] for group in ("events", "CD") if group in file for name in file[group]]
    return any(item.chunks is not None and item.chunks[0] > BLOCK for item in sets if hasattr(item, "chunks"))


def _opened(file, path: Path) -> tuple[Recording, Iterator[tuple], dict, int | None]:
    """All but the events; their columns in blocks and how to read those; how many duplicates are declared."""
    attributes, own, pooled = _attributes(file, path)
    if not own and "CD" in file:
        where = f"{path}: CD/events"
        records = _record_set(file, "CD", path)
        size = _stated_size(attributes)
        if None in size:
            size = _scanned_size((records[k : k + BLOCK] for k in range(0, len(records), BLOCK)), size)
        blocks = (records[k : k + PART_EVENTS] for k in range(0, len(records), PART_EVENTS))
        columns = ((b["t"], b["x"], b["y"], np.clip(b["p"], 0, 1)) for b in blocks)
        head = _prophesee_recording(file, path, attributes, Events.empty(size[0] or 1, size[1] or 1, 1000))
        return head, columns, {"unit": "us", "tick_ns": 1000, "where": where}, None
    group, where = _event_group(file, path, "events"), f"{path}: events"
    sets = [_data_set(group, name, where) for name in "txyp"]
    lengths = [len(column) for column in sets]
    if len(set(lengths)) != 1:
        found = ", ".join(map(str, lengths))
        raise InputError(f"{where}: t, x, y, p must have one length, found {found}")
    unit, tick_ns, offset = _time_unit(group, file, where, own)
    size = _size(group, file, "width", where, own), _size(group, file, "height", where, own)
    if None in size:
        blocks = ({"x": sets[1][k : k + BLOCK], "y": sets[2][k : k + BLOCK]} for k in range(0, lengths[0], BLOCK))
        width, height = _scanned_size(blocks, size)
        size = (640, 480) if lengths[0] and _like_dsec(file, size, width - 1, height - 1) else (width, height)
    columns = (tuple(c[k : k + PART_EVENTS] for c in sets) for k in range(0, lengths[0], PART_EVENTS))
    head = _own_recording(file, path, attributes, pooled, Events.empty(size[0] or 1, size[1] or 1, tick_ns))
    declared = _declared_duplicates(group, where) if own and not pooled else None
    return head, columns, {"unit": unit, "tick_ns": tick_ns, "where": where, "offset": offset}, declared


def _scanned_size(blocks: Iterable, stated: tuple[int | None, int | None]) -> tuple[int, int]:
    """The stated size, or the smallest that holds the x and y of all blocks."""
    width, height = 1, 1
    for block in blocks:
        if block["x"].dtype.kind in "iu" and block["y"].dtype.kind in "iu":  # else refused when it is read
            wide, high = sensor_size(block["x"], block["y"], *stated)
            width, height = max(width, wide), max(height, high)
    return width, height


def refuse_foreign_storage(file, path: Path) -> None:
    """Raise InputError for links and datasets that lead out of the file, and sizes that it cannot hold.

    What lies in another file is not what was given to be read, and may be nobody's business.
    """
    import h5py

    groups, held = [(file, "")], path.stat().st_size
    for _ in range(MOST_OBJECTS):
        if not groups:
            return
        group, inside = groups.pop()
        for name in group:
            where = f"{inside}{name}"
            if not isinstance(group.get(name, getlink=True), h5py.HardLink):
                raise InputError(f"{path}: {where}: expected data in this file, found a link to elsewhere")
            item = group[name]
            if isinstance(item, h5py.Group):
                groups.append((item, f"{where}/"))
            elif item.is_virtual or item.external:
                raise InputError(f"{path}: {where}: expected data in this file, found it stored elsewhere")
            elif item.nbytes > SMALL_BYTES and item.nbytes > MOST_RATIO * held:
                raise InputError(
                    f"{path}: {where}: declares {item.nbytes} bytes, a file of {held} bytes cannot hold them"
                )
    raise InputError(f"{path}: expected a recording, found more than {MOST_OBJECTS} groups")


def _attributes(file, path: Path) -> tuple[dict, bool, bool]:
    """The file's attributes, whether it is of the project's own format, and whether its pixels are pooled."""
    attributes = {name: _attribute(value) for name, value in file.attrs.items()}
    own = attributes.get("format") == FORMAT
    if not own and "format" in attributes:
        raise InputError(f"{path}: format: expected {FORMAT!r}, found {shown(attributes['format'])}")
    if own and attributes.get("version") != VERSION:
        raise InputError(f"{path}: version: expected {VERSION}, found {shown(attributes.get('version'))}")
    for name in ("condition", "sensor") if own else ():
        if not isinstance(attributes.get(name, ""), str | int | float):
            raise InputError(f"{path}: {name}: expected text, found {shown(attributes[name])}")
    return attributes, own, yes_or_no(attributes.get("pooled", False), f"{path}: pooled")


def _read(file, path: Path) -> Recording:
    attributes, own, pooled = _attributes(file, path)
    if not own and "CD" in file:
        return _read_prophesee(file, path, attributes)
    events = _read_events(file, path, own)
    if own and not pooled:
        _refuse_undeclared_duplicates(events, _declared_duplicates(file["events"], f"{path}: events"), path)
    recording = _own_recording(file, path, attributes, pooled, events)
    return replace(recording, exposures=_read_events(file, path, own, "exposures") if "exposures" in file else None)


def _own_recording(file, path: Path, attributes: dict, pooled: bool, events: Events) -> Recording:
    """The recording around its events."""
    return Recording(
        events=events,
        stimulus=_read_stimulus(file, path) if "stimulus" in file else None,
        condition=str(attributes.get("condition", "")),
        sensor=str(attributes.get("sensor", "")),
        pooled=pooled,
        source=path,
        attributes={name: value for name, value in attributes.items() if name not in NAMED},
        triggers=_read_triggers(file["triggers"], f"{path}: triggers") if "triggers" in file else None,
    )


def _declared_duplicates(group, where: str) -> int:
    """How many events repeat an earlier one, as the file says."""
    value = group.attrs.get("duplicates", 0)
    return 0 if np.size(value) == 1 and value == 0 else whole(value, f"{where}: attribute duplicates", 1 << 62)


def _read_triggers(group, where: str) -> Triggers:
    if not hasattr(group, "keys"):
        raise InputError(f"{where}: expected a group with t, rising, channel, found something else")
    t, rising, channel = (_column(group, name, where) for name in ("t", "rising", "channel"))
    return Triggers.from_columns(t, rising, channel, where=where)


def _read_prophesee(file, path: Path, attributes: dict) -> Recording:
    """A file of Prophesee's HDF5 format."""
    where = f"{path}: CD/events"
    records = _record_set(file, "CD", path)[:]
    size = sensor_size(records["x"], records["y"], *_stated_size(attributes))
    t = to_nanoseconds(records["t"], "us", where)
    p = np.clip(records["p"], 0, 1)
    events = Events.from_columns(t, records["x"], records["y"], p, *size, tick_ns=1000, where=where)
    return _prophesee_recording(file, path, attributes, events)


def _stated_size(attributes: dict) -> tuple[int | None, int | None]:
    """Width and height in Prophesee's attribute `geometry`."""
    stated = re.fullmatch(r"(\d{1,9})x(\d{1,9})", str(attributes.get("geometry", "")).lower(), re.ASCII)
    return (None, None) if stated is None else (int(stated[1]), int(stated[2]))


def _prophesee_recording(file, path: Path, attributes: dict, events: Events) -> Recording:
    """The recording around its events."""
    triggers = None
    if "EXT_TRIGGER" in file:
        edges, where = _record_set(file, "EXT_TRIGGER", path, ("t", "p", "id"))[:], f"{path}: EXT_TRIGGER/events"
        triggers = Triggers.from_columns(
            to_nanoseconds(edges["t"], "us", where), edges["p"] > 0, edges["id"], where=where
        )
    kept = {name: value for name, value in attributes.items() if isinstance(value, str | int | float)}
    return Recording(
        events, sensor=str(attributes.get("plugin_name", "")), source=path, attributes=kept, triggers=triggers
    )


def _record_set(file, group: str, path: Path, fields: tuple[str, ...] = ("t", "x", "y", "p")):
    """The records of `group`/events.

    Raises:
        InputError: they are missing, have other fields, or need a filter that this installation has not.
    """
    where = f"{path}: {group}/events"
    try:
        records = file[group]["events"]
        records[:1]
    except (KeyError, AttributeError, TypeError, ValueError):
        raise InputError(f"{where}: missing") from None
    except OSError as error:
        if "filter" not in str(error):
            raise
        raise InputError(
            f"{where} is compressed by a filter (ECF) that h5py here lacks; "
            "install Prophesee's plugin, or convert the file to RAW with the maker's tools"
        ) from None
    if not set(fields) <= set(records.dtype.names or ()):
        raise InputError(f"{where}: expected records of {', '.join(fields)}, found {shown(str(records.dtype))}")
    if records.ndim != 1 or any(records.dtype[name].kind not in "iub" for name in fields):
        found = f"{shown(str(records.dtype), 200)} of shape {records.shape}"
        raise InputError(f"{where}: expected one column of records of integers, found {found}")
    return records


def _event_group(file, path: Path, name: str):
    if name not in file or not hasattr(file[name], "keys"):
        raise InputError(f"{path}: expected a group events with t, x, y, p; found {', '.join(file) or 'nothing'}")
    return file[name]


def _time_unit(group, file, where: str, own: bool) -> tuple[str, int, int]:
    """Unit and tick [ns] of the times, and what is added to them."""
    unit = _attribute(group["t"].attrs.get("unit", "us"))
    if unit not in ("ns", "us"):
        raise InputError(f"{where}/t: expected unit 'ns' or 'us', found {shown(unit)}")
    tick = group.attrs.get("tick_ns", 1 if unit == "ns" else 1000)
    return str(unit), whole(tick, f"{where}: attribute tick_ns", MOST_TICK_NS), 0 if own else _time_offset(file, where)


def _time_offset(file, where: str) -> int:
    """DSEC's scalar `t_offset`."""
    if "t_offset" not in file:
        return 0
    value = np.asarray(file["t_offset"][()] if hasattr(file["t_offset"], "shape") else None)
    if value.size != 1 or value.dtype.kind not in "iu":
        raise InputError(f"{where}: t_offset: expected one whole number, found {shown(value.tolist())}")
    return int(value.item())


def _like_dsec(file, stated: tuple[int | None, int | None], last_x: int, last_y: int) -> bool:
    """Whether the sensor is DSEC's of 640 × 480 pixels, which its files do not say."""
    return stated == (None, None) and "ms_to_idx" in file and last_x < 640 and last_y < 480


def _read_events(file, path: Path, own: bool, name: str = "events") -> Events:
    where, group = f"{path}: {name}", _event_group(file, path, name)
    t, x, y, p = (_column(group, name, where) for name in "txyp")
    unit, tick_ns, offset = _time_unit(group, file, where, own)
    width, height = (_size(group, file, name, where, own) for name in ("width", "height"))
    if len(x) and len(y) and _like_dsec(file, (width, height), int(x.max()), int(y.max())):
        width, height = 640, 480
    if x.dtype.kind in "iu" and y.dtype.kind in "iu":
        width, height = sensor_size(x, y, width, height)
    nanoseconds = to_nanoseconds(t, unit, where, offset)
    return Events.from_columns(nanoseconds, x, y, p, width or 1, height or 1, tick_ns=tick_ns, where=where)


def _column(group, name: str, where: str) -> np.ndarray:
    return _data_set(group, name, where)[:]


def _data_set(group, name: str, where: str):
    if name not in group or not hasattr(group[name], "shape"):
        raise InputError(f"{where}/{name}: missing; expected t, x, y, p, found {', '.join(group) or 'nothing'}")
    if group[name].ndim != 1:
        raise InputError(f"{where}/{name}: expected one column, found shape {group[name].shape}")
    return group[name]


def _size(group, file, name: str, where: str, required: bool) -> int | None:
    value = group.attrs.get(name, file.attrs.get(name))
    if value is None:
        if required:
            raise InputError(f"{where}: attribute {name} is missing; expected the sensor's {name} in pixels")
        return None
    return whole(value, f"{where}: attribute {name}", MOST_SIZE)


def _refuse_undeclared_duplicates(events: Events, declared: int, path: Path) -> None:
    again = duplicated(events)
    if len(again) > declared:
        k = int(again[0])
        raise InputError(
            f"{path}: events: expected each event once, found {len(again)} duplicates; event {k} repeats "
            f"t = {events.t[k]} ns, x = {events.x[k]}, y = {events.y[k]}, p = {events.p[k]}"
        )


def _read_stimulus(file, path: Path) -> Light:
    group, where = file["stimulus"], f"{path}: stimulus"
    if not hasattr(group, "keys"):
        raise InputError(f"{where}: expected a group with t and radiance, found something else")
    for name in ("t", "radiance"):
        if name not in group:
            raise InputError(f"{where}/{name}: missing; expected t and radiance, found {', '.join(group) or 'nothing'}")
    unit: Any = _attribute(group.attrs.get("unit", "relative"))  # refused with the light where they are no text
    interpolation: Any = _attribute(group.attrs.get("interpolation", "linear"))
    columns = {name: group[name] for name in ("t", "radiance", "first", "of_pixel") if name in group}
    for name, column in columns.items():
        if not getattr(column, "shape", None) or column.dtype.kind not in "iuf":
            raise InputError(f"{where}/{name}: expected an array of numbers, found {shown(column)}")
    return light_from_arrays({name: column[:] for name, column in columns.items()}, unit, interpolation, where)


def _attribute(value):
    """An HDF5 attribute as plain Python; JSON objects and lists are decoded."""
    if isinstance(value, bytes):
        value = value.decode("utf-8", "replace")
    if isinstance(value, str) and value[:1] in ("{", "["):
        try:
            return json.loads(value)
        except (ValueError, RecursionError):
            return value
    if isinstance(value, np.ndarray):
        return [_attribute(entry) for entry in value.ravel().tolist()]
    value = value.item() if isinstance(value, np.generic) else value
    return (
        value if isinstance(value, str | int | float | list) else shown(value)
    )  # complex numbers, references, nothing
