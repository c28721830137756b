"""Continuous-time pixels under a smooth light: trajectories of fourth order, crossing times to nanoseconds.

The equations of docs/model.md and nothing of the package.  The photoreceptor is solved by Runge–Kutta.  The follower
and the amplifier each filter a cubic whose ends and slopes are known, so their solution over a step is an integral of
exponential times cubic, which Gauss's rule gives to rounding.  No pole limits the step: 5 µs is a twelfth of the
fastest oscillation of the photoreceptor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
NODES, WEIGHTS = 0.5 * (_NODES + 1.0), 0.5 * _WEIGHTS  # on 0…1


@dataclass(frozen=True)
class Circuit:
    """A pixel's circuit and what disturbs it.

    Attributes:
        alpha, beta, gamma: of the photoreceptor, in 1/s² per fA, 1/s and 1/s per fA.
        sf_cutoff_hz, diff_cutoff_hz: of source follower and differencing amplifier.
        on_threshold, off_threshold: means over pixels, in log radiance.
        refractory_s: dead time.
        threshold_mismatch, threshold_sigma: relative scatter of thresholds between pixels and between events.
        leak_hz: drift of the change, mean ON thresholds per second;  leak_hz_per_fa: the same per fA of light.
        dark_fa: photocurrent without light.
        shot_density: one-sided power spectral density of the light's logarithm at 1 fA, in fA/Hz; it falls with 1/L.
        jitter_s: standard deviation of time stamps.
    """

    alpha: float
    beta: float
    gamma: float
    sf_cutoff_hz: float
    diff_cutoff_hz: float
    on_threshold: float
    off_threshold: float
    refractory_s: float
    threshold_mismatch: float = 0.0
    threshold_sigma: float = 0.0
    leak_hz: float = 0.0
    leak_hz_per_fa: float = 0.0
    dark_fa: float = 0.0
    shot_density: float = 0.0
    jitter_s: float = 0.0

    @property
    def rates(self) -> np.ndarray:
        """(5,): α, β, γ and the two angular cutoffs."""
        follower, amplifier = 2 * np.pi * self.sf_cutoff_hz, 2 * np.pi * self.diff_cutoff_hz
        return np.array([self.alpha, self.beta, self.gamma, follower, amplifier])


@dataclass(frozen=True)
class Grid:
    """Steps h (n,) s, beginning at t (n + 1,), and the radiance in fA at their ends (n + 1,) and middles (n,).

    Corners of the light must be on the grid: between its points the light is smooth.
    """

    t: np.ndarray
    h: np.ndarray
    ends: np.ndarray
    middles: np.ndarray


@dataclass(frozen=True)
class Trajectory:
    """At the grid's points (n + 1,): photoreceptor, follower, amplifier that is never reset, leak since the start."""

    photoreceptor: np.ndarray
    follower: np.ndarray
    amplifier: np.ndarray
    leaked: np.ndarray


def grid(light, corners, duration_s: float, step_s: float) -> Grid:
    """Equal steps of at most `step_s` between corners of `light`, a function of time in seconds that gives fA."""
    bounds = np.unique(np.concatenate([[0.0], [c for c in corners if 0.0 < c < duration_s], [duration_s]]))
    counts = np.ceil(np.diff(bounds) / step_s - 1e-9).astype(int)
    h = np.repeat(np.diff(bounds) / counts, counts)
    parts = zip(bounds[:-1], bounds[1:], counts, strict=True)
    t = np.concatenate([begin + np.arange(m) * (end - begin) / m for begin, end, m in parts])
    t = np.append(t, duration_s)
    return Grid(t, h, light(t), light(t[:-1] + 0.5 * h))


def trajectory(circuit: Circuit, steps: Grid, gain: float = 1.0, rng: np.random.Generator | None = None) -> Trajectory:
    """From the steady state at the grid's start.

    Args:
        circuit: the pixel.
        steps: times and light.
        gain: what this pixel's light is multiplied by.
        rng: of the shot noise, which is left out without it.
    """
    ends, middles = gain * steps.ends + circuit.dark_fa, gain * steps.middles + circuit.dark_fa
    noise = np.zeros(len(steps.h))
    if rng is not None and circuit.shot_density > 0:  # white up to half the rate of steps
        noise = rng.standard_normal(len(steps.h)) * np.sqrt(circuit.shot_density / middles / (2.0 * steps.h))
    outputs = _solve(steps.h, ends, middles, np.log(ends), np.log(middles), noise, circuit.rates)
    rate = np.array([circuit.leak_hz + circuit.leak_hz_per_fa * each for each in (ends[:-1], middles, ends[1:])])
    leaked = np.concatenate([[0.0], np.cumsum(steps.h * (rate[0] + 4.0 * rate[1] + rate[2]) / 6.0)])
    return Trajectory(*outputs, circuit.on_threshold * leaked)


