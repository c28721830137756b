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

import io
import json
from pathlib import Path

import numpy as np

from pixelid.errors import InputError
from pixelid.outputs import plain
from pixelid.recordings.columns import duplicated, sensor_size, to_nanoseconds
from pixelid.recordings.events import Events
from pixelid.recordings.metadata import FORMAT, VERSION
from pixelid.recordings.recording import Recording
from pixelid.recordings.triggers import Triggers
from pixelid.stimuli.pixel_lights import Light, light_from_arrays

CHUNK = 1 << 16
BLOCK = 1 << 22
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
            _refuse_foreign_storage(file, path)
            return _read(file, path)
    except OSError as error:
        raise InputError(f"{path}: truncated or damaged HDF5 ({str(error).splitlines()[0][:120]})") from error


def _refuse_foreign_storage(file, path: Path) -> None:
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


def _read(file, path: Path) -> Recording:
    attributes = {name: _attribute(value) for name, value in file.attrs.items()}
    own = attributes.get("format") == FORMAT
    if not own and "format" in attributes:
        raise InputError(f"{path}: format: expected {FORMAT!r}, found {attributes['format']!r}")
    if own and attributes.get("version") != VERSION:
        raise InputError(f"{path}: version: expected {VERSION}, found {attributes.get('version')!r}")
    pooled = bool(attributes.get("pooled", False))
    if not own and "CD" in file:
        return _read_prophesee(file, path, attributes)
    events = _read_events(file, path, own)
    if own and not pooled:
        _refuse_undeclared_duplicates(events, int(file["events"].attrs.get("duplicates", 0)), path)
    return Recording(
        events=events,
        stimulus=_read_stimulus(file, path) if "stimulus" in file else None,
        condition=str(attributes.get("condition", "")),
        sensor=str(attributes.get("sensor", "")),
        pooled=pooled,
        source=path,
        attributes={name: value for name, value in attributes.items() if name not in NAMED},
        triggers=_read_triggers(file["triggers"], f"{path}: triggers") if "triggers" in file else None,
        exposures=_read_events(file, path, own, "exposures") if "exposures" in file else None,
    )


def _read_triggers(group, where: str) -> Triggers:
    t, rising, channel = (_column(group, name, where) for name in ("t", "rising", "channel"))
    return Triggers.from_columns(t, rising, channel, where=where)


def _read_prophesee(file, path: Path, attributes: dict) -> Recording:
    """A file of Prophesee's HDF5 format."""
    where = f"{path}: CD/events"
    records = _records(file, "CD", path)
    if not {"t", "x", "y", "p"} <= set(records.dtype.names or ()):
        raise InputError(f"{where}: expected records of t, x, y, p, found {records.dtype}")
    geometry = str(attributes.get("geometry", "")).lower().partition("x")
    stated = [int(g) if g.isdigit() else None for g in (geometry[0], geometry[2])]
    size = sensor_size(records["x"], records["y"], *stated)
    t = to_nanoseconds(records["t"], "us", where)
    p = np.clip(records["p"], 0, 1)
    events = Events.from_columns(t, records["x"], records["y"], p, *size, tick_ns=1000, where=where)
    triggers = None
    if "EXT_TRIGGER" in file:
        edges, where = _records(file, "EXT_TRIGGER", path), f"{path}: EXT_TRIGGER/events"
        triggers = Triggers.from_columns(
            to_nanoseconds(edges["t"], "us", where), edges["p"] > 0, edges["id"], where=where
        )
    kept = {name: value for name, value in attributes.items() if isinstance(value, str | int | float)}
    return Recording(
        events, sensor=str(attributes.get("plugin_name", "")), source=path, attributes=kept, triggers=triggers
    )


def _records(file, group: str, path: Path) -> np.ndarray:
    """The records of `group`/events.  Raises InputError where a filter is missing that this installation has not."""
    try:
        return file[group]["events"][:]
    except (KeyError, AttributeError, TypeError):
        raise InputError(f"{path}: {group}/events: missing") from None
    except OSError as error:
        if "filter" not in str(error):
            raise
        raise InputError(
            f"{path}: {group}/events is compressed by a filter (ECF) that h5py here lacks; "
            "install Prophesee's plugin, or convert the file to RAW with the maker's tools"
        ) from None


def _read_events(file, path: Path, own: bool, name: str = "events") -> Events:
    where = f"{path}: {name}"
    if name not in file or not hasattr(file[name], "keys"):
        raise InputError(f"{path}: expected a group events with t, x, y, p; found {', '.join(file) or 'nothing'}")
    group = file[name]
    t, x, y, p = (_column(group, name, where) for name in "txyp")
    unit = _attribute(group["t"].attrs.get("unit", "us"))
    if unit not in ("ns", "us"):
        raise InputError(f"{where}/t: expected unit 'ns' or 'us', found {unit!r}")
    offset = int(file["t_offset"][()]) if "t_offset" in file and not own else 0
    width, height = (_size(group, file, name, where, own) for name in ("width", "height"))
    if width is None and height is None and "ms_to_idx" in file and len(x) and x.max() < 640 and y.max() < 480:
        width, height = 640, 480
    if x.dtype.kind in "iu" and y.dtype.kind in "iu":
        width, height = sensor_size(x, y, width, height)
    tick_ns = int(group.attrs.get("tick_ns", 1 if unit == "ns" else 1000))
    nanoseconds = to_nanoseconds(t, unit, where, offset)
    return Events.from_columns(nanoseconds, x, y, p, width or 1, height or 1, tick_ns=tick_ns, where=where)


