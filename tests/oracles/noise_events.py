"""Noise events by brute force: the stages' noise stepped exactly in distribution, thresholds, dead time and resets.

Written from the circuit's equations alone: its own matrices, its own crossings (cubics between steps), no code of the
package.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy.linalg import expm, solve_continuous_lyapunov


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
    # an event is seen at the end of its step, half a step late: a dead time of m − ½ steps is the wanted one
    silent = max(1, round(dead_s / step))
    step = dead_s / (silent - 0.5) if dead_s > step else step
    F = expm(A * step)
    scale = np.sqrt(np.diag(P))
    values, vectors = np.linalg.eigh((P - F @ P @ F.T) / np.outer(scale, scale))
    root = scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    rng = np.random.default_rng(seed)
    x = rng.multivariate_normal(np.zeros(4), P)
    steps = int(duration_s / step)
    t, p = _run(rng, F, root, step, differencing, on, off, silent if dead_s > 0 else 0, leak, threshold_noise, x, steps)
    return t, p, steps * step


@njit(cache=True, fastmath=True)
def _peak(z0, s0, z1, s1, h):
    """The extreme of the cubic between two steps at which the slope changes its sign."""
    f = s0 / (s0 - s1)
    return (
        z0 * (1 + 2 * f) * (1 - f) ** 2
        + h * s0 * f * (1 - f) ** 2
        + z1 * f * f * (3 - 2 * f)
        + h * s1 * f * f * (f - 1)
    )


@njit(cache=True, fastmath=True)
def _run(rng, F, root, h, wd, on_mean, off_mean, silent, leak, noise, x, steps):
    times, polarities, count = np.empty(1024), np.empty(1024, np.int8), 0
    y = np.empty(4)
    kept, lag, since, waiting = x[2], x[3] - x[2], 0.0, 0
    on, off = on_mean * (1 + noise * rng.standard_normal()), off_mean * (1 + noise * rng.standard_normal())
    z0, s0 = 0.0, 0.0
    fade = np.exp(-wd * h)
    for i in range(steps):
        g = (rng.standard_normal(), rng.standard_normal(), rng.standard_normal(), rng.standard_normal())
        for r in range(4):
            y[r] = 0.0
            for q in range(4):
                y[r] += F[r, q] * x[q] + root[r, q] * g[q]
        x[:] = y
        if waiting > 0:
            waiting -= 1
            if waiting == 0:
                kept, lag, since, z0, s0 = x[2], x[3] - x[2], 0.0, 0.0, 0.0
            continue
        lag *= fade
        since += h
        z = x[3] - kept - lag + leak * since
        s = wd * (x[2] - x[3] + lag) + leak
        top, bottom = max(z0, z), min(z0, z)
        if s0 > 0.0 > s:
            top = max(top, _peak(z0, s0, z, s, h))
        elif s0 < 0.0 < s:
            bottom = min(bottom, _peak(z0, s0, z, s, h))
        z0, s0 = z, s
        if top >= on or bottom <= -off:
            if count == len(times):
                more, other = np.empty(2 * count), np.empty(2 * count, np.int8)
                more[:count], other[:count] = times, polarities
                times, polarities = more, other
            times[count], polarities[count] = (i + 1) * h, 1 if top >= on else 0
            count += 1
            on, off = on_mean * (1 + noise * rng.standard_normal()), off_mean * (1 + noise * rng.standard_normal())
            waiting = silent
            if silent == 0:
                kept, lag, since, z0, s0 = x[2], x[3] - x[2], 0.0, 0.0, 0.0
    return times[:count], polarities[:count]
