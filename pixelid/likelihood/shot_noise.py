"""How much of what events scatter by is shot noise: a Kalman filter of the noise that their levels share.

Threshold noise is drawn independently for each event.  Shot noise n(t), filtered by the stages, is in the level at an
event and, stored as the reference, in that of the next:

    y_k = s_k (z_k − C) = ξ_k − s_k (n(t_k) − n(r_k)),        r_k the end of the dead time after event k − 1

with s_k the polarity and r_k stored at the amplifier's input.  Between events the stages are linear, with rates that
follow the light: n has a state x, propagated exactly over steps of constant light, and the stored value is one more
component.  A stamp that is late by j_k adds r_k j_k to its own level and m_k j_k to the next, whose reference it moves;
it is the last component.  Of this linear Gaussian system the filter (Kalman 1960, J. Basic Eng. 82, 35)
gives mean and variance of each y_k, the events before it given, and so the likelihood of a density, a jitter and a
threshold noise.  Events are taken as levels at given times: that a noisy level is met early is left out here, and
corrected by simulation where it is used.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numba import njit

from pixelid.dynamics.linear import has_pole, linear_stages, stationary_covariance
from pixelid.likelihood.event_times import EventTimes
from pixelid.likelihood.layout import Shift, read_only
from pixelid.likelihood.stamps import MOST_SHARE
from pixelid.parallel import map_threads
from pixelid.stages.circuit import Circuit
from pixelid.stages.comparator import memory_factor
from pixelid.stimuli.pixel_lights import Light, lights_in, log_radiance_at

STEP = 0.1  # of the time in which the level's noise changes by its own size, in the brightest light
PER_LOG = 30.0  # lights per e-fold that steps are tabulated for, and most of them
MOST_LIGHTS = 400
SLOWEST = -6.0  # standard deviations of a slope: beyond, E[w⁺] is rounding
MOST_MOVED = 0.5  # of a threshold, that noise moves one by
MARGIN = 1e-3  # of log light, so that a constant one is a range
BLOCKS = 12  # of 1, 2, 4, … steps of one light that are taken at once
MOST_STEPS = 1.5e7  # of all pixels together, one and a half seconds of work a density
OUTLIER = 5.0  # scales of the fit's residuals: events that something else made
RATIOS = (1e-6, 1e6)  # of shot noise to threshold noise, variances, between which it is looked for; of jitter, too
TRIED = (1e-3, 0.1, 3.0)  # of them, from which the search begins
NEAR_NATS, FARTHEST = 0.3, 0.5  # of the optimum, from where a parabola leads to it; and how far that may lead
LEAST_CURVATURE = 1e-2  # of the log-likelihood by them: what events say nothing of is known to ten e-folds
WIDTH = 0.1  # of the differences that the parabola is taken from
LEAST_THRESHOLDS = 1e-3  # of the fit's noise variance: 3 % of the noise, less than any sensor's thresholds


@dataclass(frozen=True)
class Division:
    """The noise of a fit, shared out.

    Attributes:
        density: Of shot noise, one-sided PSD × radiance.
        thresholds: What is left to the thresholds, of the variance that the fit gives them.
        error: Standard error of ln density, all else known.
        gain: Nats over a fit without shot noise.
        quiet: Variance of the level by shot noise of unit density, in the dimmest light.
        jitter_s: Of stamps, beyond their unit; 0 where it was not free.
    """

    density: float
    thresholds: float
    error: float
    gain: float
    quiet: float
    jitter_s: float = 0.0

    @property
    def log_noise(self) -> float:
        """What ln of the thresholds' noise changes by; not to nothing."""
        return 0.5 * math.log(max(self.thresholds, LEAST_THRESHOLDS))


class Noise(NamedTuple):
    """(n,) what shot noise adds to levels at events, the events before given.

    mean, variance: of −s (n(t) − n(r)), what the level must be more to reach its threshold
    slope, together, slope_variance: mean of the slope s ṅ(t), its covariance with the level's, and its variance
    before: variance by the stamp of the event before, with twice its covariance with the noise
    stamp: variance of the event's own stamp [s²]
    """

    mean: np.ndarray
    variance: np.ndarray
    slope: np.ndarray
    together: np.ndarray
    slope_variance: np.ndarray
    before: np.ndarray
    stamp: np.ndarray


