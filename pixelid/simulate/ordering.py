"""From per-pixel event lists to one stream in order of (time, pixel), chunk by chunk."""

from __future__ import annotations

import numpy as np

from pixelid.recordings.events import Events


class Ordering:
    """Merges the events of successive chunks.  Ties in the integer nanosecond go by pixel.

    Events in the last nanosecond of a chunk wait for the next, because a later chunk may round into it.
    """

    def __init__(self, width: int, height: int, delay_s: float = 0.0) -> None:
        self._size = (width, height)
        self._delay = delay_s
        self._waiting = (np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0, np.uint8))

    def merge(self, parts, until_s: float, final: bool) -> Events:
        """Events up to `until_s`, the end of the chunk, from parts (times s, pixels, polarities), clock delay added.

        Events that the delay moves before time zero were not recorded and are left out.
        """
        parts = list(parts)
        times = [np.rint((part[0] + self._delay) * 1e9).astype(np.int64) for part in parts]
        t, pixel, p = (
            np.concatenate([waiting, *columns])
            for waiting, columns in zip(
                self._waiting, (times, [part[1] for part in parts], [part[2] for part in parts]), strict=True
            )
        )
        t, pixel, p = _sorted(t, pixel, p, self._size[0] * self._size[1])
        ready = len(t) if final else int(np.searchsorted(t, round((until_s + self._delay) * 1e9)))
        self._waiting = t[ready:], pixel[ready:], p[ready:]
        width, height = self._size
        skip = int(np.searchsorted(t, 0))
        t, pixel, p = t[skip:ready], pixel[skip:ready], p[skip:ready]
        y, x = np.divmod(pixel, width)
        return Events(t, x.astype(np.uint16), y.astype(np.uint16), p, width, height)


def _sorted(t: np.ndarray, pixel: np.ndarray, p: np.ndarray, pixels: int) -> tuple:
    """(t, pixel, p) in the order of (t, pixel, p): all three packed into one 64-bit number where they fit."""
    if not len(t):
        return t, pixel, p
    start, bits = int(t.min()), (pixels - 1).bit_length() + 1
    if (int(t.max()) - start).bit_length() + bits > 62:
        order = np.lexsort((p, pixel, t))
        return t[order], pixel[order], p[order]
    key = (t - start) << bits
    key |= pixel << 1
    key |= p
    key.sort()
    return (key >> bits) + start, (key & ((1 << bits) - 1)) >> 1, (key & 1).astype(np.uint8)