def _column(group, name: str, where: str) -> np.ndarray:
    if name not in group or not hasattr(group[name], "shape"):
        raise InputError(f"{where}/{name}: missing; expected t, x, y, p, found {', '.join(group) or 'nothing'}")
    if group[name].ndim != 1:
        raise InputError(f"{where}/{name}: expected one column, found shape {group[name].shape}")
    return group[name][:]


def _size(group, file, name: str, where: str, required: bool) -> int | None:
    value = group.attrs.get(name, file.attrs.get(name))
    if value is None:
        if required:
            raise InputError(f"{where}: attribute {name} is missing; expected the sensor's {name} in pixels")
        return None
    value = np.asarray(value)
    if value.size != 1 or value.dtype.kind not in "iuf" or value.item() != int(value.item()) or value.item() < 1:
        raise InputError(f"{where}: attribute {name}: expected a positive integer, found {value.tolist()!r}")
    return int(value.item())


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
    for name in ("t", "radiance"):
        if name not in group:
            raise InputError(f"{where}/{name}: missing; expected t and radiance, found {', '.join(group) or 'nothing'}")
    unit = _attribute(group.attrs.get("unit", "relative"))
    interpolation = _attribute(group.attrs.get("interpolation", "linear"))
    columns = {name: group[name][:] for name in ("t", "radiance", "first", "of_pixel") if name in group}
    return light_from_arrays(columns, unit, interpolation, where)


def _attribute(value):
    """An HDF5 attribute as plain Python; JSON objects and lists are decoded."""
    if isinstance(value, bytes):
        value = value.decode("utf-8", "replace")
    if isinstance(value, str) and value[:1] in "{[":
        try:
            return json.loads(value)
        except json.JSONDecodeError:
            return value
    return value.item() if isinstance(value, np.generic) else value


def write(recording: Recording, path: Path) -> None:
    """Write `recording` to a new HDF5 file, compressed, in blocks (extra memory does not grow with it)."""
    import h5py

    events, stimulus = recording.events, recording.stimulus
    with _PatientFile(path, "w+b") as disk, h5py.File(disk, "w") as file:
        file.attrs.update({"format": FORMAT, "version": VERSION, "condition": recording.condition})
        file.attrs["sensor"] = recording.sensor
        if recording.pooled:
            file.attrs["pooled"] = True
        for name, value in recording.attributes.items():
            file.attrs[name] = json.dumps(plain(value)) if isinstance(value, (dict, list, tuple)) else value
        group = _write_events(file, "events", events)
        if not recording.pooled and (repeats := len(duplicated(events))):
            group.attrs["duplicates"] = repeats
        if recording.exposures is not None:
            _write_events(file, "exposures", recording.exposures)
        if recording.triggers is not None:
            group = file.create_group("triggers")
            edges = recording.triggers
            for name, column in (("t", edges.t), ("rising", edges.rising.astype(np.uint8)), ("channel", edges.channel)):
                _compressed(group, name, column.shape, column.dtype)[...] = column
        if stimulus is not None:
            group = file.create_group("stimulus")
            group.attrs.update({"unit": stimulus.unit, "interpolation": stimulus.interpolation})
            for name, column in stimulus.arrays.items():
                _compressed(group, name, column.shape, column.dtype)[...] = column
    if disk.error is not None:
        raise disk.error


class _PatientFile(io.FileIO):
    """A file that keeps its first error to itself: HDF5 crashes the process when the disk is full."""

    error: OSError | None = None

    def write(self, data, /) -> int:
        view = memoryview(data).cast("B")
        done = 0
        while self.error is None and done < len(view):
            try:
                done += super().write(view[done:]) or 0
            except OSError as error:
                self.error = error
        return len(view)

    def truncate(self, size=None, /) -> int:
        try:
            return super().truncate(size)
        except OSError as error:
            self.error = self.error or error
            return size or 0


def _write_events(file, name: str, events: Events):
    """A new group with the columns of `events`."""
    in_us = events.tick_ns % 1000 == 0 and not any(np.any(events.t[k : k + BLOCK] % 1000) for k in _blocks(events))
    group = file.create_group(name)
    group.attrs.update({"width": events.width, "height": events.height, "tick_ns": events.tick_ns})
    for letter, column in (("t", events.t), ("x", events.x), ("y", events.y), ("p", events.p)):
        dataset = _compressed(group, letter, column.shape, column.dtype)
        for k in _blocks(events):
            block = column[k : k + BLOCK]
            dataset[k : k + BLOCK] = block // 1000 if letter == "t" and in_us else block
    group["t"].attrs["unit"] = "us" if in_us else "ns"
    return group


def _blocks(events: Events) -> range:
    return range(0, len(events), BLOCK)


def _compressed(group, name: str, shape: tuple, dtype):
    """A new dataset: gzip level 1 after byte shuffling, at most CHUNK samples per chunk."""
    if not shape[0]:
        return group.create_dataset(name, shape, dtype)
    samples = int(np.prod(shape[1:], dtype=np.int64))
    chunk = (max(1, min(shape[0], CHUNK // samples)), *shape[1:])
    return group.create_dataset(name, shape, dtype, chunks=chunk, compression="gzip", compression_opts=1, shuffle=True)
