"""Teacher-forced changes: what the differencing amplifier showed at each event, given the previous event.

For an interval released at tr (previous event + dead time), DESIGN §1:

    change(t) = d(t) − h(tr) − (d(tr) − h(tr)) exp(−ωd (t − tr)) + C_on (leak (t − tr) + parasitic ∫ L dt)

with d the never-reset amplifier output and h what it is reset to.  The leak part is kept apart (`drift`, in
units of C_on) because it is the only part that depends on a threshold.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from pixelid.dynamics import kernels, slew, vectorised
from pixelid.dynamics.equations import PRESENT_BELOW
from pixelid.dynamics.of_circuit import dynamics_of
from pixelid.dynamics.slewed import SlewedTrajectory, slewed
from pixelid.dynamics.trajectory import Dynamics, Trajectory, integrate
from pixelid.likelihood import plain_changes
from pixelid.likelihood.plain_changes import Plain, locate
from pixelid.likelihood.sequences import Sequences
from pixelid.recordings.recording import Recording
from pixelid.stages.circuit import Circuit
from pixelid.stimuli.drive import Drive, drive

PER_EVENT = ("change", "slope", "drift", "drift_slope", "opposite", "opposite_drift", "early")
PER_PIXEL = ("rise", "rise_drift", "fall", "fall_drift")
BLOCK = 16  # samples whose extremes are kept together
APART = 4e-3  # least relative gap of follower and extra pole: closer ones are as good as this far apart, see `_apart`


@dataclass(frozen=True)
class Changes:
    """Per interval, in log radiance units (leak excluded) and units of C_on (drift).

    change, slope: (n,) at the event;  drift, drift_slope: (n,) leak at the event, in C_on and C_on/s
    opposite: (n,) extreme of −sign·change before the event, and opposite_drift there
    rise, rise_drift, fall, fall_drift: (m,) extremes of +change and −change over the censored last intervals
    early: (n,) whether the event comes before its pixel's release (impossible under the model)
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


@njit(cache=True, error_model="numpy")
def _light_integral(tau, k, t, u, L):
    """∫ L dt over the first `tau` of step k, log radiance linear."""
    if k + 1 >= len(t):
        return L[k] * tau
    step = t[k + 1] - t[k]
    if step <= 0:
        return L[k] * 0.0
    x = (u[k + 1] - u[k]) / step * tau
    if abs(x.real) < 1e-4:
        return L[k] * tau * (1.0 + x / 2.0 + x * x / 6.0)
    return L[k] * tau * (np.exp(x) - 1.0) / x


@njit(cache=True, nogil=True, error_model="numpy")
def _locate_all(t, times, hints, out):
    for i in range(len(times)):
        out[i] = locate(t, times[i].real, hints[i])


@njit(cache=True, nogil=True, error_model="numpy")
def _states_one_by_one(times, step, t, u, L, dynamics, midpoint, states, out):
    coincide = kernels.cutoffs_coincide(dynamics[3], dynamics[4], dynamics[5], dynamics[6])
    for i in range(len(times)):
        state = kernels.within_step(times[i], step[i], t, u, L, dynamics, coincide, midpoint, states)
        for j in range(6):
            out[i, j] = state[j]


@njit(cache=True, nogil=True, error_model="numpy")
def _prepare(t, u, L, dynamics, states, output, highest, lowest, lights):
    """Fill the amplifier output at every sample, its extremes per block, and the running light integral."""
    finite = dynamics[6].real < PRESENT_BELOW
    for k in range(len(t)):
        output[k] = states[k, 5] if finite else states[k, 3] - states[k, 4]
        block = k // BLOCK
        value = output[k].real
        if k % BLOCK == 0:
            highest[block] = value
            lowest[block] = value
        highest[block] = max(highest[block], value)
        lowest[block] = min(lowest[block], value)
    if len(lights) > 1:
        lights[0] = L[0] * 0.0
        for k in range(1, len(t)):
            lights[k] = lights[k - 1] + _light_integral(t[k] - t[k - 1], k - 1, t, u, L)


