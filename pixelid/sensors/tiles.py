"""A sensor cut into tiles: the unit of work that travels to a worker, and that is kept on disk when done."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pixelid.errors import InputError
from pixelid.recordings.recording import Recording


@dataclass(frozen=True)
class Tile:
    """Columns left … right − 1 and rows top … bottom − 1 of a sensor."""

    left: int
    right: int
    top: int
    bottom: int

    def cut(self, recording: Recording) -> Recording:
        """The recording with the tile's events only; addresses stay those of the whole sensor."""
        e = recording.events
        inside = (e.x >= self.left) & (e.x < self.right) & (e.y >= self.top) & (e.y < self.bottom)
        return replace(recording, events=e.select(inside))


def tiles_of(width: int, height: int, size: int) -> list[Tile]:
    """Tiles of at most size × size pixels that cover the sensor, row by row."""
    return [
        Tile(x, min(x + size, width), y, min(y + size, height))
        for y in range(0, height, size)
        for x in range(0, width, size)
    ]


def common_size(recordings: list[Recording]) -> tuple[int, int]:
    """(width, height) of the sensor that all recordings show.

    Raises InputError for pooled recordings, recordings without stimulus, and recordings of several sensors.
    """
    if not recordings:
        raise InputError("no recordings to map")
    first = recordings[0]
    for r in recordings:
        r.check_stimulus_covers_events()
        if r.pooled:
            raise InputError(f"{r.name}: pooled events have no pixels to map")
        if (r.sensor, r.events.width, r.events.height) != (first.sensor, first.events.width, first.events.height):
            raise InputError(
                f"{r.name}: expected the sensor of {first.name} ({first.sensor or 'unnamed'}, "
                f"{first.events.width} x {first.events.height}), found {r.sensor or 'unnamed'}, "
                f"{r.events.width} x {r.events.height}"
            )
    return first.events.width, first.events.height


def block_index(pixel: np.ndarray, width: int, block: int) -> np.ndarray:
    """Flat index of the block × block group of pixels that each flat pixel index belongs to."""
    across = -(-width // block)
    return (pixel // width // block) * across + (pixel % width) // block
