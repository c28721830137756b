"""Prophesee's DAT, version 2: 8 bytes per event, little-endian, after a byte each for the kind of event and its size.

Time [µs], which rolls over after 71 minutes, then from the lowest bit column (14), row (14) and polarity (4)
(docs.prophesee.ai, "DAT File Format").
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from pixelid.errors import InputError
from pixelid.recordings.columns import Rollovers, word_pairs
from pixelid.recordings.raw import Block

PIXEL_EVENTS = (0x00, 0x0C)  # kinds


def decode(path: Path, start: int) -> Iterator[Block]:
    """Blocks of (t µs, x, y, p), the clock's rollovers undone; a fall that is none stays.

    Args:
        path: the file.
        start: byte after the header's lines.

    Raises:
        InputError: other kinds of events, or a file that ends within one.
    """
    with path.open("rb") as file:
        file.seek(start)
        kind = file.read(2)
    if len(kind) < 2 or kind[0] not in PIXEL_EVENTS or kind[1] != 8:
        raise InputError(f"{path}: expected events of 8 bytes, kind 12, after the header, found {list(kind)}")
    clock = Rollovers(1 << 32)
    for words in word_pairs(path, start + 2, "<u4"):
        address = words[:, 1]
        yield Block(clock.undone(words[:, 0]), address & 0x3FFF, address >> 14 & 0x3FFF, address >> 28)