@njit(cache=False)
def _filtered(z, before, begin, slope, end, end_slope):
    """First-order low-pass after a step of z time constants; its input is the cubic of ends and slopes per step."""
    after = before * np.exp(-z)
    for i in range(len(NODES)):
        after += WEIGHTS[i] * z * np.exp(-z * (1.0 - NODES[i])) * _cubic(NODES[i], begin, slope, end, end_slope)
    return after


@njit(cache=False)
def _cubic(x, begin, slope, end, end_slope):
    """Hermite's polynomial at x in 0…1; slopes are per step."""
    rise = end - begin
    return begin + x * (slope + x * (3.0 * rise - 2.0 * slope - end_slope + x * (slope + end_slope - 2.0 * rise)))


@njit(cache=False)
def _weights(z):
    """(e^−z, weights of begin, slope, end, end slope) of `_filtered`."""
    out = np.empty(5)
    for i in range(5):
        unit = np.zeros(5)
        unit[i] = 1.0
        out[i] = _filtered(z, unit[0], unit[1], unit[2], unit[3], unit[4])
    return out


@njit(cache=False)
def _solve(h, ends, middles, u_ends, u_middles, noise, rates):
    alpha, beta, gamma, wf, wa = rates
    n = len(h)
    receptor, follower, amplifier = np.empty(n + 1), np.empty(n + 1), np.empty(n + 1)
    v, y, s, d = 0.0, u_ends[0], u_ends[0], u_ends[0]
    receptor[0], follower[0], amplifier[0] = y, s, d
    last, of_follower, of_amplifier = -1.0, np.empty(5), np.empty(5)
    for k in range(n):
        dt = h[k]
        if dt != last:
            last, of_follower, of_amplifier = dt, _weights(wf * dt), _weights(wa * dt)
        half, sixth, extra = 0.5 * dt, dt / 6.0, noise[k]
        l0, l1, l2 = ends[k], middles[k], ends[k + 1]
        u0, u1, u2 = u_ends[k] + extra, u_middles[k] + extra, u_ends[k + 1] + extra
        damp0, damp1, damp2 = beta + gamma * l0, beta + gamma * l1, beta + gamma * l2
        a = alpha * l0 * (u0 - y) - damp0 * v
        vb = v + half * a
        b = alpha * l1 * (u1 - y - half * v) - damp1 * vb
        vc = v + half * b
        c = alpha * l1 * (u1 - y - half * vb) - damp1 * vc
        ve = v + dt * c
        e = alpha * l2 * (u2 - y - dt * vc) - damp2 * ve
        y_next = y + sixth * (v + 2.0 * vb + 2.0 * vc + ve)
        v_next = v + sixth * (a + 2.0 * b + 2.0 * c + e)
        w = of_follower
        s_next = w[0] * s + w[1] * y + w[2] * dt * v + w[3] * y_next + w[4] * dt * v_next
        w, rise, rise_next = of_amplifier, wf * dt * (y - s), wf * dt * (y_next - s_next)
        d = w[0] * d + w[1] * s + w[2] * rise + w[3] * s_next + w[4] * rise_next
        v, y, s = v_next, y_next, s_next
        receptor[k + 1], follower[k + 1], amplifier[k + 1] = y, s, d
    return receptor, follower, amplifier


def thresholds(circuit: Circuit, pixels: int, rng: np.random.Generator) -> np.ndarray:
    """(pixels, 2) mean ON and OFF thresholds of each pixel."""
    scatter = 1.0 + circuit.threshold_mismatch * rng.standard_normal((pixels, 2))
    return np.array([circuit.on_threshold, circuit.off_threshold]) * scatter


