"""Full-field light: one trajectory, shared by all pixels; each pixel only compares and resets.

Where a readout is shared, a pixel that has crossed a threshold waits for the next cycle, is read with all others that
wait, and is reset then: pixels are carried through a step together, cycle by cycle.
"""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np
from numba import njit

from pixelid.dynamics import kernels, slew
from pixelid.dynamics.trajectory import integrate
from pixelid.simulate import comparator, random
from pixelid.simulate.comparator import DECAY, LAST, LEVEL, OFF, ON, RELEASE, events_in_step
from pixelid.simulate.crossing import DEPTH
from pixelid.simulate.laws import Rules
from pixelid.simulate.relaxing import relaxed
from pixelid.simulate.step import after_jump, light_integral, modes, slope_bound
from pixelid.stages.circuit import Circuit
from pixelid.stages.modulation import set_at_reset
from pixelid.stimuli.drive import Drive, drive, refined_radiance
from pixelid.stimuli.stimulus import Stimulus

WORK = 1 << 24  # pixel steps between two deliveries of sorted events
FIRST_CAPACITY = 1024
CYCLE = 9  # stream of random numbers, after that of `simulate/readout.py`
UNTIL_READ = 1e300  # s: dead time of a pixel that waits


@dataclass(frozen=True)
class Shared:
    """The trajectory that all pixels share, and what each of its n − 1 steps can do.

    t, u, logs, light, radiance: (n,) knots, u the response to the light, logs its logarithm, radiance what sets the
    photoreceptor's rates;  states: (n, 6)
    high, low: (n − 1,) bounds on the amplifier's output in a step
    fade: (n − 1,) e^{−ωd Δt};  drift: (n − 1,) leak over the step, log radiance
    """

    t: np.ndarray
    u: np.ndarray
    logs: np.ndarray
    light: np.ndarray
    radiance: np.ndarray
    states: np.ndarray
    high: np.ndarray
    low: np.ndarray
    fade: np.ndarray
    drift: np.ndarray


@dataclass(frozen=True)
class Twins:
    """Pixels that are to be like measured ones.

    on, off: (n,) thresholds, log radiance;  event_s: (n,) when each fires the event that it starts from, its dead time
    running from there; infinite where it has none, so that it starts at random as any pixel does
    after: (n,) polarity of that event, ±1, or 0 where it has none; None: nowhere any
    """

    on: np.ndarray
    off: np.ndarray
    event_s: np.ndarray
    after: np.ndarray | None = None

    def only(self, chosen: np.ndarray) -> Twins:
        """Some of them."""
        after = None if self.after is None else self.after[chosen]
        return Twins(self.on[chosen], self.off[chosen], self.event_s[chosen], after)


