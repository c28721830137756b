"""Noise events by brute force: the stages' noise stepped exactly in distribution, thresholds, dead time and resets.

Written from the circuit's equations alone: its own matrices, its own crossings (cubics between steps), no code of the
package.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy.linalg import expm, solve_continuous_lyapunov

PLACES = 64  # of a crossing within a step that are told apart


def stages(a: float, b2: float, follower: float, differencing: float, psd: float) -> tuple[np.ndarray, np.ndarray]:
    """(A, P): dynamics and stationary covariance of slope / √a, photoreceptor, follower, amplifier; psd one-sided."""
    root = np.sqrt(a)
    A = np.array(
        [[-b2, -root, 0, 0], [root, 0, 0, 0], [0, follower, -follower, 0], [0, 0, differencing, -differencing]]
    )
    Q = np.zeros((4, 4))
    Q[0, 0] = a * psd / 2
    return A, solve_continuous_lyapunov(A, -Q)


def simulate_noise_events(
    a: float, b2: float, follower: float, differencing: float, psd: float, on: float, off: float, *,
    dead_s: float, duration_s: float, leak: float = 0.0, threshold_noise: float = 0.0, seed: int = 0,
    fineness: float = 20.0,
) -> tuple[np.ndarray, np.ndarray, float]:  # fmt: skip
    """(times, polarities, duration) of one pixel.

    a, b2: ωn² and 2ζωn of the photoreceptor;  follower, differencing: rad/s;  on, off: thresholds;  leak: change per
    second;  fineness: steps per time in which the slope's scale passes one standard deviation.
    """
    A, P = stages(a, b2, follower, differencing, psd)
    step = np.sqrt(P[3, 3] / (A @ P @ A.T)[3, 3]) / fineness
    if dead_s > 0:
        step = min(step, dead_s)
    F, root = _stepped(A, P, step)
    # from the end of the step in which a threshold is crossed to the end of the dead time, by place of the crossing
    silent = [_stepped(A, P, max(dead_s - (1.0 - (k + 0.5) / PLACES) * step, 0.0)) for k in range(PLACES)]
    rng = np.random.default_rng(seed)
    x = rng.multivariate_normal(np.zeros(4), P)
    t, p = _run(
        rng, F, root, np.array([each[0] for each in silent]), np.array([each[1] for each in silent]), step,
        differencing, on, off, dead_s, leak, threshold_noise, x, duration_s,
    )  # fmt: skip
    return t, p, duration_s


def _stepped(A, P, step):
    """Propagator of a step and a root of the covariance of its noise."""
    F = expm(A * step)
    scale = np.sqrt(np.diag(P))
    values, vectors = np.linalg.eigh((P - F @ P @ F.T) / np.outer(scale, scale))
    return F, scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))


@njit(cache=True, fastmath=True)
def _cubic(f, z0, s0, z1, s1, h):
    """The cubic through two steps' values and slopes, at a fraction f of the step."""
    return (
        z0 * (1 + 2 * f) * (1 - f) ** 2
        + h * s0 * f * (1 - f) ** 2
        + z1 * f * f * (3 - 2 * f)
        + h * s1 * f * f * (f - 1)
    )


@njit(cache=True, fastmath=True)
def _crossed(level, sign, end, z0, s0, z1, s1, h):
    """Fraction of the step, before `end`, at which sign · cubic first exceeds sign · level."""
    low, high = 0.0, end
    for _ in range(20):
        middle = 0.5 * (low + high)
        if sign * _cubic(middle, z0, s0, z1, s1, h) >= sign * level:
            high = middle
        else:
            low = middle
    return high


@njit(cache=True, fastmath=True)
def _move(rng, F, root, x, y):
    """x after a step; y is room for it."""
    g = (rng.standard_normal(), rng.standard_normal(), rng.standard_normal(), rng.standard_normal())
    for r in range(4):
        y[r] = 0.0
        for q in range(4):
            y[r] += F[r, q] * x[q] + root[r, q] * g[q]
    x[:] = y


@njit(cache=True, fastmath=True)
def _run(rng, F, root, jumps, jump_roots, h, wd, on_mean, off_mean, dead, leak, noise, x, duration):
    times, polarities, count = np.empty(1024), np.empty(1024, np.int8), 0
    y = np.empty(4)
    kept, lag, since = x[2], x[3] - x[2], 0.0
    on, off = on_mean * (1 + noise * rng.standard_normal()), off_mean * (1 + noise * rng.standard_normal())
    z0, s0, now = 0.0, 0.0, 0.0
    fade = np.exp(-wd * h)
    while now < duration:
        _move(rng, F, root, x, y)
        now += h
        lag *= fade
        since += h
        z = x[3] - kept - lag + leak * since
        s = wd * (x[2] - x[3] + lag) + leak
        end, extreme = 1.0, z
        if s0 * s < 0.0:
            end = s0 / (s0 - s)
            extreme = _cubic(end, z0, s0, z, s, h)
        up = max(z, extreme) >= on
        if up or min(z, extreme) <= -off:
            if count == len(times):
                more, other = np.empty(2 * count), np.empty(2 * count, np.int8)
                more[:count], other[:count] = times, polarities
                times, polarities = more, other
            level, sign = (on, 1.0) if up else (-off, -1.0)
            if sign * extreme < sign * level:
                end = 1.0
            at = _crossed(level, sign, end, z0, s0, z, s, h)
            times[count], polarities[count] = now - (1.0 - at) * h, 1 if up else 0
            count += 1
            on, off = on_mean * (1 + noise * rng.standard_normal()), off_mean * (1 + noise * rng.standard_normal())
            if dead > 0.0:
                place = min(int(at * len(jumps)), len(jumps) - 1)
                _move(rng, jumps[place], jump_roots[place], x, y)
                now = times[count - 1] + dead
            kept, lag, since, z0, s0 = x[2], x[3] - x[2], 0.0, 0.0, leak
        else:
            z0, s0 = z, s
    return times[:count], polarities[:count]
