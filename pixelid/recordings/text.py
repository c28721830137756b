"""Recordings as text: one event per line, `t x y p`, separated by spaces or commas.

Lines that begin with `#` are comments; a line of column names may say another order and a unit of the times (`t_us`,
`timestamp [ns]`).  Otherwise integer times are microseconds, times with a decimal point seconds (the layout of the
Event Camera Dataset's events.txt), and lines without names may be Metavision's, `x,y,p,t`.
The project's own files carry a line `# {JSON}` with everything else, and the stimulus in `# stimulus {JSON}`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np

from pixelid.errors import InputError, first_line, shown
from pixelid.recordings import metadata
from pixelid.recordings.columns import sensor_size, to_nanoseconds, validated
from pixelid.recordings.events import NS_PER_UNIT, Events
from pixelid.recordings.npz import NAMES, floats_to_ns
from pixelid.recordings.parts import LongRecording, cut
from pixelid.recordings.recording import Recording
from pixelid.stimuli.pixel_lights import PixelLights

LINES_AT_ONCE = 1 << 19
LINES_SEEN = 1 << 12  # that say whether times are whole microseconds or seconds
TXYP, METAVISION = [0, 1, 2, 3], [3, 0, 1, 2]  # columns of t, x, y, p
IN_UNIT = re.compile(r"(\w+?)(?:[\s_]+|\s*[\[(])(ns|[uµ]s|ms|s)[\])]?")  # t_us, timestamp [ns]


def read(path: Path) -> Recording:
    """The recording in a text file; raises InputError for lines that are not four numbers."""
    where = f"{path}: events"
    meta, stimulus, blocks, unit, tick_ns = _opened(path)
    every = list(blocks)
    empty = np.empty(0, np.int64)
    t, x, y, p = (np.concatenate([block[k] for block in every]) if every else empty for k in range(4))
    width, height = sensor_size(x, y, meta.get("width"), meta.get("height"))
    t = to_nanoseconds(t, unit, where)
    events = Events.from_columns(t, x, y, p, width, height, tick_ns=tick_ns, where=where)
    return metadata.assemble(meta, events, stimulus, path, str(path))


def stream(path: Path) -> tuple[Recording, Iterator[Recording]]:
    """The same in parts: the recording without events, and its parts; an unstated size takes a reading more."""
    meta, stimulus, blocks, unit, tick_ns = _opened(path)
    size = meta.get("width"), meta.get("height")
    if None in size:
        size = (1, 1)
        for _, x, y, _ in blocks:
            wide, high = sensor_size(x, y, meta.get("width"), meta.get("height"))
            size = max(size[0], wide), max(size[1], high)
        *_, blocks, _, _ = _opened(path)
    width, height = sensor_size(np.empty(0), np.empty(0), *size)
    head = metadata.assemble(meta, Events.empty(width, height, tick_ns), stimulus, path, str(path))
    events = validated(blocks, width, height, unit=unit, tick_ns=tick_ns, where=f"{path}: events")
    return head, (replace(head, events=some) for some in events)


def _opened(path: Path):
    """Metadata, arrays of the stimulus or None, blocks of columns, unit and tick [ns] of the times."""
    try:
        with path.open(encoding="utf-8-sig") as file:
            meta, stimulus, named, first = _header(file, path)
            seen = [] if first is None else _rows([first, *islice(file, LINES_SEEN - 1)])
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: expected text, found binary data") from error
    order, told = named or (METAVISION if _is_metavision(seen) else TXYP, None)
    point = _has_point(seen, order, path)
    unit = told or ("s" if point else meta.get("unit", "us"))
    tick_ns = meta.get("tick_ns", 1 if point else NS_PER_UNIT.get(unit, 1000))

    def blocks() -> Iterator[tuple]:
        try:
            with path.open(encoding="utf-8-sig") as file:
                *_, first = _header(file, path)
                if first is not None:
                    yield from _blocks(file, first, order, unit if point else None, f"{path}: events")
        except UnicodeDecodeError as error:
            raise InputError(f"{path}: expected text, found binary data") from error

    return meta, stimulus, blocks(), "ns" if point else unit, tick_ns


def _header(file, path: Path):
    """Metadata, arrays of the stimulus or None, what names of columns say or None, and the first line of numbers."""
    meta, stimulus, named = {}, None, None
    for line in file:
        line = line.strip()
        if line.startswith("# {"):
            meta = metadata.from_json(line[2:], f"{path}: header")
        elif line.startswith("# stimulus {"):
            stimulus = _light(line[len("# stimulus ") :], f"{path}: stimulus")
        elif line and not line.startswith("#"):
            if not line[0].isalpha():
                return meta, stimulus, named, line
            named = _named(line, path)
    return meta, stimulus, named, None


def _rows(lines: list[str]) -> list[list[str]]:
    """The cells of those lines that are no comments."""
    return [line.replace(",", " ").split() for line in lines if line.strip() and not line.lstrip().startswith("#")]


def _is_metavision(rows: list[list[str]]) -> bool:
    """Whether rows without names are `x y p t`: the last number is no polarity but a time, and the one before it is."""
    if not all(len(row) == 4 and row[2] in ("0", "1") and row[3].isdecimal() for row in rows):
        return False
    t = [int(row[3]) for row in rows]
    return bool(t) and max(t) > 1 and t == sorted(t)


def _has_point(rows: list[list[str]], order: list[int], path: Path) -> bool:
    """Whether any time in some rows has a decimal point or an exponent."""
    for k, cells in enumerate(rows):
        if len(cells) <= max(order):
            found = f"{len(cells)} in event {k}"
            raise InputError(f"{path}: expected {max(order) + 1} numbers a line at least, found {found}")
        if any(c in cells[order[0]] for c in ".eE"):
            return True
    return False


def _light(text: str, where: str) -> dict[str, np.ndarray]:
    """The arrays of the stimulus from its line of JSON."""
    try:
        told = json.loads(text)
        t, radiance, kind = np.array(told["t"], np.float64), told["radiance"], told["dtype"]
        if kind not in ("float32", "float64"):
            raise ValueError(f"dtype {shown(kind, 20)}")
        return {"t": t, "radiance": np.array(radiance, dtype=kind)}
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        found = f"no {shown(error.args[0])}" if isinstance(error, KeyError) else first_line(error)
        raise InputError(f"{where}: expected t, radiance and dtype as JSON, found {found}") from error


def _named(line: str, path: Path) -> tuple[list[int], str | None]:
    """The columns of t, x, y, p by their names, and the unit of the times where that of t says one."""
    names = [name.strip().lower() for name in (line.split(",") if "," in line else line.split())]
    unit = None
    for k, name in enumerate(names):
        if (parts := IN_UNIT.fullmatch(name)) and parts[1] in NAMES["t"]:
            names[k], unit = parts[1], parts[2].replace("µ", "u")
    columns = [next((k for k, name in enumerate(names) if name in NAMES[letter]), None) for letter in "txyp"]
    if any(k is None for k in columns):
        raise InputError(
            f"{path}: header: expected columns t, x, y, p (t in whole µs, or in s with a point), found "
            f"{', '.join(names)[:80]}"
        )
    return [k for k in columns if k is not None], unit


def _blocks(file, first: str, order: list[int], unit: str | None, where: str):
    """The columns (t int64 [ns when floats in `unit`], x, y, p) of successive blocks of lines."""
    delimiter = "," if "," in first else None
    lines, done = [first], 0
    time = np.int64 if unit is None else np.float64
    kinds = np.dtype([("t", time), ("x", np.int32), ("y", np.int32), ("p", np.int8)])
    while True:
        lines += islice(file, LINES_AT_ONCE - len(lines))
        if not lines:
            return
        try:
            block = np.loadtxt(lines, dtype=kinds, delimiter=delimiter, usecols=order, ndmin=1)
        except (ValueError, OverflowError) as error:
            reason = str(error).splitlines()[0]
            raise InputError(f"{where}: expected lines of t x y p after event {done}, found: {reason}") from error
        t = block["t"] if unit is None else floats_to_ns(block["t"], unit, where)
        yield t, block["x"].copy(), block["y"].copy(), block["p"].copy()
        done, lines = done + len(block), []


def write(recording: Recording | LongRecording, path: Path) -> None:
    """Write `recording` as text, t in nanoseconds; a per-pixel stimulus is refused (use .h5 or .npz)."""
    head, parts = (recording.head, recording.read()) if isinstance(recording, LongRecording) else cut(recording)
    stimulus = head.stimulus
    if stimulus is not None and (isinstance(stimulus, PixelLights) or not stimulus.full_field):
        raise InputError(f"{path.name}: text holds no per-pixel stimulus; write .h5 or .npz")
    separator = "," if path.suffix.lower() == ".csv" else " "
    with path.open("w", encoding="utf-8") as file:
        file.write(f"# {metadata.to_json(head)}\n")
        if stimulus is not None:
            told = {"t": stimulus.t.tolist(), "radiance": stimulus.radiance.tolist()}
            file.write(f"# stimulus {json.dumps(told | {'dtype': stimulus.radiance.dtype.name})}\n")
        file.write(separator.join("txyp") + "\n")
        for part in parts:
            rows = zip(*(getattr(part.events, letter).tolist() for letter in "txyp"), strict=True)
            file.writelines(f"{t}{separator}{x}{separator}{y}{separator}{p}\n" for t, x, y, p in rows)
