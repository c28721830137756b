"""True times behind delayed or rounded timestamps: drawn from what the model and the readout allow.

A readout leaves of each event time a window lo … hi: of an event that waited in a queue, from the arrival of the one
that began the busy period to its own departure less one service time; of a rounded one, the tick around it.  Given
the circuit, event k's own interval says when it came, z(t_k) ~ N(M, s²) with slope r = dz/dt, and so does the
interval that begins with it, whose level moves by g = dz'/dt_k.  The times are drawn from the product, a normal cut
to its window,

    1/v = r²/s² + g²/s'²        m = t_k + v (r (M − z)/s² + g (M' − z')/s'²)

every other event of a pixel in turn (Gibbs sampling; Tanner & Wong 1987, JASA 82, 528).  Refits and draws alternate
(stochastic EM; Celeux & Diebolt 1985), after which everything else sees events as if the readout were perfect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr, ndtri

from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import Model
from pixelid.recordings.recording import Recording
from pixelid.simulate import simulate

CROWD = 400  # simulated pixels behind an expected number of events
NUDGE_S = 1e-7  # of the release, to find its slope


@dataclass(frozen=True)
class Windows:
    """One recording's windows.

    lo, hi: (n,) ns, in the order of its events; equal where the time is exact
    """

    lo: np.ndarray
    hi: np.ndarray


def queue_windows(recording: Recording, service_s: float) -> Windows:
    """When the events of a recording can have arrived at a server of that service time."""
    t = recording.events.t.astype(float)
    service = service_s * 1e9
    slack = 2.0 * recording.events.tick_ns + 1e-6 * service
    waited = np.concatenate([[False], np.diff(t) <= service + slack])
    begins = np.maximum.accumulate(np.where(waited, -1, np.arange(len(t)))) if len(t) else np.empty(0, int)
    arrival = t - service
    return Windows(np.minimum(arrival[begins], arrival), arrival)


def tick_windows(recording: Recording, tick_s: float) -> Windows:
    """When rounded events can have come."""
    t = recording.events.t.astype(float)
    half = 0.5e9 * tick_s
    return Windows(t - half, t + half)


def beginning(recordings: Sequence[Recording], windows: Sequence[Windows], early: bool) -> list[np.ndarray]:
    """First guesses of the times (n,) ns: where windows begin (`early`), or their middles."""
    return [_ordered(r, w.lo if early else 0.5 * (w.lo + w.hi)) for r, w in zip(recordings, windows, strict=True)]


def ranked(
    recordings: Sequence[Recording], windows: Sequence[Windows], model: Model, pixels: int, seed: int
) -> list[np.ndarray]:
    """First guesses of the times (n,) ns of queued events, from how fast `pixels` pixels of the model fire together.

    First come, first served keeps the order: the k-th event of a busy period is the k-th of all pixels to fire since
    it began, so it came about when the expected number of events since then was k.
    """
    found = []
    for i, (recording, window) in enumerate(zip(recordings, windows, strict=True)):
        assert recording.stimulus is not None
        copies = max(1, round(CROWD / pixels))
        crowd = simulate(model, recording.stimulus, width=copies * pixels, height=1, seed=seed + i).events
        when, number = crowd.t.astype(float), np.arange(len(crowd)) / copies
        begins = window.hi <= window.lo
        head = np.maximum.accumulate(np.where(begins, np.arange(len(begins)), 0))
        if len(when) < 2 or not len(head):
            found.append(window.lo.copy())
            continue
        since = np.arange(len(head)) - head
        expected = np.interp(np.interp(window.lo[head], when, number) + since, number, when)
        found.append(_ordered(recording, np.clip(expected, window.lo, window.hi)))
    return found


def with_times(recordings: Sequence[Recording], times: Sequence[np.ndarray]) -> list[Recording]:
    """The recordings at other times (n,) ns, given in the order of their events."""
    found = []
    for recording, t in zip(recordings, times, strict=True):
        order = np.argsort(t, kind="stable")
        events = recording.events.select(order)
        events = replace(events, t=np.maximum(np.rint(t[order]), 0).astype(np.int64), tick_ns=1)
        found.append(replace(recording, events=events))
    return found


def drawn(
    recordings: Sequence[Recording], windows: Sequence[Windows], times: Sequence[np.ndarray], model: Model,
    rng: np.random.Generator,
) -> list[np.ndarray]:  # fmt: skip
    """One Gibbs sweep over all times, (n,) ns per recording, from the previous ones."""
    times = [t.copy() for t in times]
    for parity in (0, 1):
        current = with_times(recordings, times)
        likelihood = EventTimes(current)
        circuit = model.circuit()
        gathered = likelihood.gathered(circuit)
        terms = likelihood.terms(circuit, gathered)
        later = circuit.with_(refractory=circuit.refractory + NUDGE_S)
        moved = likelihood.terms(later, likelihood.gathered(later, locate=False))
        lost = terms.stray | moved.stray
        release = np.where(lost, 0.0, (moved.z - terms.z) / NUDGE_S)
        rate = np.where(lost, 0.0, np.exp(terms.log_rate))
        pull = (terms.group_mean[likelihood.group] - terms.z) / terms.scale**2
        pull = np.where(lost, 0.0, pull)
        weight = 1.0 / terms.scale**2
        first = np.concatenate([[0], np.cumsum([len(iv) for iv in likelihood.intervals])])
        for i, (recording, window) in enumerate(zip(recordings, windows, strict=True)):
            part = slice(first[i], first[i + 1])
            order = np.argsort(times[i], kind="stable")
            n = len(order)
            ends = order[likelihood.intervals[i].event]  # which event ends each interval, in the recording's order
            begins = _previous(recording, times[i])[ends]
            precision, push = np.zeros(n), np.zeros(n)
            np.add.at(precision, ends, rate[part] ** 2 * weight[part])
            np.add.at(push, ends, rate[part] * pull[part])
            np.add.at(precision, begins, release[part] ** 2 * weight[part])
            np.add.at(push, begins, release[part] * pull[part])
            mine = (_rank(recording, times[i]) % 2 == parity) & (window.hi > window.lo)
            adrift = np.flatnonzero(mine & (precision == 0))
            # nothing speaks for any time: start anew between the pixel's events before and after
            before = _previous(recording, times[i])
            after = np.full(n, -1)
            after[before[before >= 0]] = np.flatnonzero(before >= 0)
            dead = 1e9 * float(circuit.refractory)
            low = np.where(before >= 0, np.maximum(window.lo, times[i][before] + dead), window.lo)[adrift]
            high = np.where(after >= 0, np.minimum(window.hi, times[i][after] - dead), window.hi)[adrift]
            times[i][adrift] = np.clip(rng.uniform(low, np.maximum(low, high)), window.lo[adrift], window.hi[adrift])
            at = np.flatnonzero(mine & (precision > 0))
            sd = 1e9 / np.sqrt(precision[at])
            mean = times[i][at] + 1e9 * push[at] / precision[at]
            low, high = (ndtr((edge[at] - mean) / sd) for edge in (window.lo, window.hi))
            u = rng.uniform(low, high)
            inside = (high - low) > 1e-12
            draw = mean + sd * ndtri(np.clip(u, 1e-15, 1 - 1e-15))
            nearest = np.where(mean > window.hi[at], window.hi[at], window.lo[at])
            times[i][at] = np.clip(np.where(inside, draw, nearest), window.lo[at], window.hi[at])
            times[i] = _ordered(recording, times[i])
    return times


def _ordered(recording: Recording, t: np.ndarray) -> np.ndarray:
    """The times with each pixel's events in the order they were read out."""
    t = t.copy()
    order = np.argsort(recording.events.pixel, kind="stable")
    pixel = recording.events.pixel[order]
    for chunk in np.split(order, np.flatnonzero(np.diff(pixel)) + 1):
        t[chunk] = np.maximum.accumulate(t[chunk] + 0.0)
    return t


def _previous(recording: Recording, t: np.ndarray) -> np.ndarray:
    """(n,) index of the same pixel's event before, −1 for its first."""
    order = np.lexsort((t, recording.events.pixel))
    pixel = recording.events.pixel[order]
    before = np.full(len(t), -1)
    same = np.flatnonzero(pixel[1:] == pixel[:-1]) + 1
    before[order[same]] = order[same - 1]
    return before


def _rank(recording: Recording, t: np.ndarray) -> np.ndarray:
    """(n,) how many events of the same pixel came before."""
    order = np.lexsort((t, recording.events.pixel))
    pixel = recording.events.pixel[order]
    start = np.maximum.accumulate(np.where(np.concatenate([[True], np.diff(pixel) != 0]), np.arange(len(t)), 0))
    rank = np.empty(len(t), np.int64)
    rank[order] = np.arange(len(t)) - start
    return rank
