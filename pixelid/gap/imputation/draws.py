"""Event times drawn from what the model and the readout allow.

Given the circuit, event k's own interval says when it came, z(t_k) ~ N(M, s²) with slope r = dz/dt, and so does the
interval that begins with it, whose level moves by g = dz'/dt_k.  With a stamp a that scatters by σ, the times are drawn
from the product, a normal cut to its window (`windows.py`) and kept the dead time apart from the pixel's events before
and after,

    1/v = r²/s² + g²/s'² + 1/σ²        m = t_k + v (r (M − z)/s² + g (M' − z')/s'² + (a − t_k)/σ²)

every other event of a pixel in turn (Gibbs sampling; Tanner & Wong 1987, JASA 82, 528), and in the end kept or not by
what the density itself says there (Metropolis–Hastings): near an extreme of the light, r is no constant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri

from pixelid.gap.imputation.windows import Windows, in_order, with_times
from pixelid.likelihood.density import BACKGROUND_HZ
from pixelid.likelihood.event_times import NUDGE_S, EventTimes
from pixelid.model.model import Model
from pixelid.recordings.recording import Recording


@dataclass(frozen=True)
class Draw:
    """Times drawn, and what the stamps were like beside them.

    times: (n,) ns per recording;  miss, variance: (m,) ns and ns², of events whose intervals tell enough: by how much
    the stamp misses the time that the model expects, and how uncertain that is
    """

    times: list[np.ndarray]
    miss: np.ndarray
    variance: np.ndarray


def draw_times(
    recordings: Sequence[Recording], windows: Sequence[Windows], times: Sequence[np.ndarray], model: Model,
    rng: np.random.Generator, exact: bool = False, reordered: bool = False,
) -> Draw:  # fmt: skip
    """One sweep over all times, (n,) ns per recording, from the previous ones.

    exact: draws are kept or not by what the density says of them, twice the work; far from the truth they get stuck
    reordered: a pixel's events need not be in the order they were read out, and what has no room stays where it is
    """
    times = [t.copy() for t in times]
    misses, variances = [], []
    min_information_ratio = 0.3  # of what intervals say of a time to what its stamp says: enough to judge the stamp by
    for parity in (0, 1):
        here = _conditionals(recordings, windows, times, model)
        moved, bounds = [], []
        for recording, window, t, told in zip(recordings, windows, times, here, strict=True):
            at = np.flatnonzero((_rank(recording, t) % 2 == parity) & (window.hi > window.lo))
            low, high = _bounds(recording, window, t, 1e9 * float(model.circuit().refractory), reordered)
            bounds.append((at, low[at], high[at]))
            moved.append(t.copy())
            moved[-1][at] = _cut_normal(t[at], told.precision[at], told.push[at], low[at], high[at], rng)
            if window.stamp is not None:
                by_intervals = told.precision - 1.0 / window.sd**2
                known = at[by_intervals[at] * window.sd**2 > min_information_ratio]
                push = told.push[known] - (window.stamp - t)[known] / window.sd**2
                misses.append(window.stamp[known] - t[known] - push / by_intervals[known])
                variances.append(1.0 / by_intervals[known])
        there = _conditionals(recordings, windows, moved, model) if exact else None
        for i, (recording, (at, low, high)) in enumerate(zip(recordings, bounds, strict=True)):
            if there is None:
                times[i] = moved[i] if reordered else in_order(recording, moved[i])
                continue
            x, y, told, other = times[i][at], moved[i][at], here[i], there[i]
            forth = _log_cut_normal(y, x, told.precision[at], told.push[at], low, high)
            back = _log_cut_normal(x, y, other.precision[at], other.push[at], low, high)
            gain = other.score[at] - told.score[at] + back - forth
            times[i][at] = np.where(np.log(rng.random(len(at))) < gain, y, x)
            times[i] = times[i] if reordered else in_order(recording, times[i])
    none = np.empty(0)
    return Draw(times, np.concatenate([none, *misses]), np.concatenate([none, *variances]))


@dataclass(frozen=True)
class _Conditional:
    """What is said of each event of a recording (n,): precision 1/ns² and push 1/ns of a normal about its present time,
    and the log density of that time."""

    precision: np.ndarray
    push: np.ndarray
    score: np.ndarray


def _conditionals(
    recordings: Sequence[Recording], windows: Sequence[Windows], times: Sequence[np.ndarray], model: Model
) -> list[_Conditional]:
    """By the interval that an event ends, by the one that it begins, and by its stamp."""
    likelihood, circuit = EventTimes(with_times(recordings, times)), model.circuit()
    later = circuit.with_(refractory=circuit.refractory + NUDGE_S)
    here = likelihood.terms(circuit)
    there = likelihood.terms(later, likelihood.changes(later, here.changes))
    mute = np.zeros(likelihood.events, bool)  # where the model cannot have fired
    for terms in (here, there):
        mute |= (terms.z == 0.0) & (terms.log_rate == 0.0)
    lacks = np.where(mute, 0.0, here.group_mean[likelihood.group] - here.z)
    weight = np.where(mute, 0.0, 1e-18 / here.scale**2)
    score = here.log_rate - np.log(here.scale) - 0.5 * (lacks / here.scale) ** 2 - 0.5 * np.log(2.0 * np.pi)
    score = np.where(mute, -np.inf, score)
    score = np.maximum(score, np.log(BACKGROUND_HZ))
    max_slope_hz = 1e4  # level per second by which a release can matter: steeper is rounding
    slopes = (
        np.where(mute, 0.0, np.exp(here.log_rate)),
        np.clip((there.z - here.z) / NUDGE_S, -max_slope_hz, max_slope_hz),
    )
    conditionals, first = [], 0
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
        conditionals.append(_Conditional(precision, push, total))
    return conditionals


def _bounds(
    recording: Recording, window: Windows, t: np.ndarray, dead: float, held: bool
) -> tuple[np.ndarray, np.ndarray]:
    """(low, high) (n,) ns: the window, and a dead time from the pixel's events before and after where there is room.

    held: else nothing but the present time
    """
    before = _previous(recording, t)
    after = np.full(len(t), -1)
    after[before[before >= 0]] = np.flatnonzero(before >= 0)
    low = np.where(before >= 0, np.maximum(window.lo, t[before] + dead), window.lo)
    high = np.where(after >= 0, np.minimum(window.hi, t[after] - dead), window.hi)
    room = (high > low) & (t >= low) & (t <= high)  # else its neighbours are too near, and will be moved in their turn
    return np.where(room, low, t if held else window.lo), np.where(room, high, t if held else window.hi)


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
