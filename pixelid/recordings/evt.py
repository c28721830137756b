"""Prophesee's EVT 2.0, 2.1 and 3.0: little-endian words of 32, 64 and 16 bits (docs.prophesee.ai, "Data Encoding
Formats"); and DAT.

EVT 2.0, from the highest bit: type (4), then for events (0 OFF, 1 ON) the low 6 bits of the time [µs], column (11) and
row (11).  Type 8 carries the high 28 bits of the time; type 10 an edge at a trigger input: low 6 bits of the time,
input in bits 8–12, rising in bit 0.

EVT 2.1 has the same in the high half of its words; of events the column is that of the first of 32 neighbours, which a
bit each of the low half are set for.  Some sensors (IMX636; `endianness=legacy` in the header, where it is stated) send
the high half of each word first, others (GenX320) the low half.

EVT 3.0 says only what changes: type (4), then 12 bits: row (0), one event's polarity and column (2), polarity and first
column of vectors (3), a vector of 12 or 8 pixels (4, 5), which moves that column on, low and high 12 bits of the time
(6, 8), an edge at a trigger input (10: input in bits 8–11, rising in bit 0).

The clocks roll over.  A fall of the high part by more than half its range is a rollover; any smaller one stays a fall,
which the check of the times refuses.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numba import njit

from pixelid.errors import InputError
from pixelid.recordings.columns import Rollovers, word_pairs
from pixelid.recordings.raw import Block
from pixelid.recordings.triggers import Triggers

WORDS_AT_ONCE = 1 << 18  # up to 32 events each
UNKNOWN = -1
STATE = 6  # high part with rollovers, low part, row, first column of vectors, their polarity, rollovers
TIME_HIGH = 8  # type of words
DAT_KINDS = (0x00, 0x0C)  # of events of pixels


def decode(file: BinaryIO, version: str, named: Path, swapped: bool | None = None) -> Iterator[Block]:
    """Blocks of events, times in µs, with trigger edges; what comes before the first time is left out.

    Args:
        file: open where its words begin.
        version: of `FORMATS`.
        named: whom errors name.
        swapped: of EVT 2.1, whether the high half of each word comes first; None: the first words show it.

    Raises:
        InputError: the file ends within a word, or holds words of unknown meaning only.
    """
    form, start = FORMATS[version], file.tell()
    if left := (file.seek(0, io.SEEK_END) - start) % form.size:
        raise InputError(f"{named}: expected words of {form.size} bytes after the header, found {left} bytes left over")
    file.seek(start)
    state, seen, known = np.full(STATE, UNKNOWN, np.int64), 0, 0
    state[STATE - 1] = 0
    while len(data := file.read(form.size * WORDS_AT_ONCE)):
        words = np.frombuffer(data, f"<u{form.size}")
        if form.halves:
            other = (words << np.uint64(32)) | (words >> np.uint64(32))
            swapped = _times(other) > _times(words) if swapped is None else swapped
            words = other if swapped else words
        kinds = (words >> words.dtype.type(8 * form.size - 4)).astype(np.uint8)
        known += int(np.isin(kinds, form.known).sum())
        seen += len(words)
        if form.size == 4:  # as words of 2.1, each of one pixel
            words = words.astype(np.uint64) << np.uint64(32) | np.uint64(1)
        t, x, y = np.empty((3, form.most * len(words)), np.int64)
        p = np.empty(len(t), np.uint8)
        edges = np.empty((3, len(words)), np.int64)
        events, count = form.read(words, state, 1 << form.high_bits, t, x, y, p, edges)
        found = None
        if count:
            when, channel, rising = edges[:, :count]
            where = f"{named}: triggers"
            found = Triggers.from_columns(when * 1000, rising, channel.astype(np.uint8), where=where)
        yield Block.of((column[:events].copy() for column in (t, x, y, p)), found)
    if seen and not known:
        raise InputError(f"{named}: expected words of EVT {version}, found none in {seen}")


def decode_dat(path: Path, start: int) -> Iterator[Block]:
    """Blocks of a DAT file of version 2: 8 bytes per event after a byte each for the kind of event and its size.

    Time [µs], which rolls over after 71 minutes, then from the lowest bit column (14), row (14) and polarity (4)
    (docs.prophesee.ai, "DAT File Format").

    Args:
        path: the file.
        start: byte after the header's lines.

    Raises:
        InputError: other kinds of events, or a file that ends within one.
    """
    with path.open("rb") as file:
        file.seek(start)
        kind = file.read(2)
    if len(kind) < 2 or kind[0] not in DAT_KINDS or kind[1] != 8:
        raise InputError(f"{path}: expected events of 8 bytes, kind 12, after the header, found {list(kind)}")
    clock = Rollovers(1 << 32)
    for words in word_pairs(path, start + 2, "<u4"):
        address = words[:, 1]
        yield Block(clock.undone(words[:, 0]), address & 0x3FFF, address >> 14 & 0x3FFF, address >> 28)


def _times(words: np.ndarray) -> int:
    """How many words of EVT 2.1 carry a time and nothing else: read the wrong way round they look like events."""
    return int(np.count_nonzero((words >> np.uint64(60) == TIME_HIGH) & (words & np.uint64(0xFFFFFFFF) == 0)))


@njit(cache=True, nogil=True)
def _unrolled(high, state, span):
    """Keep the high part of the time in the state, its clock's rollovers undone."""
    if state[0] >= 0 and high + state[5] * span < state[0] - span // 2:
        state[5] += 1
    state[0] = high + state[5] * span


