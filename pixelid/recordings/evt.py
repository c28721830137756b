"""Prophesee's EVT 2.0 and 3.0: words of 32 and of 16 bits, little-endian (docs.prophesee.ai, "Data Encoding Formats").

EVT 2.0, from the highest bit: type (4), then for events (0 OFF, 1 ON) the low 6 bits of the time [µs], column (11) and
row (11).  Type 8 carries the high 28 bits of the time; type 10 an edge at a trigger input: low 6 bits of the time,
input in bits 8–12, rising in bit 0.

EVT 3.0 says only what changes: type (4), then 12 bits: row (0), one event's polarity and column (2), polarity and first
column of vectors (3), a vector of 12 or 8 pixels (4, 5), which moves that column on, low and high 12 bits of the time
(6, 8), an edge at a trigger input (10: input in bits 8–11, rising in bit 0).

Both clocks roll over.  A fall of the high part by more than half its range is a rollover; any smaller one stays a fall,
which the check of the times refuses.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numba import njit

from pixelid.errors import InputError
from pixelid.recordings.triggers import Triggers

WORDS_AT_ONCE = 1 << 20
HIGH_BITS = {2: 28, 3: 12}  # of the time, after which the high part rolls over
KNOWN = {2: (0x0, 0x1, 0x8, 0xA), 3: (0x0, 0x2, 0x3, 0x4, 0x5, 0x6, 0x8, 0xA)}
UNKNOWN = -1
STATE = 6  # high part with rollovers, low part, row, first column of vectors, their polarity, rollovers


def decode(path: Path, start: int, version: int, named: Path) -> Iterator[tuple[tuple, Triggers | None]]:
    """Blocks of ((t µs, x, y, p), trigger edges or None); what comes before the first time is left out.

    Args:
        path: the file.
        start: byte at which its words begin.
        version: 2 or 3.
        named: whom errors name.

    Raises:
        InputError: the file ends within a word, or holds words of unknown meaning only.
    """
    size = 4 if version == 2 else 2
    if left := (path.stat().st_size - start) % size:
        raise InputError(f"{named}: expected words of {size} bytes after the header, found {left} bytes left over")
    read: Callable = _evt2 if version == 2 else _evt3
    state, seen, known, shift = np.full(STATE, UNKNOWN, np.int64), 0, 0, 28 if version == 2 else 12
    state[STATE - 1] = 0
    with path.open("rb") as file:
        file.seek(start)
        while len(data := file.read(size * WORDS_AT_ONCE)):
            words = np.frombuffer(data, f"<u{size}")
            known += int(np.isin((words >> words.dtype.type(shift)).astype(np.uint8), KNOWN[version]).sum())
            seen += len(words)
            most = len(words) if version == 2 else _most(words)
            t, x, y = np.empty((3, most), np.int64)
            p = np.empty(most, np.uint8)
            edges = np.empty((3, len(words)), np.int64)
            events, count = read(words, state, 1 << HIGH_BITS[version], t, x, y, p, edges)
            found = None
            if count:
                when, channel, rising = edges[:, :count]
                where = f"{named}: triggers"
                found = Triggers.from_columns(when * 1000, rising, channel.astype(np.uint8), where=where)
            yield (t[:events], x[:events], y[:events], p[:events]), found
    if seen and not known:
        raise InputError(f"{named}: expected words of EVT {version}.0, found none in {seen}")


def _most(words: np.ndarray) -> int:
    """Events in words of EVT 3.0 at most."""
    kind = words >> np.uint16(12)
    return int((kind == 2).sum()) + 12 * int((kind == 4).sum()) + 8 * int((kind == 5).sum())


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
        kind = word >> 28
        if kind == 0x8:
            _unrolled(np.int64(word & 0xFFFFFFF), state, span)
        elif state[0] >= 0 and kind <= 0x1:
            t[n] = (state[0] << 6) | ((word >> 22) & 0x3F)
            x[n], y[n], p[n] = (word >> 11) & 0x7FF, word & 0x7FF, kind
            n += 1
        elif state[0] >= 0 and kind == 0xA:
            edges[0, m] = (state[0] << 6) | ((word >> 22) & 0x3F)
            edges[1, m], edges[2, m] = (word >> 8) & 0x1F, word & 1
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
