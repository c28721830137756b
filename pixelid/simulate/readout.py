"""Readout, as pure functions on columns of events: losses, one server's queue, timestamp jitter, timestamp grid.

Times are int64 nanoseconds.  `Readout` chains them over successive chunks.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy.special import ndtri

from pixelid.recordings.events import Events
from pixelid.simulate import random
from pixelid.stages.circuit import Circuit


@njit(cache=True, nogil=True)
def queue(t, service_ns, busy_until, out):
    """Departures from a first-come-first-served server: out[k] = max(t[k], departure k−1) + service.

    t, out: (n,) int64 ns, t in order;  service_ns: float;  busy_until: last departure so far (ns, −∞ at first).
    Returns the last departure.  The effect is `readout_latency`.
    """
    for k in range(len(t)):
        busy_until = max(float(t[k]), busy_until) + service_ns
        out[k] = round(busy_until)
    return busy_until


def kept(count: int, fraction: float, first: int, seed: int) -> np.ndarray:
    """(count,) bool, which events are not lost; `first`: number of events before these."""
    draws = np.empty(count)
    lost = 8  # stream of random numbers, after those of `random.py`
    random.fill_normals(seed, lost, first, draws)
    return draws > ndtri(fraction)


def jitter(t: np.ndarray, sigma_ns: float, first: int, seed: int) -> np.ndarray:
    """Times (n,) ns moved by Gaussian jitter, not below 0, out of order; `first`: number of events before these."""
    draws = np.empty(len(t))
    random.fill_normals(seed, random.JITTER, first, draws)
    return np.maximum(t + np.rint(sigma_ns * draws).astype(np.int64), 0)


def quantise(t: np.ndarray, tick_ns: float) -> np.ndarray:
    """Times (n,) ns on a grid of tick_ns, rounded to the nearest; order is kept."""
    return np.rint(np.rint(t / tick_ns) * tick_ns).astype(np.int64)


class Readout:
    """Queue, jitter and grid of one sensor, carried over chunks."""

    def __init__(self, circuit: Circuit, seed: int) -> None:
        self._lost = circuit.lost
        self._arrived = 0
        self._service = circuit.service * 1e9
        self._sigma = circuit.jitter * 1e9
        self._tick = circuit.tick * 1e9
        self._seed = seed
        self._busy_until = -np.inf
        self._done = 0
        self._waiting: Events | None = None

    def __call__(self, events: Events, until_ns: float, final: bool) -> Events:
        """Events as read out; those that a later event could still overtake wait, unless this is the `final` chunk.

        events: the next chunk in order of time;  until_ns: no later event arrives before this.
        """
        if self._lost > 0:
            arrived, self._arrived = self._arrived, self._arrived + len(events)
            events = events.select(kept(len(events), self._lost, arrived, self._seed))
        t = events.t
        if self._service > 0:
            out = np.empty_like(t)
            self._busy_until = queue(t, self._service, self._busy_until, out)
            t = out
        if self._sigma > 0:
            events, t = self._jittered(events, t, until_ns, final)
        if self._tick > 0:
            t = quantise(t, self._tick)
        tick_ns = round(self._tick) if self._tick >= 1 and abs(self._tick - round(self._tick)) < 1e-6 else 1
        return Events(t, events.x, events.y, events.p, events.width, events.height, tick_ns)

    def _jittered(self, events: Events, t: np.ndarray, until_ns: float, final: bool) -> tuple[Events, np.ndarray]:
        t = jitter(t, self._sigma, self._done, self._seed)
        self._done += len(t)
        x, y, p = events.x, events.y, events.p
        if self._waiting is not None:
            held = self._waiting
            t, x, y, p = (np.concatenate(pair) for pair in ((held.t, t), (held.x, x), (held.y, y), (held.p, p)))
        order = np.lexsort((x, y, t))
        largest_draw_sigmas = 8.7  # `random.normal_pair` never exceeds them
        ready = len(t) if final else int(np.searchsorted(t[order], until_ns - largest_draw_sigmas * self._sigma))
        now, later = order[:ready], order[ready:]
        size = events.width, events.height
        self._waiting = Events(t[later], x[later], y[later], p[later], *size)
        return Events(t[now], x[now], y[now], p[now], *size), t[now]