@njit(cache=True, error_model="numpy")
def _at_sample(k, tr, level, offset, light_r, t, wd, output, lights, leak, parasitic):
    """(change, drift) at stimulus sample k of an interval released at tr."""
    change = output[k] - level
    x = wd * (t[k] - tr)
    if x.real < 40.0:
        change = change - offset * np.exp(-x)
    drift = leak * (t[k] - tr)
    if len(lights) > 1:
        drift = drift + parasitic * (lights[k] - light_r)
    return change, drift


@njit(cache=True, error_model="numpy", fastmath={"nnan", "nsz"})
def _stays_below(limit, sign, low, high, level, highest, lowest):
    """Whether sign · (output − level) stays below `limit` in every block that low..high touches."""
    first, last = low // BLOCK, high // BLOCK
    peak = -np.inf
    if sign > 0:
        for block in highest[first : last + 1]:
            peak = max(peak, block)
    else:
        for block in lowest[first : last + 1]:
            peak = max(peak, -block)
    return peak - sign * level < limit


@njit(cache=True, error_model="numpy")
def _extreme(sign, low, high, tr, level, offset, light_r, t, wd, output, highest, lowest, lights, leak, parasitic, on):
    """The sample in low..high where sign · change is largest, −1 where it never exceeds 0 (its value at release).

    Once the reset has decayed, and without leak, change differs from the output by a constant, and whole blocks
    are judged by their extremes.
    """
    best, where = 0.0, -1
    k = low
    plain = leak.real == 0.0 and parasitic.real == 0.0
    settled = tr.real + min(max(np.log(abs(offset) + 1e-300) + 30.0, 0.0), 40.0) / wd.real  # offset decayed to 1e-13
    while k <= high and not (plain and t[k] >= settled):
        change, drift = _at_sample(k, tr, level, offset, light_r, t, wd, output, lights, leak, parasitic)
        value = sign * (change + on * drift).real
        if value > best:
            best, where = value, k
        k += 1
    bound = best + sign * level.real
    while k <= high:
        if k % BLOCK == 0 and k + BLOCK - 1 <= high:
            block = k // BLOCK
            peak = highest[block] if sign > 0 else -lowest[block]
            if peak <= bound:
                k += BLOCK
                continue
        value = sign * output[k].real
        if value > bound:
            bound, where = value, k
        k += 1
    return where


@njit(cache=True, error_model="numpy")
def _released(i, state_r, kr, tr, t, u, L, dynamics, lights):
    """(level, offset, light) an interval starts from."""
    level = state_r[i, 3] - state_r[i, 4]
    offset = state_r[i, 5] - level if dynamics[6].real < PRESENT_BELOW else level * 0.0
    light = u[0] * 0.0
    if len(lights) > 1:
        light = lights[kr] + _light_integral(tr - t[kr], kr, t, u, L)
    return level, offset, light


