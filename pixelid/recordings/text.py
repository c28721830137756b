"""Recordings as text: one event per line, in the dialects that programs write.

Cells are apart by spaces, commas, semicolons or tabs; numbers may have decimal commas, in quotes where commas are the
mark.  Lines that begin with `#`, `%` or `//` are comments, of which the last before the numbers may name the columns
(`# x y t[ms] p`), and any may state the sensor's size or name (`%geometry:1280,720`, `# DAVIS346`) and the unit of the
times.  A line of names may say the order of the columns and the unit of the times (`t_us`, `timestamp [ns]`), a line
of units may follow it; a first line of two numbers is E2VID's width and height.  Everything else is inferred
(`rules`).  The project's own files carry a line `# {JSON}` with everything else, and the
stimulus in `# stimulus {JSON}`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from pixelid.delimited import COMMENTS, DECIMAL_COMMA, HEAD_BYTES, NO_ROW, NUMBER, SPACES, cells_of, encoding_of
from pixelid.errors import InputError, first_line, shown
from pixelid.recordings import metadata
from pixelid.recordings.damage import refusing
from pixelid.recordings.events import Events
from pixelid.recordings.parts import LongRecording, as_long
from pixelid.recordings.raw import Block, RawEvents
from pixelid.recordings.recording import Recording
from pixelid.recordings.rules import ROWS, infer_order, named_columns, numbers_of_words
from pixelid.recordings.source import ReadingOptions, size_of_chip
from pixelid.stimuli.pixel_lights import PixelLights
from pixelid.time_units import UNIT_OF, plain, unit_in

LINES_AT_ONCE, LINES_READ = 1 << 19, 1 << 12
SIZE = re.compile(r"(?:geometry|size|resolution|sensor)\W+(\d{1,5})\s*[x×, ;]\s*(\d{1,5})", re.I)
SIDES = re.compile(r"\b(?:(width)|(height)|(W)|(H))\W{1,3}(\d{1,5})\b", re.I)
BINARY = ("expected text, found binary data", UnicodeError)
BRACKETS = str.maketrans("[]()", "    ")  # of rows that are written as Python shows them


@dataclass
class _Header:
    """What stands before the numbers, and how cells are apart."""

    meta: dict[str, Any] = field(default_factory=dict)
    light: dict[str, np.ndarray] | None = None
    names: list[str] | None = None
    title: str = ""
    unit: str | None = None
    chip: tuple[tuple[tuple[int, int], str], ...] = ()
    size: tuple[int | None, int | None] = (None, None)
    lines: int = 0
    worded: int = 0
    first: str | None = None
    mark: str = SPACES
    decimal: str = "."
    encoding: str = "utf-8-sig"


def opened(path: Path, options: ReadingOptions) -> RawEvents:
    """What a text file holds; raises InputError for lines that are not numbers."""
    where = f"{path}: events"
    with refusing(path, *BINARY):
        header = _header(path)
        sample = next(_frames(path, header, where, ROWS), None)
    most_names = 2  # lines: names of columns, and their units
    if sample is None and header.worded > most_names:
        raise InputError(f"{where}: expected lines of numbers, t x y p, found {shown(header.title, 60)}")
    order, unit, inferred = _order(sample, header, options, where)
    unit = unit or header.meta.get("unit") or header.unit

    def blocks() -> Iterator[Block]:
        with refusing(path, *BINARY):
            for columns in _frames(path, header, where, LINES_AT_ONCE):
                yield Block.of(columns[k] for k in order)

    head = metadata.assemble(header.meta, Events.empty(1, 1), header.light, path, str(path))
    return RawEvents(head, blocks, where, unit, header.meta.get("tick_ns"), size=header.size, likely_sizes=header.chip,
                     inferred=inferred, polarity="01" if header.meta else None)  # fmt: skip


def _header(path: Path) -> _Header:
    """What stands before the first line of numbers."""
    with path.open("rb") as file:
        header = _Header(encoding=encoding_of(file.read(HEAD_BYTES)))
    comment = ""
    with path.open(encoding=header.encoding) as file:
        for line in file:
            text = line.strip()
            if text.startswith("# {"):
                header.meta = metadata.from_json(text[2:], f"{path}: header")
                header.size = header.meta["width"], header.meta["height"]
            elif text.startswith("# stimulus {"):
                header.light = _light(text[len("# stimulus ") :], f"{path}: stimulus")
            elif text.startswith(COMMENTS):
                comment = text.lstrip("#%/ \t")
                _note(header, comment)
                if named_columns(names := cells_of(comment.rpartition(":")[2].strip())[0])[0] is not None:
                    header.names = names
            elif text:
                cells, mark = cells_of(text.translate(BRACKETS).strip() if text[0] in "[(" else text)
                numbers = sum(NUMBER.fullmatch(cell) is not None for cell in cells)
                if not numbers or (header.names is not None and any(_units(cells))):
                    header.title = header.title or text  # comes again where files are joined
                    header.worded += 1
                    _note_names(header, cells if cells[-1] else cells[:-1])
                elif len(cells) < len("txyp") and not NUMBER.fullmatch(cells[0]):  # width: 640
                    _note(header, text)
                elif len(cells) == 2 and header.names is None and all(map(str.isdecimal, cells)):
                    header.size = int(cells[0]), int(cells[1])
                else:
                    header.first, header.mark = text, mark
                    if any(DECIMAL_COMMA.fullmatch(cell) for cell in cells):
                        header.decimal = ","
                    return header
            header.lines += 1
    return header


def _note(header: _Header, comment: str) -> None:
    """What a comment states of the sensor and of the times."""
    header.unit = header.unit or unit_in(comment)
    if header.size == (None, None) and (found := SIZE.search(comment)):
        header.size = int(found[1]), int(found[2])
    for *sides, number in SIDES.findall(comment):
        k = 0 if sides[0] or sides[2] else 1
        header.size = tuple(int(number) if i == k else old for i, old in enumerate(header.size))  # type: ignore[assignment]
    for word in re.findall(r"[A-Za-z][\w-]{4,}", comment):
        if (size := size_of_chip(word)) is not None:
            header.chip = ((size, f" of the sensor ({word[:20]})"),)


def _note_names(header: _Header, cells: list[str]) -> None:
    """Names of columns, or the units of those that are named in the line before."""
    units = _units(cells)
    if header.names is not None and len(cells) <= len(header.names) and any(units):
        units += [None] * (len(header.names) - len(cells))
        header.names = [f"{name} [{unit}]" if unit else name for name, unit in zip(header.names, units, strict=True)]
        return
    header.names = cells
    sides = {cell[0]: int(cell[2:]) for cell in cells if re.fullmatch(r"[xy]@\d{1,5}", cell)}
    if len(sides) == 2:
        header.size = sides["x"], sides["y"]


def _units(cells: list[str]) -> list[str | None]:
    """The unit of time that each cell is."""
    return [UNIT_OF.get(plain(cell).strip("[]()")) for cell in cells]


def _order(sample, header: _Header, options: ReadingOptions, where: str):
    """Places of t, x, y, p; the unit that a name states; what was inferred."""
    if header.names is not None or options.columns:
        names = header.names or [str(k) for k in range(len(sample or ()))]
        order, unit = named_columns(names, options.columns)
        if order is None:
            raise InputError(
                f"{where}: header: expected columns t, x, y, p (with its unit: t_us, t [s]), found "
                f"{', '.join(names)[:80]}; state them: --columns t,x,y,p or t=NAME,…"
            )
        if sample is not None and max(order) >= len(sample):
            found = f"{len(sample)} in event 0"
            raise InputError(f"{where}: expected {max(order) + 1} numbers a line at least, found {found}")
        if sample is not None and header.names and len(sample) != len(names) and not options.columns:
            raise InputError(
                f"{where}: header: names {len(names)} columns, found {len(sample)}; state them: --columns t,x,y,p"
            )
        return order, unit, ()
    if sample is None:
        return [0, 1, 2, 3], None, ()
    order, inferred = infer_order(sample, where, options.size or header.size)
    return order, None, (("columns", inferred),)


def _frames(path: Path, header: _Header, where: str, rows: int) -> Iterator[list[np.ndarray]]:
    """Columns of numbers of successive lines, so many at once."""
    import pandas

    if header.first is None:
        return
    done = 0
    try:
        with path.open(encoding=header.encoding) as file:
            lines = (line for line in islice(file, header.lines, None) if not NO_ROW.match(line))
            lines = (line for line in lines if line.strip() != header.title)
            if header.first[0] in "[(":
                lines = (line.translate(BRACKETS).strip() + "\n" for line in lines)
            source: Any = _Lines(lines)
            with pandas.read_csv(
                source, sep=header.mark, header=None, decimal=header.decimal, chunksize=rows,
                float_precision="round_trip", skipinitialspace=True, na_filter=False, low_memory=False,
            ) as frames:  # fmt: skip
                for frame in frames:
                    columns = [numbers_of_words(frame[name].to_numpy()) for name in frame]
                    for k, column in enumerate(columns):
                        if column.dtype.kind not in "iufb":
                            columns[k] = _numbers(column, f"{where}: column {k}", done)
                    if columns[-1].dtype.kind == "U" and not np.any(columns[-1] != ""):
                        columns.pop()  # behind a mark that ends every line
                    yield columns
                    done += len(frame)
    except (ValueError, OverflowError, pandas.errors.ParserError) as error:
        if isinstance(error, UnicodeError):
            raise
        reason = first_line(error)
        raise InputError(
            f"{where}: expected lines of t x y p after event {done}, found: {reason}; remove or correct that line"
        ) from error


def _numbers(column: np.ndarray, where: str, before: int) -> np.ndarray:
    """A column that is no plain numbers: of words that are none anywhere it stays as it is, and is refused if read."""
    words = [str(word) for word in column[:1]]
    if not NUMBER.fullmatch(words[0]):
        return column.astype("U")
    for k, word in enumerate(column):
        if not isinstance(word, int | float) and not (NUMBER.fullmatch(str(word)) and str(word).lower() != "nan"):
            raise ValueError(f"{shown(word, 30)} in event {before + k}")
    raise ValueError(f"numbers that fit no column of 64 bits in {where}")


class _Lines:
    """Lines as a file that pandas reads."""

    def __init__(self, lines: Iterator[str]) -> None:
        self._lines = lines

    def __iter__(self) -> Iterator[str]:
        return self._lines

    def read(self, _: int = -1) -> str:
        """Some lines, until there are none."""
        return "".join(islice(self._lines, LINES_READ))


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


def write(recording: Recording | LongRecording, path: Path) -> None:
    """Write `recording` as text, t in nanoseconds; a per-pixel stimulus is refused (use .h5 or .npz)."""
    long = as_long(recording)
    stimulus = long.head.stimulus
    if stimulus is not None and (isinstance(stimulus, PixelLights) or not stimulus.full_field):
        raise InputError(f"{path.name}: text holds no per-pixel stimulus; write .h5 or .npz")
    separator = "," if path.suffix.lower() == ".csv" else " "
    with path.open("w", encoding="utf-8") as file:
        file.write(f"# {metadata.to_json(long.head)}\n")
        if stimulus is not None:
            told = {"t": stimulus.t.tolist(), "radiance": stimulus.radiance.tolist()}
            file.write(f"# stimulus {json.dumps(told | {'dtype': stimulus.radiance.dtype.name})}\n")
        file.write(separator.join("txyp") + "\n")
        for part in long.read():
            rows = zip(*(getattr(part.events, letter).tolist() for letter in "txyp"), strict=True)
            file.writelines(f"{t}{separator}{x}{separator}{y}{separator}{p}\n" for t, x, y, p in rows)
