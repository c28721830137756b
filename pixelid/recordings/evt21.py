"""Prophesee's EVT 2.1: 64-bit words, each a row of up to 32 neighbouring pixels that fired at one time.

Little-endian word, from the highest bit: type (4), then for events of one polarity (0 OFF, 1 ON) the low 6 bits of the
time [µs], column of the first pixel (11), row (11), and a bit per pixel from the first on (32).  Type 8 carries the
high 28 bits of the time in bits 32–59, which roll over; type 10 an edge at a trigger input: low 6 bits of the time in
bits 54–59, input in bits 40–44, rising in bit 32.  Some sensors (IMX636; `endianness=legacy` in the header, where it
says) send the high half of each word first, others (GenX320) the low half (docs.prophesee.ai, "EVT 2.1 Format").
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from pixelid.errors import InputError
from pixelid.recordings.columns import Rollovers
from pixelid.recordings.triggers import Triggers

WORDS_AT_ONCE = 1 << 17  # up to 32 events each
OFF, ON, TIME_HIGH, TRIGGER = 0x0, 0x1, 0x8, 0xA
TIME_BITS = 34  # after which the clock rolls over


def decode(path: Path, start: int, swapped: bool | None = None) -> Iterator[tuple[tuple, Triggers | None]]:
    """Blocks of ((t µs, x, y, p), trigger edges or None); events before the first time are left out.

    Args:
        path: the file.
        start: byte at which its words begin.
        swapped: whether the high half of each word comes first; None: the first words show it.

    Raises:
        InputError: the file ends within a word, or holds words of unknown meaning only.
    """
    length = path.stat().st_size - start
    if length % 8:
        raise InputError(f"{path}: expected words of 8 bytes after the header, found {length % 8} bytes left over")
    high, known, seen, clock = -1, 0, 0, Rollovers(1 << (TIME_BITS - 6))
    with path.open("rb") as file:
        file.seek(start)
        while len(data := file.read(8 * WORDS_AT_ONCE)):
            words = np.frombuffer(data, "<u8")
            if swapped is None:
                swapped = _times(_swapped(words)) > _times(words)
            if swapped:
                words = _swapped(words)
            kind = (words >> np.uint64(60)).astype(np.uint8)
            seen += len(words)
            known += int(np.isin(kind, (OFF, ON, TIME_HIGH, TRIGGER)).sum())
            highs = np.where(kind == TIME_HIGH, (words >> np.uint64(32)).astype(np.int64) & 0xFFFFFFF, -1)
            stamps = np.flatnonzero(highs >= 0)
            unrolled = clock.undone(highs[stamps])
            place = np.searchsorted(stamps, np.arange(len(words)), side="right")
            base = np.concatenate([[high], unrolled])[place]
            high = int(unrolled[-1]) if len(unrolled) else high
            t = (base << 6) | ((words >> np.uint64(54)).astype(np.int64) & 0x3F)
            timed = base >= 0
            columns = _events(words, t, timed & (kind <= ON))
            yield columns, _triggers(words, t, timed & (kind == TRIGGER), path)
    if seen and not known:
        raise InputError(f"{path}: expected words of EVT 2.1, found none in {seen}")


def _swapped(words: np.ndarray) -> np.ndarray:
    """The words with their halves exchanged."""
    return (words << np.uint64(32)) | (words >> np.uint64(32))


def _times(words: np.ndarray) -> int:
    """How many words say a time and nothing else: read the wrong way round they look like events."""
    return int(np.count_nonzero((words >> np.uint64(60) == TIME_HIGH) & (words & np.uint64(0xFFFFFFFF) == 0)))


def _events(words: np.ndarray, t: np.ndarray, chosen: np.ndarray) -> tuple:
    """(t, x, y, p), one row per bit that is set."""
    words, t = words[chosen], t[chosen]
    mask = np.unpackbits((words & np.uint64(0xFFFFFFFF)).astype("<u4").view(np.uint8), bitorder="little")
    owner, bit = np.nonzero(mask.reshape(-1, 32))
    x = (words >> np.uint64(43)).astype(np.int64) & 0x7FF
    y = (words >> np.uint64(32)).astype(np.int64) & 0x7FF
    return t[owner], x[owner] + bit, y[owner], (words >> np.uint64(60)).astype(np.uint8)[owner]


def _triggers(words: np.ndarray, t: np.ndarray, chosen: np.ndarray, path: Path) -> Triggers | None:
    if not chosen.any():
        return None
    words = words[chosen]
    rising, channel = words >> np.uint64(32) & np.uint64(1), words >> np.uint64(40) & np.uint64(0x1F)
    return Triggers.from_columns(t[chosen] * 1000, rising, channel.astype(np.uint8), where=f"{path}: triggers")
