"""Events of one pixel with a dead time that resets and one that does not, by small Runge–Kutta steps.

The amplifier that is simulated is the one that gets reset: it restarts from the source follower at the end of the
dead time, and its change since then is followed step by step.  Nothing of the package is used.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np


def events(
    log_light: Callable[[float], float],
    duration_s: float,
    *,
    alpha: float,
    beta: float,
    gamma: float,
    follower: float,
    differencing: float,
    thresholds: tuple[float, float],
    dead_s: float,
    silent_s: float,
    leak_hz: float = 0.0,
    step_s: float = 2e-6,
) -> tuple[np.ndarray, np.ndarray]:
    """(times s, polarities ±1) under light of log radiance `log_light`, the first reference taken at time 0.

    Args:
        log_light: Log radiance at a time in seconds.
        duration_s: Until when.
        alpha, beta, gamma: Of the photoreceptor.
        follower, differencing: Cutoffs, rad/s.
        thresholds: ON, OFF, log radiance.
        dead_s: How long the amplifier is held in reset after an event.
        silent_s: How long the comparator does not look after an event.
        leak_hz: ON thresholds per second that drift into the change.
        step_s: Of the integration; crossings are taken to lie on the straight line between two of its ends.
    """
    on, off = thresholds

    def slopes(t, x, held):
        v, y, s, a = x
        u = log_light(t)
        light = float(np.exp(u))
        return np.array(
            (
                alpha * light * (u - y) - (beta + gamma * light) * v,
                v,
                follower * (y - s),
                follower * (y - s) if held else differencing * (s - a),
            )
        )

    def advanced(t, h, x, held):
        k1 = slopes(t, x, held)
        k2 = slopes(t + h / 2, x + h / 2 * k1, held)
        k3 = slopes(t + h / 2, x + h / 2 * k2, held)
        k4 = slopes(t + h, x + h * k3, held)
        return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    u0 = log_light(0.0)
    t, x = 0.0, np.array([0.0, u0, u0, u0])
    reference, released, last, held = u0, 0.0, -np.inf, False
    times, signs = [], []

    def change(t, x):
        return x[3] - reference + on * leak_hz * (t - released)

    while t < duration_s:
        stops = [duration_s, last + dead_s if held else np.inf, last + silent_s if t < last + silent_s else np.inf]
        h = min(step_s, min(stops) - t)
        later = advanced(t, h, x, held) if h > 0.0 else x
        then = min(stops) if h < step_s else t + h
        if held and then >= last + dead_s:  # released: the amplifier and its reference are what the follower shows
            t, x, held = then, np.array([*later[:3], later[2]]), False
            reference, released = later[2], then
            continue
        if held or then < last + silent_s or (h <= 0.0 and then > last + silent_s):
            t, x = then, later
            continue
        before, after = change(t, x), change(then, later)
        seen = t >= last + silent_s  # else the comparator opens at the end of this step
        at, sign = None, 0.0
        if seen and (before >= on or before <= -off):
            at, sign = t, 1.0 if before >= on else -1.0
        elif after >= on or after <= -off:
            sign = 1.0 if after >= on else -1.0
            threshold = on if sign > 0 else -off
            at = t + h * (threshold - before) / (after - before) if seen else then
        if at is None:
            t, x = then, later
            continue
        t, x = at, advanced(t, at - t, x, held) if at > t else x
        times.append(t)
        signs.append(sign)
        last, held = t, True
        if dead_s == 0.0:
            x, held, reference, released = np.array([*x[:3], x[2]]), False, x[2], t
    return np.array(times), np.array(signs)
