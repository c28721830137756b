"""Events of a pixel without poles whose thresholds, dead time and light depend on whatever a function says.

Written out event by event with bisection, from what the definitions say; nothing of the package is used.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq


@dataclass(frozen=True)
class Before:
    """A pixel's previous event: its polarity (±1; 0: there was none), time, radiance and |d ln L/dt| then."""

    polarity: float
    time: float
    radiance: float
    speed: float


Threshold = Callable[[Before, float], float]  # of the previous event and the time since then


def events(
    t: np.ndarray,
    logs: np.ndarray,
    on: Threshold,
    off: Threshold,
    dead: Callable[[Before], float],
    response: Callable[[float, float], float] = lambda log_light, time: log_light,
    leak: Callable[[float, float], float] = lambda log_light, time: 0.0,
    draw: Callable[[], tuple[float, float]] = lambda: (0.0, 0.0),
    fine_s: float = 2e-4,
) -> tuple[np.ndarray, np.ndarray]:
    """(times s, polarities ±1) under light whose logarithm `logs` (n,) is linear between the times t (n,).

    on, off: thresholds;  dead: dead time after an event;  response: of log light and time, what the change is one of
    leak: drift of the change per second, of log light and time;  draw: added to both thresholds, anew for each event
    """
    grid = np.unique(np.concatenate([t, np.arange(t[0], t[-1], fine_s)]))
    np.array([response(x, w) for x, w in zip(np.interp(grid, t, logs), grid, strict=True)])
    rates = np.array([leak(x, w) for x, w in zip(np.interp(grid, t, logs), grid, strict=True)])
    drifted = np.concatenate([[0.0], np.cumsum(0.5 * (rates[1:] + rates[:-1]) * np.diff(grid))])

    def shown(when: float) -> float:
        return response(float(np.interp(when, t, logs)), when) + float(np.interp(when, grid, drifted))

    times, signs = [], []
    before, release = Before(0.0, -np.inf, 1.0, 0.0), float(t[0])
    extra = draw()
    while True:
        level = shown(release)

        def margin(when: float, sign: float, level=level, before=before, extra=extra) -> float:
            threshold = (on if sign > 0 else off)(before, when - before.time) + extra[0 if sign > 0 else 1]
            return sign * (shown(when) - level) - threshold

        first = np.searchsorted(grid, release, side="right")
        found = None
        left = release
        for right in grid[first:]:
            for sign in (1.0, -1.0):
                if margin(right, sign) >= 0.0 and margin(left, sign) < 0.0:
                    when: float = brentq(margin, left, right, args=(sign,), xtol=1e-14)  # type: ignore[assignment]
                    if found is None or when < found[0]:
                        found = when, sign
            if found is not None:
                break
            left = right
        if found is None:
            return np.array(times), np.array(signs)
        when, sign = found
        times.append(when)
        signs.append(sign)
        k = min(int(np.searchsorted(t, when, side="right")) - 1, len(t) - 2)
        speed = abs(logs[k + 1] - logs[k]) / (t[k + 1] - t[k])
        before = Before(sign, when, float(np.exp(np.interp(when, t, logs))), float(speed))
        release = when + dead(before)
        extra = draw()
        if release >= t[-1]:
            return np.array(times), np.array(signs)
