"""How much of what events scatter by is shot noise: a Kalman filter of the noise that their levels share.

Threshold noise is drawn independently for each event.  Shot noise n(t), filtered by the stages, is in the level at an
event and, stored as the reference, in that of the next:

    y_k = s_k (z_k − C) = ξ_k − s_k (n(t_k) − n(r_k)),        r_k the end of the dead time after event k − 1

with s_k the polarity and r_k stored at the amplifier's input.  Between events the stages are linear, with rates that
follow the light: n has a state x, propagated exactly over steps of constant light, and the stored value is one more
component.  Of this linear Gaussian system the filter (Kalman 1960, J. Basic Eng. 82, 35) gives mean and variance of
each y_k, the events before it given, and so the likelihood of a density and a threshold noise.  Events are taken as
levels at given times: that a noisy level is met early is left out here, and corrected by simulation where it is used.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numba import njit

from pixelid.dynamics.linear import has_pole, linear_stages, stationary_covariance
from pixelid.likelihood.event_times import EventTimes
from pixelid.likelihood.layout import Shift, read_only
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
RATIOS = (1e-6, 1e6)  # of shot noise to threshold noise, variances, between which it is looked for
TOLERANCE = 0.01  # of its logarithm
WIDTH = 0.1  # of the differences that its error is taken from
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
    """

    density: float
    thresholds: float
    error: float
    gain: float
    quiet: float

    @property
    def log_noise(self) -> float:
        """What ln of the thresholds' noise changes by; not to nothing."""
        return 0.5 * math.log(max(self.thresholds, LEAST_THRESHOLDS))


class Noise(NamedTuple):
    """(n,) what shot noise adds to levels at events, the events before given.

    mean, variance: of −s (n(t) − n(r)), what the level must be more to reach its threshold
    slope, together, slope_variance: mean of the slope s ṅ(t), its covariance with the level's, and its variance
    """

    mean: np.ndarray
    variance: np.ndarray
    slope: np.ndarray
    together: np.ndarray
    slope_variance: np.ndarray


