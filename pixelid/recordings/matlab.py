"""MATLAB files (.mat, up to version 7) of ATIS and DVS cameras: structures or variables of columns ts, x, y, p.

`TD` holds the change events.  An ATIS adds `EM`, its exposure measurements: after a change, each pixel marks the begin
(p = 0) and the end (p = 1) of the time its photocurrent takes to move a fixed charge, so the light is proportional to
one over that time (Posch, Matolin & Wohlgenannt, JSSC 2011).  Addresses count from one, unless one of them is zero.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from pixelid.errors import InputError, first_line
from pixelid.recordings.events import Events
from pixelid.recordings.layouts import Arrays, Stream, chosen_stream
from pixelid.recordings.raw import RawEvents
from pixelid.recordings.recording import Recording
from pixelid.recordings.source import SENSOR_SIZES, ReadingOptions

EXPOSURES = "EM"


def opened(path: Path, options: ReadingOptions) -> RawEvents:
    """Change events of a MATLAB file, and the exposure measurements of an ATIS.

    Raises:
        InputError: for files that are not MATLAB's, of version 7.3, or without such columns.
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
    found = dict(_columns(content, ""))

    def pieces(names: Sequence[str]) -> Iterator[list[np.ndarray]]:
        yield [found[name] for name in names]

    arrays = Arrays({name: (column.dtype, column.shape) for name, column in found.items()}, pieces)
    atis = any(name.startswith(f"{EXPOSURES}/") for name in found)
    stream, streams = chosen_stream(arrays, options, str(path), without=[EXPOSURES] if atis else [])
    exposures = None
    if atis:
        chosen = ReadingOptions(stream=EXPOSURES, columns=options.columns)
        exposures = _raw(chosen_stream(arrays, chosen, str(path))[0], arrays, path, atis)
    return _raw(stream, arrays, path, atis, streams, exposures)


def _raw(stream: Stream, arrays: Arrays, path: Path, atis: bool, streams=(), exposures=None) -> RawEvents:
    unit = stream.unit or ("us" if stream.name in ("TD", EXPOSURES) else None)
    head = Recording(Events.empty(1, 1), sensor="ATIS" if atis else "", source=path)
    likely = ((SENSOR_SIZES["ATIS"], " of an ATIS, which has exposure measurements"),) if atis else ()
    return RawEvents(head, lambda: stream.blocks(arrays), f"{path}: {stream.name}", unit, likely_sizes=likely,
                     from_one=True, inferred=stream.inferred, streams=streams, exposures=exposures)  # fmt: skip


def _columns(content, inside: str) -> Iterator[tuple[str, np.ndarray]]:
    """Numeric variables, also of structures, by path."""
    for name, value in content.items():
        if name.startswith("__") or not isinstance(value, np.ndarray):
            continue
        if value.dtype.names and value.size == 1:
            yield from _columns({field: value[field].flat[0] for field in value.dtype.names}, f"{inside}{name}/")
        elif value.dtype.kind in "iufb":
            yield f"{inside}{name}", value.reshape(-1) if 1 in value.shape else value
