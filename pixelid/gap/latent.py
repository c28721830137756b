"""True times behind delayed, rounded or jittered timestamps: drawn from what the model and the readout allow.

A readout leaves of each event time a window lo … hi: of an event that waited in a queue, from the arrival of the one
that began the busy period to its own departure less one service time; of a rounded one, the tick around it; or, of a
jittered one, a normal of spread σ about its stamp a.  Given the circuit, event k's own interval says when it came,
z(t_k) ~ N(M, s²) with slope r = dz/dt, and so does the interval that begins with it, whose level moves by
g = dz'/dt_k.  The times are drawn from the product, a normal cut to its window and kept the dead time apart from the
pixel's events before and after,

    1/v = r²/s² + g²/s'² + 1/σ²        m = t_k + v (r (M − z)/s² + g (M' − z')/s'² + (a − t_k)/σ²)

every other event of a pixel in turn (Gibbs sampling; Tanner & Wong 1987, JASA 82, 528), and in the end kept or not by
what the density itself says there (Metropolis–Hastings): near an extreme of the light, r is no constant.  Refits and
draws alternate (stochastic EM; Celeux & Diebolt 1985), after which everything else sees events as if the readout were
perfect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import isotonic_regression, minimize_scalar
from scipy.special import expit, ndtr, ndtri

from pixelid.likelihood.event_times import STRAY_HZ, EventTimes
from pixelid.model.model import Model
from pixelid.recordings.recording import Recording
from pixelid.simulate import simulate

CROWD = 400  # simulated pixels behind an expected number of events
NUDGE_S = 1e-7  # of the release, to find its slope
STEEPEST = 1e4  # level per second by which a release can matter
CAP = 8.0  # nats that one event's jitter may cost: farther ones have other causes
TELLING = 0.3  # what the intervals say of an event's time, over what its stamp does: enough to judge the stamp by
SPREAD = 1.1  # times the dead time that first guesses are apart


@dataclass(frozen=True)
class Windows:
    """One recording's windows.

    lo, hi: (n,) ns, in the order of its events; equal where the time is exact
    stamp: (n,) ns, about which times scatter, and sd: ns, by how much; without jitter nothing but the window counts
    """

    lo: np.ndarray
    hi: np.ndarray
    stamp: np.ndarray | None = None
    sd: float = np.inf


@dataclass(frozen=True)
class Draw:
    """Times drawn, and what the stamps were like beside them.

    times: (n,) ns per recording;  miss, variance: (m,) ns and ns², of events whose intervals tell enough: by how much
    the stamp misses the time that the model expects, and how uncertain that is
    """

    times: list[np.ndarray]
    miss: np.ndarray
    variance: np.ndarray


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


def jitter_windows(recording: Recording, sigma_s: float) -> Windows:
    """When jittered events can have come."""
    assert recording.stimulus is not None
    n, light = len(recording.events), recording.stimulus.t
    lo, hi = (np.full(n, edge) for edge in (np.ceil(1e9 * light[0]), np.floor(1e9 * light[-1])))
    return Windows(lo, hi, recording.events.t.astype(float), 1e9 * sigma_s)


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
    rng: np.random.Generator, exact: bool = False,
) -> Draw:  # fmt: skip
    """One sweep over all times, (n,) ns per recording, from the previous ones.

    exact: draws are kept or not by what the density says of them, twice the work; far from the truth they get stuck
    """
    times = [t.copy() for t in times]
    misses, variances = [], []
    for parity in (0, 1):
        here = _told(recordings, windows, times, model)
        moved, bounds = [], []
        for recording, window, t, told in zip(recordings, windows, times, here, strict=True):
            at = np.flatnonzero((_rank(recording, t) % 2 == parity) & (window.hi > window.lo))
            low, high = _bounds(recording, window, t, 1e9 * float(model.circuit().refractory))
            bounds.append((at, low[at], high[at]))
            moved.append(t.copy())
            moved[-1][at] = _cut_normal(t[at], told.precision[at], told.push[at], low[at], high[at], rng)
            if window.stamp is not None:
                own = told.precision - 1.0 / window.sd**2
                known = at[own[at] * window.sd**2 > TELLING]
                push = told.push[known] - (window.stamp - t)[known] / window.sd**2
                misses.append(window.stamp[known] - t[known] - push / own[known])
                variances.append(1.0 / own[known])
        there = _told(recordings, windows, moved, model) if exact else None
        for i, (recording, (at, low, high)) in enumerate(zip(recordings, bounds, strict=True)):
            if there is None:
                times[i] = _ordered(recording, moved[i])
                continue
            x, y, told, other = times[i][at], moved[i][at], here[i], there[i]
            forth = _log_cut_normal(y, x, told.precision[at], told.push[at], low, high)
            back = _log_cut_normal(x, y, other.precision[at], other.push[at], low, high)
            gain = other.score[at] - told.score[at] + back - forth
            times[i][at] = np.where(np.log(rng.random(len(at))) < gain, y, x)
            times[i] = _ordered(recording, times[i])
    none = np.empty(0)
    return Draw(times, np.concatenate([none, *misses]), np.concatenate([none, *variances]))


@dataclass(frozen=True)
class _Told:
    """What is said of each event of a recording (n,): precision 1/ns² and push 1/ns of a normal about its present time,
    and the log density of that time."""

    precision: np.ndarray
    push: np.ndarray
    score: np.ndarray


def _told(
    recordings: Sequence[Recording], windows: Sequence[Windows], times: Sequence[np.ndarray], model: Model
) -> list[_Told]:
    """By the interval that an event ends, by the one that it begins, and by its stamp."""
    likelihood, circuit = EventTimes(with_times(recordings, times)), model.circuit()
    later = circuit.with_(refractory=circuit.refractory + NUDGE_S)
    here = likelihood.terms(circuit)
    there = likelihood.terms(later, likelihood.gathered(later, locate=False))
    mute = np.zeros(likelihood.events, bool)  # where the model cannot have fired
    for terms in (here, there):
        mute |= (terms.z == 0.0) & (terms.log_rate == 0.0)
    lacks = np.where(mute, 0.0, here.group_mean[likelihood.group] - here.z)
    weight = np.where(mute, 0.0, 1e-18 / here.scale**2)
    score = here.log_rate - np.log(here.scale) - 0.5 * (lacks / here.scale) ** 2 - 0.5 * np.log(2.0 * np.pi)
    score = np.where(mute, -np.inf, score)
    score = np.maximum(score, np.log(STRAY_HZ))
    slopes = np.where(mute, 0.0, np.exp(here.log_rate)), np.clip((there.z - here.z) / NUDGE_S, -STEEPEST, STEEPEST)
    found, first = [], 0
    for recording, window, t, intervals in zip(recordings, windows, times, likelihood.intervals, strict=True):
        part = slice(first, first + len(intervals))
        first += len(intervals)
        ends = np.argsort(t, kind="stable")[intervals.event]  # which event ends each interval
        precision, push, total = np.zeros(len(t)), np.zeros(len(t)), np.zeros(len(t))
        for at, slope in zip((ends, _previous(recording, t)[ends]), slopes, strict=True):
            np.add.at(precision, at, slope[part] ** 2 * weight[part])
            np.add.at(push, at, 1e9 * slope[part] * lacks[part] * weight[part])
            np.add.at(total, at, score[part])
        if window.stamp is not None:
            precision += 1.0 / window.sd**2
            push += (window.stamp - t) / window.sd**2
            total -= 0.5 * ((window.stamp - t) / window.sd) ** 2
        found.append(_Told(precision, push, total))
    return found


def _bounds(recording: Recording, window: Windows, t: np.ndarray, dead: float) -> tuple[np.ndarray, np.ndarray]:
    """(low, high) (n,) ns: the window, and a dead time from the pixel's events before and after where there is room."""
    before = _previous(recording, t)
    after = np.full(len(t), -1)
    after[before[before >= 0]] = np.flatnonzero(before >= 0)
    low = np.where(before >= 0, np.maximum(window.lo, t[before] + dead), window.lo)
    high = np.where(after >= 0, np.minimum(window.hi, t[after] - dead), window.hi)
    room = (high > low) & (t >= low) & (t <= high)  # else its neighbours are too near, and will be moved in their turn
    return np.where(room, low, window.lo), np.where(room, high, window.hi)