@njit(cache=True, nogil=True, error_model="numpy")
def _events(
    release, time, sign, step_r, step_e, state_r, state_e, extreme_at, locate,
    near_on, near_off, t, u, L, dynamics, output, highest, lowest, lights, leak, parasitic, on,
    change, slope, drift, drift_slope, opposite, opposite_drift,
):  # fmt: skip
    """Fill the per-interval arrays.  Extremes below near_on, near_off cannot reach a threshold: not looked for."""
    plain = leak.real == 0.0 and parasitic.real == 0.0
    wd = dynamics[6]
    zero = u[0] * 0.0
    for i in range(len(time)):
        tr, te, kr, ke = release[i], time[i], step_r[i], step_e[i]
        level, offset, light_r = _released(i, state_r, kr, tr, t, u, L, dynamics, lights)
        rate = (u[ke + 1] - u[ke]) / (t[ke + 1] - t[ke]) if ke + 1 < len(t) else zero
        state = (state_e[i, 0], state_e[i, 1], state_e[i, 2], state_e[i, 3], state_e[i, 4], state_e[i, 5])
        _, d, ds = kernels.reference_and_slopes(state, dynamics, rate)
        since = wd * (te - tr)
        decay = offset * np.exp(-since) if since.real < 40.0 else zero
        change[i] = d - level - decay
        slope[i] = ds + wd * decay if wd.real < PRESENT_BELOW else ds
        drift[i] = leak * (te - tr)
        drift_slope[i] = leak
        if len(lights) > 1:
            drift[i] += parasitic * (lights[ke] + _light_integral(te - t[ke], ke, t, u, L) - light_r)
            drift_slope[i] += parasitic * np.exp(u[ke] + rate * (te - t[ke]))
        if locate:
            extreme_at[i] = -1
            limit = near_off if sign[i] > 0 else near_on
            limit -= abs(offset)  # what the reset leaves is at most its offset
        if locate and not (plain and _stays_below(limit, -sign[i], kr, ke, level.real, highest, lowest)):
            extreme_at[i] = _extreme(
                -sign[i], kr + 1, ke, tr, level, offset, light_r, t, wd, output, highest, lowest,
                lights, leak, parasitic, on,
            )  # fmt: skip
        opposite[i], opposite_drift[i] = zero, zero
        if extreme_at[i] >= 0:
            c, f = _at_sample(extreme_at[i], tr, level, offset, light_r, t, wd, output, lights, leak, parasitic)
            opposite[i], opposite_drift[i] = -sign[i] * c, -sign[i] * f


@njit(cache=True, nogil=True, error_model="numpy")
def _censored(
    release, step_r, state_r, last_sample, rise_at, fall_at, locate,
    t, u, L, dynamics, output, highest, lowest, lights, leak, parasitic, on,
    rise, rise_drift, fall, fall_drift,
):  # fmt: skip
    """Fill the extremes of the intervals that the end of the recording cuts off."""
    wd = dynamics[6]
    zero = u[0] * 0.0
    for i in range(len(release)):
        tr, kr = release[i], step_r[i]
        level, offset, light_r = _released(i, state_r, kr, tr, t, u, L, dynamics, lights)
        for sign, at in ((1.0, rise_at), (-1.0, fall_at)):
            if locate:
                at[i] = _extreme(
                    sign, kr + 1, last_sample, tr, level, offset, light_r, t, wd, output, highest, lowest,
                    lights, leak, parasitic, on,
                )  # fmt: skip
        rise[i], rise_drift[i], fall[i], fall_drift[i] = zero, zero, zero, zero
        if rise_at[i] >= 0:
            rise[i], rise_drift[i] = _at_sample(
                rise_at[i], tr, level, offset, light_r, t, wd, output, lights, leak, parasitic
            )
        if fall_at[i] >= 0:
            c, f = _at_sample(fall_at[i], tr, level, offset, light_r, t, wd, output, lights, leak, parasitic)
            fall[i], fall_drift[i] = -c, -f


