"""Events as intervals: from the end of the previous event's dead time to the event; chains of them share their past.

A chain is up to `CHAIN` consecutive intervals of one pixel.  Its light is sampled once, at sorted times: both ends of
every interval, a past before the first one, and points within long intervals.  Where the samples go is importance
sampling of past inputs (Low & Lee, arXiv 2409.17988, supplement): lifetimes before an output are exponential at the
slowest dominant pole ω, truncated at cumulative probability 0.95, S evenly spaced quantiles, the output itself among
them.  Within a chain the next output decides: between two events mass (S − 1)(1 − exp(−ω Δt))/0.95 of points is due.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

CHAIN = 16
OWN = 1 / 3
COVERED = 0.95  # of the lifetimes' probability


@dataclass(frozen=True)
class Intervals:
    """All events sorted by (pixel, time), and which of them end an interval.

    t: (N,) s;  pixel: (N,) row-major index;  on: (N,) bool;  ends: (M,) events with a predecessor in their pixel
    """

    t: np.ndarray
    pixel: np.ndarray
    on: np.ndarray
    ends: np.ndarray

    def of(self, which: np.ndarray) -> Intervals:
        """The same events with only some of the intervals."""
        return Intervals(self.t, self.pixel, self.on, self.ends[which])


class Chains(NamedTuple):
    """A batch of chains.

    t: (n,) sample times, run after run;  first: (runs + 1,);  pixel: (runs,)
    begin, end: (runs, CHAIN) sample at the interval's start and end;  weight: (runs, CHAIN) 1, or 0 where there is no
    (usable) interval;  on: (runs, CHAIN);  sub: (runs, CHAIN, 2) sample before the ends of a random sub-interval and
    share: (runs, CHAIN, 2) how far towards the next sample
    """

    t: np.ndarray
    first: np.ndarray
    pixel: np.ndarray
    begin: np.ndarray
    end: np.ndarray
    weight: np.ndarray
    on: np.ndarray
    sub: np.ndarray
    share: np.ndarray


def intervals(t, x, y, on, width: int) -> Intervals:
    """Intervals of events in order of time."""
    pixel = y * width + x
    order = np.lexsort((t, pixel))
    t, pixel, on = np.ascontiguousarray(t[order]), np.ascontiguousarray(pixel[order]), np.ascontiguousarray(on[order])
    ends = np.flatnonzero((pixel[1:] == pixel[:-1]) & (t[1:] > t[:-1])) + 1
    return Intervals(t, pixel, on, ends)


def split(found: Intervals, share: float, rng: np.random.Generator) -> tuple[Intervals, Intervals]:
    """(training, held out): `share` of the pixels is held out with all its events."""
    pixels = np.unique(found.pixel)
    out = rng.permutation(pixels)[: max(1, round(share * len(pixels)))] if share > 0 else pixels[:0]
    held = np.isin(found.pixel[found.ends], out)
    return found.of(~held), found.of(held)


def past_lifetimes(samples: int, rate: float) -> np.ndarray:
    """(samples,) s before the output, increasing from 0: quantiles of the truncated exponential."""
    share = COVERED * np.arange(samples) / max(samples - 1, 1)
    return -np.log1p(-share) / rate


def chains(found: Intervals, starts, dead: float, samples: int, rate: float, rng: np.random.Generator) -> Chains:
    """The chains that begin at the intervals `starts` (runs,), indices into `found.ends`.

    dead: s;  samples: S, 1 for no past at all;  rate: ω rad/s.  Neighbours share their samples: of its S − 1 past ones
    an output places a part `OWN` itself.
    """
    samples = 1 + math.ceil(OWN * (samples - 1))
    starts = np.asarray(starts)
    events = found.ends[starts]
    runs = len(events)
    random = rng.random((runs, CHAIN, 3))
    shape = (runs, CHAIN)
    begin, end, sub = np.zeros(shape, np.int64), np.zeros(shape, np.int64), np.zeros((*shape, 2), np.int64)
    weight, on, share = np.zeros(shape), np.zeros(shape, bool), np.zeros((*shape, 2))
    lifetimes = past_lifetimes(samples, rate)[1:][::-1].copy()
    first = np.zeros(runs + 1, np.int64)
    t = np.empty(runs * ((samples - 1) + CHAIN * (2 + samples)))
    n = _fill(
        events,
        found.t,
        found.pixel,
        found.on,
        dead,
        lifetimes,
        rate,
        random,
        t,
        first,
        begin,
        end,
        weight,
        on,
        sub,
        share,
    )
    return Chains(t[:n].copy(), first, found.pixel[events], begin, end, weight, on, sub, share)


@njit(cache=True, nogil=True)
def _fill(events, t, pixel, on, dead, lifetimes, rate, random, out, first, begin, end, weight, up, sub, share):
    n = 0
    density = len(lifetimes) / COVERED
    for run in range(len(events)):
        first[run] = n
        event = events[run]
        start = min(t[event - 1] + dead, t[event])
        for j in range(len(lifetimes)):
            out[n] = start - lifetimes[j]
            n += 1
        for k in range(CHAIN):
            i = event + k
            if i >= len(t) or pixel[i] != pixel[event]:
                for m in range(k, CHAIN):  # padding points at a valid sample and weighs nothing
                    begin[run, m] = end[run, m] = sub[run, m, 0] = sub[run, m, 1] = n - 1
                break
            start = min(t[i - 1] + dead, t[i])
            length = t[i] - start
            begin[run, k], up[run, k] = n, on[i]
            weight[run, k] = 1.0 if length > 0.0 else 0.0
            out[n] = start
            n += 1
            if density > 0.0:
                reach = 1.0 - np.exp(-rate * length)
                points = min(int(density * reach + random[run, k, 0]), len(lifetimes))
                for j in range(points, 0, -1):
                    out[n] = max(t[i] + np.log1p(-reach * (j - 0.5) / points) / rate, start)
                    n += 1
            end[run, k] = n
            out[n] = t[i]
            n += 1
            # a sub-interval: length triangular with mode 0, start uniform
            part = 1.0 - np.sqrt(random[run, k, 1])
            a = start + (1.0 - part) * random[run, k, 2] * length
            for side in range(2):
                at = a + side * part * length
                j = begin[run, k]
                while j + 2 <= end[run, k] and out[j + 1] <= at:
                    j += 1
                sub[run, k, side] = j
                step = out[j + 1] - out[j]
                share[run, k, side] = min((at - out[j]) / step, 1.0) if step > 0.0 else 0.0
    first[len(events)] = n
    return n
