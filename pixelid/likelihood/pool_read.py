"""A finite pool of pixels that one readout takes in cycles: all that wait are read, and the others wait for its end.

A pixel is as in `likelihood/pool.py`, but that its dead time runs from when it is read.  When cycles began and how many
events each had is taken from the recording, up to the moment of which something is expected: pixels are exchangeable,
so what is known of one of N after a cycle of n events is known to have been read with the probability n/N.  Cohorts,
pixels read in one cycle, are followed side by side.  At each cycle the odds of those that may have crossed a threshold
are multiplied by one factor, so that the shares read add up to n/N: the distribution of independent pixels given their
sum, but for terms of 1/N.

What crosses while a cycle lasts is expected at its end, all together; what crosses later, at once.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from pixelid.likelihood.pool import FIRST, LEAST_SHARE, LEAST_SPREAD, REACH, above

LEAST_CROSSED = 1e-12  # of the pool: with less there is no one to be read
ALL = 1.0 - 1e-9
ROUNDS = 30  # of the search for the factor
FIELDS = 10
KIND, SHARE, CROSSED, LEVEL, LEFT, HIGHEST, LOWEST, ON_LEFT, OFF_LEFT, BEGUN = range(FIELDS)


class Cycles(NamedTuple):
    """Of the readout, by the grid of times; times in bins.

    begun, released: (cycles,) point of the grid at which a cycle begins, and at which those read in it are released
    ends: (cycles,) when it is expected to end;  size: (cycles,) its events
    """

    begun: np.ndarray
    released: np.ndarray
    ends: np.ndarray
    size: np.ndarray


class Pool(NamedTuple):
    """The kinds of pixel in it.

    on, off: (kinds,) thresholds, log radiance;  share: (kinds,) of the pool;  light: (kinds,) row of the signals
    noise: relative, from event to event;  drift: of thresholds, relative, per bin
    rate: at which the rest of a reset fades, per bin
    pixels: how many;  background: events per bin that are of none
    """

    on: np.ndarray
    off: np.ndarray
    share: np.ndarray
    light: np.ndarray
    noise: float
    drift: float
    rate: float
    pixels: float
    background: float


def read_flow(
    place: np.ndarray, level: np.ndarray, output: np.ndarray, pool: Pool, cycles: Cycles
) -> tuple[np.ndarray, np.ndarray]:
    """What a pixel of the pool is expected to do, given the cycles before.

    Args:
        place: (n + 1,) times of the grid, bins.
        level, output: (lights, n + 1) there, as in `pool.Signals`.
        pool, cycles: The pixels and their readout.

    Returns:
        (2, n) ON and OFF events per step that find the readout free; (2, cycles) those that wait for a cycle's end.
    """
    events, held = np.zeros((2, len(place) - 1)), np.zeros((2, len(cycles.size)))
    _read_flow(place, level, output, pool, cycles, events, held)
    return events, held


@njit(cache=True, nogil=True, error_model="numpy")
def _started(cohorts, count, kind, share, level, left, now, at, pool, noise):
    """One cohort more, of pixels whose change is `now` at the time `at`; returns (cohorts, count)."""
    if count == cohorts.shape[0]:
        more = np.empty((2 * count, FIELDS))
        more[:count] = cohorts
        cohorts = more
    grown = 1.0 + pool.drift * at
    on, off = pool.on[kind] * grown, pool.off[kind] * grown
    highest, lowest = max(now, on * (1.0 - REACH * noise)), max(-now, off * (1.0 - REACH * noise))
    on_left, _ = above((highest / on - 1.0) / noise)
    off_left, _ = above((lowest / off - 1.0) / noise)
    one = cohorts[count]
    one[KIND], one[CROSSED], one[LEVEL], one[LEFT], one[BEGUN] = kind, 0.0, level, left, at
    one[HIGHEST], one[LOWEST], one[ON_LEFT], one[OFF_LEFT] = highest, lowest, on_left, off_left
    one[SHARE] = share / max(on_left * off_left, 1e-3)
    return cohorts, count + 1


@njit(cache=True, nogil=True, error_model="numpy")
def _read_flow(place, level, output, pool, cycles, events, held):
    n, kinds = events.shape[1], len(pool.share)
    noise = max(pool.noise, LEAST_SPREAD)
    cohorts, count = np.empty((256, FIELDS)), np.int64(0)
    for kind in range(kinds):
        span = pool.on[kind] + pool.off[kind]
        for i in range(FIRST):
            z = -pool.off[kind] + span * (i + 0.5) / FIRST
            cohorts, count = _started(
                cohorts, count, kind, pool.share[kind] / FIRST, output[pool.light[kind], 0] - z, 0.0, z, 0.0, pool,
                noise,
            )  # fmt: skip
    read = np.zeros((len(cycles.size), kinds))
    cycle, releasing, last = np.int64(-1), np.int64(0), 0.0
    for k in range(n):
        while cycle + 1 < len(cycles.size) and cycles.begun[cycle + 1] <= k:
            cycle += 1
            count = _taken(cohorts, count, cycles.size[cycle], pool, place[k] - last, read[cycle])
            last = place[k]
        while releasing < len(cycles.size) and cycles.released[releasing] <= k and releasing <= cycle:
            for kind in range(kinds):
                if read[releasing, kind] > LEAST_SHARE:
                    row = pool.light[kind]
                    cohorts, count = _started(
                        cohorts, count, kind, read[releasing, kind], level[row, k], output[row, k] - level[row, k], 0.0,
                        place[k], pool, noise,
                    )  # fmt: skip
            releasing += 1
        width = place[k + 1] - place[k]
        fade = math.exp(-pool.rate * width)
        waits = 0.0 if cycle < 0 else min(max((cycles.ends[cycle] - place[k]) / width, 0.0), 1.0)
        for i in range(count):
            one = cohorts[i]
            if one[LEFT] != 0.0:
                one[LEFT] = one[LEFT] * fade if abs(one[LEFT]) > 1e-9 else 0.0
            kind = int(one[KIND])
            after = output[pool.light[kind], k + 1] - one[LEVEL] - one[LEFT]
            polarity, mass = -1, 0.0
            if after > one[HIGHEST]:
                left, _ = above((after / (pool.on[kind] * (1.0 + pool.drift * one[BEGUN])) - 1.0) / noise)
                polarity, mass = 0, one[SHARE] * one[OFF_LEFT] * (one[ON_LEFT] - left)
                one[HIGHEST], one[ON_LEFT] = after, left
            elif -after > one[LOWEST]:
                left, _ = above((-after / (pool.off[kind] * (1.0 + pool.drift * one[BEGUN])) - 1.0) / noise)
                polarity, mass = 1, one[SHARE] * one[ON_LEFT] * (one[OFF_LEFT] - left)
                one[LOWEST], one[OFF_LEFT] = -after, left
            if mass > 0.0:
                one[CROSSED] += mass
                events[polarity, k] += mass * (1.0 - waits)
                if waits > 0.0:
                    held[polarity, cycle] += mass * waits


@njit(cache=True, nogil=True, error_model="numpy")
def _taken(cohorts, count, size, pool, since, read):
    """Read so many events: what each cohort loses adds to `read` (kinds,).  Returns how many cohorts are left."""
    crossed, reach = 0.0, 0.0
    for i in range(count):
        one = cohorts[i]
        crossed += one[CROSSED]
        if one[CROSSED] > 0.0:
            reach += one[CROSSED] + one[SHARE] * one[ON_LEFT] * one[OFF_LEFT]
    if crossed < LEAST_CROSSED:
        return count
    expected = pool.pixels * crossed
    share = min(size / pool.pixels * expected / (expected + pool.background * since), ALL * reach)
    log_factor = math.log(share * max(1.0 - crossed, 1e-6) / (crossed * max(1.0 - share, 1e-6)))
    low, high = -700.0, 700.0
    for _ in range(ROUNDS):
        factor, total, slope = math.exp(log_factor), 0.0, 0.0
        for i in range(count):
            one = cohorts[i]
            if one[CROSSED] > 0.0:
                rest = one[SHARE] * one[ON_LEFT] * one[OFF_LEFT]
                p = factor * one[CROSSED] / (factor * one[CROSSED] + rest)
                total += (one[CROSSED] + rest) * p
                slope += (one[CROSSED] + rest) * p * (1.0 - p)
        if abs(total - share) < 1e-10 * share:
            break
        low, high = (log_factor, high) if total < share else (low, log_factor)
        moved = log_factor + (share - total) / max(slope, 1e-300)
        log_factor = moved if low < moved < high else 0.5 * (low + high)
    factor, kept = math.exp(log_factor), 0
    for i in range(count):
        one = cohorts[i]
        rest = one[SHARE] * one[ON_LEFT] * one[OFF_LEFT]
        if one[CROSSED] > 0.0:
            whole = one[CROSSED] + rest
            taken = whole * factor * one[CROSSED] / (factor * one[CROSSED] + rest)
            read[int(one[KIND])] += taken
            if rest > 0.0:
                one[SHARE] *= (whole - taken) / rest
            rest, one[CROSSED] = whole - taken, 0.0
        if rest > LEAST_SHARE and one[ON_LEFT] > 0.0 and one[OFF_LEFT] > 0.0:
            if kept < i:
                cohorts[kept] = one
            kept += 1
        elif rest > 0.0:  # nothing is lost: they join those that are read
            read[int(one[KIND])] += rest
    return kept
