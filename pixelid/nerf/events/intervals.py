"""Chains: consecutive stretches of a pixel's events that share their samples of past light.

A chain is up to `CHAIN` consecutive stretches of one pixel.  Its light is sampled once, at sorted times: both ends of
every stretch, both ends of a random part of every second one, if it is quiet, a past before the first one, and points
within long ones.  Where the samples go is importance sampling of past inputs (Low & Lee, arXiv 2409.17988, supplement):
lifetimes before an output are exponential at the slowest dominant pole ω, truncated at cumulative probability 0.95, S
evenly spaced quantiles, the output itself among them.  Within a chain the next output decides: over Δt, mass
(S − 1)(1 − exp(−ω Δt))/0.95 of points is due.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from pixelid.nerf.events.stretches import NOISE, Stretches, stretches

CHAIN = 16
OWN = 1 / 3
ASKED = 2  # one in so many stretches has a part of its own that is to be quiet: of all, half the rays would be for that
COVERED = 0.95  # of the lifetimes' probability
LEAST = 0.01  # of a drifting threshold, relative; the simulator's least


@dataclass(frozen=True)
class Intervals:
    """All stretches by (pixel, time), and those of them at which a chain may begin.

    starts: (M,) indices into `stretches`
    """

    stretches: Stretches
    starts: np.ndarray

    def of(self, which: np.ndarray) -> Intervals:
        """The same stretches with only some of the starts."""
        return Intervals(self.stretches, self.starts[which])


class Chains(NamedTuple):
    """A batch of chains.

    t: (n,) sample times, run after run;  first: (runs + 1,);  pixel: (runs,)
    begin, end: (runs, CHAIN) sample at the stretch's start and end;  weight: (runs, CHAIN) 1, or 0 where there is
    none;  rise, fall, variance, reset, burst: (runs, CHAIN) of `Stretches`, of which `which` are the rows;  sub: (runs,
    CHAIN, 2) samples at the ends of a random part of a quiet stretch, twice the same one where it is not asked
    """

    t: np.ndarray
    first: np.ndarray
    pixel: np.ndarray
    begin: np.ndarray
    end: np.ndarray
    weight: np.ndarray
    rise: np.ndarray
    fall: np.ndarray
    variance: np.ndarray
    reset: np.ndarray
    burst: np.ndarray
    sub: np.ndarray
    which: np.ndarray


def intervals(
    t, x, y, on, width: int, *, dead=0.0, lag=0.0, shortest: float | np.ndarray = 0.0, noise=NOISE, drift=0.0,
    memory=0.0,
) -> Intervals:  # fmt: skip
    """Stretches of events (N,) in order of time.

    dead, lag, shortest, noise: see `stretches`, an array in the order of the events given;  drift: of the thresholds,
    relative, per second from t = 0;  memory: by how much, relative, an event of one polarity makes the next threshold
    of the same polarity larger and of the other smaller
    """
    pixel = np.asarray(y, np.int32) * np.int32(width) + np.asarray(x, np.int32)
    order = np.argsort(pixel, kind="stable")
    pixel, t, on = pixel[order], np.asarray(t)[order], np.asarray(on)[order]
    shortest = np.asarray(shortest)[order] if np.ndim(shortest) else shortest
    del order  # as large as the times
    size = None
    if drift or memory:
        same = np.concatenate([[0.0], np.where(on[1:] == on[:-1], 1.0, -1.0) * (pixel[1:] == pixel[:-1])])
        size = np.maximum(1.0 + drift * t + memory * same, LEAST)
    cut = stretches(t, pixel, on, dead, lag, shortest, noise, size)
    return Intervals(cut, np.arange(len(cut.begin), dtype=np.int32))


def split(every: Intervals, share: float, rng: np.random.Generator) -> tuple[Intervals, Intervals]:
    """(training, held out): `share` of the pixels is held out with all its events."""
    pixel = every.stretches.pixel  # in order
    pixels = pixel[np.concatenate([[True], pixel[1:] != pixel[:-1]])].astype(np.int64)
    out = rng.permutation(pixels)[: max(1, round(share * len(pixels)))] if share > 0 else pixels[:0]
    is_out = np.zeros(pixels[-1] + 1, bool)
    is_out[out] = True
    held = is_out[pixel[every.starts]]
    return every.of(~held), every.of(held)


def own_past(samples: int) -> int:
    """How many of its S − 1 past samples an output places itself; the others are those of its neighbours."""
    return math.ceil(OWN * (samples - 1))


def rows_of(every: Intervals, starts) -> np.ndarray:
    """(runs, CHAIN) rows of `every.stretches` in the chains that begin at `starts`; of the end, its last row."""
    rows = every.starts[np.asarray(starts)].astype(np.int64)[:, None] + np.arange(CHAIN)
    return np.minimum(rows, len(every.stretches.begin) - 1)


def chains(
    every: Intervals, starts, samples: int, rate: float | np.ndarray, rng: np.random.Generator,
    points: int | np.ndarray | None = None,
) -> Chains:  # fmt: skip
    """The chains that begin at `starts` (runs,), indices into `every.starts`.

    samples: S, 1 for no past at all;  rate: ω rad/s, one or (runs, CHAIN), of every output;  points: (runs, CHAIN) int,
    the most past samples that an output places itself (at most `own_past`, which is the default)
    """
    samples = 1 + own_past(samples)
    first_of_run = every.starts[np.asarray(starts)].astype(np.int64)
    runs = len(first_of_run)
    random = rng.random((runs, CHAIN, 3))
    shape = (runs, CHAIN)
    rate = np.broadcast_to(np.asarray(rate, float), shape)
    points = np.broadcast_to(np.minimum(samples - 1 if points is None else points, samples - 1), shape)
    begin, end, sub = np.zeros(shape, np.int64), np.zeros(shape, np.int64), np.zeros((*shape, 2), np.int64)
    weight = np.zeros(shape)
    first = np.zeros(runs + 1, np.int64)
    t = np.empty(runs * ((samples - 1) + CHAIN * (4 + samples)))
    which = np.zeros(shape, np.int64)
    f = every.stretches
    n = _fill(
        first_of_run, f.begin, f.end, f.pixel, f.burst, rate, points, random, t, first, begin, end, weight, which, sub,
    )  # fmt: skip
    rise, fall, variance = (column[which].astype(np.float64) for column in (f.rise, f.fall, f.variance))
    return Chains(
        t[:n].copy(), first, f.pixel[first_of_run].astype(np.int64), begin, end, weight, rise, fall, variance,
        f.reset[which], f.burst[which], sub, which,
    )  # fmt: skip


@njit(cache=True, nogil=True)
def _fill(starts, since, until, pixel, burst, rate, points, random, out, first, begin, end, weight, which, sub):
    n = 0
    for run in range(len(starts)):
        first[run] = n
        for j in range(points[run, 0], 0, -1):  # quantiles of the truncated exponential, the oldest first
            out[n] = since[starts[run]] + np.log1p(-COVERED * j / points[run, 0]) / rate[run, 0]
            n += 1
        for k in range(CHAIN):
            i = starts[run] + k
            if i >= len(since) or pixel[i] != pixel[starts[run]]:
                for m in range(k, CHAIN):  # padding points at a valid sample and weighs nothing
                    begin[run, m] = end[run, m] = sub[run, m, 0] = sub[run, m, 1] = n - 1
                    which[run, m] = starts[run]
                break
            start, length = since[i], until[i] - since[i]
            which[run, k], weight[run, k] = i, 1.0
            if n > first[run] and out[n - 1] == start:  # where the stretch before has ended
                begin[run, k] = n - 1
            else:
                begin[run, k] = n
                out[n] = start
                n += 1
            # a part of a quiet stretch: length triangular with mode 0, start uniform
            part = (1.0 - np.sqrt(random[run, k, 1])) * length
            sub_at = start + random[run, k, 2] * (length - part)
            asked = not burst[i] and (run + k) % ASKED == 0
            ends, wanted = (sub_at, sub_at + part), 2 if asked else 0
            reach, most, placed, past = 1.0 - np.exp(-rate[run, k] * length), points[run, k], 0, 0
            if most > 0:
                past = min(int(most / COVERED * reach + random[run, k, 0]), most)
            for j in range(past, -1, -1):
                at = until[i]
                if j > 0:
                    at = max(until[i] + np.log1p(-reach * (j - 0.5) / past) / rate[run, k], start)
                while placed < wanted and ends[placed] <= at:
                    sub[run, k, placed] = n
                    out[n] = ends[placed]
                    n += 1
                    placed += 1
                if j > 0:
                    out[n] = at
                    n += 1
            while placed < 2:  # not asked, or an end that rounding has put behind the stretch's
                sub[run, k, placed] = n if asked else begin[run, k]
                placed += 1
            end[run, k] = n
            out[n] = until[i]
            n += 1
    first[len(starts)] = n
    return n
