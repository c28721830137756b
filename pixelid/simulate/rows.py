"""The rows of a tile's work space, and what fills those of its light: loops over the tile's n pixels.

Rows are named by their numbers, as in `dynamics.blocks`, whose rows come first.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pixelid.dynamics.blocks import BEGIN, BLOCK, D0, D1, END, L0, L1, U0, U1
from pixelid.dynamics.vector_math import vexp, vlog
from pixelid.simulate import random
from pixelid.simulate.chain_step import SPARE
from pixelid.simulate.comparator import FIELDS

COMPARATORS = SPARE + 1  # rows after those of `chain_step`: `comparator.FIELDS` of them
FLAG, BEFORE, AFTER, NOISE, NEXT_NOISE = range(COMPARATORS + FIELDS, COMPARATORS + FIELDS + 5)
ROWS = NEXT_NOISE + 1


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def load(frames, first, live, out):
    """The radiance of a tile's pixels, out (m, tile), as float64.

    Full-field frames (m, 1) serve all pixels; places beyond the sensor repeat its last pixel.
    """
    for k in range(len(out)):
        if frames.shape[1] == 1:
            out[k] = frames[k, 0]
            continue
        for i in range(live):
            out[k, i] = frames[k, first + i]
        out[k, live:] = frames[k, first + live - 1]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def move_light(w, n):
    """What the last step ended with is where the next begins."""
    for i in range(n):
        w[i + U0 * BLOCK], w[i + L0 * BLOCK] = w[i + U1 * BLOCK], w[i + L1 * BLOCK]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def move_states(w, n):
    """What the last step ended with is where the next begins."""
    for i in range(6 * BLOCK if n == BLOCK else 5 * BLOCK + n):
        w[i + BEGIN * BLOCK] = w[i + END * BLOCK]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def move_four_states(w, n):
    """As `move_states` without the extra pole and the lower cutoff."""
    for i in range(n):
        w[i + BEGIN * BLOCK], w[i + (BEGIN + 1) * BLOCK] = w[i + END * BLOCK], w[i + (END + 1) * BLOCK]
        w[i + (BEGIN + 2) * BLOCK], w[i + D0 * BLOCK] = w[i + (END + 2) * BLOCK], w[i + D1 * BLOCK]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def fill_light(radiance, gain, dark, w, n):
    """Fill L1."""
    for i in range(n):
        w[i + L1 * BLOCK] = radiance[i] * gain + dark


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def fill_logs(radiance, out):
    for i in range(len(out)):
        out[i] = vlog(radiance[i])


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def fill_responses(w, n, bend):
    """Fill U1: log radiance, or below the knee the line that continues it (`photocurrent.logarithm`)."""
    for i in range(n):
        w[i + U1 * BLOCK] = vlog(w[i + L1 * BLOCK])
    knee, slope = bend
    if knee > 0.0:
        for i in range(n):
            light = w[i + L1 * BLOCK]
            if light < knee:
                w[i + U1 * BLOCK] = np.log(knee) + slope * (light / knee - 1.0)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def scale(x, factor, out):
    for i in range(len(out)):
        out[i] = x[i] * factor


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def lower(x, drift):
    for i in range(len(x)):
        x[i] = x[i] - drift


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def fill_light_between(w, n, weight, gain, dark):
    """Effective radiance part of the way between two frames, whose logs stand in BEFORE and AFTER."""
    for i in range(n):
        light = vexp((1.0 - weight) * w[i + BEFORE * BLOCK] + weight * w[i + AFTER * BLOCK])
        w[i + L1 * BLOCK] = light * gain + dark


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def fill_normals(key, first, knot, w, n):
    """Standard normals of the tile at a knot; even knots also fill NEXT_NOISE for the knot after."""
    if knot & 1:
        for i in range(n):
            w[i + NOISE * BLOCK] = random.normal_pair(key, first + i, knot >> 1)[1]
        return
    for i in range(n):
        w[i + NOISE * BLOCK], w[i + NEXT_NOISE * BLOCK] = random.normal_pair(key, first + i, knot >> 1)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def add_noise(normals, L, variance, u):
    """Shot noise: white, so that a knot's variance is the one-sided PSD, density/L, times half its sampling rate."""
    for i in range(len(u)):
        u[i] = u[i] + normals[i] * np.sqrt(variance / L[i])


@njit(cache=True, nogil=True, error_model="numpy")
def fill_steady(u, wh, begin_state):
    """Steady state under log radiance u (n,)."""
    for i in range(len(u)):
        low = u[i] if wh > 0.0 else 0.0
        begin_state[0, i], begin_state[1, i], begin_state[2, i], begin_state[3, i] = 0.0, u[i], u[i], u[i]
        begin_state[4, i], begin_state[5, i] = low, u[i] - low
