"""Events of the whole pixel, written out: Runge–Kutta on a fine grid, then pixel by pixel and event by event.

The equations of docs/model.md, nothing of the package: photoreceptor, follower, amplifier, reset during the dead time,
leak, thresholds that differ from pixel to pixel and scatter from event to event.  What the library lacks is an array on
the grid or a function of the previous event: see `Oddity`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit

STEP_S = 2.5e-6  # of the grid: a quarter of the amplifier's time constant; crossings are then off by nanoseconds
MOST = 100_000  # events of a pixel in one recording


@dataclass(frozen=True)
class Pixel:
    """The circuit: invariants of the photoreceptor, angular cutoffs in rad/s, thresholds in log radiance, s.

    sigma, mismatch: scatter of thresholds, relative, from event to event and from pixel to pixel
    """

    alpha: float
    beta: float
    gamma: float
    follower: float
    differencing: float
    on: float
    off: float
    dead_s: float
    sigma: float = 0.0
    mismatch: float = 0.0


Light = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]  # of time, radiance and |d ln L/dt|, arrays


@dataclass(frozen=True)
class Oddity:
    """What a pixel does that the circuit does not say.

    on, off, dead_s: what an event adds to thresholds (relative) and dead time (s) until the next, by time, radiance and
    speed of the light when it comes
    after: the same of (ON, OFF) thresholds and dead time, added after an ON event and taken away after an OFF one
    relaxing: (ON, OFF, s) added to thresholds (relative) just after an event, fading
    faster: what the photoreceptor's bandwidth is multiplied by;  responds: added to the logarithm of the light
    leak_hz: drift of the change, ON thresholds per second;  light: what the light is multiplied by
    """

    on: Light | None = None
    off: Light | None = None
    dead_s: Light | None = None
    after: tuple[float, float, float] = (0.0, 0.0, 0.0)
    relaxing: tuple[float, float, float] = (0.0, 0.0, 1.0)
    faster: Light | None = None
    responds: Light | None = None
    leak_hz: Light | None = None
    light: Light | None = None


NOTHING = Oddity()


@dataclass(frozen=True)
class Signals:
    """On the grid: the follower's and the amplifier's output, leaked since the start (ON thresholds); what an event
    there adds to ON and OFF threshold and dead time, (n, 3)."""

    follower: np.ndarray
    amplifier: np.ndarray
    leaked: np.ndarray
    adds: np.ndarray


def signals(
    pixel: Pixel, light: Callable[[np.ndarray], np.ndarray], duration_s: float, odd: Oddity = NOTHING
) -> Signals:
    """The pixel's signals from the steady state on; light: radiance at times."""
    half = np.arange(2 * int(duration_s / STEP_S) + 1) * 0.5 * STEP_S
    radiance = light(half)
    speed = np.abs(np.gradient(np.log(radiance), half))

    def of(what: Light | None, otherwise: float) -> np.ndarray:
        return np.full(len(half), otherwise) if what is None else np.zeros(len(half)) + what(half, radiance, speed)

    radiance = radiance * of(odd.light, 1.0)
    u = np.log(radiance) + of(odd.responds, 0.0)
    rates = np.array([pixel.alpha, pixel.beta, pixel.gamma, pixel.follower, pixel.differencing])
    outputs = _runge_kutta(u, radiance, of(odd.faster, 1.0), rates)
    leak = of(odd.leak_hz, 0.0)[::2]
    leaked = np.concatenate([[0.0], np.cumsum(0.5 * (leak[1:] + leak[:-1]) * STEP_S)])
    adds = np.column_stack([of(what, 0.0)[::2] for what in (odd.on, odd.off, odd.dead_s)])
    return Signals(*outputs, leaked, adds)


@njit(cache=False)
def _slope(x, u, light, faster, rates):
    alpha, beta, gamma, follower, differencing = rates
    v, y, s, d = x
    pull = faster * faster * alpha * light * (u - y) - faster * (beta + gamma * light) * v
    return np.array([pull, v, follower * (y - s), differencing * (s - d)])


