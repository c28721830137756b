"""Recordings in HDF5: the project's own format, and the layouts that others publish.

    attrs      format="pixelid-recording", version=1, condition, sensor, [pooled, temperature_k, biases (JSON), …]
    events/    attrs width, height, [tick_ns, duplicates]
               t int64 (attr unit "ns" | "us", default "us"), x uint16, y uint16, p uint8 (1 ON, 0 OFF)
    triggers/  t int64 ns, rising uint8, channel uint8: edges on the camera's trigger inputs, where there are any
    exposures/ t, x, y, p as in events/: exposure measurements of an ATIS, where there are any
    stimulus/  t float64 [s], radiance (n,) or (n, height, width); attrs unit, interpolation

`events.attrs["duplicates"]` states how many events repeat an earlier one exactly.  Without it such events are
refused, because they usually mean a file joined to itself; pooled recordings have no addresses and are exempt.

Of others, wherever `layouts` finds events: DSEC, VECtor, TUM-VIE, EDS (`ms_to_idx`: times are µs, from the scalar
`t_offset`), M3ED (`ms_map_idx`, `calib/resolution`), Prophesee's `CD/events` and `EXT_TRIGGER/events` (µs), E2VID's
(`sensor_resolution`), v2e's and MVSEC's arrays of four columns.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from pixelid.errors import InputError, shown
from pixelid.recordings.bias_files import biases_beside
from pixelid.recordings.columns import to_nanoseconds
from pixelid.recordings.damage import refusing
from pixelid.recordings.events import Events
from pixelid.recordings.layouts import Arrays, Stream, chosen_stream
from pixelid.recordings.metadata import FORMAT, MOST_SIZE, MOST_TICK_NS, VERSION, assemble, whole, yes_or_no
from pixelid.recordings.raw import RawEvents
from pixelid.recordings.recording import Recording
from pixelid.recordings.rules import is_whole
from pixelid.recordings.source import ReadingOptions
from pixelid.recordings.statements import stated_size, stated_unit
from pixelid.recordings.triggers import COLUMNS, Triggers

PIECE, WHOLE = 1 << 20, 1 << 22  # events taken at once; a compressed piece of more is taken once, with all others
DAMAGED = "truncated or damaged HDF5"
EDGES = ("t", "p", "id")  # of a record of Prophesee's trigger edges
NAMED = {"format", "version", "condition", "sensor", "pooled"}
MILLISECONDS = ("ms_to_idx", "ms_map_idx")  # for every millisecond, the first event: so times are µs
MILLISECOND_SIZES = (640, 480), (1280, 720)  # DSEC, EDS, VECtor; TUM-VIE
FILTERS = {0x8ECF: "ECF (Prophesee's plugin: set HDF5_PLUGIN_PATH, or convert with the maker's tools)",
           32000: "LZF", 32001: "Blosc",
           32004: "LZ4", 32008: "bitshuffle", 32015: "Zstandard", 32026: "Blosc2"}  # fmt: skip


def opened(path: Path, options: ReadingOptions) -> RawEvents:
    """What an HDF5 file holds; raises InputError for anything that docs/formats.md does not allow."""
    import h5py
    import hdf5plugin  # noqa: F401  # registers its filters

    if not h5py.is_hdf5(path):
        raise InputError(f"{path}: expected an HDF5 file, found something else")
    with refusing(path, DAMAGED, OSError), contextlib.ExitStack() as stack:
        file = stack.enter_context(h5py.File(path, "r"))
        refuse_foreign_storage(file, path)
        attributes, own, pooled = _attributes(file, path)
        raw = _own(file, path, attributes, pooled) if own else _foreign(file, path, attributes, options)
        stack.pop_all()  # its blocks are read later
        return replace(raw, close=file.close)


def _own(file, path: Path, attributes: dict, pooled: bool) -> RawEvents:
    """The project's own format, which states everything."""
    labels = {name: str(attributes.get(name, "")) for name in ("condition", "sensor")}
    meta = {**labels, "pooled": pooled, "attributes": {k: v for k, v in attributes.items() if k not in NAMED}}
    triggers = light = None
    if "triggers" in file:
        columns = _columns(file, path, "triggers", COLUMNS)
        triggers = Triggers.from_columns(*(columns[name][:] for name in COLUMNS), where=f"{path}: triggers")
    if "stimulus" in file:
        meta["stimulus"] = {name: _attribute(value) for name, value in file["stimulus"].attrs.items()}
        light = {name: column[:] for name, column in _columns(file, path, "stimulus", ("t", "radiance")).items()}
    head = replace(assemble(meta, Events.empty(1, 1), light, path, str(path)), triggers=triggers)
    duplicates, exposures = None, None
    if not pooled and "events" in file:
        value = file["events"].attrs.get("duplicates", 0)
        where = f"{path}: events: attribute duplicates"
        duplicates = 0 if np.size(value) == 1 and value == 0 else whole(value, where, 1 << 62)
    if "exposures" in file:
        exposures = _own_events(file, path, "exposures", replace(head, triggers=None))
    return replace(_own_events(file, path, "events", head), duplicates=duplicates, exposures=exposures)