def _normal(t, precision, push) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(where anything speaks for a time, mean, standard deviation) (n,)."""
    told = precision > 0
    sd = 1.0 / np.sqrt(np.where(told, precision, 1.0))
    return told, t + np.where(told, push, 0.0) * sd**2, sd


def _cut_normal(t, precision, push, low, high, rng) -> np.ndarray:
    """Draws (n,) from normals about t + push/precision cut to low … high; uniform where nothing speaks for any time."""
    told, mean, sd = _normal(t, precision, push)
    p_low, p_high = (ndtr((edge - mean) / sd) for edge in (low, high))
    u = rng.uniform(p_low, np.maximum(p_low, p_high))
    draw = mean + sd * ndtri(np.clip(u, 1e-15, 1 - 1e-15))
    near = np.where(p_high - p_low > 1e-12, draw, np.where(mean > high, high, low))
    anywhere = rng.uniform(np.where(told, 0.0, low), np.where(told, 1.0, high))
    return np.clip(np.where(told, near, anywhere), low, high)


def _log_cut_normal(y, t, precision, push, low, high) -> np.ndarray:
    """Log density (n,) at y of what `_cut_normal` draws from at t."""
    told, mean, sd = _normal(t, precision, push)
    mass = np.maximum(ndtr((high - mean) / sd) - ndtr((low - mean) / sd), 1e-12)
    normal = -0.5 * ((y - mean) / sd) ** 2 - np.log(sd) - np.log(mass)
    return np.where(told, normal, -np.log(np.where(told, 1.0, np.maximum(high - low, 1.0))))


def exchanged(
    recordings: Sequence[Recording], windows: Sequence[Windows], times: Sequence[np.ndarray], rng: np.random.Generator
) -> list[Windows]:
    """The windows with stamps drawn anew: jitter lets neighbouring events of a pixel and polarity swap theirs."""
    found = []
    for recording, window, t in zip(recordings, windows, times, strict=True):
        assert window.stamp is not None
        order = np.lexsort((t, recording.events.pixel))
        pixel, polarity, stamp = recording.events.pixel[order], recording.events.p[order], window.stamp[order]
        moment = t[order]
        for start in (0, 1):
            k = np.arange(start, len(order) - 1, 2)
            k = k[(pixel[k] == pixel[k + 1]) & (polarity[k] == polarity[k + 1])]
            gain = (stamp[k + 1] - stamp[k]) * (moment[k] - moment[k + 1]) / window.sd**2
            k = k[rng.random(len(k)) < expit(gain)]
            stamp[k], stamp[k + 1] = stamp[k + 1], stamp[k]
        back = np.empty_like(stamp)
        back[order] = stamp
        found.append(replace(window, stamp=back))
    return found


def spread(draw: Draw, sd: float) -> tuple[float, float]:
    """(standard deviation of the jitter, ns, that makes the misses likeliest;  its relative standard error).

    Each event's own time is integrated over, which makes alternating draws and estimates settle sooner.  sd: the last
    """

    def loss(log_sd: float) -> float:
        variance = np.exp(2.0 * log_sd) + draw.variance
        return float(np.sum(0.5 * np.log(variance) + np.minimum(0.5 * draw.miss**2 / variance, CAP)))

    best = minimize_scalar(loss, bounds=(np.log(sd) - 0.5, np.log(sd) + 0.5), method="bounded")
    found = float(np.exp(best.x))
    told = np.sum(2.0 * (found**2 / (found**2 + draw.variance)) ** 2)
    return found, float(1.0 / np.sqrt(max(told, 1.0)))


def spaced(recordings: Sequence[Recording], windows: Sequence[Windows], dead_s: float) -> list[np.ndarray]:
    """The times (n,) ns nearest to the stamps, by squares, with a pixel's events a dead time apart at least."""
    gap, found = SPREAD * 1e9 * dead_s, []
    for recording, window in zip(recordings, windows, strict=True):
        assert window.stamp is not None
        t = window.stamp
        order = np.lexsort((t, recording.events.pixel))
        out = t.copy()
        for chunk in np.split(order, np.flatnonzero(np.diff(recording.events.pixel[order])) + 1):
            if len(chunk):
                least = gap * np.arange(len(chunk))
                out[chunk] = isotonic_regression(t[chunk] - least).x + least
        found.append(np.clip(out, window.lo, window.hi))
    return found


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