@dataclass(frozen=True)
class _Chain:
    """Events of one pixel in one recording, in order: where in `steps` they and their references are.

    rows: (n,) which events of the likelihood they are
    y, variance: (n,) as the fit has them, without what stamps add;  sign: (n,)
    usable: (n,) whether to learn from them
    rate, moved: (n,) by how much later stamps of the event and of the one before raise its level, per second
    stamp: (n,) variance of stamps by their unit
    reference, event: (n,) number of steps before each
    light, until: (runs,) index of the tabulated light, and the step up to which it lasts
    """

    rows: np.ndarray
    y: np.ndarray
    variance: np.ndarray
    sign: np.ndarray
    usable: np.ndarray
    rate: np.ndarray
    moved: np.ndarray
    stamp: np.ndarray
    reference: np.ndarray
    event: np.ndarray
    light: np.ndarray
    until: np.ndarray

    @property
    def steps_of_light(self) -> np.ndarray:
        """(runs,) how many steps each light lasts."""
        return np.diff(self.until, prepend=0)

    def filtered(self, steps: _Steps, density: float, jitter: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """((3,) Σ ln S, Σ r²/S and count, (n, 7) moments of `Noise`) with shot noise of a density.

        jitter: variance of stamps beyond that by their unit [s²]
        """
        moments = np.empty((len(self.y), len(Noise._fields)))
        sums = _filter(
            self.y, self.variance, self.sign, self.usable, self.rate, self.moved, self.stamp + jitter, self.reference,
            self.event, self.light,
            self.until, steps.propagator, steps.added, steps.stationary, steps.slope, steps.stored, density, moments,
        )  # fmt: skip
        return np.array(sums), moments


@dataclass(frozen=True)
class _Steps:
    """Propagators (blocks, lights, n, n) over 1, 2, 4, … steps and the covariances of unit density that come on top;
    those that are stationary (lights, n, n);  `slope`: (lights, n) what the slope of the level is of the state;
    `stored`: the component that a reset stores."""

    propagator: np.ndarray
    added: np.ndarray
    stationary: np.ndarray
    slope: np.ndarray
    stored: int


def share_out(likelihood: EventTimes, circuit: Circuit, seed: int = 0, free_jitter: bool = False) -> Division | None:
    """Shot noise, threshold noise and jitter of stamps that make what events scatter by likeliest.

    Args:
        likelihood: Of the events.
        circuit: As fitted to them.
        seed: Of the choice of pixels where all would take too long.
        free_jitter: Whether stamps may jitter where those of the circuit do not.

    Returns:
        None where no event shows anything, or the circuit has no pole: white noise has no level there.
    """
    from scipy.optimize import minimize

    if not has_pole(circuit):
        return None
    chains, steps = _chains(likelihood, circuit, False, seed)
    chains = [chain for chain in chains if chain.usable.any()]
    if not chains:
        return None
    shared = _Shared(chains, steps)
    usual = shared.usual if free_jitter or circuit.jitter > 0.0 else shared.usual[:1]
    starts = [usual + np.log(tried) for tried in itertools.product(TRIED, repeat=len(usual))]
    start = max(starts, key=shared.value)
    near = minimize(
        lambda v: -shared.value(v), start, method="Nelder-Mead", bounds=[tuple(at + np.log(RATIOS)) for at in usual],
        options={"initial_simplex": [start, *(start + np.eye(len(start)))], "xatol": WIDTH, "fatol": NEAR_NATS},
    )  # fmt: skip
    return shared.division(near.x)


@dataclass(frozen=True)
class _Shared:
    """Noise of events shared out: coordinates (1,) or (2,) are ln of shot noise and jitter over threshold noise, whose
    factor is the likeliest."""

    chains: list[_Chain]
    steps: _Steps

    @cached_property
    def usual(self) -> np.ndarray:
        """(2,) coordinates at which either is about as large as threshold noise."""
        of_shot = np.median([
            np.average(self.steps.stationary[chain.light, -1, -1], weights=chain.steps_of_light)
            for chain in self.chains
        ])  # fmt: skip
        of_stamps = np.median(np.concatenate([chain.rate[chain.usable] for chain in self.chains])) ** 2
        thresholds = np.median(np.concatenate([chain.variance for chain in self.chains]))
        return np.log(thresholds / np.array([of_shot, of_stamps]))

    def value(self, v: Sequence[float] | np.ndarray) -> float:
        """Log-likelihood."""
        return self._filtered(v)[0]

    def _filtered(self, v: Sequence[float] | np.ndarray) -> tuple[float, float]:
        """(log-likelihood, likeliest factor of all variances)."""
        density, jitter = math.exp(v[0]), math.exp(v[1]) if len(v) > 1 else 0.0
        sums = map_threads(lambda chain: chain.filtered(self.steps, density, jitter)[0], self.chains)
        logs, squares, count = np.sum(sums, axis=0)
        scale = squares / count
        return -0.5 * (logs + count * (math.log(scale) + 1.0)), scale

    def division(self, near: np.ndarray) -> Division:
        """At the top of the parabola through the surroundings of coordinates near the optimum."""
        d = len(near)
        middle, scale_there = self._filtered(near)
        steps = WIDTH * np.eye(d)
        up, down = ([self._filtered(near + sign * step) for step in steps] for sign in (1.0, -1.0))
        slope = np.array([more[0] - less[0] for more, less in zip(up, down, strict=True)]) / (2.0 * WIDTH)
        curvature = np.diag([2.0 * middle - more[0] - less[0] for more, less in zip(up, down, strict=True)])
        if d > 1:
            both = self.value(near + steps.sum(axis=0))
            curvature[0, 1] = curvature[1, 0] = up[0][0] + up[1][0] - middle - both
        curvature = curvature / WIDTH**2 + LEAST_CURVATURE * np.eye(d)
        covariance = np.linalg.pinv(curvature, hermitian=True)
        v = near + np.clip(covariance @ slope, -FARTHEST, FARTHEST)
        top, scale = self._filtered(v)
        if not top > middle:
            v, top, scale = near, middle, scale_there
        moved = np.array([math.log(more[1] / less[1]) for more, less in zip(up, down, strict=True)]) / (2.0 * WIDTH)
        moved[0] += 1.0  # ln density = v_0 + ln factor
        events = sum(int(chain.usable.sum()) for chain in self.chains)
        variance = moved @ covariance @ moved + 2.0 / events
        dimmest = self.steps.stationary[min(int(chain.light.min()) for chain in self.chains)][-1, -1]
        return Division(
            density=scale * math.exp(v[0]), thresholds=scale, error=math.sqrt(max(variance, 2.0 / events)),
            gain=top - self._without(v), quiet=float(dimmest),
            jitter_s=math.sqrt(scale * math.exp(v[1])) if d > 1 else 0.0,
        )  # fmt: skip

    def _without(self, v: np.ndarray) -> float:
        """Log-likelihood without shot noise to speak of, jitter the likeliest then."""
        from scipy.optimize import minimize_scalar

        none, (_, jitter) = self.usual[0] + math.log(RATIOS[0]), self.usual
        if len(v) == 1:
            return self.value([none])
        found = minimize_scalar(
            lambda at: -self.value([none, at]), bounds=tuple(jitter + np.log(RATIOS)), method="bounded",
            options={"xatol": WIDTH},
        )  # fmt: skip
        return -float(found.fun)


def noise_of(likelihood: EventTimes, circuit: Circuit) -> Noise:
    """What a circuit's shot noise adds to the levels of all events, those before given."""
    moments = np.zeros((likelihood.events, len(Noise._fields)))
    chains, steps = _chains(likelihood, circuit, True, 0)
    for chain, (_, some) in zip(
        chains,
        map_threads(lambda chain: chain.filtered(steps, circuit.shot_density, circuit.jitter**2), chains),
        strict=True,
    ):
        moments[chain.rows] = some
    return Noise(*moments.T)


def under_shot_noise(likelihood: EventTimes, circuit: Circuit) -> EventTimes:
    """The likelihood of events whose levels a circuit's shot noise has moved, to be maximised near that circuit.

    Given the events before, the level at an event is normal about the noiseless one, and it is met the oftener the
    faster it rises there: the density of an event is that of its level times E[w⁺], w the slope with its noise, given
    the level (Rice 1944).  With w normal, of mean m and deviation d, E[w⁺] = d (x Φ(x) + φ(x)) with x = m / d, and the
    level where the event is likeliest lies Cov(w, level) Φ(x) / E[w⁺] further.  Means, variances and slopes are those
    at the circuit and held: what they owe to it is of second order.

    Args:
        likelihood: Without shot noise.
        circuit: With it, close to where the likelihood will be largest.
    """
    from scipy.special import ndtr

    likelihood = likelihood.with_single_stamps()
    noise, terms = noise_of(likelihood, circuit), likelihood.terms(circuit)
    threshold = terms.group_mean[likelihood.group]
    rate = likelihood.sign * terms.changes.events.slope
    by_stamp = terms.event.rate**2 * noise.stamp
    # what the stamp before adds counts as the event's own, as far as it adds
    share = np.clip(noise.before / by_stamp, 0.0, MOST_SHARE - 1.0)
    added = noise.variance + noise.before - share * by_stamp
    total = added + (1.0 + share) * by_stamp + (circuit.noise * threshold) ** 2
    factor = memory_factor(circuit.polarity_memory, likelihood.layout.alike)
    missed = factor * (terms.z - threshold) - noise.mean
    told = ~terms.at_once & (np.abs(missed) < OUTLIER * np.sqrt(total))
    slope = rate + noise.slope + np.where(told, noise.together / total * missed, 0.0)
    spread = np.sqrt(np.maximum(noise.slope_variance - noise.together**2 / total, 1e-12))
    x = np.maximum(slope / spread, SLOWEST)
    speed = spread * (x * ndtr(x) + np.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi))
    # at the end of a silence the level lies beyond the threshold: it is not met, and no faster for noise
    met, speed = np.where(terms.at_once, 0.0, ndtr(x) / speed), np.where(terms.at_once, rate, speed)
    further = np.clip(noise.mean + noise.together * met, -MOST_MOVED * threshold, MOST_MOVED * threshold)
    usual = np.full(likelihood.layout.ends, noise.variance.mean())
    at = likelihood.layout
    both = ((at.light, added), (at.light_reset, noise.variance), (at.light_last, usual))
    light, reset, last = (read_only(known + added if len(known) else added) for known, added in both)
    layout = replace(at, light=light, light_reset=reset, light_last=last)
    shifted = likelihood.with_shift(Shift(read_only(-further), read_only(speed - rate)), layout)
    shifted.clock_share = read_only(1.0 + share)
    carried, _ = likelihood.shared_by_stamps(circuit, terms, noise.variance, missed)
    if carried is not None:  # what stamps share is among the means already: from here on it follows the circuit
        change = terms.changes.events.change - likelihood.sign * further
        shifted.carried = replace(carried, change=read_only(change), level=read_only(np.zeros(len(change))))
    return shifted


