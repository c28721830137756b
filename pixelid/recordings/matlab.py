"""MATLAB files (.mat, up to version 7) of ATIS and DVS cameras: structures or variables of columns ts, x, y, p.

`TD` holds the change events.  An ATIS adds `EM`, its exposure measurements: after a change, each pixel marks the begin
(p = 0) and the end (p = 1) of the time its photocurrent takes to move a fixed charge, so the light is proportional to
one over that time (Posch, Matolin & Wohlgenannt, JSSC 2011).  Addresses count from one, unless one of them is zero.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from pixelid.errors import InputError
from pixelid.recordings.damage import refusing
from pixelid.recordings.events import Events
from pixelid.recordings.layouts import Arrays, chosen_stream
from pixelid.recordings.raw import RawEvents
from pixelid.recordings.recording import Recording
from pixelid.recordings.rules import is_whole
from pixelid.recordings.source import SENSOR_SIZES, ReadingOptions

EXPOSURES = "EM"


def opened(path: Path, options: ReadingOptions) -> RawEvents:
    """Change events of a MATLAB file, and the exposure measurements of an ATIS.

    Raises:
        InputError: for files that are not MATLAB's, of version 7.3, or without such columns.
    """
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    kinds = MatReadError, ValueError, TypeError, KeyError, OSError, EOFError, IndexError
    try:
        with refusing(path, "expected a MATLAB file, found a damaged or different one", *kinds):
            content = loadmat(path, squeeze_me=False, struct_as_record=True)
    except NotImplementedError:
        raise InputError(
            f"{path}: expected a MATLAB file up to version 7, found version 7.3; save it with -v7"
        ) from None
    found = dict(_columns(content, ""))
    measured = {name: column for name, column in found.items() if name.startswith(f"{EXPOSURES}/")}
    raw = _raw({name: column for name, column in found.items() if name not in measured}, path, options)
    if not measured:
        return raw
    likely = ((SENSOR_SIZES["ATIS"], " of an ATIS, which has exposure measurements"),)
    exposures = _raw(measured, path, ReadingOptions(columns=options.columns))
    return replace(raw, head=replace(raw.head, sensor="ATIS"), likely_sizes=likely, exposures=exposures)


def _raw(columns: dict[str, np.ndarray], path: Path, options: ReadingOptions) -> RawEvents:
    """The stream among columns by path."""
    kinds = {name: (column.dtype, column.shape) for name, column in columns.items()}
    arrays = Arrays(kinds, lambda names: iter([[columns[name] for name in names]]))
    stream, streams = chosen_stream(arrays, options, str(path))
    layout = stream.name in ("TD", EXPOSURES) and is_whole(next(stream.blocks(arrays)).t)
    unit = stream.unit or ("us" if layout else None)
    return RawEvents(
        Recording(Events.empty(1, 1), source=path), lambda: stream.blocks(arrays), f"{path}: {stream.name}", unit,
        from_one=True, inferred=stream.inferred, streams=streams,
    )  # fmt: skip


def _columns(content, inside: str) -> Iterator[tuple[str, np.ndarray]]:
    """Numeric variables, also of structures, by path."""
    for name, value in content.items():
        if name.startswith("__") or not isinstance(value, np.ndarray):
            continue
        if value.dtype.names and value.size == 1:
            yield from _columns({field: value[field].flat[0] for field in value.dtype.names}, f"{inside}{name}/")
        elif value.dtype.kind in "iufb":
            yield f"{inside}{name}", value.reshape(-1) if 1 in value.shape else value