def _columns(file, path: Path, name: str, needed: Sequence[str]) -> dict[str, Any]:
    """The arrays of numbers in a group of the project's own format.

    Raises:
        InputError: it is none, or lacks one that is needed.
    """
    group, where = file.get(name), f"{path}: {name}"
    found = ", ".join(group if hasattr(group, "keys") else file) or "nothing"
    if not hasattr(group, "keys"):
        raise InputError(f"{where}: expected a group with {', '.join(needed)}, found {found}")
    columns = {key: item for key, item in group.items() if getattr(item, "shape", None)}
    for key in needed:
        if key not in columns:
            raise InputError(f"{where}/{key}: missing; expected arrays {', '.join(needed)}, found {found}")
    for key, column in columns.items():
        if column.dtype.kind not in "iufb":
            raise InputError(f"{where}/{key}: expected numbers, found {column.dtype}")
    return columns


def _own_events(file, path: Path, name: str, head: Recording) -> RawEvents:
    columns, group, where = _columns(file, path, name, "txyp"), file[name], f"{path}: {name}"
    shapes = [columns[letter].shape for letter in "txyp"]
    if len(set(shapes)) != 1 or len(shapes[0]) != 1:
        raise InputError(f"{where}: t, x, y, p must have one length, found {', '.join(map(str, shapes))}")
    unit = _attribute(group["t"].attrs.get("unit", "us"))
    if unit not in ("ns", "us"):
        raise InputError(f"{where}/t: expected unit 'ns' or 'us', found {shown(unit)}")
    tick = group.attrs.get("tick_ns", 1 if unit == "ns" else 1000)
    size = []
    for side in ("width", "height"):
        value = group.attrs.get(side, file.attrs.get(side))
        if value is None:
            raise InputError(f"{where}: attribute {side} is missing; expected the sensor's {side} in pixels")
        size.append(whole(value, f"{where}: attribute {side}", MOST_SIZE))
    if columns["t"].dtype.kind not in "iu":
        raise InputError(f"{where}/t: expected integers, found {columns['t'].dtype}")
    stream = Stream(name, shapes[0][0], tuple(f"{name}/{letter}" for letter in "txyp"))
    return RawEvents(
        head, lambda: stream.blocks(_arrays(file, path)), where, str(unit),
        whole(tick, f"{where}: attribute tick_ns", MOST_TICK_NS), size=(size[0], size[1]), polarity="01",
    )  # fmt: skip


def _foreign(file, path: Path, attributes: dict, options: ReadingOptions) -> RawEvents:
    """Another program's file."""
    arrays = _arrays(file, path)
    stream, streams = chosen_stream(arrays, options, str(path))
    for place in stream.paths:
        _refuse_missing_filter(file[place], f"{path}: {place}")
    group = file[stream.name] if hasattr(file[stream.name], "keys") else file[stream.name].parent
    groups = [group, *([] if group.name == "/" else [group.parent, file])]
    where = f"{path}: {stream.name}"
    by_layout = any(name in one for one in groups for name in MILLISECONDS) or stream.name == "CD/events"
    by_layout = by_layout and all(is_whole(one.t) for one in islice(stream.blocks(arrays), 1))
    holders = [_entries(one) for one in groups]
    own = {name: _attribute(value) for name, value in file[stream.paths[0]].attrs.items()}
    unit = options.time_unit or stream.unit or stated_unit(own, holders, where) or ("us" if by_layout else None)
    size, likely = stated_size(holders, where)
    if any("ms_to_idx" in one for one in groups):
        likely += tuple((one, " of a sensor whose data sets have this layout") for one in MILLISECOND_SIZES)
    kept: dict[str, Any] = {name: value for name, value in attributes.items()
            if name not in NAMED and isinstance(value, str | int | float)}  # fmt: skip
    if biases := biases_beside(path):
        kept["biases"] = biases
    triggers = _prophesee_triggers(file, path) if "EXT_TRIGGER" in file else None
    head = Recording(Events.empty(1, 1), sensor=str(attributes.get("plugin_name", "")), source=path,
                     attributes=kept, triggers=triggers)  # fmt: skip
    return RawEvents(
        head, lambda: stream.blocks(arrays), where, unit, offset=_time_offset(groups, where), size=size,
        likely_sizes=likely, inferred=stream.inferred, streams=streams,
    )  # fmt: skip


def _arrays(file, path: Path) -> Arrays:
    """Every array of the file, which `refuse_foreign_storage` has looked through."""
    import h5py

    kinds = {}

    def note(name: str, item) -> None:
        if isinstance(item, h5py.Dataset) and item.shape is not None:
            kinds[name] = (item.dtype, item.shape)

    file.visititems(note)

    def pieces(names: Sequence[str]) -> Iterator[list[np.ndarray]]:
        with refusing(path, DAMAGED, OSError):
            sets = [file[name] for name in names]
            if any(one.chunks is not None and max(one.chunks) > WHOLE for one in sets) or any(
                one.ndim > 1 and one.shape[0] != max(one.shape) for one in sets
            ):
                sets = [one[()].reshape(-1) if 1 in one.shape else one[()] for one in sets]
            for k in range(0, len(sets[0]), PIECE):
                yield [one[k : k + PIECE] for one in sets]

    return Arrays(kinds, pieces)