def _chains(likelihood: EventTimes, circuit: Circuit, every: bool, seed: int) -> tuple[list[_Chain], _Steps]:
    """The chains of events, and the steps between them."""
    likelihood = likelihood.with_single_stamps()
    terms = likelihood.terms(circuit)
    y, rate = terms.z - terms.group_mean[likelihood.group], terms.event.rate
    moved = likelihood.moved_by_release(circuit, terms)
    stamp = terms.event.clock - circuit.jitter**2
    variance = np.maximum(terms.scale**2 - rate**2 * terms.event.clock, 0.0)
    usable = ~(terms.background | terms.at_once) & (np.abs(y) < OUTLIER * terms.scale)
    seen = [r.stimulus for r in likelihood.recordings if r.stimulus is not None]
    lights = [np.log(np.exp(_range(light)) + circuit.dark) for light in seen]
    low, high = min(light[0] for light in lights) - MARGIN, max(light[1] for light in lights) + MARGIN
    grid = np.linspace(low, high, int(np.clip(math.ceil(PER_LOG * (high - low)) + 1, 2, MOST_LIGHTS)))
    duration_s = sum(light.duration_s for light in seen)
    fine_s = _step_s(circuit, math.exp(high))
    count = likelihood.pixels if every else int(np.clip(MOST_STEPS * fine_s / duration_s, 1, likelihood.pixels))
    # coarser ones round the times of events, no more: noise is propagated exactly
    step_s = max(fine_s, duration_s * count / MOST_STEPS)
    steps = _steps(circuit, np.exp(grid), step_s)
    previous, time = likelihood.times_on_light(circuit)
    chains = []
    whole: dict[int, tuple[np.ndarray, np.ndarray]] = {}  # of recordings under full-field light
    for rows in _within(likelihood, count, seed):
        pixel, recording = likelihood.pixel[rows[0]], int(likelihood.recording_of_event[rows[0]])
        source, start = seen[recording], seen[recording].start_s
        runs = whole.get(recording)
        if runs is None:
            at = start + step_s * (np.arange(max(int(source.duration_s / step_s), 1)) + 0.5)
            flat = np.full(len(at), likelihood.flat_pixels[pixel])
            log_light = np.log(np.exp(log_radiance_at(source, flat, at)) + circuit.dark)
            light = np.clip(np.rint((log_light - low) / (grid[1] - grid[0])), 0, len(grid) - 1).astype(np.int16)
            runs = _runs(light)
            if source.full_field:
                whole[recording] = runs
        event = np.clip((time[rows] - start) / step_s, 0, runs[1][-1]).astype(np.int64)
        reference = np.clip((previous[rows] + circuit.refractory - start) / step_s, 0, event).astype(np.int64)
        chain = _Chain(
            rows, y[rows], variance[rows], likelihood.sign[rows].astype(float), usable[rows], rate[rows], moved[rows],
            stamp[rows], reference, event, *runs,
        )  # fmt: skip
        chains.append(chain)
    return chains, steps


