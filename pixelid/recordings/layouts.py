"""Where the events lie among a file's arrays: HDF5, npz and MATLAB files name and nest them in many ways.

A stream of events is a group of columns with the names of t, x, y and p, the two addresses perhaps in one array of two
columns; one array of records with such fields; or an array of four columns or rows, whose order is inferred.  Streams
without events are passed over; of several one is stated.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pixelid.errors import InputError, shown
from pixelid.recordings.raw import Block
from pixelid.recordings.rules import ROWS, chosen_name, infer_order, named_columns
from pixelid.recordings.source import ReadingOptions

Kind = tuple[np.dtype, tuple[int, ...]]
POSITION = re.compile(r"(xy|pos|positions?|coords?|coordinates|locations?|pixels?)$", re.I)  # x and y in one array


@dataclass(frozen=True)
class Arrays:
    """The arrays of a file.

    Attributes:
        kinds: path → type and shape.
        pieces: makes an iterator over pieces of some arrays of one length, side by side, along their first axis.
    """

    kinds: dict[str, Kind]
    pieces: Callable[[Sequence[str]], Iterator[list[np.ndarray]]]


@dataclass(frozen=True)
class Stream:
    """Columns of events in a file.

    Attributes:
        name: path of the group or array.
        length: events.
        paths: of the arrays that hold t, x, y, p.
        fields: of each its name or number in that array; None where it is all of it.
        unit: that the name of t states.
        inferred: of `Source`.
        across: whether the columns are rows of an array.
    """

    name: str
    length: int
    paths: Sequence[str]
    fields: Sequence[str | int | None] = (None,) * 4
    unit: str | None = None
    inferred: tuple[tuple[str, tuple[Any, str]], ...] = ()
    across: bool = False

    def blocks(self, arrays: Arrays) -> Iterator[Block]:
        """Its columns, piece by piece."""
        every = list(dict.fromkeys(self.paths))
        for piece in arrays.pieces(every):
            found = dict(zip(every, piece, strict=True))
            yield Block.of(self._column(found[path], k) for path, k in zip(self.paths, self.fields, strict=True))

    def _column(self, array: np.ndarray, field: str | int | None) -> np.ndarray:
        if field is None:
            return array.reshape(-1)
        return array[field] if self.across or isinstance(field, str) else array[:, field]


def chosen_stream(arrays: Arrays, options: ReadingOptions, where: str) -> tuple[Stream, tuple[str, ...]]:
    """The stream of events of a file that is stated, or the only one that has any; and the names of all.

    Args:
        arrays: of the file.
        options: what the user states.
        where: names the file in errors.

    Raises:
        InputError: there is none, or one must be stated.
    """
    streams = _streams(arrays, options, where)
    names = tuple(stream.name for stream in streams)
    if not streams:
        found = ", ".join(f"{path} ({', '.join(kind.names)})" if kind.names else path
                          for path, (kind, _) in arrays.kinds.items())  # fmt: skip
        raise InputError(
            f"{where}: expected columns t, x, y, p, found {shown(found or 'nothing', 200)}; "
            "state their names: --columns t=NAME,x=NAME,y=NAME,p=NAME"
        )
    name = chosen_name([stream.name for stream in streams if stream.length], names, options, where)
    return next(stream for stream in streams if stream.name == name), names if len(names) > 1 else ()


def _streams(arrays: Arrays, options: ReadingOptions, where: str) -> list[Stream]:
    groups: dict[str, list[str]] = {}
    for path, (_, shape) in arrays.kinds.items():
        if shape:
            groups.setdefault(path.rpartition("/")[0], []).append(path)
    by_name = [word for word in options.columns if "=" in word]  # arrays of a group have no order
    found = [_of_group(arrays, group, paths, by_name, where) for group, paths in groups.items()]
    found += [_of_records(path, kind, by_name) for path, kind in arrays.kinds.items()]
    streams = [stream for stream in found if stream is not None]
    stated = len(options.columns)
    most_columns = 16  # of an array whose order is stated
    plain = [path for path, (dtype, shape) in arrays.kinds.items()
             if dtype.kind in "iuf" and len(shape) == 2 and min(shape) > 0
             and (4 in shape or (4 <= stated <= most_columns and stated in shape))]  # fmt: skip
    named = [path for path in plain if "event" in path.lower()]
    for path in named or ([] if streams else plain):
        streams.append(_of_four(arrays, path, options, where))
    return streams


def _of_group(arrays: Arrays, group: str, paths: list[str], by_name: Sequence[str], where: str) -> Stream | None:
    names, places = [], []
    for path in paths:
        name, shape = path.rpartition("/")[2], arrays.kinds[path][1]
        both = len(shape) == 2 and shape[1] == 2 and POSITION.search(name)
        names += [f"{name[: both.start()]}{letter}" for letter in "xy"] if both else [name]
        places += [(path, 0), (path, 1)] if both else [(path, None)]
    order, unit = named_columns(names, by_name)
    if order is None:
        return None
    chosen = [places[k] for k in order]
    lengths = []
    for path, field in chosen:
        dtype, shape = arrays.kinds[path]
        if field is None and (int(np.prod(shape)) != max(shape, default=0) or dtype.names):
            raise InputError(f"{where}: {path}: expected one column, found shape {shape}")
        lengths.append(shape[0] if field is not None else max(shape, default=0))
    if len(set(lengths)) != 1:
        raise InputError(f"{where}: {group}: t, x, y, p must have one length, found {', '.join(map(str, lengths))}")
    return Stream(group or "/", lengths[0], [path for path, _ in chosen], [field for _, field in chosen], unit)


def _of_records(path: str, kind: Kind, by_name: Sequence[str]) -> Stream | None:
    names = kind[0].names or ()
    order, unit = named_columns(names, by_name) if names else (None, None)
    if order is None or len(kind[1]) != 1:
        return None
    return Stream(path, kind[1][0], (path,) * 4, [names[k] for k in order], unit)


def _of_four(arrays: Arrays, path: str, options: ReadingOptions, where: str) -> Stream:
    shape, count = arrays.kinds[path][1], len(options.columns) or 4
    across = shape[1] != count
    length = shape[1] if across else shape[0]
    if options.columns:
        order, _ = named_columns([str(k) for k in range(count)], options.columns)
        if order is None or count not in shape:
            raise InputError(f"{where}: {path}: --columns: expected {min(shape)}, found {','.join(options.columns)}")
        return Stream(path, length, (path,) * 4, order, across=across)
    sample = next(arrays.pieces([path]))[0]
    columns = list(sample[:, :ROWS]) if across else [sample[:ROWS, k] for k in range(4)]
    order, inferred = infer_order(columns, f"{where}: {path}", options.size)
    return Stream(path, length, (path,) * 4, order, None, (("columns", inferred),), across)
