"""`Changes` of the plain pixel in compiled loops: four states, no leak, real values.

What most fits evaluate, thousands of times.  The amplifier's output then differs from the change by a constant once the
reset has decayed, so the extreme of an interval is an extreme of the output: either end of one of the monotone
runs that make up the interval.  Runs are found once per trajectory; an interval is searched run by run.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit

from pixelid.dynamics import vectorised
from pixelid.dynamics.equations import PRESENT_BELOW
from pixelid.dynamics.slew import slews
from pixelid.dynamics.trajectory import Trajectory
from pixelid.stages.circuit import Circuit

BLOCK = 64  # samples whose extremes are kept together
MOST_RUNS = 6  # of an interval; more are searched block by block
DECAYED = 40.0  # time constants after which nothing is left of a reset


def applicable(circuit: Circuit) -> bool:
    """Whether the changes of this circuit are its output's own: nothing leaks, nothing is complex."""
    leaks = circuit.leak_hz != 0 or circuit.leak_hz_per_radiance != 0
    return not leaks and not slews(circuit) and not any(isinstance(value, complex) for value in vars(circuit).values())


class Plain:
    """Output and monotone runs of one trajectory, from which the changes of its intervals are read."""

    def __init__(self, trajectory: Trajectory) -> None:
        self.trajectory = trajectory
        n = len(trajectory.t)
        output, run = np.empty(n), np.empty(n, np.int32)
        highest, lowest = np.empty(-(-n // BLOCK)), np.empty(-(-n // BLOCK))
        _runs(trajectory.states, output, run)
        _block_extremes(output, highest, lowest)
        self.output = output, run, highest, lowest

    @staticmethod
    def describes(trajectory: Trajectory) -> bool:
        """Whether a trajectory is one of real numbers, with an amplifier of finite bandwidth at its end."""
        real = trajectory.states.dtype == np.float64
        present = trajectory.dynamics[6] < PRESENT_BELOW  # otherwise the change's slope is that of an earlier stage
        return bool(real and present and vectorised.applicable(tuple(trajectory.dynamics)))

    def outputs(self, times: np.ndarray, step: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(step, follower, amplifier) at `times` (m,); step: guesses of the steps they lie in, corrected in place."""
        T = self.trajectory
        s, d = np.empty(len(times)), np.empty(len(times))
        _locate_all(T.t, times, step)
        vectorised.outputs_at(times, step, T.t, T.u, T.radiance, tuple(T.dynamics), T.midpoint, T.states, s, d)
        return step, s, d

    def events(
        self,
        release: tuple,
        end: tuple,
        sign: np.ndarray,
        extreme_at: np.ndarray,
        near: tuple | None,
        rows: Sequence[np.ndarray] | np.ndarray,
    ) -> None:
        """Fill rows (change, slope, drift, drift_slope, opposite, opposite_drift) of the intervals.

        release, end: (times, guessed steps) of where they begin and end
        near: levels of (+change, −change) below which an extreme cannot reach a threshold and is not looked for;
        None leaves `extreme_at` as it is
        """
        step_r, level, offset = self.outputs(*release)
        step_e, s, d = self.outputs(*end)
        offset -= level
        change, slope, drift, drift_slope, opposite, opposite_drift = rows
        _changes(release[0], end[0], level, offset, s, d, self.trajectory.dynamics[6], change, slope)
        for nothing in (drift, drift_slope, opposite, opposite_drift):
            nothing[:] = 0.0
        common = (self.trajectory.t, self.output, self.trajectory.dynamics[6])
        if near is not None:
            _locate_extremes(-sign, step_r + 1, step_e, release[0], level, offset, *near, extreme_at, *common)
        _at_extremes(-sign, release[0], level, offset, extreme_at, opposite, *common)

    def censored(
        self,
        release: tuple,
        last_sample: int,
        rise_at: np.ndarray,
        fall_at: np.ndarray,
        locate: bool,
        rows: Sequence[np.ndarray] | np.ndarray,
    ) -> None:
        """Fill rows (rise, rise_drift, fall, fall_drift) of the intervals that the end of the recording cuts off."""
        step, level, offset = self.outputs(*release)
        offset -= level
        common = (self.trajectory.t, self.output, self.trajectory.dynamics[6])
        last = np.full(len(step), last_sample)
        for sign, at, row in ((1.0, rise_at, rows[0]), (-1.0, fall_at, rows[2])):
            signs = np.full(len(step), sign)
            if locate:
                _locate_extremes(signs, step + 1, last, release[0], level, offset, -np.inf, -np.inf, at, *common)
            row[:] = 0.0
            _at_extremes(signs, release[0], level, offset, at, row, *common)
        rows[1][:] = 0.0
        rows[3][:] = 0.0


@njit(cache=True, error_model="numpy")
def locate(t, time, hint):
    """Index k with t[k] ≤ time < t[k+1], walking from a hint."""
    k = hint
    last = len(t) - 1
    if k > last or k < 0:
        k = 0
    if time < t[k] or (k + 16 < last and time > t[k + 16]):
        k = max(np.searchsorted(t, time, side="right") - 1, 0)
    while k < last and t[k + 1] <= time:
        k += 1
    return k


@njit(cache=True, nogil=True, error_model="numpy")
def _locate_all(t, times, step):
    for i in range(len(times)):
        step[i] = locate(t, times[i], step[i])


@njit(cache=True, nogil=True, error_model="numpy")
def _runs(states, output, run):
    """Fill the output, and for each sample where the monotone run that ends there begins."""
    before, start, falling = states[0, 5], 0, False
    output[0], run[0] = before, 0
    for k in range(1, len(output)):
        here = states[k, 5]
        turns = here < before if not falling else here > before
        if turns:
            start, falling = k - 1, not falling
        output[k], run[k] = here, start
        before = here


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _changes(release, time, level, offset, s, d, wd, change, slope):
    for i in range(len(change)):
        since = wd * (time[i] - release[i])
        left = offset[i] * np.exp(min(-since, DECAYED)) if since < DECAYED else 0.0  # before release: only finite
        change[i] = d[i] - level[i] - left
        slope[i] = wd * (s[i] - d[i] + left)


@njit(cache=True, error_model="numpy")
def _change_at(k, tr, level, offset, t, output, wd):
    """The change at sample k of an interval released at tr."""
    change = output[k] - level
    x = wd * (t[k] - tr)
    return change - offset * np.exp(-x) if x < DECAYED else change


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"nnan", "nsz"})
def _block_extremes(output, highest, lowest):
    for block in range(len(highest)):
        high, low = -np.inf, np.inf
        for value in output[block * BLOCK : (block + 1) * BLOCK]:
            high, low = max(high, value), min(low, value)
        highest[block], lowest[block] = high, low


@njit(cache=True, error_model="numpy")
def _highest(sign, low, high, output):
    """(largest sign · output over samples low … high, where), run by run from the right, then block by block."""
    values, run, highest, lowest = output
    k, best, where = high, sign * values[high], high
    for _ in range(MOST_RUNS):
        if k <= low:
            return best, where
        k = max(run[k], low)
        if sign * values[k] >= best:
            best, where = sign * values[k], k
    while k > low:
        block = k // BLOCK
        first = max(block * BLOCK, low)
        if (highest[block] if sign > 0 else -lowest[block]) >= best:
            for j in range(k - 1, first - 1, -1):
                if sign * values[j] >= best:
                    best, where = sign * values[j], j
        k = first if first == low else first - 1
        if sign * values[k] >= best:
            best, where = sign * values[k], k
    return best, where


@njit(cache=True, error_model="numpy")
def _candidates(sign, low, high, level, offset, near_up, near_down, output):
    """Intervals whose sign · change may come near a threshold: a bound per interval, in few instructions."""
    values, run, _, _ = output
    found, count = np.empty(len(low), np.int64), 0
    for i in range(len(low)):
        k = high[i]
        if low[i] > k:
            continue
        peak = sign[i] * values[k]
        for _ in range(MOST_RUNS):
            if k <= low[i]:
                break
            k = max(run[k], low[i])
            peak = max(peak, sign[i] * values[k])
        if k > low[i]:
            peak = np.inf
        # what the reset leaves is at most its offset
        if peak - sign[i] * level[i] + abs(offset[i]) >= (near_up if sign[i] > 0 else near_down):
            found[count] = i
            count += 1
    return found[:count]


@njit(cache=True, nogil=True, error_model="numpy")
def _locate_extremes(sign, low, high, release, level, offset, near_up, near_down, at, t, output, wd):
    """Fill `at` with the sample in low … high where sign · change is largest; −1 where it never exceeds 0, its value
    at release, or stays under what could reach a threshold (near_up, near_down).
    """
    at[:] = -1
    for i in _candidates(sign, low, high, level, offset, near_up, near_down, output):
        left = abs(offset[i])
        peak, where = _highest(sign[i], low[i], high[i], output)
        peak -= sign[i] * level[i]
        if peak + left < (near_up if sign[i] > 0 else near_down):
            continue
        # the output's own extreme after the first samples; among these the reset still counts, one by one
        settled = release[i] + min(max(np.log(left + 1e-300) + 30.0, 0.0), DECAYED) / wd  # decayed to 1e-13
        after = low[i]
        while after <= high[i] and t[after] < settled:
            after += 1
        best = 0.0
        if where < after <= high[i]:
            peak, where = _highest(sign[i], after, high[i], output)
            peak -= sign[i] * level[i]
        if where >= after and peak > best:
            best, at[i] = peak, where
        for k in range(after - 1, low[i] - 1, -1):
            if sign[i] * (output[0][k] - level[i]) + left >= best:
                value = sign[i] * _change_at(k, release[i], level[i], offset[i], t, output[0], wd)
                if value >= best and value > 0.0:
                    best, at[i] = value, k


@njit(cache=True, nogil=True, error_model="numpy")
def _at_extremes(sign, release, level, offset, at, value, t, output, wd):
    for i in range(len(at)):
        if at[i] >= 0:
            value[i] = sign[i] * _change_at(at[i], release[i], level[i], offset[i], t, output[0], wd)
