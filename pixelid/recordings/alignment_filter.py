"""Changes of a filtered log radiance between two events of a pixel; the offset, clock rate and filter that fit them.

Between two events the differencing amplifier sees the filtered log radiance Y change by one threshold C:

    r = s (Y(t_k) − Y(t_(k−1) + dead time))/C_s − 1,   s = ±1 the polarity

on the light's clock.  Y is ln L behind a second-order low-pass whose rates follow the light, and a first-order one.
The filter takes up what the pixel delays, so the offset is the clock's own as far as such a filter describes the pixel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

SOFT = 0.3  # thresholds' units from which a residual counts linearly: noise is some 0.1, missed events are 1
RATE_BOUND = 5e-4  # of a clock: crystals are within 1e-4, ceramic resonators within 5e-4
SHIFT_S, DEAD_S = 1e-3, 1e-4  # units of the first and the seventh parameter
MOST_SHIFT = 20.0  # of SHIFT_S that a refinement may move

# Starts: ln of stiffness, damping, damping by light and follower rate (1/s² and 1/s, at the light's geometric mean),
# dead time (0.1 ms), ln of the thresholds.  Lags of 0.1 ms, 0.2 ms, 1.4 ms and 10 ms.
STARTS = np.array(
    [
        (np.log(stiffness), np.log(damping), np.log(by_light), np.log(2e4), 1.0, np.log(0.2), np.log(0.2))
        for stiffness, damping, by_light in ((4e8, 4e3, 8e3), (2.5e7, 2e3, 500.0), (1.5e6, 2e3, 30.0), (2e5, 2e3, 3.0))
    ]
)
LOWER = np.array([-MOST_SHIFT, -1.0, *np.log([1e2, 1e1, 1e-1, 1e2]), 0.0, *np.log([0.01, 0.01])])
UPPER = np.array([MOST_SHIFT, 1.0, *np.log([1e11, 1e6, 1e6, 1e6]), 20.0, *np.log([3.0, 3.0])])


@dataclass(frozen=True)
class Changes:
    """Intervals between two events of one pixel.

    begin, time: (n,) s from `origin_s`, on the camera's clock;  sign: (n,) ±1 of the event at `time`
    light: (n,) which light the pixel sees;  origin_s: on the camera's clock
    """

    begin: np.ndarray
    time: np.ndarray
    sign: np.ndarray
    light: np.ndarray
    origin_s: float

    def select(self, which: np.ndarray | slice) -> Changes:
        """Those of a mask or an index."""
        return Changes(self.begin[which], self.time[which], self.sign[which], self.light[which], self.origin_s)

    @property
    def middle_s(self) -> float:
        """Between the first and the last event, from `origin_s`."""
        return 0.5 * float(self.time.min() + self.time.max())


@dataclass(frozen=True)
class LogLight:
    """Log radiance on a uniform grid of the light's clock.

    first_s, step_s: of the grid;  log: (lights, n);  level: mean of `log`, where the filter's rates hold
    """

    first_s: float
    step_s: float
    log: np.ndarray
    level: float

    @staticmethod
    def of(lights: Sequence[tuple[np.ndarray, np.ndarray]], finer: int) -> LogLight:
        """`finer` samples per sample of the finest light.

        Args:
            lights: (t (n,), log radiance (n,)) of each.
        """
        first = float(lights[0][0][0])
        duration = float(lights[0][0][-1]) - first
        most_samples = 1 << 18  # of the filter
        step = max(min(float(np.median(np.diff(t))) for t, _ in lights) / finer, duration / most_samples)
        grid = first + step * np.arange(round(duration / step) + 2)
        log = np.array([np.interp(grid, t, values) for t, values in lights])
        return LogLight(first, step, log, float(log.mean()))

    @property
    def last_s(self) -> float:
        """The last sample's time."""
        return self.first_s + self.step_s * (self.log.shape[1] - 1)

    def at(self, filtered: np.ndarray, t: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Value and slope of light number `which` of filtered (lights, n) at times t; constant outside of the grid."""
        place, last = (t - self.first_s) / self.step_s, filtered.shape[1] - 1
        k = np.clip(place, 0, last - 1).astype(np.int64)
        low, rise = filtered[which, k], filtered[which, k + 1] - filtered[which, k]
        inside = (place > 0.0) & (place < last)
        return low + np.clip(place - k, 0.0, 1.0) * rise, np.where(inside, rise / self.step_s, 0.0)

    def filtered(self, rates: np.ndarray) -> np.ndarray:
        """(m, lights, n) behind filters of ln rates (m, 4): see `STARTS`."""
        out = np.empty((len(rates), *self.log.shape))
        for k, log in enumerate(self.log):
            _filter(log, np.exp(log - self.level), self.step_s, np.exp(rates), out[:, k])
        return out


@dataclass(frozen=True)
class Refined:
    """A refinement: x (9,) shift (ms), rate (of RATE_BOUND), then as in `STARTS`; residuals and Jacobian there.

    begin_s: the light's time zero from `origin_s` of the changes at shift 0
    """

    begin_s: float
    x: np.ndarray
    residuals: np.ndarray
    jacobian: np.ndarray

    @property
    def zero_s(self) -> float:
        """The light's time zero at the changes' middle, from `origin_s`."""
        return self.begin_s + SHIFT_S * float(self.x[0])

    @property
    def cost(self) -> float:
        """Mean loss of a change."""
        return float(soft_loss(self.residuals).mean())


def soft_loss(residuals: np.ndarray) -> np.ndarray:
    """Half a square near zero, linear far from it."""
    return SOFT**2 * (np.sqrt(1.0 + (residuals / SOFT) ** 2) - 1.0)


def refine(
    changes: Changes,
    light: LogLight,
    begin_s: float,
    start: np.ndarray,
    centre: np.ndarray,
    steps: int,
    tolerance: float = 1e-4,
) -> Refined:
    """Least squares of soft residuals over shift, rate, filter, dead time and both thresholds.

    Args:
        begin_s: the light's time zero, from `origin_s`.
        start: (9,) parameters.
        centre: (4,) ln rates of the filter to which it is weakly held.
        steps: at most;  tolerance: relative, of the loss.
    """
    problem = _Problem(changes, light, begin_s, centre)
    x = np.clip(start, LOWER, UPPER)
    r, damping = problem.residuals(x), 1e-3
    for _ in range(steps):
        jacobian = problem.jacobian(x)
        weighted = jacobian / np.sqrt(1.0 + (r / SOFT) ** 2)[:, None]  # of the soft loss
        gradient, curvature = weighted.T @ r, weighted.T @ jacobian
        free = ~((x <= LOWER) & (gradient > 0) | (x >= UPPER) & (gradient < 0))
        before = soft_loss(r).sum()
        for _ in range(6):
            x_new, r_new = x.copy(), r
            x_new[free] -= _step(gradient[free], curvature[np.ix_(free, free)], damping)
            x_new = np.clip(x_new, LOWER, UPPER)
            r_new = problem.residuals(x_new)
            lower = before - soft_loss(r_new).sum()
            if lower > 0.0:
                break
            damping *= 5.0
        if lower <= 0.0:
            break
        x, r, damping = x_new, r_new, 0.2 * damping
        if lower < tolerance * before:
            break
    count = len(changes.time)
    r, jacobian = problem.residuals(x)[:count], problem.jacobian(x)[:count]
    return Refined(begin_s, x, r, jacobian)


def _step(gradient: np.ndarray, curvature: np.ndarray, damping: float) -> np.ndarray:
    """Levenberg–Marquardt."""
    own = np.maximum(np.diag(curvature), 1e-12)
    return np.linalg.solve(curvature + np.diag(damping * own + 1e-12), gradient)


def downhill(changes: Changes, light: LogLight, begin: Refined, end: Refined) -> bool:
    """Whether the loss never rises on the line from one refinement to a better one: then both are one optimum."""
    to = end.x.copy()
    to[0] += (end.begin_s - begin.begin_s) / SHIFT_S
    problem = _Problem(changes, light, begin.begin_s, end.x[2:6])
    line = (begin.x + share * (to - begin.x) for share in (0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9))
    costs = [begin.cost, *(float(soft_loss(problem.residuals(x)[:-4]).mean()) for x in line), end.cost]
    return bool((np.diff(costs) <= 0.0).all())


def hold(changes: int) -> float:
    """Residual of a filter's ln rate per e-fold off its centre: the same share of any number of changes."""
    weak = 0.03  # thresholds' units by which an e-fold of a filter's rate counts: holds what the light does not excite
    return weak * float(np.sqrt(changes / 100.0))


def scan(
    changes: Changes, light: LogLight, filtered: np.ndarray, begins_s: np.ndarray, x: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Sum of the loss of the changes that lie within the light, and their number, at each offset.

    Args:
        filtered: (lights, n) of `light`.
        begins_s: (k,) the light's time zero from `origin_s`.
        x: (9,) parameters; the rate is 0.
    """
    gain = np.where(changes.sign > 0, np.exp(-x[7]), np.exp(-x[8])) * changes.sign
    loss, count = np.zeros(len(begins_s)), np.zeros(len(begins_s))
    scanned_at_once = 64  # offsets
    for k in range(0, len(begins_s), scanned_at_once):
        begin_s = begins_s[k : k + scanned_at_once, None]
        first, end = changes.begin + DEAD_S * x[6] - begin_s, changes.time - begin_s
        inside = (first >= light.first_s) & (first <= end) & (end < light.last_s)
        low, high = (light.at(filtered, t, changes.light)[0] for t in (first, end))
        loss[k : k + scanned_at_once] = np.where(inside, soft_loss(gain * (high - low) - 1.0), 0.0).sum(axis=1)
        count[k : k + scanned_at_once] = inside.sum(axis=1)
    return loss, count


def within(changes: Changes, light: LogLight, fit: Refined, middle_s: float | None = None) -> np.ndarray:
    """(n,) whether both ends of a change lie within the light; `middle_s`: of the changes refined, if others."""
    middle_s = changes.middle_s if middle_s is None else middle_s
    begin, time = (_on_light(t, middle_s, fit.begin_s, fit.x) for t in (changes.begin, changes.time))
    return (begin >= light.first_s) & (time <= light.last_s)


def lag_s(x: np.ndarray) -> float:
    """Seconds by which a filter (its part of a start) delays slow changes."""
    return float((np.exp(x[1]) + np.exp(x[2])) / np.exp(x[0]) + np.exp(-x[3]))


def _on_light(t: np.ndarray, middle: float, begin_s: float, x: np.ndarray) -> np.ndarray:
    return t - begin_s - SHIFT_S * x[0] - RATE_BOUND * x[1] * (t - middle)


class _Problem:
    """Residuals and Jacobian of `refine`; the filter runs only where its rates have moved."""

    def __init__(self, changes: Changes, light: LogLight, begin_s: float, centre: np.ndarray) -> None:
        self.changes, self.light, self.begin_s, self.centre = changes, light, begin_s, centre
        self.middle = changes.middle_s
        self.rates = np.full(4, np.nan)
        self.filtered = np.empty(0)
        self.holds = hold(len(changes.time))

    def _times(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        time, begin = (_on_light(t, self.middle, self.begin_s, x) for t in (self.changes.time, self.changes.begin))
        return time, begin + DEAD_S * x[6]

    def _gain(self, x: np.ndarray) -> np.ndarray:
        return np.where(self.changes.sign > 0, np.exp(-x[7]), np.exp(-x[8])) * self.changes.sign

    def residuals(self, x: np.ndarray) -> np.ndarray:
        if not np.array_equal(x[2:6], self.rates):
            self.rates, self.filtered = x[2:6].copy(), self.light.filtered(x[None, 2:6])[0]
        end, begin = (self.light.at(self.filtered, t, self.changes.light)[0] for t in self._times(x))
        return np.concatenate([self._gain(x) * (end - begin) - 1.0, self.holds * (x[2:6] - self.centre)])

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        r = self.residuals(x)[: len(self.changes.time)]
        time, begin = self._times(x)
        gain, on, which = self._gain(x), self.changes.sign > 0, self.changes.light
        (_, fast), (_, fast_begin) = (self.light.at(self.filtered, t, which) for t in (time, begin))
        out = np.zeros((len(r) + 4, 9))
        rows = out[: len(r)]
        rows[:, 0] = -SHIFT_S * gain * (fast - fast_begin)
        apart = self.changes.time - self.middle, self.changes.begin - self.middle
        rows[:, 1] = -RATE_BOUND * gain * (fast * apart[0] - fast_begin * apart[1])
        step = 1e-4
        for k, moved in enumerate(self.light.filtered(x[2:6] + step * np.eye(4)), start=2):
            high, low = (self.light.at(moved, t, which)[0] for t in (time, begin))
            rows[:, k] = (gain * (high - low) - 1.0 - r) / step
        rows[:, 6] = -DEAD_S * gain * fast_begin
        rows[on, 7], rows[~on, 8] = -(r[on] + 1.0), -(r[~on] + 1.0)
        out[len(r) + np.arange(4), 2 + np.arange(4)] = self.holds
        return out


@njit(cache=True, fastmath=True, error_model="numpy")
def _filter(u, relative, step, rates, out):
    """Fill `out` (m, n) with u (n,) behind m filters of rates (m, 4) that run side by side.

    y'' + (damping + damping_of_light · relative) y' + stiffness · relative (y − u) = 0 by the implicit trapezoid, which
    is stable at any step and of second order, then a first-order low-pass; at rest at the first sample.
    """
    m = len(rates)
    y, v, s = np.empty(m), np.zeros(m), np.empty(m)
    keep = np.exp(-rates[:, 3] * step)
    half = 0.5 * step
    for j in range(m):
        y[j] = s[j] = out[j, 0] = u[0]
    for k in range(1, len(u)):
        light = 0.5 * (relative[k - 1] + relative[k])
        target = 0.5 * (u[k - 1] + u[k])
        for j in range(m):
            a, b = rates[j, 0] * light, rates[j, 1] + rates[j, 2] * light
            # v1 = v − step (b (v + v1)/2 + a ((y + y1)/2 − target)),  y1 = y + step (v + v1)/2
            v1 = v[j] * (1.0 - half * b - half * half * a) - step * a * (y[j] - target)
            v1 /= 1.0 + half * b + half * half * a
            y1 = y[j] + half * (v[j] + v1)
            mean = 0.5 * (y[j] + y1)
            s[j] = mean + (s[j] - mean) * keep[j]
            y[j], v[j] = y1, v1
            out[j, k] = s[j]
