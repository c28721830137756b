"""Where, between a pixel's release and the end of an interval, the change reached furthest: positions and values.

Without leak the change differs from the amplifier's output by a constant once the reset has decayed, so its extreme is
an extreme of the output: either end of one of the monotone runs that make up the interval.  Runs are found once per
trajectory; an interval is searched run by run.  With leak every sample of the interval is looked at.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from pixelid.dynamics.equations import PRESENT_BELOW
from pixelid.dynamics.trajectory import Trajectory

BLOCK = 64  # samples whose extremes are kept together: does not matter within a factor of two
MOST_RUNS = 6  # of an interval; more are searched block by block
DECAYED = 40.0  # time constants after which nothing is left of a reset


@dataclass(frozen=True)
class Extremes:
    """Samples at which the changes of n intervals and of m censored ones reach furthest; −1: nowhere that matters.

    opposite: (n,) of −sign·change before the event;  rise, fall: (m,) of +change and −change
    """

    opposite: np.ndarray
    rise: np.ndarray
    fall: np.ndarray


@dataclass(frozen=True)
class Output:
    """What the amplifier shows at the n samples of a trajectory, and its monotone runs.

    values: (n,);  run: (n,) where the monotone run that ends at each sample begins
    highest, lowest: (n / BLOCK,) extremes of each block of samples
    """

    values: np.ndarray
    run: np.ndarray
    highest: np.ndarray
    lowest: np.ndarray

    @staticmethod
    def of(trajectory: Trajectory) -> Output:
        """The output of a trajectory; where the amplifier has no pole, what drives it."""
        states, n = trajectory.states, len(trajectory.t)
        plain = trajectory.dynamics.differencing < PRESENT_BELOW
        values, run = np.empty(n), np.empty(n, np.int32)
        highest, lowest = np.empty(-(-n // BLOCK)), np.empty(-(-n // BLOCK))
        _runs(states, plain, values, run)
        _block_extremes(values, highest, lowest)
        return Output(values, run, highest, lowest)

    @staticmethod
    def without_runs(trajectory: Trajectory) -> Output:
        """As `of`, its runs and blocks empty: for extremes whose places are known."""
        states = trajectory.states
        plain = trajectory.dynamics.differencing < PRESENT_BELOW
        values = states[:, 5].copy() if plain else states[:, 3] - states[:, 4]
        return Output(values, np.empty(0, np.int32), *np.empty((2, 0)))


@dataclass(frozen=True)
class Begun:
    """Where k intervals begin: release_s, sample (k,), reset level and output less that level at release (k,)."""

    release_s: np.ndarray
    sample: np.ndarray
    level: np.ndarray
    offset: np.ndarray


@dataclass(frozen=True)
class Drift:
    """What leaks into the change, in ON thresholds: per second, per second and radiance; on: the ON threshold.

    lights: (samples,) ∫ L dt from the first sample;  light: (k,) the same at the releases
    """

    rate: float
    per_light: float
    on: float
    lights: np.ndarray
    light: np.ndarray


def locate_extremes(
    trajectory: Trajectory, output: Output, begun: Begun, sign, last, near: tuple[float, float], drift: Drift | None
) -> np.ndarray:
    """(k,) samples after release, up to `last`, where sign · change is largest.

    −1 where it never exceeds 0, its value at release, or stays below `near`: the changes (ON, OFF) that cannot have
    reached a threshold.
    """
    if drift is not None:
        return locate_by_sample(trajectory, output, begun, sign, last, drift)
    at = np.empty(len(sign), np.int64)
    _locate(
        sign, begun.sample + 1, last, begun.release_s, begun.level, begun.offset, *near, at, trajectory.t,
        (output.values, output.run, output.highest, output.lowest), trajectory.dynamics.differencing,
    )  # fmt: skip
    return at


def locate_by_sample(
    trajectory: Trajectory,
    output: Output,
    begun: Begun,
    sign: np.ndarray,
    last: np.ndarray,
    drift: Drift | None,
    relaxing: tuple[np.ndarray, np.ndarray, float] | None = None,
) -> np.ndarray:
    """As `locate_extremes`, where something leaks or thresholds relax: every sample is looked at.

    relaxing: (time of the event before (k,), shift of the threshold just after it (k,), scale s)
    """
    k = len(sign)
    at, nothing = np.empty(k, np.int64), np.zeros(k)
    leaking = drift or Drift(0.0, 0.0, 1.0, np.zeros(0), nothing)
    before, shift, scale = relaxing or (nothing, nothing, 1.0)
    _locate_by_sample(
        sign, begun.sample + 1, last, begun.release_s, begun.level, begun.offset, trajectory.t, output.values,
        trajectory.dynamics.differencing, leaking.rate, leaking.per_light, leaking.on, leaking.lights, leaking.light,
        before, shift, scale, at,
    )  # fmt: skip
    return at


def at_samples(trajectory: Trajectory, output: Output, begun: Begun, sign, at, drift: Drift | None, change, drifted):
    """Fill `change` and `drifted` (k,): sign · change and sign · drift at the samples `at` (k,), 0 where that is −1."""
    change[:], drifted[:] = 0.0, 0.0
    wd = trajectory.dynamics.differencing
    _at_extremes(sign, begun.release_s, begun.level, begun.offset, at, change, trajectory.t, output.values, wd)
    if drift is not None:
        there = np.flatnonzero(at >= 0)
        k = at[there]
        leaked = drift.rate * (trajectory.t[k] - begun.release_s[there])
        if drift.per_light != 0:
            leaked += drift.per_light * (drift.lights[k] - drift.light[there])
        drifted[there] = sign[there] * leaked


@njit(cache=True, nogil=True, error_model="numpy")
def _runs(states, plain, values, run):
    """Fill the output, and for each sample where the monotone run that ends there begins."""
    before, start, falling = states[0, 5] if plain else states[0, 3] - states[0, 4], 0, False
    values[0], run[0] = before, 0
    for k in range(1, len(values)):
        here = states[k, 5] if plain else states[k, 3] - states[k, 4]
        turns = here < before if not falling else here > before
        if turns:
            start, falling = k - 1, not falling
        values[k], run[k] = here, start
        before = here


@njit(cache=True, error_model="numpy")
def _change_at(k, tr, level, offset, t, values, wd):
    """The change at sample k of an interval released at tr."""
    change = values[k] - level
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
def _locate(sign, low, high, release, level, offset, near_up, near_down, at, t, output, wd):
    """Fill `at` with the sample in low … high where sign · change is largest; −1 where it never exceeds 0, its value
    at release, or stays under what could reach a threshold (near_up, near_down).
    """
    at[:] = -1
    near_up, near_down = max(near_up, 0.0), max(near_down, 0.0)  # nothing else counts, however low thresholds may be
    for i in _candidates(sign, low, high, level, offset, near_up, near_down, output):
        left = abs(offset[i])
        peak, where = _highest(sign[i], low[i], high[i], output)
        peak -= sign[i] * level[i]
        if peak + left < (near_up if sign[i] > 0 else near_down):
            continue
        # the output's own extreme after the first samples; among these the reset still counts, one by one
        unaffected_s = release[i] + min(max(np.log(left + 1e-300) + 30.0, 0.0), DECAYED) / wd  # decayed to 1e-13
        after = low[i]
        while after <= high[i] and t[after] < unaffected_s:
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
def _locate_by_sample(
    sign, low, high, release, level, offset, t, values, wd, rate, per_light, on, lights, light, before, shift, scale, at
):  # fmt: skip
    """As `_locate`, of the change with its drift, less a shift of the threshold that relaxes since `before`."""
    for i in range(len(at)):
        best, at[i] = 0.0, -1
        for k in range(low[i], high[i] + 1):
            drift = rate * (t[k] - release[i])
            if per_light != 0.0:
                drift += per_light * (lights[k] - light[i])
            value = sign[i] * (_change_at(k, release[i], level[i], offset[i], t, values, wd) + on * drift)
            if shift[i] != 0.0:
                value -= shift[i] * np.exp(-(t[k] - before[i]) / scale)
            if value > best:
                best, at[i] = value, k


@njit(cache=True, nogil=True, error_model="numpy")
def _at_extremes(sign, release, level, offset, at, value, t, values, wd):
    for i in range(len(at)):
        if at[i] >= 0:
            value[i] = sign[i] * _change_at(at[i], release[i], level[i], offset[i], t, values, wd)
