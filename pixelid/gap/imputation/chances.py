"""The chance that a pixel's next event comes in a short span of time, by the circuit and the light: compiled.

Chances of cells are differences of the normal distribution function at the running extremes of the change, so that they
are exact for cells of any width; the time in the middle of a cell stands for all of it as the next event's reset.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from pixelid.likelihood.density_release import factor

BLOCK = 64  # cells whose extremes are kept together
MARGIN = 5.5  # standard deviations from a threshold beyond which nothing crosses: 2e-8
DECAYED = 14.0  # time constants after which a reset counts as over: 1e-6 of its offset

_TABLE_STEP = 1 / 128
_PHI = np.array([0.5 * math.erfc(-x / math.sqrt(2.0)) for x in np.arange(-MARGIN, MARGIN + 1, _TABLE_STEP)])


class Light(NamedTuple):
    """What a circuit makes of one recording's light, on cells of equal width.

    step: s;  output, level: (c,) amplifier never reset, and what it is reset to, at the end of each cell, the first
    at `begin` s;  drift: (c,) what has leaked since the beginning, in log radiance;  growth: relative, of thresholds
    per second
    highest, lowest: (c / BLOCK,) extremes of the output
    decay: 1/s, of what a reset leaves, 0 where nothing is left;  dead: s
    """

    begin: float
    step: float
    output: np.ndarray
    level: np.ndarray
    drift: np.ndarray
    highest: np.ndarray
    lowest: np.ndarray
    growth: float
    decay: float
    dead: float


class Thresholds(NamedTuple):
    """Of one pixel: mean and standard deviation of ON and OFF, and the circuit's polarity memory."""

    on: float
    off: float
    sd_on: float
    sd_off: float
    memory: float


@njit(cache=True, error_model="numpy", inline="always")
def _phi(x):
    """Normal distribution function, by linear interpolation to 2e-6."""
    if x <= -MARGIN:
        return 0.0
    if x >= MARGIN:
        return 1.0
    at = (x + MARGIN) / _TABLE_STEP
    k = int(at)
    return _PHI[k] + (at - k) * (_PHI[k + 1] - _PHI[k])


@njit(cache=True, error_model="numpy")
def _release(light, when):
    """(cell that it lies in, level there, output less that level, drift there, s) of a release; held at the end."""
    x = (when - light.begin) / light.step
    k = min(max(math.floor(x), 0), len(light.output) - 2)
    part = min(max(x - k, 0.0), 1.0)
    level = light.level[k] + part * (light.level[k + 1] - light.level[k])
    output = light.output[k] + part * (light.output[k + 1] - light.output[k])
    drift = light.drift[k] + part * (light.drift[k + 1] - light.drift[k])
    return k + 1, level, output - level, drift


@njit(cache=True, error_model="numpy")
def _quiet(light, block, level, offset, drift, highest, lowest):
    """Whether no cell of a block comes near either threshold; `highest`, `lowest` changes that do."""
    last = min((block + 1) * BLOCK, len(light.output)) - 1
    leaked, leaked_first = light.drift[last] - drift, light.drift[block * BLOCK] - drift
    up = light.highest[block] - level + abs(offset) + max(leaked, leaked_first)
    down = light.lowest[block] - level - abs(offset) + min(leaked, leaked_first)
    return up < highest and down > -lowest


@njit(cache=True, error_model="numpy")
def add_chances(light, at, when, before, first, stride, last, on_cells, off_cells, weight):
    """Add to cells (k,) the chance, times `weight`, that the event after one at `when` crosses there, ON or OFF.

    Cells are `stride` wide and end at cells first, first + stride … of the light, up to `last`.  Empty: not wanted.
    """
    k, level, offset, drift = _release(light, when + light.dead)
    on, off = at.on * factor(at.memory, before), at.off * factor(at.memory, -before)
    near_on, near_off = on - MARGIN * at.sd_on, off - MARGIN * at.sd_off
    if light.growth != 0.0:
        near_on, near_off = 0.0, 0.0
    released = when + light.dead - light.begin
    m = first + max(0, (k - first + stride - 1) // stride) * stride
    start = m
    # cells before the first wanted one count by their extremes: the same strides, from the release on
    if m > k + stride:
        m -= ((m - k) // stride) * stride
    up, down, crossed_on, crossed_off = -np.inf, -np.inf, 0.0, 0.0
    fading = math.exp(-light.decay * light.step * stride)
    left, from_ = 0.0, -1  # what the reset leaves, kept cell by cell
    while m <= last:
        if m % BLOCK < stride and _quiet(light, m // BLOCK, level, offset, drift, near_on, near_off):
            m += ((BLOCK - m % BLOCK + stride - 1) // stride) * stride
            continue
        since = m * light.step - released
        change = light.output[m] - level + light.drift[m] - drift
        if light.decay * since < DECAYED:
            left = left * fading if from_ == m - stride else offset * math.exp(-light.decay * since)
            from_ = m
            change -= left
        if light.growth != 0.0:
            change /= 1.0 + light.growth * (light.begin + m * light.step)
        up, down = max(up, change), max(down, -change)
        if up > near_on or down > near_off:
            now_on, now_off = _phi((up - on) / at.sd_on), _phi((down - off) / at.sd_off)
            if m >= start:
                cell = (m - first) // stride
                if now_on > crossed_on and cell < len(on_cells):
                    on_cells[cell] += weight * (now_on - crossed_on) * (1.0 - crossed_off)
                if now_off > crossed_off and cell < len(off_cells):
                    off_cells[cell] += weight * (now_off - crossed_off) * (1.0 - crossed_on)
            crossed_on, crossed_off = now_on, now_off
            if (1.0 - crossed_on) * (1.0 - crossed_off) < 1e-9:
                return
        m += stride
