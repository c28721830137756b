"""Events of HDF5 files with one column each of x, y, t, p, as DSEC, EDS and TUM-VIE publish them, block by block."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from pixelid.documents import interpreting
from pixelid.errors import InputError, first_line
from pixelid.nerf.data.published.source import Block
from pixelid.recordings.hdf5 import refuse_foreign_storage
from pixelid.recordings.isolated import arrays_isolated

BLOCK = 1 << 20  # events read together: 13 MB, and as much again while they are converted
PROBE = 1024  # events read together to find a time
COLUMNS = "xytp"


def events_of(path: Path) -> Callable[[int, int], Iterator[Block]]:
    """What reads the events of a file between two times [ns]; the file is looked at once, to see that it can be read.

    Times are microseconds, later by `t_offset` where the file has one.  Only what lies between the two times is looked
    at: events out of order before or after are no matter.

    Raises:
        InputError: columns that are missing or differ in length, or a compression that h5py cannot undo; when events
            are read, such as are not in order of time.
    """
    next(arrays_isolated("event_blocks", path, begin=0, end=-1))

    def blocks(begin: int, end: int) -> Iterator[Block]:
        answers = arrays_isolated("event_blocks", path, begin=begin, end=end)
        next(answers)
        return (Block(**columns) for columns in answers)

    return blocks


def event_blocks(path: Path, begin: int, end: int) -> Iterator[dict[str, np.ndarray]]:
    """What the reading process does: first the number of events, then blocks with those between two times [ns].

    Where `end` is before `begin`, nothing is asked but whether the file can be read.
    """
    ns_per_us = 1000
    with interpreting(path, "columns x, y, t, p of numbers"), _columns(path) as (columns, offset):
        t = columns["t"]
        yield {"events": np.array([len(t)])}
        for column in columns.values():
            column[:1]
        first = _first_at(t, begin // ns_per_us - offset) if begin <= end else len(t)
        before = np.empty(0, np.int64)
        for k in range(first, len(t), BLOCK):
            some = slice(k, k + BLOCK)
            time = (t[some].astype(np.int64) + offset) * ns_per_us
            _refuse_disorder(np.append(before, time), begin, end, k - len(before), path)
            if time.min() > end:  # not `time[0]`: a single late stamp among the events asked for is not their end
                return
            yield {"t": time, "x": columns["x"][some], "y": columns["y"][some], "on": columns["p"][some] > 0}
            before = time[-1:]


@contextmanager
def _columns(path: Path) -> Iterator[tuple[Any, int]]:
    """({"x", "y", "t", "p"} → columns, offset of t [µs]) of an open file."""
    import h5py

    with suppress(ImportError):  # brings the filters that published files are compressed with
        import hdf5plugin  # type: ignore[import-not-found]  # noqa: F401
    if not path.is_file() or not h5py.is_hdf5(path):
        raise InputError(
            f"{path}: expected an HDF5 file of events, found {'something else' if path.exists() else 'none'}"
        )
    try:
        with h5py.File(path, "r") as file:
            refuse_foreign_storage(file, path)
            yield _checked(file, path)
    except (OSError, RuntimeError, KeyError) as error:  # h5py raises all of them for damaged files
        if "filter" in str(error):
            raise InputError(
                f"{path}: compressed by a filter that h5py here lacks; pip install hdf5plugin brings the usual ones"
            ) from None
        raise InputError(f"{path}: truncated or damaged HDF5 ({first_line(error)[:120]})") from None


def _checked(file: Any, path: Path) -> tuple[Any, int]:
    """The columns of an open file, and the offset of their times."""
    group = file.get("events", file)
    missing = [name for name in COLUMNS if name not in group or len(getattr(group[name], "shape", ())) != 1]
    if missing:
        raise InputError(f"{path}: events/{missing[0]}: missing; expected columns x, y, t, p, found {', '.join(group)}")
    columns = {name: group[name] for name in COLUMNS}
    lengths = {name: len(column) for name, column in columns.items()}
    if len(set(lengths.values())) != 1 or not lengths["t"]:
        raise InputError(f"{path}: events: expected x, y, t, p of one length above 0, found {lengths}")
    if columns["t"].dtype.kind not in "iu":
        raise InputError(f"{path}: events/t: expected whole microseconds, found {columns['t'].dtype}")
    return columns, int(file["t_offset"][()]) if "t_offset" in file else 0


def _refuse_disorder(t: np.ndarray, begin: int, end: int, row: int, path: Path) -> None:
    """Raise InputError where a time is earlier than the one before, and one of them is from `begin` to `end`.

    row: of the first of t (n,)
    """
    asked = (t >= begin) & (t <= end)
    backwards = (t[1:] < t[:-1]) & (asked[1:] | asked[:-1])
    if backwards.any():
        raise InputError(
            f"{path}: events/t: row {row + 1 + int(np.argmax(backwards))} is earlier than the one before; sort the "
            "events by time first"
        )


def _first_at(t, time: int) -> int:
    """The index of the first event at or after a time, by bisection: `t` need not fit into memory.

    Medians of some events are compared, which single ones out of order elsewhere in the file do not move.
    """
    low, high = 0, -(-len(t) // PROBE)
    while low < high:
        middle = (low + high) // 2
        some = t[middle * PROBE : (middle + 1) * PROBE]
        if int(np.sort(some)[len(some) // 2]) < time:
            low = middle + 1
        else:
            high = middle
    first = max(low - 1, 0) * PROBE
    early = t[first : first + 2 * PROBE].astype(np.int64) < time
    return first + (len(early) if early.all() else int(np.argmin(early)))
