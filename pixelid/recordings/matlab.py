"""MATLAB files (.mat, up to version 7) of ATIS and DVS cameras: a structure of columns ts, x, y, p.

`TD` holds the change events.  An ATIS adds `EM`, its exposure measurements: after a change, each pixel marks the begin
(p = 0) and the end (p = 1) of the time its photocurrent takes to move a fixed charge, so the light is proportional to
one over that time (Posch, Matolin & Wohlgenannt, JSSC 2011).  Times are microseconds, addresses count from one.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pixelid.errors import InputError, first_line
from pixelid.recordings.columns import sensor_size, to_nanoseconds
from pixelid.recordings.events import Events
from pixelid.recordings.recording import Recording

NAMES = {"t": ("ts", "t", "timestamp"), "x": ("x",), "y": ("y",), "p": ("p", "pol", "on")}
ATIS_SIZE = (304, 240)


def read(path: Path) -> Recording:
    """Change events of a MATLAB file, and the exposure measurements of an ATIS.

    Raises:
        InputError: for files that are not MATLAB's, of version 7.3, or without such a structure.
    """
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        content = loadmat(path, squeeze_me=False, struct_as_record=True)
    except NotImplementedError:
        raise InputError(
            f"{path}: expected a MATLAB file up to version 7, found version 7.3; save it with -v7"
        ) from None
    except (MatReadError, ValueError, TypeError, KeyError, OSError, EOFError, IndexError, MemoryError) as error:
        reason = first_line(error)[:120]
        raise InputError(f"{path}: expected a MATLAB file, found a damaged or different one ({reason})") from None
    tables = {name: value for name, value in content.items() if not name.startswith("__")}
    changes = next((name for name in ("TD", "td", "events") if name in tables), None)
    if changes is None:
        changes = next((name for name, value in tables.items() if _is_table(value)), None)
    if changes is None or not _is_table(tables[changes]):
        raise InputError(f"{path}: expected a structure TD with ts, x, y, p, found {', '.join(tables) or 'nothing'}")
    atis = "EM" in tables and _is_table(tables["EM"])
    events = _events(tables[changes], f"{path}: {changes}", ATIS_SIZE if atis else None)
    exposures = _events(tables["EM"], f"{path}: EM", ATIS_SIZE) if atis else None
    return Recording(events, sensor="ATIS" if atis else "", source=path, exposures=exposures)


def _is_table(value) -> bool:
    names = getattr(value, "dtype", np.dtype(int)).names or ()
    return value.size == 1 and all(any(name in names for name in NAMES[letter]) for letter in "txyp")


def _events(table: np.ndarray, where: str, size: tuple[int, int] | None) -> Events:
    t, x, y, p = (_column(table, letter, where) for letter in "txyp")
    if not len(t) == len(x) == len(y) == len(p):
        raise InputError(f"{where}: ts, x, y, p must have one length, found {len(t)}, {len(x)}, {len(y)}, {len(p)}")
    x, y = x.astype(np.int64) - 1, y.astype(np.int64) - 1
    if len(x) and min(int(x.min()), int(y.min())) < 0:  # a file whose addresses count from zero
        x, y = x + 1, y + 1
    if size is None or (len(x) and (x.max() >= size[0] or y.max() >= size[1])):
        size = sensor_size(x, y, None, None)
    if len(p) and p.min() == -1:
        p = (p > 0).astype(np.uint8)
    return Events.from_columns(to_nanoseconds(t, "us", where), x, y, p, *size, tick_ns=1000, where=where)


def _column(table: np.ndarray, letter: str, where: str) -> np.ndarray:
    names = table.dtype.names or ()
    name = next(name for name in NAMES[letter] if name in names)
    column = np.asarray(table[name].flat[0])
    if column.dtype.kind == "f" and np.isfinite(column).all() and (column == np.rint(column)).all():
        column = column.astype(np.int64)
    if column.dtype.kind not in "iub":
        raise InputError(f"{where}/{name}: expected whole numbers, found {column.dtype}")
    return column.ravel()
