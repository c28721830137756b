"""Pixels that wait for a readout they share, marched together on a fine grid; nothing of the package.

All that have crossed a threshold when a cycle begins are read in it and reset; a cycle of n events lasts a + b n, give
or take a spread, and the next begins when one waits.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from tests.oracles import whole_pixel as oracle

MOST = 2_000_000
FINER = 5  # steps per step of the signals: a cycle begins at the end of one


def pool(
    pixel: oracle.Pixel,
    pixels: int,
    light,
    seconds: float,
    seed: int,
    cycle_s: float = 0.0,
    event_s: float = 0.0,
    spread: float = 0.0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(times (n,) ns, pixels (n,), polarities (n,) 0 or 1) of a pool; cycles of length 0 are those of free pixels."""
    seen = oracle.signals(pixel, light, seconds)
    rng = np.random.default_rng(seed)
    own = oracle.thresholds(pixel, pixels, rng)
    coarse = np.arange(len(seen.follower)) * oracle.STEP_S
    fine = np.arange((len(coarse) - 1) * FINER + 1) * (oracle.STEP_S / FINER)
    follower, amplifier = np.interp(fine, coarse, seen.follower), np.interp(fine, coarse, seen.amplifier)
    t, which, sign = _march(
        follower, amplifier, oracle.STEP_S / FINER, own, pixel.sigma, pixel.differencing, pixel.dead_s, cycle_s,
        event_s, spread, rng,
    )  # fmt: skip
    return np.round(t * 1e9).astype(np.int64), which, (sign > 0).astype(np.uint8)


@njit(cache=False)
def _march(follower, amplifier, step, own, sigma, rate, dead_s, cycle_s, event_s, spread, rng):
    pixels, fade = len(own), np.exp(-rate * step)
    level, rest, release = np.empty(pixels), np.zeros(pixels), np.full(pixels, np.inf)
    waits, mine = np.zeros(pixels, np.int64), np.empty((pixels, 2))
    times, which, signs, n, free = np.empty(MOST), np.empty(MOST, np.int64), np.empty(MOST, np.int64), 0, 0.0
    for i in range(pixels):
        mine[i, 0], mine[i, 1] = own[i] * (1.0 + sigma * rng.standard_normal(2))
        level[i] = amplifier[0] + mine[i, 1] - (mine[i, 0] + mine[i, 1]) * rng.random()
    for k in range(len(follower)):
        now, waiting = k * step, 0
        for i in range(pixels):
            if release[i] < np.inf:
                if release[i] > now:
                    continue
                release[i], level[i], rest[i] = np.inf, follower[k], amplifier[k] - follower[k]
                mine[i, 0], mine[i, 1] = own[i] * (1.0 + sigma * rng.standard_normal(2))
            elif waits[i] == 0:
                rest[i] *= fade
                change = amplifier[k] - level[i] - rest[i]
                waits[i] = 1 if change >= mine[i, 0] else (-1 if -change >= mine[i, 1] else 0)
            waiting += waits[i] != 0
        if waiting > 0 and now >= free:
            for i in range(pixels):
                if waits[i] != 0:
                    times[n], which[n], signs[n], n = now, i, waits[i], n + 1
                    waits[i], release[i] = 0, now + dead_s
            free = now + (cycle_s + event_s * waiting) * (1.0 + spread * rng.standard_normal())
    return times[:n], which[:n], signs[:n]
