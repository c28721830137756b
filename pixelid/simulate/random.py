"""Random numbers by counting: each is a hash of (seed, stream, pixel, counter) and of nothing else.

Results therefore do not depend on the number of threads, on tiles or on chunks.  The hash is the finaliser of
splitmix64 (Steele, Lea & Flood, OOPSLA 2014), applied once per word of the key; it has no branches, so loops over
pixels vectorise.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pixelid.dynamics.vector_math import unit_interval, vlog, vsincos
from pixelid.errors import InputError

# One stream per purpose.
MISMATCH, THRESHOLD, PHASE, SHOT, HOT_PLACE, HOT_TIME, JITTER = range(1, 8)

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1, _MIX_2 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_30, _27, _31, _32 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(32)


@njit(forceinline=True, error_model="numpy")
def mix(z):
    """splitmix64's finaliser: a bijection of 64 bits that looks random."""
    z = (z ^ (z >> _30)) * _MIX_1
    z = (z ^ (z >> _27)) * _MIX_2
    return z ^ (z >> _31)


@njit(forceinline=True, error_model="numpy")
def stream_key(seed, stream):
    """The 64-bit key of one stream under `both_seeds`: what belongs to the sensor hangs on the sensor's seed only."""
    own = np.uint64(seed)
    if stream in (MISMATCH, HOT_PLACE):
        own = own >> _32
    return mix(mix(own + _GOLDEN) + np.uint64(stream) * _GOLDEN)


def both_seeds(seed: int, sensor_seed: int) -> int:
    """The two seeds in one number.  Raises InputError unless both lie in 0 … 2³¹ − 1."""
    for name, value in (("seed", seed), ("sensor_seed", sensor_seed)):
        if not 0 <= value < 1 << 31:
            raise InputError(f"{name}: expected 0..{(1 << 31) - 1}, found {value}")
    return sensor_seed << 32 | seed


@njit(forceinline=True, error_model="numpy")
def bits(key, pixel, counter):
    """64 random bits."""
    return mix(mix(key + np.uint64(pixel) * _GOLDEN) + np.uint64(counter) * _GOLDEN)


@njit(forceinline=True, error_model="numpy")
def uniform(key, pixel, counter):
    """Uniform in (0, 1)."""
    return unit_interval(bits(key, pixel, counter))


@njit(forceinline=True, error_model="numpy")
def normal_pair(key, pixel, counter):
    """Two independent standard normals (Box & Muller 1958); |value| < 8.6."""
    first = bits(key, pixel, counter)
    radius = np.sqrt(-2.0 * vlog(unit_interval(first)))
    sine, cosine = vsincos(6.283185307179586 * unit_interval(mix(first + _GOLDEN)))
    return radius * cosine, radius * sine


@njit(cache=True, nogil=True, error_model="numpy")
def fill_normals(seed, stream, first, out):
    """out[i] = standard normal number `first` + i of a stream that has no pixels."""
    key = stream_key(seed, stream)
    for i in range(len(out)):
        out[i] = normal_pair(key, 0, first + i)[0]