@dataclass(frozen=True)
class _Chain:
    """Events of one pixel in one recording, in order: where in `steps` they and their references are.

    rows: (n,) which events of the likelihood they are
    y, variance: (n,) as the fit has them;  sign: (n,);  usable: (n,) whether to learn from them
    reference, event: (n,) number of steps before each
    light, until: (runs,) index of the tabulated light, and the step up to which it lasts
    """

    rows: np.ndarray
    y: np.ndarray
    variance: np.ndarray
    sign: np.ndarray
    usable: np.ndarray
    reference: np.ndarray
    event: np.ndarray
    light: np.ndarray
    until: np.ndarray

    @property
    def steps_of_light(self) -> np.ndarray:
        """(runs,) how many steps each light lasts."""
        return np.diff(self.until, prepend=0)

    def filtered(self, steps: _Steps, density: float) -> tuple[np.ndarray, np.ndarray]:
        """((3,) Σ ln S, Σ r²/S and count, (n, 5) moments of `Noise`) with shot noise of a density."""
        moments = np.empty((len(self.y), len(Noise._fields)))
        sums = _filter(
            self.y, self.variance, self.sign, self.usable, self.reference, self.event, self.light,
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


def share_out(likelihood: EventTimes, circuit: Circuit, seed: int = 0) -> Division | None:
    """Shot noise and threshold noise that make what events scatter by likeliest.

    Args:
        likelihood: Of the events.
        circuit: As fitted to them.
        seed: Of the choice of pixels where all would take too long.

    Returns:
        None where no event shows anything, or the circuit has no pole: white noise has no level there.
    """
    from scipy.optimize import minimize_scalar

    if not has_pole(circuit):
        return None
    chains, steps = _chains(likelihood, circuit, False, seed)
    chains = [chain for chain in chains if chain.usable.any()]
    if not chains:
        return None

    def filtered(log_ratio: float) -> tuple[float, float]:
        """(log-likelihood, factor of all variances that makes it largest)."""
        sums = map_threads(lambda chain: chain.filtered(steps, math.exp(log_ratio))[0], chains)
        logs, squares, count = np.sum(sums, axis=0)
        scale = squares / count
        return -0.5 * (logs + count * (math.log(scale) + 1.0)), scale

    bounds = (math.log(RATIOS[0]), math.log(RATIOS[1]))
    usual = _usual_ratio(chains, steps)
    low, high = bounds[0] - math.log(usual), bounds[1] - math.log(usual)
    optimum = minimize_scalar(
        lambda u: -filtered(u)[0], bounds=(low, high), method="bounded", options={"xatol": TOLERANCE}
    )
    at = float(optimum.x)
    top, scale = filtered(at)
    without = filtered(low)[0]
    (less, scale_less), (more, scale_more) = filtered(at - WIDTH), filtered(at + WIDTH)
    curvature = max((2.0 * top - less - more) / WIDTH**2, 1e-12)
    moved = 1.0 + math.log(scale_more / scale_less) / (2.0 * WIDTH)  # d ln density / d ln ratio
    events = sum(int(chain.usable.sum()) for chain in chains)
    error = math.sqrt(moved**2 / curvature + 2.0 / events)
    dimmest = steps.stationary[min(int(chain.light.min()) for chain in chains)][-1, -1]
    return Division(scale * math.exp(at), scale, error, top - without, float(dimmest))


def noise_of(likelihood: EventTimes, circuit: Circuit) -> Noise:
    """What a circuit's shot noise adds to the levels of all events, those before given."""
    moments = np.zeros((likelihood.events, len(Noise._fields)))
    chains, steps = _chains(likelihood, circuit, True, 0)
    for chain, (_, some) in zip(
        chains, map_threads(lambda chain: chain.filtered(steps, circuit.shot_density), chains), strict=True
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

    noise, terms = noise_of(likelihood, circuit), likelihood.terms(circuit)
    threshold = terms.group_mean[likelihood.group]
    total = noise.variance + (circuit.noise * threshold) ** 2
    factor = memory_factor(circuit.polarity_memory, likelihood.layout.alike)
    missed = factor * (terms.z - threshold) - noise.mean
    told = ~terms.at_once & (np.abs(missed) < OUTLIER * np.sqrt(total))
    rate = likelihood.sign * terms.changes.events.slope
    slope = rate + noise.slope + np.where(told, noise.together / total * missed, 0.0)
    spread = np.sqrt(np.maximum(noise.slope_variance - noise.together**2 / total, 1e-12))
    x = np.maximum(slope / spread, SLOWEST)
    speed = spread * (x * ndtr(x) + np.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi))
    # at the end of a silence the level lies beyond the threshold: it is not met, and no faster for noise
    met, speed = np.where(terms.at_once, 0.0, ndtr(x) / speed), np.where(terms.at_once, rate, speed)
    further = np.clip(noise.mean + noise.together * met, -MOST_MOVED * threshold, MOST_MOVED * threshold)
    usual = np.full(likelihood.layout.ends, noise.variance.mean())
    at = likelihood.layout
    both = ((at.light, noise.variance), (at.light_reset, noise.variance), (at.light_last, usual))
    light, reset, last = (read_only(known + added if len(known) else added) for known, added in both)
    layout = replace(at, light=light, light_reset=reset, light_last=last)
    return likelihood.with_shift(Shift(read_only(-further), read_only(speed - rate)), layout)


def _usual_ratio(chains: list[_Chain], steps: _Steps) -> float:
    """Variance of shot noise of unit density over that of thresholds, about."""
    noise = np.median([
        np.average(steps.stationary[chain.light, -1, -1], weights=chain.steps_of_light) for chain in chains
    ])  # fmt: skip
    return float(noise / np.median(np.concatenate([chain.variance for chain in chains])))


def _chains(likelihood: EventTimes, circuit: Circuit, every: bool, seed: int) -> tuple[list[_Chain], _Steps]:
    """The chains of events, and the steps between them."""
    terms = likelihood.terms(circuit)
    y = terms.z - terms.group_mean[likelihood.group]
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
            rows, y[rows], terms.scale[rows] ** 2, likelihood.sign[rows].astype(float), usable[rows], reference, event,
            *runs,
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
    y, variance, sign, usable, reference, event, light, lasts, propagator, added, stationary, slope, stored, density,
    moments,
):  # fmt: skip
    """(Σ ln S, Σ r²/S, count) of the innovations r of one chain and their variances S; fills `moments` (n, 5).

    The state is that of the stages and, last, the stored reference.
    """
    blocks, n = propagator.shape[0], propagator.shape[2]
    x, moved = np.zeros(n + 1), np.zeros(n)
    P, half = np.zeros((n + 1, n + 1)), np.zeros((n, n))
    P[:n, :n] = stationary[light[0]] * density
    gain = np.zeros(n + 1)
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
                    total = 0.0
                    for j in range(n):
                        total += E[i, j] * P[j, n]
                    moved[i] = total
                    for j in range(n):
                        total = 0.0
                        for m in range(n):
                            total += E[i, m] * P[m, j]
                        half[i, j] = total
                for i in range(n):
                    P[i, n] = P[n, i] = moved[i]
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
                for j in range(n):
                    P[n, j] = P[j, n] = P[stored, j]
                P[n, n] = P[stored, stored]
        along = slope[light[run]]
        for i in range(n + 1):
            gain[i] = -sign[k] * (P[i, n - 1] - P[i, n])
        mean, own = -sign[k] * (x[n - 1] - x[n]), -sign[k] * (gain[n - 1] - gain[n])
        drift, together, scatter = 0.0, 0.0, 0.0
        for i in range(n):
            drift += sign[k] * along[i] * x[i]
            together += sign[k] * along[i] * gain[i]
            for j in range(n):
                scatter += along[i] * along[j] * P[i, j]
        moments[k, 0], moments[k, 1] = mean, own
        moments[k, 2], moments[k, 3], moments[k, 4] = drift, together, scatter
        if not usable[k]:
            continue
        S, r = own + variance[k], y[k] - mean
        logs += math.log(S)
        squares += r * r / S
        count += 1
        for i in range(n + 1):
            x[i] += gain[i] * r / S
            for j in range(n + 1):
                P[i, j] -= gain[i] * gain[j] / S
    return logs, squares, float(count)
