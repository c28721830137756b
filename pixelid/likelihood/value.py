"""The log-likelihood of event times without derivatives, in one compiled pass per thing that sums over events.

The formulas are those of `event_times.py`; samplers and anything else that only compares points call this, and get
the total with its parts by pixel and by recording.  Logarithms are taken a block of events at a time, in vector form.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from pixelid.dynamics.vector_math import vlog
from pixelid.likelihood.density import NUMBERS, survived
from pixelid.stages.circuit import Circuit

if TYPE_CHECKING:
    from pixelid.likelihood.event_times import EventTimes


@dataclass(frozen=True)
class Value:
    """The log-likelihood.

    per_pixel: (pixels,), sums to the total;  per_recording: (recordings,), given the thresholds' posterior: what is
    left of the total is the thresholds' own (as in `Terms`)
    """

    total: float
    per_pixel: np.ndarray
    per_recording: np.ndarray


def value(likelihood: EventTimes, circuit: Circuit, gathered: np.ndarray) -> Value:
    """The log-likelihood of a likelihood's events under a real circuit; `gathered`: `likelihood.gathered(circuit)`."""
    from pixelid.likelihood.event_times import MISSED, STRAY_HZ

    n, m = likelihood.events, len(likelihood.last_pixel)
    numbers = tuple(float(getattr(circuit, name)) for name in NUMBERS)
    per_pixel, per_recording = np.zeros(likelihood.pixels), np.zeros(len(likelihood.recordings))
    event = gathered[: 7 * n].reshape(7, n)
    z, rate, variance, falling = np.empty(n), np.empty(n), np.empty(n), np.empty(n, np.bool_)
    _levels(
        likelihood.sign,
        likelihood.time_s,
        likelihood.tick_s,
        likelihood.clock_share,
        event,
        numbers,
        z,
        rate,
        variance,
        falling,
    )
    _sum(
        likelihood.group, likelihood.time_s, likelihood.recording_of_event, event[4], event[5],
        likelihood.last_pixel, likelihood.last_time_s, likelihood.recording_of_last,
        gathered[7 * n :].reshape(4, m), numbers, math.log(STRAY_HZ), MISSED,
        z, rate, variance, falling, per_pixel, per_recording,
    )  # fmt: skip
    return Value(float(per_pixel.sum()), per_pixel, per_recording)


@njit(cache=True, nogil=True, error_model="numpy")
def _levels(sign, time, tick, share, event, numbers, z, rate, variance, falling):
    """Fill level, its rate, its variance, and whether the event cannot be the circuit's; as in `density._density`."""
    on, off, noise, _, drift, jitter = numbers
    noise_on, noise_off = (noise * on) ** 2, (noise * off) ** 2
    change, slope, leak, leak_rate, early = event[0], event[1], event[2], event[3], event[6]
    for k in range(len(z)):
        growth = 1.0 + drift * time[k]
        scale = sign[k] / growth
        z[k] = scale * (change[k] + on * leak[k])
        rate[k] = scale * (slope[k] + on * leak_rate[k]) - z[k] * drift / growth
    for k in range(len(z)):
        falling[k] = (not rate[k] > 0.0) or early[k] > 0.0 or (not abs(z[k]) < 1e6) or (not rate[k] < 1e12)
    for k in range(len(z)):
        z[k] = 0.0 if falling[k] else z[k]
        rate[k] = 1.0 if falling[k] else rate[k]
    for k in range(len(z)):
        width = share[k] * (tick[k] * tick[k] / 12.0 + jitter * jitter)
        variance[k] = (noise_on if sign[k] > 0.0 else noise_off) + rate[k] * rate[k] * width


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _logs(rate, variance, extra, group, out):
    """Fill out with log N at its centre times the rate: ½ log(r²/(2π (V + extra of the group)))."""
    for k in range(len(out)):
        out[k] = variance[k] + extra[group[k]]
    for k in range(len(out)):
        out[k] = 0.5 * vlog(rate[k] * rate[k] / (6.283185307179586 * out[k]))