@njit(cache=True, nogil=True)
def _evt2(words, state, span, t, x, y, p, edges):
    """Fill the columns and edges (time, input, rising); returns how many of each."""
    n = m = 0
    for word in words:
        high, mask = np.int64(word >> np.uint64(32)), np.int64(word & np.uint64(0xFFFFFFFF))
        kind = high >> 28
        if kind == 0x8:
            _unrolled(high & 0xFFFFFFF, state, span)
        elif state[0] >= 0 and kind <= 0x1:
            bit = 0
            while mask >> bit:
                if (mask >> bit) & 1:
                    t[n] = (state[0] << 6) | ((high >> 22) & 0x3F)
                    x[n], y[n], p[n] = ((high >> 11) & 0x7FF) + bit, high & 0x7FF, kind
                    n += 1
                bit += 1
        elif state[0] >= 0 and kind == 0xA:
            edges[0, m] = (state[0] << 6) | ((high >> 22) & 0x3F)
            edges[1, m], edges[2, m] = (high >> 8) & 0x1F, high & 1
            m += 1
    return n, m


@njit(cache=True, nogil=True)
def _evt3(words, state, span, t, x, y, p, edges):
    """Fill the columns and edges (time, input, rising); returns how many of each."""
    n = m = 0
    for word in words:
        kind, rest = word >> 12, np.int64(word & 0xFFF)
        if kind == 0x8:
            before = state[0]
            _unrolled(rest, state, span)
            if state[0] != before:
                state[1] = 0  # until a low part says more
            continue
        if kind == 0x6:
            state[1] = rest
        elif kind == 0x0:
            state[2] = rest & 0x7FF
        elif kind == 0x3:
            state[3], state[4] = rest & 0x7FF, rest >> 11
        if state[0] < 0:
            continue
        now = (state[0] << 12) | max(state[1], 0)
        if kind == 0x2 and state[2] >= 0:
            t[n], x[n], y[n], p[n] = now, rest & 0x7FF, state[2], rest >> 11
            n += 1
        elif kind == 0x4 or kind == 0x5:
            width = 12 if kind == 0x4 else 8
            if state[2] >= 0 and state[3] >= 0:
                for bit in range(width):
                    if (rest >> bit) & 1:
                        t[n], x[n], y[n], p[n] = now, state[3] + bit, state[2], state[4]
                        n += 1
            state[3] += width if state[3] >= 0 else 0
        elif kind == 0xA:
            edges[0, m], edges[1, m], edges[2, m] = now, rest >> 8, rest & 1
            m += 1
    return n, m


@dataclass(frozen=True)
class _Format:
    """size: bytes of a word;  high_bits: of the time, after which its high part rolls over;  known: types of words
    most: events in a word;  halves: whether the halves of a word may be exchanged"""

    size: int
    high_bits: int
    known: tuple[int, ...]
    read: Callable
    most: int
    halves: bool = False


FORMATS = {
    "2.0": _Format(4, 28, (0x0, 0x1, 0x8, 0xA), _evt2, 1),
    "2.1": _Format(8, 28, (0x0, 0x1, 0x8, 0xA), _evt2, 32, halves=True),
    "3.0": _Format(2, 12, (0x0, 0x2, 0x3, 0x4, 0x5, 0x6, 0x8, 0xA), _evt3, 12),
}