def _runs(light: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """((runs,) lights, (runs,) the steps up to which they last) of the light in each step."""
    last = np.append(np.flatnonzero(np.diff(light)), len(light) - 1)
    return light[last], last + 1


def _within(likelihood: EventTimes, count: int, seed: int) -> Iterator[np.ndarray]:
    """Events, in order of time, of each recording of so many pixels, drawn at random."""
    drawn = np.zeros(likelihood.pixels, bool)
    drawn[np.random.default_rng([seed, 19]).permutation(likelihood.pixels)[:count]] = True
    rows = np.flatnonzero(drawn[likelihood.pixel])
    key = likelihood.pixel[rows] * len(likelihood.recordings) + likelihood.recording_of_event[rows]
    order = np.lexsort((likelihood.time_s[rows], key))
    yield from np.split(rows[order], np.flatnonzero(np.diff(key[order])) + 1) if len(rows) else ()


def _range(light: Light) -> tuple[float, float]:
    """Of the log radiance."""
    each = [one.radiance for one in lights_in(light)]
    return math.log(min(float(one.min()) for one in each)), math.log(max(float(one.max()) for one in each))


def _step_s(circuit: Circuit, brightest: float) -> float:
    A, drive, _ = linear_stages(circuit, brightest)
    P = stationary_covariance(A, drive)
    slope = A @ P @ A.T
    return STEP * math.sqrt(P[-1, -1] / slope[-1, -1])


def _steps(circuit: Circuit, lights: np.ndarray, step_s: float) -> _Steps:
    """Of unit density: its one-sided PSD over ln L is 1 / L."""
    from scipy.linalg import expm

    propagators, added, stationary, slope = [], [], [], []
    for light in lights:
        A, drive, stored = linear_stages(circuit, float(light))
        P = stationary_covariance(A, drive) * (0.5 / light)
        E = expm(A * step_s)
        propagators.append(E)
        added.append(P - E @ P @ E.T)
        stationary.append(P)
        slope.append(A[-1] * (drive[-1] == 0.0))  # of a single pole noise has no slope
    blocks = _doubled(np.array(propagators), np.array(added))
    return _Steps(*blocks, np.array(stationary), np.array(slope), stored)


def _doubled(propagator: np.ndarray, added: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(BLOCKS, lights, n, n) each, over 1, 2, 4, … steps, of those (lights, n, n) over one."""
    propagators, sums = [propagator], [added]
    for _ in range(BLOCKS - 1):
        E, Q = propagators[-1], sums[-1]
        propagators.append(E @ E)
        sums.append(E @ Q @ E.transpose(0, 2, 1) + Q)
    return np.array(propagators), np.array(sums)


@njit(cache=True, nogil=True, error_model="numpy")
def _filter(
    y, variance, sign, usable, rate, moved_by, stamp, reference, event, light, lasts, propagator, added, stationary,
    slope, stored, density, moments,
):  # fmt: skip
    """(Σ ln S, Σ r²/S, count) of the innovations r of one chain and their variances S; fills `moments` (n, 7).

    The state is that of the stages, the stored reference and, last, what the stamp before is late by.
    """
    blocks, n = propagator.shape[0], propagator.shape[2]
    x, moved = np.zeros(n + 2), np.zeros(n)
    P, half = np.zeros((n + 2, n + 2)), np.zeros((n, n))
    P[:n, :n] = stationary[light[0]] * density
    P[n + 1, n + 1] = stamp[0]
    gain = np.zeros(n + 2)
    logs, squares, count, step, run = 0.0, 0.0, 0, 0, 0
    for k in range(len(y)):
        for stop in range(2):
            until = reference[k] if stop == 0 else event[k]
            while step < until:
                block = blocks - 1
                while step + (1 << block) > min(until, lasts[run]):
                    block -= 1
                E, Q = propagator[block, light[run]], added[block, light[run]]
                for i in range(n):
                    total = 0.0
                    for j in range(n):
                        total += E[i, j] * x[j]
                    moved[i] = total
                for i in range(n):
                    x[i] = moved[i]
                    for j in range(n):
                        total = 0.0
                        for m in range(n):
                            total += E[i, m] * P[m, j]
                        half[i, j] = total
                for late in range(n, n + 2):
                    for i in range(n):
                        total = 0.0
                        for j in range(n):
                            total += E[i, j] * P[j, late]
                        moved[i] = total
                    for i in range(n):
                        P[i, late] = P[late, i] = moved[i]
                for i in range(n):
                    for j in range(n):
                        total = Q[i, j] * density
                        for m in range(n):
                            total += half[i, m] * E[j, m]
                        P[i, j] = total
                step += 1 << block
                while lasts[run] <= step and run < len(light) - 1:
                    run += 1
            if stop == 0:
                x[n] = x[stored]
                for j in range(n + 2):
                    P[n, j] = P[j, n] = P[stored, j]
                P[n, n] = P[stored, stored]
        along = slope[light[run]]
        late = moved_by[k]
        for i in range(n + 2):
            gain[i] = -sign[k] * (P[i, n - 1] - P[i, n])
        own = -sign[k] * (gain[n - 1] - gain[n])
        before = 2.0 * late * gain[n + 1] + late * late * P[n + 1, n + 1]
        for i in range(n + 2):
            gain[i] += late * P[i, n + 1]
        mean = -sign[k] * (x[n - 1] - x[n]) + late * x[n + 1]
        drift, together, scatter = 0.0, 0.0, 0.0
        for i in range(n):
            drift += sign[k] * along[i] * x[i]
            together += sign[k] * along[i] * gain[i]
            for j in range(n):
                scatter += along[i] * along[j] * P[i, j]
        moments[k, 0], moments[k, 1] = mean, own
        moments[k, 2], moments[k, 3], moments[k, 4] = drift, together, scatter
        moments[k, 5], moments[k, 6] = before, stamp[k]
        own_stamp = rate[k] * stamp[k]
        if usable[k]:
            S, r = own + before + variance[k] + rate[k] * own_stamp, y[k] - mean
            logs += math.log(S)
            squares += r * r / S
            count += 1
            for i in range(n + 1):
                x[i] += gain[i] * r / S
                for j in range(n + 1):
                    P[i, j] -= gain[i] * gain[j] / S
                P[i, n + 1] = P[n + 1, i] = -gain[i] * own_stamp / S
            x[n + 1] = own_stamp * r / S
            P[n + 1, n + 1] = stamp[k] - own_stamp * own_stamp / S
        else:
            x[n + 1] = 0.0
            for i in range(n + 1):
                P[i, n + 1] = P[n + 1, i] = 0.0
            P[n + 1, n + 1] = stamp[k]
    return logs, squares, float(count)
