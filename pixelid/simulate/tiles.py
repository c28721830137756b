"""Light that differs from pixel to pixel: every pixel has its own trajectory.

Work goes tile by tile (up to `TILE` pixels, whose states stay in cache) and step by step.  All
pixels of a tile advance together; those whose bounds allow an event are then searched one by one.  The four-state
chain advances in vector form (`chain_step.py`), any other by `kernels.advance` or, slew limited, `slew.slewed_step`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pixelid.dynamics import kernels, vectorised
from pixelid.dynamics.equations import ABSENT_FOLLOWER, PRESENT_BELOW
from pixelid.dynamics.slew import slewed_step, smooth_state
from pixelid.dynamics.vector_math import vexp, vlog
from pixelid.simulate import chain_step, comparator, random
from pixelid.simulate.comparator import DECAY, FIELDS, LEVEL, OFF, ON, RELEASE, events_in_step
from pixelid.simulate.crossing import DEPTH
from pixelid.simulate.laws import Rules
from pixelid.simulate.light import Block
from pixelid.simulate.step import after_jump, light_integral, modes, slope_bound

TILE = 512
LANES = 16  # tiles are multiples of every vector length, so that no pixel falls into a loop's remainder
CAPACITY = 1024


class Tiles:
    """The sensor's pixels, their trajectories and comparators, carried from block to block."""

    def __init__(self, rules: Rules, pixels: int, held: bool) -> None:
        """held: light jumps from frame to frame instead of log radiance running linearly between them."""
        self._rules, self._held, self._pixels = rules, held, pixels
        self._tile = min(TILE, -(-pixels // (4 * LANES)) * LANES)  # four tiles at least, for the threads
        padded = -(-pixels // self._tile) * self._tile
        self._states = np.empty((6, padded))
        self._comparators = np.empty((FIELDS, padded))
        self._drawn = np.empty(padded, np.int64)
        absent = max(rules.chain[0], rules.chain[3], rules.dynamics.beta) > PRESENT_BELOW
        self._plain = (
            not rules.slewing and vectorised.applicable(rules.dynamics) and not (held and absent)
        )  # a jump moves stages without a pole at once, which the vector form does not do

    @property
    def firsts(self) -> range:
        """The first pixel of every tile."""
        return range(0, len(self._drawn), self._tile)

    def events(self, first: int, block: Block):
        """(times (m,) s, pixels (m,), polarities (m,)) of the tile that begins at pixel `first`."""
        rules, circuit = self._rules, self._rules.circuit
        place = slice(first, first + self._tile)
        live = min(self._tile, self._pixels - first)
        radiance = np.empty((len(block.t), self._tile))
        _load(block.frames, first, live, radiance)
        return _tile(
            first, live,
            (block.t, radiance, block.parts, block.before, block.after, block.first, self._held),
            (circuit.dark, circuit.flicker_modulation, 2 * np.pi * circuit.flicker_hz, circuit.flicker_phase),
            (circuit.knee, circuit.knee_slope),
            (circuit.shot_density, np.uint64(random.stream_key(rules.seed, random.SHOT))),
            rules.dynamics, circuit.linearisation == "midpoint", self._plain, rules.rates, rules.chain,
            rules.laws,
            (circuit.on_threshold, circuit.off_threshold, circuit.mismatch, circuit.noise),
            np.int64(rules.seed), rules.synchronous,
            self._states[:, place], self._comparators[:, place], self._drawn[place],
        )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _load(frames, first, live, out):
    """The radiance of a tile's pixels, out (m, tile), as float64.

    Full-field frames (m, 1) serve all pixels; places beyond the sensor repeat its last pixel.
    """
    last = frames.shape[1] - 1
    for k in range(len(out)):
        for i in range(out.shape[1]):
            out[k, i] = frames[k, min(first + min(i, live - 1), last)]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _effective(radiance, gain, dark, out):
    for i in range(len(out)):
        out[i] = radiance[i] * gain + dark


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _logs(x, out):
    for i in range(len(x)):
        out[i] = vlog(x[i])


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _responses(L, bend, out):
    """Log radiance, or below the knee the line that continues it (`photocurrent.logarithm`)."""
    _logs(L, out)
    knee, slope = bend
    if knee > 0.0:
        for i in range(len(L)):
            out[i] = np.log(knee) + slope * (L[i] / knee - 1.0) if L[i] < knee else out[i]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _scaled(x, factor, out):
    for i in range(len(out)):
        out[i] = x[i] * factor


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _lowered(x, drift):
    for i in range(len(x)):
        x[i] = x[i] - drift


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _between(log0, log1, weight, gain, dark, out):
    """Effective radiance part of the way between two frames."""
    for i in range(len(out)):
        out[i] = vexp((1.0 - weight) * log0[i] + weight * log1[i]) * gain + dark


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _normals(key, first, knot, out, spare):
    """Standard normals of the tile at a knot; even knots also fill `spare` for the knot after."""
    for i in range(len(out)):
        out[i], spare[i] = random.normal_pair(key, first + i, knot >> 1)
    if knot & 1:
        _scaled(spare, 1.0, out)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _add_noise(normals, L, variance, u):
    """Shot noise: white, so that a knot's variance is the one-sided PSD, density/L, times half its sampling rate."""
    for i in range(len(u)):
        u[i] = u[i] + normals[i] * np.sqrt(variance / L[i])


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _possible(d0, d1, spare, level, decay, kd, on, off, release, drift, t1, flag):
    """flag = 1 where the bounds allow an event in the step, or a dead time ends in it."""
    for i in range(len(flag)):
        decay_1 = decay[i] * kd
        high = 0.5 * (d0[i] + d1[i]) + spare[i] - level[i] + drift - min(decay[i], decay_1)
        flag[i] = 1.0 if high >= on[i] else 0.0
    for i in range(len(flag)):
        decay_1 = decay[i] * kd
        low = 0.5 * (d0[i] + d1[i]) - spare[i] - level[i] - max(decay[i], decay_1)
        flag[i] = 1.0 if -low >= off[i] else flag[i]
    for i in range(len(flag)):
        flag[i] = 1.0 if release[i] <= t1 else flag[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _general(u0, u1, L0, L1, tau, dynamics, midpoint, rates, chain, begin, end, a, b2, r, spare):
    """As `chain_step.advance`, for any chain, pixel by pixel."""
    w1, w2, wh, wd, coincide, smooth = chain
    coincide_behind = kernels.cutoffs_coincide(ABSENT_FOLLOWER, w2, wh, wd)
    for i in range(len(a)):
        r[i] = (u1[i] - u0[i]) / tau
        a[i], b2[i] = kernels.photoreceptor_rates(dynamics, kernels.linearised_at(L0[i], L1[i], midpoint))
        state = (begin[0, i], begin[1, i], begin[2, i], begin[3, i], begin[4, i], begin[5, i])
        if smooth:
            after = slewed_step(state, u0[i], r[i], tau, a[i], b2[i], rates, coincide, coincide_behind)
            h0, h1 = smooth_state(state, rates), smooth_state(after, rates)
            s0, s1 = h0[0], h1[0]
            if wd < PRESENT_BELOW:
                s0, s1 = wd * (h0[3] - h0[5]), wd * (h1[3] - h1[5])
            # a cubic exceeds its end values by at most 4/27 of the length times the slopes that point outward
            spare[i] = 0.5 * abs(h1[5] - h0[5]) + 4.0 / 27.0 * tau * (abs(s0) + abs(s1))
        else:
            state = after_jump(state, u0[i], r[i], a[i], b2[i], w1, w2, wh, wd)
            after = kernels.advance(state, u0[i], r[i], tau, a[i], b2[i], w1, w2, wh, wd, coincide)
            spare[i] = 0.5 * tau * slope_bound(state, u0[i], r[i], a[i], b2[i], w1, w2, wh, wd)
            for j in range(6):
                begin[j, i] = state[j]
        for j in range(6):
            end[j, i] = after[j]


@njit(forceinline=True, error_model="numpy")
def _state(states, i, plain, smooth, rates):
    """The six components of one pixel as `step.probe` reads them."""
    v, y, s, d = states[0, i], states[1, i], states[2, i], states[5, i]
    if plain:
        return v, y, s, s, 0.0, d
    state = (v, y, s, states[3, i], states[4, i], d)
    return smooth_state(state, rates) if smooth else state


@njit(cache=True, nogil=True, error_model="numpy")
def _start(u, wh, begin_state):
    """Steady state under log radiance u (n,)."""
    for i in range(len(u)):
        low = u[i] if wh > 0.0 else 0.0
        begin_state[0, i], begin_state[1, i], begin_state[2, i], begin_state[3, i] = 0.0, u[i], u[i], u[i]
        begin_state[4, i], begin_state[5, i] = low, u[i] - low


@njit(cache=True, nogil=True, error_model="numpy")
def _tile(
    first, live, block, light, bend, noise, dynamics, midpoint, plain, rates, chain, laws, thresholds, seed,
    synchronous, states, comparators, drawn,
):  # fmt: skip
    t, frames, parts, before, after, knot, held = block
    dark, modulation, omega, phase = light
    density, key = noise
    wh, wd, smooth = chain[2], chain[3], chain[5]
    _, leak, parasitic, growth, _, _, _, described, relaxing, _ = laws
    size = states.shape[1]
    begin, end, local, count_drawn = states.copy(), states.copy(), comparators.copy(), drawn.copy()
    work = np.empty((chain_step.WORK_ROWS, size))
    L0, L1, u0, u1, lf0, lf1 = (
        np.empty(size), np.empty(size), np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    )  # fmt: skip
    c = np.empty((vectorised.COEFFICIENTS, size))
    a, b2, r, spare, flag = c[0], c[1], np.empty(size), np.empty(size), np.empty(size)
    xi, xi_spare = np.empty(size), np.empty(size)
    on, off = np.empty(size), np.empty(size)
    which, old_level, old_decay = np.empty(size, np.int64), np.empty(size), np.empty(size)
    scratch = np.empty((6, DEPTH))
    found, count = comparator.room(np.int64(CAPACITY)), np.int64(0)  # literals would compile twice

    gain = 1.0 + modulation * np.sin(omega * t[0] + phase)
    _effective(frames[0], gain, dark, L1)
    _responses(L1, bend, u1)
    if knot == 0:
        _start(u1, wh, end)
        on_mean, off_mean, mismatch, event_noise = thresholds
        comparator.start(
            first, on_mean, off_mean, mismatch, event_noise, seed, synchronous,
            end[3] - end[4], end[5].copy(), local, count_drawn,
        )  # fmt: skip
    length_before = before
    if density > 0.0:
        _normals(key, first, knot, xi, xi_spare)
    for k in range(len(t) - 1):
        steps = parts[k]
        length = (t[k + 1] - t[k]) / steps
        F0, F1 = frames[k], frames[k + 1]
        if steps > 1 or held:
            _logs(F0, lf0)
            _logs(F1, lf1)
        for m in range(steps):
            t0 = t[k] + (t[k + 1] - t[k]) * m / steps
            t1 = t[k] + (t[k + 1] - t[k]) * (m + 1) / steps if m + 1 < steps else t[k + 1]
            tau = t1 - t0
            # the light at both ends, and the noise on it
            L0, L1, u0, u1 = L1, L0, u1, u0
            begin, end = end, begin
            weight = (m + 1) / steps
            gain = 1.0 + modulation * np.sin(omega * t1 + phase)
            if held and m == 0:
                _effective(F0, 1.0 + modulation * np.sin(omega * t0 + phase), dark, L0)
                _responses(L0, bend, u0)
            if held:
                _effective(F0, gain, dark, L1)
            elif m + 1 == steps:
                _effective(F1, gain, dark, L1)
            else:
                _between(lf0, lf1, weight, gain, dark, L1)
            _responses(L1, bend, u1)
            if density > 0.0:
                if (held and m == 0) or (k == 0 and m == 0):
                    spacing = 0.5 * (length + (length_before if length_before > 0.0 else length))
                    _add_noise(xi, L0, 0.5 * density / spacing, u0)
                knot += 1
                length_after = length
                if m + 1 == steps:
                    length_after = (t[k + 2] - t[k + 1]) / parts[k + 1] if k + 2 < len(t) else after
                    length_after = length_after if length_after > 0.0 else length
                if knot & 1:
                    xi, xi_spare = xi_spare, xi
                else:
                    _normals(key, first, knot, xi, xi_spare)
                _add_noise(xi, L1, density / (length + length_after), u1)
            # all pixels advance
            if plain:
                chain_step.advance(u0, u1, L0, L1, tau, dynamics, midpoint, begin, end, c, r, spare, work)
            else:
                _general(u0, u1, L0, L1, tau, dynamics, midpoint, rates, chain, begin, end, a, b2, r, spare)
            # which of them may fire
            kd = np.exp(-wd * tau) if wd < PRESENT_BELOW else 0.0
            drift = leak * tau
            if parasitic > 0.0:
                most = 0.0
                for i in range(size):
                    most = max(most, max(L0[i], L1[i]))
                drift += parasitic * tau * most
            factor = 1.0 + growth * (t1 if growth < 0.0 else t0)
            _scaled(local[ON], factor, on)
            _scaled(local[OFF], factor, off)
            if min(relaxing[0], relaxing[1]) < 0.0:
                _lowered(on, -min(relaxing[0], 0.0) * factor)
                _lowered(off, -min(relaxing[1], 0.0) * factor)
            _possible(begin[5], end[5], spare, local[LEVEL], local[DECAY], kd, on, off, local[RELEASE], drift, t1, flag)
            possible = 0
            for i in range(live):
                if flag[i] > 0.0:
                    which[possible] = i
                    old_level[possible], old_decay[possible] = local[LEVEL, i], local[DECAY, i]
                    possible += 1
            _scaled(local[DECAY], kd, local[DECAY])
            if parasitic > 0.0:
                for i in range(live):
                    light_rate = np.log(L1[i] / L0[i]) / tau
                    local[LEVEL, i] -= parasitic * light_integral(L0[i], light_rate, tau)
            if leak > 0.0:
                _lowered(local[LEVEL], leak * tau)
            for j in range(possible):
                i = which[j]
                local[LEVEL, i], local[DECAY, i] = old_level[j], old_decay[j]
                light_rate = np.log(L1[i] / L0[i]) / tau if parasitic > 0.0 or len(described) > 0 else 0.0
                state = _state(begin, i, plain, smooth, rates)
                step = (
                    state, _state(end, i, plain, smooth, rates), u0[i], r[i], tau, a[i], b2[i], L0[i], light_rate,
                    modes(state, u0[i], r[i], a[i], b2[i], chain),
                )  # fmt: skip
                found, count = events_in_step(
                    first + i, i, t0, t1, step, chain, local, count_drawn, laws, found, count, scratch
                )
            length_before = length
    for i in range(size):
        for j in range(len(states)):
            states[j, i] = end[j, i]
        for j in range(len(comparators)):
            comparators[j, i] = local[j, i]
        drawn[i] = count_drawn[i]
    return found[0][:count], found[1][:count], found[2][:count]