def _refuse_missing_filter(dataset, where: str) -> None:
    """Raise InputError that names a filter which HDF5 lacks here."""
    import h5py

    made = dataset.id.get_create_plist()
    for code in (made.get_filter(k)[0] for k in range(made.get_nfilters())):
        if not h5py.h5z.filter_avail(code):
            name = FILTERS.get(code, f"filter {code}")
            raise InputError(
                f"{where}: compressed by {name}, which this HDF5 lacks; pip install hdf5plugin brings most"
            )


def _entries(group) -> dict[str, Any]:
    """What a group states in attributes, and in arrays of one or two numbers or words."""
    entries = {name: _attribute(value) for name, value in group.attrs.items()}
    for name in (*group, "calib/resolution"):
        item = group.get(name)
        if getattr(item, "shape", None) in ((), (1,), (2,)) and item.dtype.kind in "iufOS":
            value = item[()]
            entries.setdefault(name, _attribute(value) if item.dtype.kind in "OS" else value)
    return entries


def _time_offset(groups: list, where: str) -> int:
    """DSEC's scalar `t_offset`."""
    holder = next((group for group in groups if "t_offset" in group), None)
    if holder is None:
        return 0
    value = np.asarray(holder["t_offset"][()] if hasattr(holder["t_offset"], "shape") else None)
    if value.size != 1 or value.dtype.kind not in "iu":
        raise InputError(f"{where}: t_offset: expected one whole number, found {shown(value.tolist())}")
    return int(value.item())


def _prophesee_triggers(file, path: Path) -> Triggers:
    """Trigger edges of Prophesee's format."""
    where = f"{path}: EXT_TRIGGER/events"
    records = file.get("EXT_TRIGGER/events")
    kinds = getattr(getattr(records, "dtype", None), "fields", None) or {}
    if records is None or records.ndim != 1 or any(kinds.get(k, records.dtype)[0].kind not in "iub" for k in EDGES):
        found = shown(str(getattr(records, "dtype", "nothing")), 200)
        raise InputError(f"{where}: expected records of integers {', '.join(EDGES)}, found {found}")
    _refuse_missing_filter(records, where)
    edges = records[:]
    t = to_nanoseconds(edges["t"], "us", where)
    return Triggers.from_columns(t, edges["p"] > 0, edges["id"], where=where)


def refuse_foreign_storage(file, path: Path) -> None:
    """Raise InputError for links and datasets that lead out of the file, and sizes that it cannot hold.

    What lies in another file is not what was given to be read, and may be nobody's business.
    """
    import h5py

    groups, held = [(file, "")], path.stat().st_size
    most_objects = 1000  # groups of a file
    small_bytes, most_ratio = 1 << 26, 2000  # deflate compresses a thousandfold at most
    for _ in range(most_objects):
        if not groups:
            return
        group, inside = groups.pop()
        for name in group:
            where = f"{inside}{name}"
            link = group.get(name, getlink=True)
            if isinstance(link, h5py.SoftLink):
                continue  # within the file: what it leads to is looked through where it is
            if not isinstance(link, h5py.HardLink):
                raise InputError(f"{path}: {where}: expected data in this file, found a link to elsewhere")
            item = group[name]
            if isinstance(item, h5py.Group):
                groups.append((item, f"{where}/"))
            elif isinstance(item, h5py.Datatype):
                continue
            elif item.is_virtual or item.external:
                raise InputError(f"{path}: {where}: expected data in this file, found it stored elsewhere")
            elif item.nbytes > small_bytes and item.nbytes > most_ratio * held:
                raise InputError(
                    f"{path}: {where}: declares {item.nbytes} bytes, a file of {held} bytes cannot hold them"
                )
    raise InputError(f"{path}: expected a recording, found more than {most_objects} groups")


def _attributes(file, path: Path) -> tuple[dict, bool, bool]:
    """The file's attributes, whether it is of the project's own format, and whether its pixels are pooled."""
    attributes = {name: _attribute(value) for name, value in file.attrs.items()}
    own = attributes.get("format") == FORMAT
    if not own and "pixelid" in str(attributes.get("format", "")):
        raise InputError(f"{path}: format: expected {FORMAT!r}, found {shown(attributes['format'])}")
    if own and attributes.get("version") != VERSION:
        raise InputError(f"{path}: version: expected {VERSION}, found {shown(attributes.get('version'))}")
    for name in ("condition", "sensor") if own else ():
        if not isinstance(attributes.get(name, ""), str | int | float):
            raise InputError(f"{path}: {name}: expected text, found {shown(attributes[name])}")
    return attributes, own, yes_or_no(attributes.get("pooled", False), f"{path}: pooled")


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