class ChangeEvaluator:
    """Evaluates `Changes` of one recording for many circuits, remembering where samples and extremes lie.

    The positions of the extremes come from the latest real-valued evaluation that located them; a complex step or
    a difference quotient reuses them (at an extreme the derivative does not see the position: envelope theorem).
    """

    def __init__(self, recording: Recording, intervals: Sequences) -> None:
        recording.check_stimulus_covers_events()
        self.recording = recording
        self.intervals = intervals
        assert recording.stimulus is not None
        self._stimulus = recording.stimulus
        t = drive(self._stimulus, Circuit(), intervals.end_s).t
        self._hints = tuple(
            np.maximum(np.searchsorted(t, when, side="right") - 1, 0)
            for when in (intervals.previous_s, intervals.time_s, intervals.last_s)
        )
        self._extreme_at = np.full(len(intervals), -1)
        self._rise_at = np.full(len(intervals.last_s), -1)
        self._fall_at = np.full(len(intervals.last_s), -1)
        self._latest: tuple[tuple, Trajectory] | None = None
        self._light: tuple[tuple, Drive] | None = None
        self._plain: Plain | None = None

    def trajectory(self, circuit: Circuit, keep: bool = False) -> Trajectory:
        """The pixel's trajectory under this recording's stimulus.

        `keep` remembers it, for circuits that differ in thresholds, dead time, leak or delay only.
        """
        reaching = (circuit.dark, circuit.flicker_modulation, circuit.flicker_hz, circuit.flicker_phase)
        limit = (circuit.slew_rise, circuit.slew_fall)
        linear = circuit.with_(slew_rise=np.inf, slew_fall=np.inf)
        dynamics = dynamics_of(linear) if slew.slews(circuit) else _apart(dynamics_of(linear))
        key = (dynamics, circuit.linearisation, *limit, *reaching)
        if self._latest is not None and self._latest[0] == key:
            return self._latest[1]
        if self._light is None or self._light[0] != reaching:
            self._light = reaching, drive(self._stimulus, circuit, self.intervals.end_s)
        light = self._light[1]
        if slew.slews(circuit):
            trajectory = slewed(light.t, light.radiance, circuit, dynamics)
        else:
            trajectory = integrate(light.t, light.radiance, dynamics, linearisation=circuit.linearisation)
        if keep:
            self._latest = key, trajectory
        return trajectory

    def forget(self) -> None:
        """Drop the remembered trajectory."""
        self._latest, self._plain = None, None

    @property
    def extremes_at(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Samples of the extremes as last located: (n,) opposite, (m,) rise, fall; −1 none."""
        return self._extreme_at, self._rise_at, self._fall_at

    def __call__(self, circuit: Circuit, locate: bool = True) -> Changes:
        """The changes of every interval under `circuit`, whose values may be complex.

        `locate=False` keeps the extremes at the samples of the latest evaluation that located them.
        """
        if plain_changes.applicable(circuit):
            rows = np.empty((7, len(self.intervals))), np.empty((4, len(self.intervals.last_s)))
            if self._fill_plain(circuit, locate, *rows):
                return Changes(*rows[0][:6], *rows[1], early=rows[0][6] > 0)
        trajectory = self.trajectory(circuit, keep=locate)
        scalars = (circuit.leak_hz, circuit.leak_hz_per_radiance, circuit.on_threshold)
        clock = (circuit.refractory, circuit.delay)
        complex_step = np.iscomplexobj(trajectory.states) or any(isinstance(s, complex) for s in (*scalars, *clock))
        dtype = np.complex128 if complex_step else np.float64
        t = trajectory.t
        states = trajectory.states.astype(dtype, copy=False)
        u = trajectory.u.astype(dtype, copy=False)
        radiance = trajectory.radiance.astype(dtype, copy=False)
        dynamics = tuple(dtype(value) for value in trajectory.dynamics)
        refractory, delay = (dtype(value) for value in clock)

        blocks = (len(t) + BLOCK - 1) // BLOCK
        output, highest, lowest = np.empty(len(t), dtype), np.empty(blocks), np.empty(blocks)
        lights = np.empty(len(t) if circuit.leak_hz_per_radiance != 0 else 1, dtype)
        _prepare(t, u, radiance, dynamics, states, output, highest, lowest, lights)

        fast = not complex_step and vectorised.applicable(dynamics)
        states_at = vectorised.states_at if fast else _states_one_by_one

        def states_of(times, hints):
            step = np.empty(len(times), np.int64)
            _locate_all(t, times, hints, step)
            if isinstance(trajectory, SlewedTrajectory):
                return step, trajectory.at(np.real(times), step).astype(dtype, copy=False)
            out = np.empty((len(times), 6), dtype)
            states_at(times, step, t, u, radiance, dynamics, trajectory.midpoint, states, out)
            return step, out

        iv = self.intervals
        release, time, last = iv.previous_s + refractory - delay, iv.time_s - delay, iv.last_s + refractory - delay
        step_r, state_r = states_of(release, self._hints[0])
        step_e, state_e = states_of(time, self._hints[1])
        step_l, state_l = states_of(last, self._hints[2])
        last_sample = int(np.searchsorted(t, iv.end_s, side="right")) - 1
        common = (
            t, u, radiance, dynamics, output, highest, lowest, lights, *(dtype(value) for value in scalars),
        )  # fmt: skip
        locate = locate and not complex_step
        per_event = np.empty((6, len(iv)), dtype)
        per_pixel = np.empty((4, len(iv.last_s)), dtype)
        _events(
            release, time, iv.sign, step_r, step_e, state_r, state_e, self._extreme_at, locate, *_near(circuit),
            *common, *per_event,
        )  # fmt: skip
        _censored(last, step_l, state_l, last_sample, self._rise_at, self._fall_at, locate, *common, *per_pixel)
        return Changes(*per_event, *per_pixel, early=np.real(time - release) <= 0)

    def fill(self, circuit: Circuit, locate: bool, events: np.ndarray, pixels: np.ndarray) -> None:
        """Write the changes under a real circuit into rows (7, n) and (4, m), in the order of `Changes`."""
        if plain_changes.applicable(circuit) and self._fill_plain(circuit, locate, events, pixels):
            return
        found = self(circuit, locate)
        for row, name in zip((*events, *pixels), (*PER_EVENT, *PER_PIXEL), strict=True):
            row[:] = getattr(found, name)

    def _fill_plain(self, circuit: Circuit, locate: bool, events: np.ndarray, pixels: np.ndarray) -> bool:
        """As `fill`, for a pixel of four states; returns whether it is one."""
        trajectory = self.trajectory(circuit, keep=locate)
        if not Plain.describes(trajectory):
            return False
        plain = self._plain
        if plain is None or plain.trajectory is not trajectory:
            plain = Plain(trajectory)
            self._plain = plain if locate else self._plain
        iv = self.intervals
        release, time = iv.previous_s + (circuit.refractory - circuit.delay), iv.time_s - circuit.delay
        last = iv.last_s + (circuit.refractory - circuit.delay)
        last_sample = int(np.searchsorted(trajectory.t, iv.end_s, side="right")) - 1
        plain.events(
            (release, self._hints[0]), (time, self._hints[1]), iv.sign, self._extreme_at,
            _near(circuit) if locate else None, events[:6],
        )  # fmt: skip
        plain.censored((last, self._hints[2]), last_sample, self._rise_at, self._fall_at, locate, pixels)
        np.less_equal(time, release, out=events[6])
        return True


def _apart(dynamics: Dynamics) -> Dynamics:
    """The dynamics, with follower and extra pole at least `APART` from each other at the same total delay.

    Climbs end where the two coincide, as their order leaves no trace.  There the closed form fails and steps cost ten
    times as much; a gap of 0.4 % moves the response to a step by 4e-6 of it.
    """
    first, second = dynamics.follower, dynamics.extra_pole
    if max(np.real(first), np.real(second)) > PRESENT_BELOW or abs(np.real(first - second)) >= APART * np.real(
        first + second
    ):
        return dynamics
    half = 0.5 * (1.0 / first + 1.0 / second)
    tilt = APART if np.real(first) >= np.real(second) else -APART
    return dynamics._replace(follower=1.0 / (half * (1.0 - tilt)), extra_pole=1.0 / (half * (1.0 + tilt)))


def _near(circuit: Circuit) -> tuple[float, float]:
    """Changes (ON, OFF) below which the chance of having reached a threshold is under 1e-15, whatever the pixel."""
    if circuit.threshold_drift != 0:
        return -np.inf, -np.inf
    closest = 1.0 - 8.0 * float(np.hypot(np.real(circuit.noise), np.real(circuit.mismatch)))
    return closest * float(np.real(circuit.on_threshold)), closest * float(np.real(circuit.off_threshold))
