"""Hot pixels: a few pixels fire extra ON events as a Poisson process, whatever the light does."""

from __future__ import annotations

import numpy as np
from numba import njit

from pixelid.errors import InputError
from pixelid.simulate import random
from pixelid.simulate.comparator import grown, room
from pixelid.stages.circuit import Circuit


class HotPixels:
    """The hot pixels of one sensor, their next firing times carried over chunks.

    Raises InputError when more pixels are hot than there are.
    """

    def __init__(self, circuit: Circuit, pixels: int, seed: int, start_s: float) -> None:
        count = circuit.hot_count if circuit.hot_hz > 0 else 0
        if count > pixels:
            raise InputError(f"hot_pixels.count = {count}: expected at most the {pixels} pixels of the sensor")
        self.pixels = np.sort(np.argsort(_places(seed, pixels), kind="stable")[:count])
        self._mean = 1.0 / circuit.hot_hz if count else np.inf
        self._seed = seed
        self._last = np.full(count, start_s)
        self._drawn = np.zeros(count, np.int64)

    def until(self, until_s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(times (m,) s, pixels (m,), polarities (m,)) up to `until_s`, since the last call."""
        if not len(self.pixels):
            return np.empty(0), np.empty(0, np.int64), np.empty(0, np.uint8)
        return _fire(self._seed, self.pixels, self._mean, self._last, self._drawn, until_s)


@njit(cache=True)
def _places(seed, pixels):
    key = random.stream_key(seed, random.HOT_PLACE)
    out = np.empty(pixels)
    for i in range(pixels):
        out[i] = random.uniform(key, i, 0)
    return out


@njit(cache=True)
def _fire(seed, pixels, mean, last, drawn, until):
    """Exponential intervals, one counter per pixel; `last` and `drawn` are moved on to the last event ≤ until."""
    key = random.stream_key(seed, random.HOT_TIME)
    fired, count = room(np.int64(64)), np.int64(0)  # literals would compile twice
    for i in range(len(pixels)):
        while True:
            t = last[i] - mean * np.log(random.uniform(key, pixels[i], drawn[i]))
            if t > until:
                break
            last[i] = t
            drawn[i] += 1
            if count == len(fired[0]):
                fired = grown(fired)
            fired[0][count], fired[1][count], fired[2][count] = t, pixels[i], 1
            count += 1
    return fired[0][:count], fired[1][:count], fired[2][:count]