@njit(cache=False)
def _runge_kutta(u, light, faster, rates):
    n = (len(light) + 1) // 2
    follower, amplifier = np.empty(n), np.empty(n)
    x = np.array([0.0, u[0], u[0], u[0]])
    h = STEP_S
    for k in range(n):
        follower[k], amplifier[k] = x[2], x[3]
        if k + 1 == n:
            break
        i, j, m = 2 * k, 2 * k + 1, 2 * k + 2
        a = _slope(x, u[i], light[i], faster[i], rates)
        b = _slope(x + 0.5 * h * a, u[j], light[j], faster[j], rates)
        c = _slope(x + 0.5 * h * b, u[j], light[j], faster[j], rates)
        d = _slope(x + h * c, u[m], light[m], faster[m], rates)
        x = x + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
    return follower, amplifier


def thresholds(pixel: Pixel, pixels: int, rng: np.random.Generator) -> np.ndarray:
    """(pixels, 2) mean ON and OFF thresholds of each pixel."""
    return np.array([pixel.on, pixel.off]) * (1.0 + pixel.mismatch * rng.standard_normal((pixels, 2)))


def events(pixel: Pixel, own: np.ndarray, seen: Signals, rng: np.random.Generator, odd: Oddity = NOTHING):
    """(times s, pixels, polarities ±1) in order of time, of pixels with the thresholds `own` of `thresholds`."""
    times, which, signs = [], [], []
    for i, mine in enumerate(own):
        draws = 1.0 + pixel.sigma * rng.standard_normal((MOST, 2))
        t, p = walk(pixel, mine, seen, draws, rng.uniform(), odd)
        times.append(t)
        which.append(np.full(len(t), i))
        signs.append(p)
    t = np.concatenate(times)
    order = np.argsort(t, kind="stable")
    return t[order], np.concatenate(which)[order], np.concatenate(signs)[order]


def walk(pixel: Pixel, own, seen: Signals, draws: np.ndarray, begin: float, odd: Oddity = NOTHING):
    """(times s, polarities ±1) of one pixel with ON and OFF thresholds `own` (2,).

    draws: (m, 2) what thresholds are multiplied by;  begin: share of the way from −C_off to C_on that the change
    begins at
    """
    return _walk(
        seen.follower, seen.amplifier, seen.leaked * pixel.on, seen.adds, pixel.differencing, pixel.dead_s, own[0],
        own[1], draws, begin, odd.after, odd.relaxing,
    )  # fmt: skip


@njit(cache=False)
def _walk(follower, amplifier, leaked, adds, wd, dead_s, on, off, draws, begin, after, relaxing):
    h = STEP_S
    n, count = len(follower), 0
    times, signs = np.empty(len(draws)), np.empty(len(draws))
    high, low = on * draws[0, 0], off * draws[0, 1]
    release, level, fallen = 0.0, amplifier[0] - (begin * (high + low) - low), 0.0
    gap, k, before = 0.0, 1, -np.inf
    last, at, last_high, last_low = amplifier[0] - level, 0.0, high, low
    while k < n:
        t = k * h
        change = amplifier[k] - level - gap * np.exp(-wd * (t - release)) + leaked[k] - fallen
        left = np.exp(-(t - before) / relaxing[2])
        now_high, now_low = high + on * relaxing[0] * left, low + off * relaxing[1] * left
        if -now_low < change < now_high:
            last, at, last_high, last_low = change, t, now_high, now_low
            k += 1
            continue
        sign = 1.0 if change >= now_high else -1.0
        ahead, behind = (change - now_high, last - last_high) if sign > 0.0 else (-change - now_low, -last - last_low)
        when = t - (t - at) * ahead / (ahead - behind) if ahead > behind else t
        times[count], signs[count] = when, sign
        count += 1
        here = adds[min(int(when / h + 0.5), n - 1)]
        high = on * (draws[count, 0] + here[0] + sign * after[0])
        low = off * (draws[count, 1] + here[1] + sign * after[1])
        release, before = when + max(dead_s + here[2] + sign * after[2], 0.0), when
        k = int(release / h) + 1
        if k >= n:
            break
        share = release / h - (k - 1)
        level = follower[k - 1] + share * (follower[k] - follower[k - 1])
        gap = amplifier[k - 1] + share * (amplifier[k] - amplifier[k - 1]) - level
        fallen = leaked[k - 1] + share * (leaked[k] - leaked[k - 1])
        left = np.exp(-(release - before) / relaxing[2])
        last, at = 0.0, release
        last_high, last_low = high + on * relaxing[0] * left, low + off * relaxing[1] * left
    return times[:count], signs[:count]