class FullField:
    """Pixels under one light: one trajectory, one comparator each.

    Args:
        stimulus: Full-field.
        rules: Of the simulation.
        pixels: How many.
        twins: What they take over from measured ones.
        places: (pixels,) which pixels of the sensor they are, in ascending order; None: all of it.
    """

    def __init__(
        self,
        stimulus: Stimulus,
        rules: Rules,
        pixels: int,
        twins: Twins | None = None,
        places: np.ndarray | None = None,
    ) -> None:
        self._rules = rules
        self._places = np.arange(pixels) if places is None else places
        light = drive(stimulus, rules.circuit)
        if rules.slewing:
            light = _refined(light, slew.longest_step(rules.chain[:4], stimulus.duration_s))
        self._shared = shared_trajectory(light, rules)
        self._comparators = np.empty((comparator.FIELDS, pixels))
        self._drawn = np.empty(pixels, np.int64)
        circuit, state = rules.circuit, self._shared.states[0]
        for part in np.split(np.arange(pixels), np.flatnonzero(np.diff(self._places) != 1) + 1):
            some = slice(part[0], part[-1] + 1)
            comparator.start(
                self._places[part[0]], circuit.on_threshold, circuit.off_threshold, circuit.mismatch, circuit.noise,
                np.int64(rules.seed), rules.synchronous, np.full(len(part), state[3] - state[4]),
                np.full(len(part), state[5]), self._comparators[:, some], self._drawn[some],
            )  # fmt: skip
        if twins is not None:
            self._imitate(twins)
        self._crossed_s, self._polarity = np.full(pixels, np.inf), np.zeros(pixels, np.uint8)
        self._readout = np.array([-np.inf, 0.0])  # end of the last cycle, and how many there have been

    def _imitate(self, twins: Twins) -> None:
        state = self._comparators
        for drawn, base, own in (
            (comparator.ON, comparator.BASE_ON, twins.on), (comparator.OFF, comparator.BASE_OFF, twins.off),
        ):  # fmt: skip
            state[drawn] *= own / state[base]
            state[base] = own
        waiting = np.isfinite(twins.event_s)
        dead = np.full(len(waiting), float(self._rules.circuit.refractory))
        if twins.after is not None:
            history = np.array([self._rules.laws.history[0], (1.0, 1.0), self._rules.laws.history[1]])
            more, shift = history[np.sign(twins.after).astype(int) + 1].T - 1.0, np.zeros((2, len(twins.on)))
            if len(self._rules.laws.described):
                on, off, longer = np.where(waiting & (twins.after != 0), self._set_before(twins), 0.0)
                shift, dead = np.array([on, off]), np.maximum(dead + longer, 0.0)
            for drawn, base, by, moved in zip(
                (comparator.ON, comparator.OFF), (comparator.BASE_ON, comparator.BASE_OFF), more, shift, strict=True
            ):
                state[drawn] = np.maximum(state[drawn] + by * state[base] + moved, comparator.LEAST * state[base])
        state[comparator.LAST, waiting] = twins.event_s[waiting]
        state[RELEASE, waiting] = (twins.event_s + dead)[waiting]
        state[LEVEL, waiting], state[DECAY, waiting] = np.nan, 0.0

    def _set_before(self, twins: Twins) -> np.ndarray:
        """(3, n) what each twin's event adds to its ON and OFF thresholds and to its dead time."""
        shared, after = self._shared, np.zeros(len(twins.on)) if twins.after is None else twins.after
        time = np.clip(twins.event_s, shared.t[0], shared.t[-1])
        k = np.minimum(np.searchsorted(shared.t, time, side="right") - 1, len(shared.t) - 2)
        step = np.maximum(shared.t[k + 1] - shared.t[k], 1e-300)
        slope = np.where(shared.t[k + 1] > shared.t[k], (shared.logs[k + 1] - shared.logs[k]) / step, 0.0)
        light = np.exp(shared.logs[k] + slope * (time - shared.t[k]))
        return np.array(set_at_reset(self._rules.laws.described, after, time, light, np.abs(slope)))

    def run(self, pool: Executor):
        """(event lists of tiles, time up to which they are complete, whether that is all), some steps at a time."""
        t, pixels = self._shared.t, len(self._drawn)
        last, size = len(t) - 1, max(1, WORK // pixels)
        tile = pixels if reads_together(self._rules.circuit) else 256  # worked on by one thread at a time
        for k in range(0, last, size):
            steps = range(k, min(k + size, last))
            parts = pool.map(
                lambda first, steps=steps: self._events(first, min(first + tile, pixels), steps),
                range(0, pixels, tile),
            )
            yield parts, float(t[steps.stop]), steps.stop == last

    def all_events(self):
        """(times (m,) s, pixels (m,), polarities (m,)), in this thread."""
        return self._events(0, len(self._drawn), range(len(self._shared.t) - 1))

    def _events(self, first: int, after: int, steps: range):
        """(times (m,) s, pixels (m,), polarities (m,)) of pixels first … after − 1, pixel by pixel."""
        shared, rules, circuit = self._shared, self._rules, self._rules.circuit
        course = (
            shared.t, shared.u, shared.logs, shared.light, shared.radiance, shared.states, shared.high, shared.low,
            shared.fade, shared.drift, rules.dynamics, rules.chain, circuit.linearisation == "midpoint",
        )  # fmt: skip
        if reads_together(circuit):
            cycle = (circuit.per_cycle, circuit.per_event, circuit.cycle_spread)
            key = np.uint64(random.stream_key(rules.seed, CYCLE))
            return _read_events(
                self._places, steps.start, steps.stop, *course, rules.laws._replace(refractory=UNTIL_READ),
                circuit.refractory, cycle, key, self._comparators, self._drawn, self._crossed_s, self._polarity,
                self._readout,
            )  # fmt: skip
        return _pixel_events(
            self._places, first, after, steps.start, steps.stop, *course, rules.laws, self._comparators, self._drawn
        )


def reads_together(circuit: Circuit) -> bool:
    """Whether pixels wait for a readout that they share."""
    return circuit.per_cycle + circuit.per_event > 0.0


def _refined(light: Drive, longest_step: float) -> Drive:
    """The same light with knots at most `longest_step` apart."""
    t, radiance = refined_radiance(light.t, light.radiance, longest_step)
    return Drive(t, radiance, light.knee, light.knee_slope, light.described)


def shared_trajectory(light: Drive, rules: Rules) -> Shared:
    """The trajectory under full-field light.  Light for a slew-limited follower must come in steps `slew` resolves."""
    midpoint = rules.circuit.linearisation == "midpoint"
    if rules.slewing:
        t, radiance = np.ascontiguousarray(light.t), np.ascontiguousarray(light.rate_radiance)
        u = light.log_radiance
        states = slew.slewed_states(t, radiance, rules.dynamics, rules.rates, midpoint, u)
    else:
        run = integrate(
            light.t, light.rate_radiance, rules.dynamics, linearisation=rules.circuit.linearisation,
            log_radiance=light.log_radiance,
        )  # fmt: skip
        t, u, radiance, states = run.t, run.u, run.radiance, run.states
    seen = np.ascontiguousarray(light.radiance, np.float64) if light.described else radiance
    logs = u if light.straight else np.log(seen)
    high, low, fade, drift = (np.empty(len(t) - 1) for _ in range(4))
    _bounds(
        t, u, logs, seen, radiance, states, rules.dynamics, rules.chain, midpoint, rules.laws, high, low, fade, drift
    )
    return Shared(t, u, logs, seen, radiance, states, high, low, fade, drift)


@njit(forceinline=True, error_model="numpy")
def _step(k, t, u, logs, light, radiance, states, dynamics, chain, midpoint):
    """The `step` tuple of step k, see `step.py`."""
    w1, w2, wh, wd, _, smooth = chain
    tau = t[k + 1] - t[k]
    r = (u[k + 1] - u[k]) / tau
    a, b2 = kernels.photoreceptor_rates(dynamics, kernels.linearised_at(radiance[k], radiance[k + 1], midpoint))
    begin = (states[k, 0], states[k, 1], states[k, 2], states[k, 3], states[k, 4], states[k, 5])
    after = k + 1
    end = (
        states[after, 0], states[after, 1], states[after, 2],
        states[after, 3], states[after, 4], states[after, 5],
    )  # fmt: skip
    if not smooth:
        begin = after_jump(begin, u[k], r, a, b2, w1, w2, wh, wd)
    light_r = (logs[k + 1] - logs[k]) / tau
    return begin, end, u[k], r, tau, a, b2, light[k], light_r, modes(begin, u[k], r, a, b2, chain)


@njit(cache=True, nogil=True, error_model="numpy")
def _bounds(t, u, logs, seen, radiance, states, dynamics, chain, midpoint, laws, high, low, fade, drift):
    w1, w2, wh, wd, _, smooth = chain
    for k in range(len(t) - 1):
        tau = t[k + 1] - t[k]
        high[k], low[k], fade[k], drift[k] = -np.inf, np.inf, 1.0, 0.0
        if tau <= 0.0:
            continue
        begin, end, u0, r, tau, a, b2, light, light_r, _ = _step(
            k, t, u, logs, seen, radiance, states, dynamics, chain, midpoint
        )
        d0, d1 = begin[5], end[5]
        if smooth:
            # a cubic exceeds its end values by at most 4/27 of the length times the slopes that point outward
            s0, s1 = begin[0], end[0]
            if wd < 1e29:
                s0, s1 = wd * (begin[3] - begin[4] - d0), wd * (end[3] - end[4] - d1)
            high[k] = max(d0, d1) + 4.0 / 27.0 * tau * (max(s0, 0.0) + max(-s1, 0.0))
            low[k] = min(d0, d1) - 4.0 / 27.0 * tau * (max(-s0, 0.0) + max(s1, 0.0))
        else:
            spare = 0.5 * tau * slope_bound(begin, u0, r, a, b2, w1, w2, wh, wd)
            high[k] = 0.5 * (d0 + d1) + spare
            low[k] = 0.5 * (d0 + d1) - spare
        fade[k] = np.exp(-wd * tau)
        drift[k] = laws[1] * tau
        if laws[2] > 0.0:
            drift[k] += laws[2] * light_integral(light, light_r, tau)


@njit(forceinline=True, error_model="numpy")
def _faded(decay, fade):
    """What is left of a reset after a step."""
    faded = decay * fade
    return faded if abs(faded) > 1e-15 else 0.0


@njit(forceinline=True, error_model="numpy")
def _quiet(t0, t1, high, low, fade, drift, level, decay, on, off, last_event, growth, relaxing):
    """Whether a live pixel crosses no threshold in the step t0 … t1."""
    faded = decay * fade
    factor = 1.0 + growth * (t1 if growth < 0.0 else t0)
    upper, lower = high - level + drift - min(decay, faded), low - level - max(decay, faded)
    if relaxing[0] != 0.0 or relaxing[1] != 0.0:
        begin, end = relaxed(relaxing, t0 - last_event), relaxed(relaxing, t1 - last_event)
        on, off = on + min(begin[0], end[0]), off + min(begin[1], end[1])
    return (upper < on * factor and lower > -off * factor) or t1 == t0


@njit(cache=True, nogil=True, error_model="numpy")
def _read_events(
    places, k_first, k_last, t, u, logs, seen, radiance, states, high, low, fade, drift, dynamics, chain, midpoint,
    laws, dead, cycle, key, comparators, drawn, crossed, polarity, readout,
):  # fmt: skip
    """Events of all pixels as a shared readout stamps them.

    laws: whose dead time no step ends;  dead: s, from the reading on;  cycle: s, s per event, relative spread
    crossed: (pixels,) s, when those that wait crossed a threshold, else infinite;  polarity: (pixels,) then
    readout: end of the last cycle, how many there have been
    """
    scratch = np.empty((6, DEPTH))
    found, one, count = comparator.room(np.int64(FIRST_CAPACITY)), comparator.room(np.int64(2)), np.int64(0)
    pixels = len(places)
    to_go = np.empty(pixels, np.bool_)
    for k in range(k_first, k_last):
        t0, t1 = t[k], t[k + 1]
        if t1 <= t0:
            continue
        to_go[:] = True
        step = _step(k, t, u, logs, seen, radiance, states, dynamics, chain, midpoint)
        while True:
            for i in range(pixels):
                if not to_go[i]:
                    continue
                to_go[i] = False
                level, decay = comparators[LEVEL, i], comparators[DECAY, i]
                if comparators[RELEASE, i] < np.inf:
                    if comparators[RELEASE, i] > t1:
                        continue
                elif _quiet(
                    t0, t1, high[k], low[k], fade[k], drift[k], level, decay, comparators[ON, i], comparators[OFF, i],
                    comparators[LAST, i], laws[3], laws[8],
                ):  # fmt: skip
                    comparators[DECAY, i], comparators[LEVEL, i] = _faded(decay, fade[k]), level - drift[k]
                    continue
                one, crossings = events_in_step(
                    places[i], i, t0, t1, step, chain, comparators, drawn, laws, one, np.int64(0), scratch
                )
                if crossings > 0:
                    crossed[i], polarity[i] = one[0][0], one[2][0]
            now = max(crossed.min(), readout[0])
            if now > t1:
                break
            read = 0
            for i in range(pixels):
                if crossed[i] <= now:
                    if count == len(found[0]):
                        found = comparator.grown(found)
                    found[0][count], found[1][count], found[2][count] = now, places[i], polarity[i]
                    count, read = count + 1, read + 1
                    crossed[i], to_go[i] = np.inf, True
                    comparators[LAST, i], comparators[RELEASE, i] = now, now + dead
            spread, _ = random.normal_pair(key, 0, np.int64(readout[1]))
            readout[0] = now + (cycle[0] + cycle[1] * read) * max(1.0 + cycle[2] * spread, 0.0)
            readout[1] += 1.0
    return found[0][:count], found[1][:count], found[2][:count]


@njit(cache=True, nogil=True, error_model="numpy")
def _pixel_events(
    places, first, last, k_first, k_last, t, u, logs, seen, radiance, states, high, low, fade, drift,
    dynamics, chain, midpoint, laws, comparators, drawn,
):  # fmt: skip
    scratch = np.empty((6, DEPTH))
    found, count = comparator.room(np.int64(FIRST_CAPACITY)), np.int64(0)  # literals would compile twice
    growth, relaxing = laws[3], laws[8]
    for i in range(first, last):
        level, decay, release = comparators[LEVEL, i], comparators[DECAY, i], comparators[RELEASE, i]
        on, off, last_event = comparators[ON, i], comparators[OFF, i], comparators[LAST, i]
        for k in range(k_first, k_last):
            t0, t1 = t[k], t[k + 1]
            if release < np.inf:
                if release > t1 or t1 == t0:
                    continue
            elif _quiet(
                t0, t1, high[k], low[k], fade[k], drift[k], level, decay, on, off, last_event, growth, relaxing
            ):
                decay = _faded(decay, fade[k])
                level -= drift[k]
                continue
            comparators[LEVEL, i], comparators[DECAY, i] = level, decay
            step = _step(k, t, u, logs, seen, radiance, states, dynamics, chain, midpoint)
            found, count = events_in_step(
                places[i], i, t0, t1, step, chain, comparators, drawn, laws, found, count, scratch
            )
            level, decay, release = comparators[LEVEL, i], comparators[DECAY, i], comparators[RELEASE, i]
            on, off, last_event = comparators[ON, i], comparators[OFF, i], comparators[LAST, i]
        comparators[LEVEL, i], comparators[DECAY, i] = level, decay
    return found[0][:count], found[1][:count], found[2][:count]
