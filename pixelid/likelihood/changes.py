"""Teacher-forced changes: what the differencing amplifier showed at each event, given the previous event.

For an interval released at tr (previous event + dead time)

    change(t) = d(t) − h(tr) − (d(tr) − h(tr)) exp(−ωd (t − tr)) + C_on (leak (t − tr) + parasitic ∫ L dt)

with d the never-reset amplifier output and h what it is reset to.  The leak part is kept apart (`drift`, in
units of C_on) because it is the only part that depends on a threshold.

Where the comparator stays blind for longer than the amplifier is held (`dead_time_without_reset`), the change is the
same, and counts from the end of that silence on: what it is there has not been crossed on the way.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numba import njit

from pixelid.dynamics.equations import PRESENT_BELOW
from pixelid.dynamics.trajectory import Trajectory
from pixelid.dynamics.vector_math import vexp
from pixelid.likelihood.clocks import Clock
from pixelid.likelihood.extremes import (
    DECAYED,
    Begun,
    Drift,
    Extremes,
    at_samples,
    locate_by_sample,
    locate_extremes,
)
from pixelid.likelihood.leaked import drifts, light_integrals, light_to
from pixelid.likelihood.located import located
from pixelid.likelihood.modulated import (
    Modulated,
    modulated,
    moves_changes,
    subtract,
    subtract_from_ends,
)  # fmt: skip
from pixelid.likelihood.sections import Section
from pixelid.likelihood.trajectories import Trajectories
from pixelid.stages.circuit import Circuit
from pixelid.stages.differencing import leaked, leaks
from pixelid.stimuli.drive import StackedDrive, stacked_drive
from pixelid.stimuli.stimulus import Stimulus

PER_EVENT = ("change", "slope", "drift", "drift_slope", "opposite", "opposite_drift", "early")
PER_PIXEL = ("rise", "rise_drift", "fall", "fall_drift")


@dataclass(frozen=True)
class Changes:
    """Per interval, in log radiance units (leak excluded) and units of C_on (drift).

    Less what the pixel's last event adds to the threshold that they are held against (`modulated.py`), and divided by
    the factor that thresholds have in this recording alone; a leak, in events per second, is not.

    change, slope: (n,) at the event;  drift, drift_slope: (n,) leak at the event, in C_on and C_on/s
    opposite: (n,) extreme of −sign·change before the event, and opposite_drift there
    rise, rise_drift, fall, fall_drift: (m,) extremes of +change and −change over the censored last intervals
    early: (n,) whether the event comes before its pixel can fire again (impossible under the model)
    """

    change: np.ndarray
    slope: np.ndarray
    drift: np.ndarray
    drift_slope: np.ndarray
    opposite: np.ndarray
    opposite_drift: np.ndarray
    rise: np.ndarray
    rise_drift: np.ndarray
    fall: np.ndarray
    fall_drift: np.ndarray
    early: np.ndarray


class ChangeEvaluator:
    """Evaluates `Changes` of one section of a recording for many circuits.

    Args:
        section: Intervals, and the lights behind them.
        remember: Whether to remember the latest trajectory, see `Trajectories`.
    """

    def __init__(self, section: Section, remember: bool = True) -> None:
        self.section = section
        intervals = self.intervals = section.intervals
        self._trajectories = Trajectories(section.lights, intervals.end_s, remember)
        light = stacked_drive(section.lights, Circuit(), intervals.end_s)
        self._near_samples = tuple(
            located(light.t, when, np.zeros(len(when), np.int64), light.first, which)
            for when, which in (
                (intervals.previous_s, section.light),
                (intervals.time_s, section.light),
                (intervals.last_s, section.last_light),
            )
        )

    def with_lights(self, lights: Sequence[Stimulus]) -> ChangeEvaluator:
        """The same intervals under other lights, sampled at the same times."""
        other = copy(self)
        other.section = replace(self.section, lights=tuple(lights))
        other._trajectories = self._trajectories.under(lights)
        return other

    def placed(self, earlier_s: np.ndarray, reset_earlier_s: np.ndarray) -> ChangeEvaluator:
        """The same with events, and those before them, placed so many seconds (n,) before their stamps."""
        other = copy(self)
        other.intervals = replace(
            self.section.intervals,
            time_s=self.section.intervals.time_s - earlier_s,
            previous_s=self.section.intervals.previous_s - reset_earlier_s,
        )
        return other

    def trajectory(self, circuit: Circuit, keep: bool = False) -> Trajectory:
        """The trajectories of this section's lights, one after the other; `keep`: see `Trajectories.of`."""
        return self._trajectories.of(circuit, keep)[0]

    def forget(self) -> None:
        """Drop the remembered trajectory."""
        self._trajectories.forget()

    def __call__(self, circuit: Circuit, locate: Extremes | Literal[True] = True) -> Changes:
        """The changes of every interval under `circuit`; `locate`: see `fill`."""
        events, pixels = np.empty((7, len(self.intervals))), np.empty((4, len(self.intervals.last_s)))
        self.fill(circuit, locate, events, pixels)
        return Changes(*events[:6], *pixels, early=events[6] >= 0)

    def fill(
        self,
        circuit: Circuit,
        locate: Extremes | Literal[True],
        events: np.ndarray,
        pixels: np.ndarray,
        clock: Clock | None = None,
        unknown: float = 0.0,
    ) -> Extremes:
        """Write the changes under a circuit into rows, in the order of `PER_EVENT` and `PER_PIXEL`.

        Args:
            circuit: Of real numbers.
            locate: True looks for the extremes.  `Extremes` are taken where they are: near the circuit they were
                located for the derivative does not see the position (envelope theorem).
            events: (7, n) to be filled.
            pixels: (4, m) to be filled.
            clock: Of the recording in addition to that of its light; None: they are one.
            unknown: Standard deviation of levels about these changes, by light or noise that is not known.

        Returns:
            Where the extremes are.
        """
        iv, looked_for = self.intervals, not isinstance(locate, Extremes)
        trajectory, output, drive = self._trajectories.of(circuit, keep=looked_for)
        first = drive.first
        of_event, of_last = self.section.light, self.section.last_light
        shift = circuit.refractory - circuit.delay
        stamps = iv.previous_s, iv.time_s, iv.last_s
        previous, stamp, begin = stamps if clock is None else map(clock.on_light, stamps)
        release, time, last = previous + shift, stamp - circuit.delay, begin + shift
        own = own_last = None
        if moves_changes(circuit):
            own = self._modulated(trajectory, drive, circuit, previous, 0, of_event, iv.previous_sign)
            own_last = self._modulated(trajectory, drive, circuit, begin, 2, of_last, iv.last_sign)
            release, last = release + own.dead_s, last + own_last.dead_s
        begun, drift = self._begun(trajectory, drive, circuit, release, 0, of_event)
        begun_last, drift_last = self._begun(trajectory, drive, circuit, last, 2, of_last)
        looks, looks_last, opened, opened_last = release, last, None, None
        if circuit.silent > 0:
            looks = np.maximum(release, previous - circuit.delay + circuit.silent)
            looks_last = np.maximum(last, begin - circuit.delay + circuit.silent)
            opened = self._opened(trajectory, drive, begun, drift, looks, 0, of_event)
            opened_last = self._opened(trajectory, drive, begun_last, drift_last, looks_last, 2, of_last)
        sample = located(trajectory.t, time, self._near_samples[1], first, of_event)

        change, slope, drifted, drift_slope, opposite, opposite_drift, early = events
        _changes(
            release, time, begun.level, begun.offset, *trajectory.slopes_at(time, sample)[1:],
            trajectory.dynamics.differencing, change, slope,
        )  # fmt: skip
        drifted[:], drift_slope[:] = 0.0, 0.0
        if drift is not None:
            drifts(
                release, time, sample, trajectory.t, drive.log_light, drift.rate, drift.per_light, drift.lights,
                drift.light, drifted, drift_slope,
            )  # fmt: skip
        np.subtract(looks, time, out=early)

        if isinstance(locate, Extremes):
            extremes = locate
        else:
            searched = begun if opened is None else opened.begun
            searched_last = begun_last if opened_last is None else opened_last.begun
            final = located(trajectory.t, np.full(len(last), iv.end_s), first[of_last], first, of_last)
            up, near = np.ones(len(last)), (-np.inf, -np.inf)
            if own is not None and own_last is not None and own.relaxes:
                relaxing = own.just_after(-iv.sign), own_last.just_after(up), own_last.just_after(-up)
                extremes = Extremes(
                    locate_by_sample(trajectory, output, searched, -iv.sign, sample, drift, relaxing[0]),
                    locate_by_sample(trajectory, output, searched_last, up, final, drift_last, relaxing[1]),
                    locate_by_sample(trajectory, output, searched_last, -up, final, drift_last, relaxing[2]),
                )
            else:
                extremes = Extremes(
                    locate_extremes(trajectory, output, searched, -iv.sign, sample, _near(circuit, unknown), drift),
                    locate_extremes(trajectory, output, searched_last, up, final, near, drift_last),
                    locate_extremes(trajectory, output, searched_last, -up, final, near, drift_last),
                )
        at_samples(trajectory, output, begun, -iv.sign, extremes.opposite, drift, opposite, opposite_drift)
        reached_s = _times_of(extremes.opposite, trajectory.t, time)
        reached_last_s = []
        if opened is not None:
            opened.raise_extremes(-iv.sign, circuit.on_threshold, time, (opposite, opposite_drift), reached_s)
        for sign, at, rows in ((1.0, extremes.rise, pixels[:2]), (-1.0, extremes.fall, pixels[2:])):
            signs = np.full(len(last), sign)
            at_samples(trajectory, output, begun_last, signs, at, drift_last, *rows)
            reached_last_s.append(_times_of(at, trajectory.t, np.full(len(last), iv.end_s)))
            if opened_last is not None:
                opened_last.raise_extremes(signs, circuit.on_threshold, iv.end_s, tuple(rows), reached_last_s[-1])
        if own is not None and own_last is not None:
            growth = circuit.threshold_drift
            subtract(own, growth, iv.sign, time, reached_s, events)
            subtract_from_ends(own_last, growth, iv.end_s, reached_last_s, pixels)
        if circuit.threshold_gain != 1.0:
            for row in (change, slope, opposite, pixels[0], pixels[2]):
                row /= circuit.threshold_gain
        return extremes

    def _modulated(
        self,
        trajectory: Trajectory,
        light: StackedDrive,
        circuit: Circuit,
        stamp: np.ndarray,
        near: int,
        light_of: np.ndarray,
        sign: np.ndarray,
    ) -> Modulated:
        """What the events stamped `stamp` (k,), on the light's clock, set for the intervals after them."""
        time = stamp - circuit.delay
        sample = located(trajectory.t, time, self._near_samples[near], light.first, light_of)
        return modulated(circuit, trajectory.t, light.log_light, sample, time, sign)

    def _begun(
        self,
        trajectory: Trajectory,
        drive: StackedDrive,
        circuit: Circuit,
        release: np.ndarray,
        near: int,
        light_of: np.ndarray,
    ) -> tuple[Begun, Drift | None]:
        """Where the intervals released at `release` (k,) begin, and what leaks into them.

        near: which of the samples found last are near them
        """
        sample = located(trajectory.t, release, self._near_samples[near], drive.first, light_of)
        level, output = trajectory.outputs_at(release, sample)
        begun = Begun(release, sample, level, output - level)
        if not leaks(circuit):
            return begun, None
        per_light = leaked(circuit, 0.0, 1.0)
        lights, light = np.zeros(len(trajectory.t)), np.zeros(len(release))
        if per_light != 0:
            light_integrals(trajectory.t, drive.log_light, lights)
            light_to(release, sample, trajectory.t, drive.log_light, lights, light)
        return begun, Drift(leaked(circuit, 1.0, 0.0), per_light, circuit.on_threshold, lights, light)

    def _opened(
        self,
        trajectory: Trajectory,
        light: StackedDrive,
        begun: Begun,
        drift: Drift | None,
        at_s: np.ndarray,
        near: int,
        light_of: np.ndarray,
    ) -> Opened:
        """Where intervals that have begun are looked at from `at_s` (k,) on; near: as of `_begun`."""
        sample = located(trajectory.t, at_s, self._near_samples[near], light.first, light_of)
        change, spare, drifted = np.empty(len(at_s)), np.empty(len(at_s)), np.zeros(len(at_s))
        _changes(
            begun.release_s, at_s, begun.level, begun.offset, *trajectory.slopes_at(at_s, sample)[1:],
            trajectory.dynamics.differencing, change, spare,
        )  # fmt: skip
        if drift is not None:
            drifts(
                begun.release_s, at_s, sample, trajectory.t, light.log_light, drift.rate, drift.per_light,
                drift.lights, drift.light, drifted, spare,
            )  # fmt: skip
        return Opened(replace(begun, sample=sample), at_s, change, drifted)


