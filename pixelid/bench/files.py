"""What a bench session consists of: which file is a recording, which its light, and what is stated about them.

A folder, in which each recording NAME.ext has its light NAME_light.csv (tsv, npy, npz, toml) with it or holds it; or a
bench.toml, which states what a folder cannot:

    model = "dvs128"         # where the fit starts
    unit = "lux"             # of the light, where its files do not say
    clock = "auto"           # auto, trigger, one (light and camera share a clock), or seconds ± error
    level_sd = 0.03          # how well levels are known, as a fraction
    roi = [120, 80, 125, 85]

    [source]                 # what files do not state: size, time_unit, columns, polarity, …
    size = "346x260"

    [[recording]]
    name = "chirp_24"
    events = "chirp_24.raw"
    light = "chirp_24_light.csv"
    level = 0.06             # what the numbers of the light are multiplied by
    clock = "trigger"
    skip = ""                # why it is left out
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pixelid.documents import is_number, read_toml
from pixelid.errors import InputError, did_you_mean, shown
from pixelid.recordings.bench import LEVEL_SD
from pixelid.recordings.reading import BINARY_SUFFIXES, TEXT_SUFFIXES
from pixelid.recordings.source import ReadingOptions

LIGHT = "_light"  # what the name of a light's file ends in
LIGHT_SUFFIXES = (".csv", ".tsv", ".npy", ".npz", ".toml")
TOML = "bench.toml"
CLOCKS = ("auto", "trigger", "one")


@dataclass(frozen=True)
class Entry:
    """One recording of a bench.

    name: of the recording;  events, light: its files, no light where the recording holds it
    level: what the numbers of its light are multiplied by;  clock: how it is aligned, "" as the bench says
    skip: why it is left out, "" where it is not
    """

    name: str
    events: Path
    light: Path | None = None
    level: float = 1.0
    clock: str = ""
    skip: str = ""


@dataclass(frozen=True)
class Bench:
    """A session on a bench, and what is stated about all of it (see the module).

    folder: that its files lie in;  stated: the bench.toml, where there is one
    """

    folder: Path
    entries: tuple[Entry, ...]
    model: str | None = None
    unit: str | None = None
    clock: str = "auto"
    level_sd: float = LEVEL_SD
    roi: tuple[int, int, int, int] | None = None
    source: ReadingOptions = field(default_factory=ReadingOptions)
    stated: Path | None = None

    @property
    def paths(self) -> list[Path]:
        """Every file that is read."""
        files = [p for e in self.entries if not e.skip for p in (e.events, e.light) if p is not None]
        return files if self.stated is None else [self.stated, *files]


def find_bench(path: str | Path) -> Bench:
    """The bench of a folder or of a bench.toml.

    Raises:
        InputError: Nothing there that could be a recording, or statements that make no sense.
    """
    path = Path(path)
    if path.is_dir() and (path / TOML).is_file():
        return read_bench(path / TOML)
    if path.suffix == ".toml":
        return read_bench(path)
    if not path.is_dir():
        raise InputError(f"{path}: expected a folder of recordings or a {TOML}, found {_what(path)}")
    return Bench(path, tuple(entries_in(path)))


def entries_in(folder: Path) -> list[Entry]:
    """The recordings of a folder with their lights, in the order of their names.

    Raises:
        InputError: None there.
    """
    every = [f for f in sorted(folder.iterdir()) if f.is_file() and not f.name.startswith(".")]
    lights = {f.stem.removesuffix(LIGHT): f for f in every if _is_light(f)}
    readable = [f for f in every if f.suffix.lower() in (*BINARY_SUFFIXES, *TEXT_SUFFIXES) and not _is_light(f)]
    # text without a light of its own is a note, where other recordings are there
    files = [f for f in readable if f.stem in lights or f.suffix.lower() in BINARY_SUFFIXES] or readable
    if not files:
        raise InputError(f"{folder}: expected recordings (NAME.raw with NAME{LIGHT}.csv), found none")
    return [Entry(f.stem, f, lights.get(f.stem)) for f in files]


def read_bench(path: Path) -> Bench:
    """The bench of a bench.toml; recordings that it does not list are those of its folder.

    Raises:
        InputError: A file that is missing, an unknown key, a value that makes no sense.
    """
    document, folder = read_toml(path), path.parent
    _known(document, ("model", "unit", "clock", "level_sd", "roi", "source", "recording"), path)
    model, unit, clock = (_text(document, key, path) for key in ("model", "unit", "clock"))
    level_sd = document.get("level_sd", LEVEL_SD)
    if not is_number(level_sd) or not 0.0 <= level_sd < 1.0:
        raise InputError(f"{path}: level_sd: expected a fraction from 0 to 1, found {shown(level_sd)}")
    tables = document.get("recording", [])
    if not isinstance(tables, list) or not all(isinstance(t, dict) for t in tables):
        raise InputError(f"{path}: [[recording]]: expected tables")
    listed = [_entry(table, folder, path) for table in tables]
    return Bench(
        folder, tuple(listed or entries_in(folder)), model, unit, _clock(clock or "auto", path), float(level_sd),
        _roi(document.get("roi"), path),
        ReadingOptions.of(_table(document.get("source", {}), path), f"{path}: [source] "), path,
    )  # fmt: skip


def write_bench(bench: Bench, path: Path) -> None:
    """Write a bench.toml with everything that a folder was taken for, to be corrected by hand."""
    import tomli_w

    from pixelid.outputs import whole_file

    head = {"model": bench.model, "unit": bench.unit, "clock": bench.clock, "level_sd": bench.level_sd}
    document: dict[str, Any] = {key: value for key, value in head.items() if value is not None}
    if bench.roi is not None:
        document["roi"] = list(bench.roi)
    if bench.source.as_dict():
        document["source"] = _plain(bench.source)
    document["recording"] = [_as_table(entry, bench.folder) for entry in bench.entries]
    with whole_file(path) as temporary:
        temporary.write_text(tomli_w.dumps(document), encoding="utf-8")


def _plain(options: ReadingOptions) -> dict[str, Any]:
    return {key: list(value) if isinstance(value, tuple) else value for key, value in options.as_dict().items()}


def _as_table(entry: Entry, folder: Path) -> dict[str, Any]:
    def relative(p: Path) -> str:
        return str(p.relative_to(folder)) if p.is_relative_to(folder) else str(p)

    table: dict[str, Any] = {"name": entry.name, "events": relative(entry.events)}
    if entry.light is not None:
        table["light"] = relative(entry.light)
    table["level"] = entry.level
    return table | {key: value for key, value in (("clock", entry.clock), ("skip", entry.skip)) if value}


def _entry(table: Mapping[str, Any], folder: Path, path: Path) -> Entry:
    _known(table, ("name", "events", "light", "level", "clock", "skip"), path)
    name, events, light = (_text(table, key, path) for key in ("name", "events", "light"))
    if events is None:
        raise InputError(f"{path}: [[recording]] {name or ''}: events: missing, the file of the recording")
    files = [folder / events, *([folder / light] if light else [])]
    for file in files:
        if not file.exists():
            raise InputError(f"{path}: [[recording]] {file}: no such file")
    level = table.get("level", 1.0)
    if not is_number(level) or not 0.0 < level < np.inf:
        raise InputError(f"{path}: [[recording]] {events}: level: expected a positive number, found {shown(level)}")
    clock = _text(table, "clock", path) or ""
    own = folder / light if light else _light_of(folder / events)
    skip = _text(table, "skip", path) or ""
    return Entry(name or Path(events).stem, folder / events, own, float(level), _clock(clock, path), skip)


def _light_of(events: Path) -> Path | None:
    names = (events.with_name(f"{events.stem}{LIGHT}{suffix}") for suffix in LIGHT_SUFFIXES)
    return next((name for name in names if name.is_file()), None)


def _clock(clock: str, path: Path) -> str:
    first = clock.replace("+-", "±").split("±")[0].split(":")[0]
    try:
        known = not clock or first in CLOCKS or np.isfinite(float(first))
    except ValueError:
        known = False
    if not known:
        expected = f"{', '.join(CLOCKS)} or seconds ± error"
        raise InputError(f"{path}: clock: expected {expected}, found {clock!r}{did_you_mean(clock, CLOCKS)}")
    return clock


def _roi(value: Any, path: Path) -> tuple[int, int, int, int] | None:
    if value is None:
        return None
    if not isinstance(value, list) or len(value) != 4 or not all(isinstance(v, int) for v in value):
        raise InputError(f"{path}: roi: expected [x0, y0, x1, y1], found {shown(value)}")
    return value[0], value[1], value[2], value[3]


def _table(value: Any, path: Path) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise InputError(f"{path}: [source]: expected a table, found {shown(value)}")
    return value


def _text(table: Mapping[str, Any], key: str, path: Path) -> str | None:
    value = table.get(key)
    if value is not None and not isinstance(value, str):
        raise InputError(f"{path}: {key}: expected text, found {shown(value)}")
    return value


def _known(table: Mapping[str, Any], keys: Sequence[str], path: Path) -> None:
    for key in table:
        if key not in keys:
            raise InputError(f"{path}: unknown key {key!r}; known: {', '.join(keys)}{did_you_mean(key, keys)}")


def _is_light(file: Path) -> bool:
    return file.stem.endswith(LIGHT) and file.suffix in LIGHT_SUFFIXES


def _what(path: Path) -> str:
    return "a file" if path.exists() else "nothing there"