@njit(cache=True, nogil=True, error_model="numpy")
def _own_variance(group, C, own, noise, variance):
    """Noise that scales with each group's own threshold instead of the population's C."""
    more = np.empty(len(C))
    for g in range(len(C)):
        more[g] = (noise * own[g]) ** 2 - (noise * C[g]) ** 2
    for k in range(len(group)):
        variance[k] += more[group[k]]


@njit(cache=True, nogil=True, error_model="numpy")
def _sum(
    group, time, recording, opposite, opposite_drift, last_pixel, last_time, recording_of_last, pixel, numbers,
    log_stray, missed, z, rate, variance, falling, per_pixel, per_recording,
):  # fmt: skip
    on, off, noise, mismatch, drift, _ = numbers
    n, groups = len(z), 2 * len(per_pixel)
    C, S, W, A = np.empty(groups), np.empty(groups), np.empty(groups), np.empty(groups)
    for g in range(groups):
        C[g] = on if g % 2 == 1 else off
        S[g] = (mismatch * C[g]) ** 2
    # strays: first against the population, then against their group
    centre, extra, logs = C.copy(), S.copy(), np.empty(n)
    stray = falling
    for _ in range(2):
        _logs(rate, variance, extra, group, logs)
        W[:] = 0.0
        A[:] = 0.0
        stray = np.empty(n, np.bool_)
        for k in range(n):
            g = group[k]
            away = z[k] - centre[g]
            stray[k] = falling[k] or logs[k] - 0.5 * away * away / (variance[k] + extra[g]) < log_stray
            if not stray[k]:
                w = 1.0 / variance[k]
                W[g] += w
                A[g] += z[k] * w
        for g in range(groups):
            q = 1.0 + S[g] * W[g]
            centre[g] = (C[g] + S[g] * A[g]) / q
            extra[g] = S[g] / q
    _own_variance(group, C, centre, noise, variance)
    W[:] = 0.0
    A[:] = 0.0
    for k in range(n):
        if not stray[k]:
            w = 1.0 / variance[k]
            W[group[k]] += w
            A[group[k]] += z[k] * w
    # groups
    mean, sd, own = np.zeros(groups), np.empty(groups), np.zeros(groups)
    for g in range(groups):
        q = 1.0 + S[g] * W[g]
        centre[g] = (C[g] + S[g] * A[g]) / q
        sd[g] = math.sqrt((noise * centre[g]) ** 2 + S[g] / q)
        if W[g] > 0.0:
            mean[g] = A[g] / W[g]
            away = mean[g] - C[g]
            own[g] = -0.5 * math.log(1.0 + S[g] * W[g]) - 0.5 * away * away / (S[g] + 1.0 / W[g])
    # events, and the survival of the other polarity
    zero = np.zeros(groups)
    _logs(rate, variance, zero, group, logs)
    given = np.zeros(len(per_recording))
    for k in range(n):
        g = group[k]
        away = z[k] - mean[g]
        term = log_stray if stray[k] else logs[k] - 0.5 * away * away / variance[k]
        reached = opposite[k] + on * opposite_drift[k]
        if reached > 0.0:
            reached /= 1.0 + drift * time[k]
            term += survived((centre[g ^ 1] - reached) / sd[g ^ 1], missed)[0]
        own[g] += term
        given[recording[k]] += term
    for i in range(len(last_pixel)):
        for side in range(2):
            g = 2 * last_pixel[i] + 1 - side
            reached = (pixel[2 * side, i] + on * pixel[2 * side + 1, i]) / (1.0 + drift * last_time[i])
            term = survived((centre[g] - reached) / sd[g], missed)[0]
            own[g] += term
            given[recording_of_last[i]] += term
    for i in range(len(per_pixel)):
        per_pixel[i] = own[2 * i] + own[2 * i + 1]
    for i in range(len(given)):
        per_recording[i] = given[i]