@dataclass(frozen=True)
class Opened:
    """Where k pixels that were silent look again.

    begun: the intervals, whose samples to look at begin there;  at_s: (k,) when
    change, drifted: (k,) the change there without leak, and what has leaked, in ON thresholds
    """

    begun: Begun
    at_s: np.ndarray
    change: np.ndarray
    drifted: np.ndarray

    def raise_extremes(
        self, sign: np.ndarray, on: float, until_s: np.ndarray | float, rows: tuple[np.ndarray, ...], when: np.ndarray
    ) -> None:
        """Put what sign · change is there in the place of extremes (k,) that it exceeds.

        on: the ON threshold;  until_s: when the intervals end;  rows: the extremes and what had leaked
        when: (k,) times of the extremes
        """
        change, drifted = sign * self.change, sign * self.drifted
        higher = (self.at_s < until_s) & (change + on * drifted > np.maximum(rows[0] + on * rows[1], 0.0))
        rows[0][higher], rows[1][higher], when[higher] = change[higher], drifted[higher], self.at_s[higher]


def _times_of(at: np.ndarray, t: np.ndarray, otherwise: np.ndarray) -> np.ndarray:
    """(k,) times of the samples `at` (k,); `otherwise` where that is −1."""
    return np.where(at >= 0, t[at], otherwise)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _changes(release, time, level, offset, output, output_slope, wd, change, slope):
    """Fill change and slope; loops that LLVM vectorises."""
    left = slope  # of the reset
    left[:] = 0.0
    if wd < PRESENT_BELOW:
        for i in range(len(change)):
            since = wd * (time[i] - release[i])
            left[i] = offset[i] * vexp(min(-since, DECAYED)) if since < DECAYED else 0.0  # before release: only finite
    for i in range(len(change)):
        change[i] = output[i] - level[i] - left[i]
    for i in range(len(change)):
        slope[i] = output_slope[i] + wd * left[i]


def _near(circuit: Circuit, unknown: float) -> tuple[float, float]:
    """Changes (ON, OFF) below which the chance of having reached a threshold is under 1e-15, whatever the pixel."""
    if circuit.threshold_drift != 0 or circuit.described:
        return -np.inf, -np.inf
    spread = float(np.hypot(circuit.noise, circuit.mismatch))
    least = 1.0 - abs(circuit.polarity_memory)
    on, off = (
        least * threshold - 8.0 * float(np.hypot(spread * threshold, unknown))
        for threshold in (circuit.on_threshold, circuit.off_threshold)
    )
    return on, off
