"""Per-pixel event-time likelihood (DESIGN §4): what the measured times say, each previous event given.

With z_k = sign · change(t_k) and rate r_k = dz/dt at event k, a threshold C_i of pixel i and polarity that is
drawn anew for each event with standard deviation s_k, the density of the event time is

    N(z_k; C_i, s_k²) · r_k · Φ((C_i' − m_k)/s')

the last factor being the chance that the other polarity's threshold C_i' stayed above the extreme m_k that
−z reached on the way.  (That t_k is the first crossing needs no factor: had an earlier z exceeded the threshold
drawn, z_k could not equal it.)  The interval that the end of the recording cuts off contributes the chance that
neither threshold was reached.

Where thresholds drift, C(t) = C (1 + d·t), z is the change over 1 + d·t, whose rate has a part −z·d/(1 + d·t).

s_k² = (σ C_i)² + q_k r_k² (tick²/12 + jitter²): threshold noise scales with the pixel's own threshold, and a
timestamp's width is noise in time (q_k: `weigh_clock`).  For C_i in s_k stands its posterior mean under s_k² with the
population's C, known to a few tenths of a percent where a pixel has a hundred events.  (With the population's C there,
the scatter of events would pretend to tell the population's thresholds, and their intervals would be some 10 % too
short.)

Pixel-to-pixel mismatch, C_i ~ N(C, τ²), is integrated out in closed form.  For a group (pixel, polarity) with
weights 1/s_k², W their sum and z̄ the weighted mean,

    ∫ Π N(z_k; C_i, s_k²) N(C_i; C, τ²) dC_i
        = Π N(z_k; z̄, s_k²) · √(2π/W) · N(z̄; C, τ² + 1/W).

The survival factors use the group's posterior mean and variance of C_i in place of C_i.

**Strays.**  A pixel also fires now and then for reasons no circuit explains.  Each polarity of each pixel has a
background of STRAY_HZ; an event better explained by it (falling change, or a level many σ from its threshold)
counts as a stray: it contributes log STRAY_HZ and says nothing about thresholds.  So a model that misses an effect
pays a bounded price per event it cannot explain, instead of bending every parameter to it.  Under a true model
one event in 10⁵ or fewer is called a stray.  Likewise a crossing goes missing with probability MISSED, which bounds
the price of an event that the model expects and the recording lacks.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from pixelid.errors import InputError
from pixelid.likelihood.changes import ChangeEvaluator, Changes
from pixelid.likelihood.normal import log_ndtr
from pixelid.likelihood.sequences import sequences
from pixelid.likelihood.value import value
from pixelid.recordings.recording import Recording
from pixelid.stages.circuit import Circuit

_POOL = ThreadPoolExecutor(os.cpu_count() or 1)

STRAY_HZ = 1e-3
MISSED = 1e-6
NUDGE_S = 1e-7  # of the release, to find how a level depends on it
MOST_SHARE = 100.0
OF_LEVEL = 4  # the first rows of `Changes` per event: those that belong to the level of the event's own polarity
LARGE = 60_000  # samples and events, a few milliseconds of work, from which handing it to other threads pays


@dataclass(frozen=True)
class Terms:
    """The pieces of the log-likelihood, and what residual plots and diagnostics need.

    z, log_rate, scale: (n,) level at the event, log of its rate, its standard deviation
    stray: (n,) events left to the background
    reached: (n,) extreme that the other polarity's level had reached before the event
    weighted_mean, weight_sum: (g,) of z per (pixel, polarity) group;  centre: (g,) population threshold
    mean_variance: (g,) variance of weighted_mean about centre
    group_mean, group_variance: (g,) posterior of each group's threshold
    per_pixel: (pixels,) log-likelihood;  total: their sum
    per_recording: (recordings,) log-likelihood given the thresholds' posterior; what is left of the total is theirs
    """

    z: np.ndarray
    log_rate: np.ndarray
    scale: np.ndarray
    stray: np.ndarray
    reached: np.ndarray
    weighted_mean: np.ndarray
    weight_sum: np.ndarray
    centre: np.ndarray
    mean_variance: np.ndarray
    group_mean: np.ndarray
    group_variance: np.ndarray
    per_pixel: np.ndarray
    total: complex | float
    per_recording: np.ndarray


class EventTimes:
    """The event-time likelihood of one or more recordings of the same pixels.

    Recordings of the same sensor and size share pixels, and so pixel thresholds.
    threshold_factor: (events,) what each event's threshold is multiplied by beside all that the circuit says, or None;
    clock_share: (events,) how often timestamp noise counts, see `weigh_clock`.
    Raises InputError for pooled recordings, a missing stimulus, or fewer than two events in any pixel.
    """

    def __init__(self, recordings: Sequence[Recording]) -> None:
        self.recordings = tuple(recordings)
        for recording in self.recordings:
            if recording.pooled:
                raise InputError(f"{recording.name}: pooled events have no pixels; use the pooled-rate likelihood")
            if recording.stimulus is not None and not recording.stimulus.full_field:
                raise InputError(f"{recording.name}: the fit needs a full-field stimulus, found one per pixel")
        self.intervals = tuple(sequences(recording) for recording in self.recordings)
        self.threshold_factor: np.ndarray | None = None
        self._evaluators = tuple(ChangeEvaluator(r, s) for r, s in zip(self.recordings, self.intervals, strict=True))
        if sum(map(len, self.intervals)) == 0:
            raise InputError("no pixel has two events: there is no interval to explain")
        self._index_pixels()
        samples = sum(len(r.stimulus.t) for r in self.recordings if r.stimulus is not None)
        self._large = samples + self.events > LARGE

    def _index_pixels(self) -> None:
        sensors: dict[tuple, int] = {}
        keys, last_keys = [], []
        for recording, iv in zip(self.recordings, self.intervals, strict=True):
            size = (recording.sensor, recording.events.width, recording.events.height)
            base = sensors.setdefault(size, len(sensors)) << 40
            keys.append(base + iv.pixel)
            last_keys.append(base + iv.last_pixel)
        every = np.concatenate([*keys, *last_keys])
        self.pixel_keys, index = np.unique(every, return_inverse=True)
        n = sum(map(len, keys))
        self.pixel = index[:n]
        self.last_pixel = index[n:]
        self.sign = np.concatenate([iv.sign for iv in self.intervals])
        self.time_s = np.concatenate([iv.time_s for iv in self.intervals])
        self.tick_s = np.concatenate([np.full(len(iv), iv.tick_s) for iv in self.intervals])
        self.recording_of_event = np.repeat(np.arange(len(self.intervals)), [len(iv) for iv in self.intervals])
        self.last_time_s = np.concatenate([np.full(len(iv.last_s), iv.end_s) for iv in self.intervals])
        self.recording_of_last = np.repeat(np.arange(len(self.intervals)), [len(iv.last_s) for iv in self.intervals])
        self.group = 2 * self.pixel + (self.sign > 0)
        self.clock_share = np.ones(len(self.sign))
        self._ends = tuple(
            np.cumsum([len(part) for part in parts])[:-1]
            for parts in (self.intervals, [iv.last_s for iv in self.intervals])
        )

    def weigh_clock(self, circuit: Circuit) -> None:
        """Count timestamp noise twice: at the event, and at the reset before, whose time is as uncertain.

        With g_k the rate at which level k falls as its release moves, clock_share becomes q_k = 1 + (g_k/r_k)² under
        this circuit (at most `MOST_SHARE`); until then it is 1.
        """
        later = circuit.with_(refractory=circuit.refractory + NUDGE_S)
        here, there = self.terms(circuit), self.terms(later, self.gathered(later, locate=False))
        moved = np.where(here.stray | there.stray, 0.0, there.z - here.z) / NUDGE_S
        self.clock_share = 1.0 + np.minimum((moved * np.exp(-here.log_rate)) ** 2, MOST_SHARE - 1.0)

    @property
    def evaluators(self) -> tuple[ChangeEvaluator, ...]:
        """What computes the changes of each recording."""
        return self._evaluators

    @property
    def events(self) -> int:
        """Number of intervals with an event at their end."""
        return len(self.sign)

    @property
    def pixels(self) -> int:
        """Number of distinct pixels with events."""
        return len(self.pixel_keys)

    def shortest_intervals_s(self, quantile: float) -> float:
        """A low quantile of the times between two events of a pixel: dead time can hardly be longer."""
        return float(np.quantile(np.concatenate([iv.time_s - iv.previous_s for iv in self.intervals]), quantile))

    def changes(self, circuit: Circuit, locate: bool = True) -> list[Changes]:
        """`Changes` of every recording under a circuit; `locate=False` keeps the extremes where they were."""
        return self._each(lambda evaluate: evaluate(circuit, locate), self._evaluators)

    def _each(self, work, *arguments) -> list:
        """[work(…) of every recording], on all cores unless there is too little to share out."""
        return list((_POOL.map if self._large else map)(work, *arguments))

    def gathered(self, circuit: Circuit, locate: bool = True) -> np.ndarray:
        """All recordings' `Changes` as one vector, in the order `terms` reads it."""
        together = self._unscaled(circuit, locate)
        if self.threshold_factor is not None:
            n = self.events
            together[: OF_LEVEL * n].reshape(OF_LEVEL, n)[:] /= self.threshold_factor
        return together

    def _unscaled(self, circuit: Circuit, locate: bool) -> np.ndarray:
        n, m = self.events, len(self.last_pixel)
        together = np.empty(7 * n + 4 * m)
        events = np.split(together[: 7 * n].reshape(7, n), self._ends[0], axis=1)
        pixels = np.split(together[7 * n :].reshape(4, m), self._ends[1], axis=1)
        self._each(lambda e, *rows: e.fill(circuit, locate, *rows), self._evaluators, events, pixels)
        return together

    def terms(self, circuit: Circuit, gathered: np.ndarray | None = None) -> Terms:
        """The likelihood's pieces under a circuit; `gathered` is `gathered(circuit)` when it is known already."""
        if gathered is None:
            gathered = self.gathered(circuit)
        n, m = self.events, len(self.last_pixel)
        change, slope, drift, drift_slope, opposite, opposite_drift, early = gathered[: 7 * n].reshape(7, n)
        rise, rise_drift, fall, fall_drift = gathered[7 * n :].reshape(4, m)
        on, off = circuit.on_threshold, circuit.off_threshold
        mean = np.where(self.sign > 0, on, off)
        growth = 1.0 + circuit.threshold_drift * self.time_s
        z = self.sign * (change + on * drift) / growth
        rate = self.sign * (slope + on * drift_slope) / growth - z * circuit.threshold_drift / growth
        # a change beyond any sensible level comes from parameters far outside physics: not worth its digits
        falling = ~(rate.real > 0) | (early.real > 0) | ~(np.abs(z.real) < 1e6) | ~(rate.real < 1e12)
        rate = np.where(falling, 1.0, rate)
        z = np.where(falling, 0.0, z)
        log_rate = np.log(rate)
        width = rate * rate * self.clock_share * (self.tick_s**2 / 12.0 + circuit.jitter**2)
        variance = (circuit.noise * mean) ** 2 + width
        group_on = np.arange(2 * self.pixels) % 2 == 1
        C = np.where(group_on, on, off)
        spread = (circuit.mismatch * C) ** 2
        stray = self._strays(falling, z.real, log_rate.real, variance.real, spread.real, C.real)
        weight = np.where(stray, 0.0, 1.0 / variance)
        own = (C + spread * sum_by(self.group, weight * z, len(C))) / (
            1.0 + spread * sum_by(self.group, weight, len(C))
        )
        variance = (circuit.noise * own[self.group]) ** 2 + width
        weight = np.where(stray, 0.0, 1.0 / variance)

        W = sum_by(self.group, weight, len(C))
        Wz = sum_by(self.group, weight * z, len(C))
        seen = W.real > 0
        safe = np.where(seen, W, 1.0)
        z_bar = Wz / safe
        mean_variance = spread + 1.0 / safe
        group_term = np.where(
            seen,
            0.5 * np.log(1.0 / (safe * mean_variance)) - 0.5 * (z_bar - C) ** 2 / mean_variance,
            0.0,
        )
        # posterior of each group's threshold: prior N(C, spread) times the events
        group_variance = np.where(seen, spread / (1.0 + spread * W), spread)
        group_mean = np.where(seen, (C + spread * Wz) / (1.0 + spread * W), C)

        within = z - z_bar[self.group]
        event_term = np.where(
            stray,
            np.log(STRAY_HZ),
            -0.5 * np.log(2.0 * np.pi * variance) - 0.5 * within * within * weight + log_rate,
        )
        survival_sd = np.sqrt((circuit.noise * group_mean) ** 2 + group_variance)
        other = self.group ^ 1
        reached = (opposite + on * opposite_drift) / growth
        event_term = event_term + np.where(
            reached.real > 0, _survived((group_mean[other] - reached) / survival_sd[other]), 0.0
        )
        last_on, last_off = 2 * self.last_pixel + 1, 2 * self.last_pixel
        grown = 1.0 + circuit.threshold_drift * self.last_time_s
        rise, fall = (rise + on * rise_drift) / grown, (fall + on * fall_drift) / grown
        censored = _survived((group_mean[last_on] - rise) / survival_sd[last_on]) + _survived(
            (group_mean[last_off] - fall) / survival_sd[last_off]
        )
        per_pixel = (
            sum_by(self.pixel, event_term, self.pixels)
            + sum_by(self.last_pixel, censored, self.pixels)
            + group_term.reshape(self.pixels, 2).sum(axis=1)
        )
        return Terms(
            z=z,
            log_rate=log_rate,
            scale=np.sqrt(variance),
            stray=stray,
            reached=reached,
            weighted_mean=z_bar,
            weight_sum=W,
            centre=C,
            mean_variance=mean_variance,
            group_mean=group_mean,
            group_variance=group_variance,
            per_pixel=per_pixel,
            total=per_pixel.sum(),
            per_recording=sum_by(self.recording_of_event, event_term, len(self.recordings))
            + sum_by(self.recording_of_last, censored, len(self.recordings)),
        )

    def _strays(self, falling, z, log_rate, variance, spread, C) -> np.ndarray:
        """(n,) events that the background explains better: first against the population, then their own group."""
        group = self.group
        stray = falling
        centre, extra = C, spread
        for _ in range(2):
            total = variance + extra[group]
            density = log_rate - 0.5 * np.log(2.0 * np.pi * total) - 0.5 * (z - centre[group]) ** 2 / total
            stray = falling | (density < np.log(STRAY_HZ))
            weight = np.where(stray, 0.0, 1.0 / variance)
            W = np.bincount(group, weight, len(C))
            shrink = 1.0 + spread * W
            centre = (C + spread * np.bincount(group, weight * z, len(C))) / shrink
            extra = spread / shrink
        return stray

    def log_likelihood(self, circuit: Circuit) -> float:
        """The log-likelihood."""
        return value(self, circuit, self.gathered(circuit)).total


def _survived(margin: np.ndarray) -> np.ndarray:
    """Log chance that a threshold `margin` standard deviations above the extreme was not reached, or its event lost."""
    return np.log(MISSED + (1.0 - MISSED) * np.exp(log_ndtr(margin)))


def sum_by(index: np.ndarray, values: np.ndarray, size: int) -> np.ndarray:
    """(size,) sums of `values` by index; values may be complex."""
    if np.iscomplexobj(values):
        return np.bincount(index, values.real, size) + 1j * np.bincount(index, values.imag, size)
    return np.bincount(index, values, size)
