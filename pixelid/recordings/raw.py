"""From a file's raw columns to a recording: what is stated, else what the rules infer, once for every format.

A reader finds the columns and says what the file states of them (`RawEvents`).  `interpreted` settles unit, size,
polarity and clock, reading the columns once before where that takes a look at all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from pixelid.errors import InputError
from pixelid.recordings.columns import PART_EVENTS, RepeatCounter, floats_to_ns, last_decimal_ns, to_nanoseconds
from pixelid.recordings.events import NS_PER_UNIT, Events
from pixelid.recordings.parts import WHOLE_EVENTS, joined
from pixelid.recordings.recording import Recording
from pixelid.recordings.rules import Statistics, decoded_polarity, infer_polarity, infer_unit
from pixelid.recordings.source import EMPTY, LARGEST, OPTION, SENSOR_SIZES, ReadingOptions, Source, size_of_chip
from pixelid.recordings.triggers import Triggers

WAYS = {
    "negative": "; add so much to the times of events and light alike",
    "fall": f"; sort them, or read one stretch: {OPTION['clock']}",
    "outside": f"; another size or order of columns may be stated: {OPTION['size']}, {OPTION['columns']}",
}


class Block(NamedTuple):
    """Columns of successive events as the file has them, and trigger edges among them."""

    t: np.ndarray
    x: np.ndarray
    y: np.ndarray
    p: np.ndarray
    triggers: Triggers | None = None

    @classmethod
    def of(cls, columns: Iterable[np.ndarray], triggers: Triggers | None = None) -> Block:
        """Of the four columns together."""
        t, x, y, p = columns
        return cls(t, x, y, p, triggers)


@dataclass(frozen=True)
class RawEvents:
    """What a file holds and states of its events.

    Attributes:
        head: the recording without events.
        blocks: makes an iterator over the columns, each time from the beginning.
        where: names file and place in errors.
        unit: of the times; None: not stated.
        tick_ns: unit in which the source counted; None: that of the times.
        offset: added to the times, in their unit.
        size: (width, height), None each where it is not stated.
        likely_sizes: what other things than the header suggest, and why; the first that holds all events is taken.
        polarity: "01" where the format says so.
        from_one: whether addresses of the format count from one, unless one of them is zero.
        inferred, notes, streams: of `Source`, settled by the reader.
        duplicates: how many events the file declares to repeat an earlier one; None: any number may.
        exposures: exposure measurements of an ATIS.
        close: lets go of the file.
    """

    head: Recording
    blocks: Callable[[], Iterator[Block]]
    where: str
    unit: str | None = None
    tick_ns: int | None = None
    offset: int = 0
    size: tuple[int | None, int | None] = (None, None)
    likely_sizes: tuple[tuple[tuple[int, int], str], ...] = ()
    polarity: str | None = None
    from_one: bool = False
    inferred: tuple[tuple[str, tuple[Any, str]], ...] = ()
    notes: tuple[str, ...] = ()
    streams: tuple[str, ...] = ()
    duplicates: int | None = None
    exposures: RawEvents | None = None
    close: Callable[[], object] = lambda: None


def interpreted(raw: RawEvents, options: ReadingOptions) -> tuple[Recording, Iterator[Recording]]:
    """The recording without events, and its parts.

    Raises:
        InputError: columns that are no events, two readings that matter; also while the parts are taken.
    """
    stated, inferred, notes = options.as_dict(), dict(raw.inferred), list(raw.notes)
    clock = options.clock or "strict"
    size = options.size or (size_of_chip(options.chip) if options.chip else None) or raw.size
    unit, code = options.time_unit or raw.unit, options.polarity or raw.polarity
    statistics, blocks, widest = Statistics(), raw.blocks, (0, 0)
    if None in (*size, unit, code, raw.tick_ns) or clock != "strict":
        statistics, blocks = _looked_at(raw)
        widest = statistics.side
        if raw.exposures is not None:
            other = _looked_at(raw.exposures)[0].side
            widest = max(widest[0], other[0]), max(widest[1], other[1])
    first = _first_address(statistics, size, raw)
    widest = widest[0] - first, widest[1] - first
    if None in size:
        size = _settled_size(size, widest, raw, inferred)
    if first:
        notes.append("addresses counted from one")
    elif statistics.least == (1, 1) and raw.size == (None, None) and not options.size:
        notes.append(f"addresses begin at 1: if they count from one, state it: {OPTION['size']}")
    if unit is not None and unit not in NS_PER_UNIT:
        raise InputError(f"{raw.where}/t: expected unit {' or '.join(NS_PER_UNIT)}, found {unit!r}")
    if unit is None:
        unit, why = infer_unit(statistics, raw.where)
        inferred |= {"time_unit": (unit, why)} if statistics.events else {}
    if code is None:
        code = infer_polarity(statistics.codes, raw.where)
        if code == "pm1":
            inferred["polarity"] = (code, ": −1 is OFF")
    settled = _Settled(raw, unit, (int(size[0] or 1), int(size[1] or 1)), code, first)
    stretch, sorts = None, bool(clock == "sort" and statistics.fall_count)
    if clock.startswith("split") and statistics.fall_count:
        stretch, inferred["clock"] = _stretch(statistics, clock, raw.where)
    if sorts:
        notes.append(f"sorted by time: {statistics.fall_count} events were earlier than the one before")
    attributes = Source(stated, inferred, tuple(notes), raw.streams).kept_in(raw.head.attributes)
    counted = not statistics.floating or ("time_unit" in inferred and statistics.whole)
    tick_ns = raw.tick_ns or (NS_PER_UNIT[unit] if counted else last_decimal_ns(statistics.spacing, unit))
    exposures = None
    if raw.exposures is not None:
        exposures = joined(*interpreted(raw.exposures, replace(options, size=settled.size, clock=None))).events
    head = replace(
        raw.head,
        events=Events.empty(*settled.size, tick_ns, raw.where),
        attributes=attributes,
        exposures=exposures,
    )
    columns = _sorted(settled, blocks) if sorts else _of_stretch(settled, blocks, stretch)
    return replace(head, triggers=None), _parts(head, columns, raw)


def _looked_at(raw: RawEvents) -> tuple[Statistics, Callable[[], Iterator[Block]]]:
    """The statistics of all events, and the columns: from memory, where they are few enough."""
    statistics, kept = Statistics(), []
    for block in raw.blocks():
        t, x, y, p = (np.asarray(column) for column in block[:4])
        statistics.add(t, x, y, p, raw.where)
        if kept is not None:
            kept = [*kept, block] if statistics.events <= WHOLE_EVENTS else None
    return statistics, raw.blocks if kept is None else lambda: iter(kept)


def _settled_size(
    size: tuple[int | None, int | None], widest: tuple[int, int], raw: RawEvents, inferred: dict
) -> tuple[int, int]:
    """The stated sides, else a likely size that holds every event, else the smallest that does."""
    for likely, why in raw.likely_sizes if size == (None, None) else ():
        if widest[0] <= likely[0] and widest[1] <= likely[1]:
            inferred["size"] = (likely, why)
            return likely
    settled = (size[0] or max(widest[0], 1), size[1] or max(widest[1], 1))
    inferred["size"] = (settled, LARGEST if widest != (0, 0) else EMPTY)
    return settled


def _first_address(s: Statistics, size: tuple[int | None, int | None], raw: RawEvents) -> int:
    """1 where addresses count from one: none is zero, and the format does so or the last is as large as the sensor."""
    if min(s.least) < 1 or not s.events:
        return 0
    last, (width, height) = (s.side[0] - 1, s.side[1] - 1), size
    if width is None or height is None:
        sizes = {*(SENSOR_SIZES.values() if s.least == (1, 1) else ()), *(likely for likely, _ in raw.likely_sizes)}
        return int(raw.from_one or last in sizes)
    reaches = last[0] == width or last[1] == height
    return int(raw.from_one or (reaches and last[0] <= width and last[1] <= height))


def _stretch(s: Statistics, clock: str, where: str) -> tuple[tuple[int, int], tuple[str, str]]:
    """First and last event of the stretch that is asked for; its number, and what to say of it."""
    count, number = s.fall_count + 1, int(clock.partition(":")[2] or 1)
    most_stretches = 100
    if count > most_stretches:
        raise InputError(f"{where}/t: the clock goes back {s.fall_count} times: too often to split; --clock sort")
    if number > count:
        raise InputError(
            f"{where}/t: --clock {clock}: the clock goes back {s.fall_count} times, there are {count} stretches"
        )
    edges = [0, *s.falls, s.events]
    begin, end = edges[number - 1], edges[number]
    return (begin, end), (f"{number}/{count}", f" (events {begin} to {end - 1}); --clock split:K reads another")


@dataclass(frozen=True)
class _Settled:
    """How the columns of a file are read."""

    raw: RawEvents
    unit: str
    size: tuple[int, int]
    code: str
    first: int = 0

    def columns(self, block: Block) -> tuple[np.ndarray, ...]:
        """(t ns, x, y, p)."""
        where = self.raw.where
        t, x, y, p = (np.asarray(column) for column in block[:4])
        if t.dtype.kind == "f":
            t = floats_to_ns(t, self.unit, where) + self.raw.offset * NS_PER_UNIT[self.unit]
        else:
            t = to_nanoseconds(t, self.unit, where, self.raw.offset)
        p = decoded_polarity(p.astype(np.uint8) if p.dtype.kind == "b" else p, self.code, where)
        x, y = _whole(x, f"{where}/x"), _whole(y, f"{where}/y")
        return (t, x.astype(np.int64) - 1, y.astype(np.int64) - 1, p) if self.first else (t, x, y, p)


def _whole(column: np.ndarray, where: str) -> np.ndarray:
    """Whole numbers that are written as floating ones."""
    if column.dtype.kind != "f":
        return column
    if not np.all(np.isfinite(column) & (column == np.rint(column)) & (np.abs(column) < 2**53)):
        found = column[column != np.rint(column)][:1].tolist() or "NaN"
        raise InputError(f"{where}: expected integers, found {found}; write whole pixels, counted from 0")
    return column.astype(np.int64)


def _of_stretch(settled: _Settled, blocks, stretch: tuple[int, int] | None) -> Iterator[Block]:
    """Columns of the file, or of a stretch of its events."""
    seen = 0
    for block in blocks():
        columns = settled.columns(block)
        if stretch is not None:
            part = slice(max(stretch[0] - seen, 0), max(stretch[1] - seen, 0))
            columns = tuple(column[part] for column in columns)
        seen += len(block.t)
        yield Block.of(columns, block.triggers)


def _sorted(settled: _Settled, blocks) -> Iterator[Block]:
    """Columns of the whole file in the order of their times."""
    every = [Block.of(settled.columns(block), block.triggers) for block in blocks()]
    columns = [np.concatenate([getattr(block, name) for block in every]) for name in "txyp"]
    order = np.argsort(columns[0], kind="stable")
    columns = [column[order] for column in columns]
    edges = Triggers.joined(block.triggers for block in every)
    for k in range(0, len(order), PART_EVENTS):
        yield Block.of((column[k : k + PART_EVENTS] for column in columns), edges if k == 0 else None)


def _parts(head: Recording, columns: Iterator[Block], raw: RawEvents) -> Iterator[Recording]:
    """Validated parts of the recording, with the edges among them."""
    before, last_ns, repeats, counter, edges = 0, 0, 0, RepeatCounter(), head.triggers
    size, tick_ns, where = (head.events.width, head.events.height), head.events.tick_ns, raw.where
    for t, x, y, p, triggers in columns:
        events = Events.from_columns(
            t, x, y, p, *size, tick_ns=tick_ns, where=where, before=before, not_before_ns=last_ns, ways=WAYS
        )
        before += len(events)
        last_ns = int(events.t[-1]) if len(events) else last_ns
        if raw.duplicates is not None:
            repeats += counter.add(events)
            if repeats > raw.duplicates:
                raise InputError(f"{where}: expected each event once, found duplicates, the first of them at or before "
                                 f"t = {last_ns} ns")  # fmt: skip
        yield replace(head, events=events, triggers=Triggers.joined([edges, triggers]))
        edges = None
    if edges is not None:
        yield replace(head, triggers=edges)
