"""How much of what events scatter by is shot noise: a Kalman filter of the noise that their levels share.

Threshold noise is drawn anew for each event.  Shot noise n(t), filtered by the stages, is in the level at an event and,
stored as the reference, in that of the next:

    y_k = s_k (z_k − C) = ξ_k − s_k (n(t_k) − n(r_k)),        r_k the end of the dead time after event k − 1

with s_k the polarity and r_k stored at the amplifier's input.  Between events the stages are linear, with rates that
follow the light: n has a state x, propagated exactly over steps of constant light, and the stored value is one more
component.  Of this linear Gaussian system the filter (Kalman 1960, J. Basic Eng. 82, 35) gives mean and variance of
each y_k, the events before it given, and so the likelihood of a density and a threshold noise.  Events are taken as
levels at given times: that a noisy level is met early is left out, and put right by simulation (`shares.py`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from pixelid.likelihood.event_times import EventTimes
from pixelid.parallel import map_threads
from pixelid.recordings.recording import Recording
from pixelid.stages.circuit import Circuit
from pixelid.stimuli.pixel_lights import Light, PixelLights, log_radiance_at
from pixelid.tables.noise.process import linear_stages, stationary_covariance

STEP = 0.1  # of the time in which the level's noise changes by its own size, in the brightest light
PER_LOG = 30.0  # lights per e-fold that steps are tabulated for, and most of them
MOST_LIGHTS = 400
MOST_STEPS = 1.5e7  # of all pixels that are looked at, one and a half seconds of work a density
OUTLIER = 5.0  # scales of the fit's residuals: events that something else made
RATIOS = (1e-6, 1e6)  # of shot noise to threshold noise, variances, between which it is looked for
TOLERANCE = 0.01  # of its logarithm
WIDTH = 0.1  # of the differences that its error is taken from


@dataclass(frozen=True)
class Division:
    """The noise of a fit, shared out.

    Attributes:
        density: Of shot noise, one-sided PSD × radiance.
        thresholds: What is left to the thresholds, of the variance that the fit gives them.
        error: Standard error of ln density, all else known.
        gain: Nats over a fit without shot noise.
        quiet: Variance of the level by shot noise of unit density, in the dimmest light: per event.
    """

    density: float
    thresholds: float
    error: float
    gain: float
    quiet: float


@dataclass(frozen=True)
class _Chain:
    """Events of one pixel in one recording, in order: where in `steps` they and their references are.

    y, variance: (n,) as the fit has them;  sign: (n,);  usable: (n,) whether to learn from them
    reference, event: (n,) number of steps before each;  light: (steps,) index of the tabulated light
    """

    y: np.ndarray
    variance: np.ndarray
    sign: np.ndarray
    usable: np.ndarray
    reference: np.ndarray
    event: np.ndarray
    light: np.ndarray


@dataclass(frozen=True)
class _Steps:
    """Propagators (lights, n, n) over one step and the covariances of unit density that come on top, and stationary;
    `stored`: the component that a reset stores."""

    propagator: np.ndarray
    added: np.ndarray
    stationary: np.ndarray
    stored: int


def share_out(likelihood: EventTimes, circuit: Circuit, seed: int = 0) -> Division | None:
    """Shot noise and threshold noise that make what events scatter by likeliest.

    Args:
        likelihood: Of the events.
        circuit: As fitted to them.
        seed: Of the choice of pixels where all would take too long.

    Returns:
        None where no event tells anything.
    """
    from scipy.optimize import minimize_scalar

    chains, steps = _chains(likelihood, circuit, seed)
    if not chains:
        return None

    def filtered(log_ratio: float) -> tuple[float, float]:
        """(log-likelihood, factor of all variances that makes it largest)."""
        sums = np.sum(map_threads(lambda chain: _filter(*_of(chain), *_of(steps), math.exp(log_ratio)), chains), axis=0)
        logs, squares, count = sums
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


def _usual_ratio(chains: list[_Chain], steps: _Steps) -> float:
    """Variance of shot noise of unit density over that of thresholds, about."""
    noise = np.median([steps.stationary[chain.light, -1, -1].mean() for chain in chains])
    return float(noise / np.median(np.concatenate([chain.variance for chain in chains])))


def _of(fields) -> tuple:
    return tuple(vars(fields).values())


def _chains(likelihood: EventTimes, circuit: Circuit, seed: int) -> tuple[list[_Chain], _Steps]:
    """The chains of events, and the steps between them."""
    terms = likelihood.terms(circuit)
    y = terms.z - terms.group_mean[likelihood.group]
    usable = ~terms.background & (np.abs(y) < OUTLIER * terms.scale)
    seen = lights_of(likelihood.recordings)
    lights = [np.log(np.exp(_range(light)) + circuit.dark) for light in seen]
    low, high = min(light[0] for light in lights), max(light[1] for light in lights)
    grid = np.linspace(low, high, int(np.clip(math.ceil(PER_LOG * (high - low)) + 1, 2, MOST_LIGHTS)))
    step_s = _step_s(circuit, math.exp(high))
    steps = _steps(circuit, np.exp(grid), step_s)
    previous = np.concatenate([interval.previous_s for interval in likelihood.intervals]) - circuit.delay
    time = likelihood.time_s - circuit.delay
    chains = []
    for pixel, recording in _within(likelihood, step_s, seed):
        source = seen[recording]
        rows = np.flatnonzero((likelihood.pixel == pixel) & (likelihood.recording_of_event == recording))
        if not len(rows):
            continue
        rows = rows[np.argsort(time[rows])]
        start = source.start_s
        count = max(int((min(source.end_s, time[rows[-1]]) - start) / step_s), 1)
        at = start + step_s * (np.arange(count) + 0.5)
        flat = np.full(1, likelihood.flat_pixels[pixel])
        log_light = np.log(np.exp(log_radiance_at(source, np.repeat(flat, count), at)) + circuit.dark)
        light = np.clip(np.rint((log_light - low) / (grid[1] - grid[0])), 0, len(grid) - 1).astype(np.int16)
        event = np.clip((time[rows] - start) / step_s, 0, count).astype(np.int64)
        reference = np.clip((previous[rows] + circuit.refractory - start) / step_s, 0, event).astype(np.int64)
        chains.append(
            _Chain(
                y[rows],
                terms.scale[rows] ** 2,
                likelihood.sign[rows].astype(float),
                usable[rows],
                reference,
                event,
                light,
            )
        )
    return [chain for chain in chains if chain.usable.any()], steps


def lights_of(recordings: Sequence[Recording]) -> list[Light]:
    """What each was recorded under."""
    return [r.stimulus for r in recordings if r.stimulus is not None]


def _within(likelihood: EventTimes, step_s: float, seed: int) -> Iterator[tuple[int, int]]:
    """(pixel, recording) of as many pixels, drawn at random, as there is time for."""
    per_pixel = sum(light.duration_s for light in lights_of(likelihood.recordings)) / step_s
    pixels = np.random.default_rng([seed, 19]).permutation(likelihood.pixels)
    for pixel in np.sort(pixels[: max(int(MOST_STEPS / per_pixel), 1)]):
        for recording in range(len(likelihood.recordings)):
            yield int(pixel), recording


def _range(light: Light) -> tuple[float, float]:
    """Of the log radiance."""
    each = light.lights if isinstance(light, PixelLights) else (light,)
    return (
        math.log(min(float(one.radiance.min()) for one in each)),
        math.log(max(float(one.radiance.max()) for one in each)),
    )


def _step_s(circuit: Circuit, brightest: float) -> float:
    A, drive, _ = linear_stages(circuit, brightest)
    P = stationary_covariance(A, drive)
    slope = A @ P @ A.T
    return STEP * math.sqrt(P[-1, -1] / slope[-1, -1])


def _steps(circuit: Circuit, lights: np.ndarray, step_s: float) -> _Steps:
    """Of unit density: its one-sided PSD over ln L is 1 / L."""
    from scipy.linalg import expm

    propagators, added, stationary = [], [], []
    for light in lights:
        A, drive, stored = linear_stages(circuit, float(light))
        P = stationary_covariance(A, drive) * (0.5 / light)
        E = expm(A * step_s)
        propagators.append(E)
        added.append(P - E @ P @ E.T)
        stationary.append(P)
    return _Steps(np.array(propagators), np.array(added), np.array(stationary), stored)


@njit(cache=True, nogil=True, error_model="numpy")
def _filter(y, variance, sign, usable, reference, event, light, propagator, added, stationary, stored, ratio):
    """(Σ ln S, Σ r²/S, count) of the innovations r of one chain and their variances S, density `ratio`, thresholds 1 ×.

    The state is that of the stages and, last, the stored reference.
    """
    n = propagator.shape[1]
    x, moved = np.zeros(n + 1), np.zeros(n)
    P, half = np.zeros((n + 1, n + 1)), np.zeros((n, n))
    P[:n, :n] = stationary[light[0]] * ratio
    gain = np.zeros(n + 1)
    logs, squares, count, step = 0.0, 0.0, 0, 0
    for k in range(len(y)):
        for stop in range(2):
            until = reference[k] if stop == 0 else event[k]
            while step < until:
                E, Q = propagator[light[step]], added[light[step]]
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
                        total = Q[i, j] * ratio
                        for m in range(n):
                            total += half[i, m] * E[j, m]
                        P[i, j] = total
                step += 1
            if stop == 0:
                x[n] = x[stored]
                for j in range(n):
                    P[n, j] = P[j, n] = P[stored, j]
                P[n, n] = P[stored, stored]
        if not usable[k]:
            continue
        for i in range(n + 1):
            gain[i] = -sign[k] * (P[i, n - 1] - P[i, n])
        S = -sign[k] * (gain[n - 1] - gain[n]) + variance[k]
        r = y[k] + sign[k] * (x[n - 1] - x[n])
        logs += math.log(S)
        squares += r * r / S
        count += 1
        for i in range(n + 1):
            x[i] += gain[i] * r / S
            for j in range(n + 1):
                P[i, j] -= gain[i] * gain[j] / S
    return logs, squares, float(count)