def walk(circuit: Circuit, steps: Grid, path: Trajectory, own: np.ndarray, draws: np.ndarray, begin: float | None):
    """Events of one pixel.

    Args:
        circuit: the pixel.
        steps: the grid.
        path: its signals there.
        own: (2,) its ON and OFF threshold.
        draws: (m + 1, 2) what the thresholds are multiplied by, event by event; m is the most events there can be.
        begin: share of the way from −C_off to C_on at which the change begins; None begins at 0.

    Returns:
        (times in s, polarities ±1)
    """
    wf, wa = circuit.rates[3:]
    signals = path.photoreceptor, path.follower, path.amplifier, path.leaked
    first = own[1] * draws[0, 1] if begin is None else begin * float(own @ draws[0])
    return _walk(steps.t, steps.h, *signals, wf, wa, circuit.refractory_s, own[0], own[1], draws, first)


@njit(cache=False)
def _at(x, k, h, receptor, follower, amplifier, wf, wa):
    """(follower, amplifier) at the share x of step k."""
    f0, f1, a0, a1 = follower[k], follower[k + 1], amplifier[k], amplifier[k + 1]
    s = _cubic(x, f0, wf * h * (receptor[k] - f0), f1, wf * h * (receptor[k + 1] - f1))
    return s, _cubic(x, a0, wa * h * (f0 - a0), a1, wa * h * (f1 - a1))


@njit(cache=False)
def _walk(t, h, receptor, follower, amplifier, leaked, wf, wa, dead_s, on, off, draws, first):
    """`first`: how far above −C_off the change begins."""
    n, most = len(h), len(draws) - 1
    times, signs, count = np.empty(most), np.empty(most), 0
    high, low = on * draws[0, 0], off * draws[0, 1]
    release, gap, fallen, k, x0 = t[0], 0.0, 0.0, 0, 0.0
    level = amplifier[0] - (first - low)
    while k < n and count < most:
        # the change at the share x of step k
        dt = h[k]
        slope0 = wa * dt * (follower[k] - amplifier[k])
        slope1 = wa * dt * (follower[k + 1] - amplifier[k + 1])
        drift = leaked[k + 1] - leaked[k]
        a0, a1 = amplifier[k], amplifier[k + 1]
        fade0 = gap * np.exp(-wa * (t[k] + x0 * dt - release))
        fade1 = gap * np.exp(-wa * (t[k + 1] - release))
        end = a1 - level - fade1 + leaked[k + 1] - fallen
        stop = -1.0
        if end >= high or end <= -low:
            stop = 1.0
        rate0 = slope0 + drift + wa * dt * fade0
        rate1 = slope1 + drift + wa * dt * fade1
        if rate0 * rate1 < 0.0:  # an extreme in between
            turn = x0 + (1.0 - x0) * rate0 / (rate0 - rate1)
            fade = gap * np.exp(-wa * (t[k] + turn * dt - release))
            inner = _cubic(turn, a0, slope0, a1, slope1) - level - fade + leaked[k] + turn * drift - fallen
            if inner >= high or inner <= -low:
                stop = turn
        if stop < 0.0:
            k, x0 = k + 1, 0.0
            continue
        lower, upper = x0, stop
        sign = 0.0
        for _ in range(44):
            x = 0.5 * (lower + upper)
            fade = gap * np.exp(-wa * (t[k] + x * dt - release))
            change = _cubic(x, a0, slope0, a1, slope1) - level - fade + leaked[k] + x * drift - fallen
            if change >= high or change <= -low:
                upper, sign = x, (1.0 if change >= high else -1.0)
            else:
                lower = x
        if sign == 0.0:
            fade = gap * np.exp(-wa * (t[k] + upper * dt - release))
            change = _cubic(upper, a0, slope0, a1, slope1) - level - fade + leaked[k] + upper * drift - fallen
            sign = 1.0 if change >= high else -1.0
        when = t[k] + upper * dt
        times[count], signs[count] = when, sign
        count += 1
        high, low = on * draws[count, 0], off * draws[count, 1]
        release = when + dead_s
        while k < n and t[k + 1] <= release:
            k += 1
        if k >= n:
            break
        x0 = (release - t[k]) / h[k]
        level, restart = _at(x0, k, h[k], receptor, follower, amplifier, wf, wa)
        gap = restart - level
        fallen = leaked[k] + x0 * (leaked[k + 1] - leaked[k])
    return times[:count], signs[:count]
