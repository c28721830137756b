"""Light that differs from pixel to pixel: every pixel has its own trajectory.

Work goes tile by tile (up to `TILE` pixels, whose states stay in cache) and step by step.  All
pixels of a tile advance together; those whose bounds allow an event are then searched, together where their way is
plain (`many.py`), else one by one.  The four-state
chain advances in vector form (`chain_step.py`), any other by `kernels.advance` or, slew limited, `slew.slewed_step`.
All numbers of a tile are rows of one flat work space, as in `dynamics.blocks`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pixelid.dynamics import kernels, vectorised
from pixelid.dynamics.blocks import B2, BEGIN, BLOCK, D0, D1, END, L0, L1, U0, U1, A, R
from pixelid.dynamics.equations import ABSENT_FOLLOWER, PRESENT_BELOW
from pixelid.dynamics.slew import slewed_step, smooth_state
from pixelid.simulate import chain_step, comparator, many, random, rows
from pixelid.simulate.chain_step import SPARE
from pixelid.simulate.comparator import DECAY, FIELDS, LEVEL, OFF, ON, RELEASE, events_in_step, fire
from pixelid.simulate.crossing import DEPTH
from pixelid.simulate.laws import Rules
from pixelid.simulate.light import Block
from pixelid.simulate.rows import AFTER, BEFORE, COMPARATORS, FLAG, NEXT_NOISE, NOISE, ROWS
from pixelid.simulate.step import after_jump, light_integral, modes, slope_bound

TILE = BLOCK
CAPACITY = 1024


class Tiles:
    """The sensor's pixels, their trajectories and comparators, carried from block to block."""

    def __init__(self, rules: Rules, pixels: int, held: bool) -> None:
        """held: light jumps from frame to frame instead of log radiance running linearly between them."""
        self._rules, self._held, self._pixels = rules, held, pixels
        lanes = 8  # tiles are multiples of the vector length, so that no pixel falls into a loop's remainder
        self._tile = min(TILE, -(-pixels // (4 * lanes)) * lanes)  # four tiles at least, for the threads
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
        rows.load(block.frames, first, live, radiance)
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
def _possible(w, n, kd, factor, lowered_on, lowered_off, drift, t1):
    """FLAG = 1 where the bounds allow an event in the step, or a dead time ends in it.

    factor, lowered_on, lowered_off: thresholds are ON · factor − lowered_on, and so OFF
    """
    for i in range(n):
        decay = w[i + (COMPARATORS + DECAY) * BLOCK]
        later = decay * kd
        spare = w[i + SPARE * BLOCK]
        middle = 0.5 * (w[i + D0 * BLOCK] + w[i + D1 * BLOCK]) - w[i + (COMPARATORS + LEVEL) * BLOCK]
        high, low = middle + spare + drift - min(decay, later), middle - spare - max(decay, later)
        flag = 1.0 if high >= w[i + (COMPARATORS + ON) * BLOCK] * factor - lowered_on else 0.0
        flag = 1.0 if -low >= w[i + (COMPARATORS + OFF) * BLOCK] * factor - lowered_off else flag
        w[i + FLAG * BLOCK] = 1.0 if w[i + (COMPARATORS + RELEASE) * BLOCK] <= t1 else flag


@njit(cache=True, nogil=True, error_model="numpy")
def _general(w, n, tau, dynamics, midpoint, rates, chain, begin, end):
    """As `chain_step.advance`, for any chain, pixel by pixel; begin, end: (6, BLOCK), the states in w."""
    w1, w2, wh, wd, coincide, smooth = chain
    coincide_behind = kernels.cutoffs_coincide(ABSENT_FOLLOWER, w2, wh, wd)
    for i in range(n):
        u0 = w[i + U0 * BLOCK]
        r = (w[i + U1 * BLOCK] - u0) / tau
        light = kernels.linearised_at(w[i + L0 * BLOCK], w[i + L1 * BLOCK], midpoint)
        a, b2 = kernels.photoreceptor_rates(dynamics, light)
        w[i + R * BLOCK], w[i + A * BLOCK], w[i + B2 * BLOCK] = r, a, b2
        state = (begin[0, i], begin[1, i], begin[2, i], begin[3, i], begin[4, i], begin[5, i])
        if smooth:
            after = slewed_step(state, u0, r, tau, a, b2, rates, coincide, coincide_behind)
            h0, h1 = smooth_state(state, rates), smooth_state(after, rates)
            s0, s1 = h0[0], h1[0]
            if wd < PRESENT_BELOW:
                s0, s1 = wd * (h0[3] - h0[5]), wd * (h1[3] - h1[5])
            # a cubic exceeds its end values by at most 4/27 of the length times the slopes that point outward
            w[i + SPARE * BLOCK] = 0.5 * abs(h1[5] - h0[5]) + 4.0 / 27.0 * tau * (abs(s0) + abs(s1))
        else:
            state = after_jump(state, u0, r, a, b2, w1, w2, wh, wd)
            after = kernels.advance(state, u0, r, tau, a, b2, w1, w2, wh, wd, coincide)
            w[i + SPARE * BLOCK] = 0.5 * tau * slope_bound(state, u0, r, a, b2, w1, w2, wh, wd)
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


@njit(cache=True, error_model="numpy")
def _searched_together(dynamics, laws):
    """Whether `many` knows all that these pixels do."""
    _, leak, parasitic, growth, _, _, _, described, relaxing, silent = laws
    still = leak == 0.0 and parasitic == 0.0 and growth == 0.0 and relaxing[0] == 0.0 and relaxing[1] == 0.0
    return still and silent == 0.0 and len(described) == 0 and max(dynamics.beta, dynamics.differencing) < PRESENT_BELOW


@njit(cache=True, nogil=True, error_model="numpy")
def _divide(which, possible, local, t1, ending):
    """Put those of which[:possible] whose dead time ends until t1 into `ending`, keep the others; how many of each."""
    releasing, kept = 0, 0
    for j in range(possible):
        i = which[j]
        ends = local[RELEASE, i] <= t1
        which[kept], ending[releasing] = i, i
        kept, releasing = kept + (0 if ends else 1), releasing + (1 if ends else 0)
    return releasing, kept


@njit(cache=True, nogil=True, error_model="numpy")
def _take_over(q, ending, releasing, local, which, possible):
    """Take over what `many.release` found; the others are added to which[:possible], whose number is returned."""
    for j in range(releasing):
        i = ending[j]
        if q[j + many.PLAIN * BLOCK] > 0.0:
            local[LEVEL, i], local[DECAY, i] = q[j + many.LEVEL * BLOCK], q[j + many.DECAY * BLOCK]
            local[RELEASE, i] = np.inf
        else:
            which[possible] = i
            possible += 1
    return possible


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
    n = states.shape[1]
    w = np.zeros(ROWS * BLOCK)  # of zeros: what nobody fills must not be so small that arithmetic gets slow
    begin, end = (
        w[BEGIN * BLOCK : (BEGIN + 6) * BLOCK].reshape(6, BLOCK),
        w[END * BLOCK : (END + 6) * BLOCK].reshape(6, BLOCK),
    )
    local = w[COMPARATORS * BLOCK : (COMPARATORS + FIELDS) * BLOCK].reshape(FIELDS, BLOCK)
    l0, l1 = w[L0 * BLOCK : L0 * BLOCK + n], w[L1 * BLOCK : L1 * BLOCK + n]
    u0, u1 = w[U0 * BLOCK : U0 * BLOCK + n], w[U1 * BLOCK : U1 * BLOCK + n]
    count_drawn = np.zeros(BLOCK, np.int64)
    which, ending, old_level, old_decay = np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n), np.empty(n)
    together, any_delicate = plain and _searched_together(dynamics, laws), False
    q = np.zeros(many.ROWS * BLOCK if together else 1)
    scratch = np.empty((6, DEPTH))
    found, count = comparator.room(np.int64(CAPACITY)), np.int64(0)  # literals would compile twice
    for i in range(n):
        for j in range(6):
            end[j, i] = states[j, i]
        for j in range(FIELDS):
            local[j, i] = comparators[j, i]
        count_drawn[i] = drawn[i]

    gain = 1.0 + modulation * np.sin(omega * t[0] + phase)
    rows.fill_light(frames[0], gain, dark, w, n)
    rows.fill_responses(w, n, bend)
    if knot == 0:
        rows.fill_steady(u1, wh, end)
        on_mean, off_mean, mismatch, event_noise = thresholds
        comparator.start(
            first, on_mean, off_mean, mismatch, event_noise, seed, synchronous,
            end[3] - end[4], end[5].copy(), local, count_drawn,
        )  # fmt: skip
    length_before = before
    if density > 0.0:
        rows.fill_normals(key, first, knot, w, n)
    for k in range(len(t) - 1):
        steps = parts[k]
        length = (t[k + 1] - t[k]) / steps
        F0, F1 = frames[k], frames[k + 1]
        if steps > 1 or held:
            rows.fill_logs(F0, w[BEFORE * BLOCK : BEFORE * BLOCK + n])
            rows.fill_logs(F1, w[AFTER * BLOCK : AFTER * BLOCK + n])
        for m in range(steps):
            t0 = t[k] + (t[k + 1] - t[k]) * m / steps
            t1 = t[k] + (t[k + 1] - t[k]) * (m + 1) / steps if m + 1 < steps else t[k + 1]
            tau = t1 - t0
            # the light at both ends, and the noise on it
            weight = (m + 1) / steps
            gain = 1.0 + modulation * np.sin(omega * t1 + phase)
            if held and m == 0:
                rows.fill_light(F0, 1.0 + modulation * np.sin(omega * t0 + phase), dark, w, n)
                rows.fill_responses(w, n, bend)
            rows.move_light(w, n)
            if held:
                rows.fill_light(F0, gain, dark, w, n)
            elif m + 1 == steps:
                rows.fill_light(F1, gain, dark, w, n)
            else:
                rows.fill_light_between(w, n, weight, gain, dark)
            rows.fill_responses(w, n, bend)
            if density > 0.0:
                xi = w[NOISE * BLOCK : NOISE * BLOCK + n]
                if (held and m == 0) or (k == 0 and m == 0):
                    spacing = 0.5 * (length + (length_before if length_before > 0.0 else length))
                    rows.add_noise(xi, l0, 0.5 * density / spacing, u0)
                knot += 1
                length_after = length
                if m + 1 == steps:
                    length_after = (t[k + 2] - t[k + 1]) / parts[k + 1] if k + 2 < len(t) else after
                    length_after = length_after if length_after > 0.0 else length
                if knot & 1:
                    rows.scale(w[NEXT_NOISE * BLOCK : NEXT_NOISE * BLOCK + n], 1.0, xi)
                else:
                    rows.fill_normals(key, first, knot, w, n)
                rows.add_noise(xi, l1, density / (length + length_after), u1)
            # all pixels advance
            if plain:
                rows.move_four_states(w, n)
                any_delicate = chain_step.advance(w, n, tau, dynamics, midpoint)
            else:
                rows.move_states(w, n)
                _general(w, n, tau, dynamics, midpoint, rates, chain, begin, end)
            # which of them may fire
            kd = np.exp(-wd * tau) if wd < PRESENT_BELOW else 0.0
            drift = leak * tau
            if parasitic > 0.0:
                most = 0.0
                for i in range(n):
                    most = max(most, max(l0[i], l1[i]))
                drift += parasitic * tau * most
            factor = 1.0 + growth * (t1 if growth < 0.0 else t0)
            lowered_on, lowered_off = 0.0, 0.0
            if min(relaxing[0], relaxing[1]) < 0.0:
                lowered_on, lowered_off = -min(relaxing[0], 0.0) * factor, -min(relaxing[1], 0.0) * factor
            _possible(w, n, kd, factor, lowered_on, lowered_off, drift, t1)
            possible = 0
            for i in range(live):
                which[possible] = i
                possible += 1 if w[i + FLAG * BLOCK] > 0.0 else 0
            releasing = 0
            if together and not any_delicate:
                releasing, possible = _divide(which, possible, local, t1, ending)
                many.take(w, local, which, possible, q)
                many.search(q, possible, tau, chain[0], wd)
                rest = 0
                for j in range(possible):
                    i = which[j]
                    which[rest] = i
                    if q[j + many.PLAIN * BLOCK] == 0.0:
                        rest += 1
                    elif q[j + many.HIT * BLOCK] > 0.0:
                        polarity = 1 if q[j + many.SIGN * BLOCK] > 0.0 else 0
                        time = t0 + q[j + many.X * BLOCK]
                        found, count = fire(first + i, i, time, polarity, local, count_drawn, laws, found, count)
                        rest += 1 if local[RELEASE, i] <= t1 else 0
                possible = rest
            for j in range(possible):
                old_level[j], old_decay[j] = local[LEVEL, which[j]], local[DECAY, which[j]]
            rows.scale(local[DECAY], kd, local[DECAY])
            if releasing > 0:
                many.take(w, local, ending, releasing, q)
                many.release(q, releasing, t0, tau, chain[0], wd)
                possible = _take_over(q, ending, releasing, local, which, possible)
            if parasitic > 0.0:
                for i in range(live):
                    light_rate = np.log(l1[i] / l0[i]) / tau
                    local[LEVEL, i] -= parasitic * light_integral(l0[i], light_rate, tau)
            if leak > 0.0:
                rows.lower(local[LEVEL], leak * tau)
            for j in range(possible):
                i = which[j]
                if not local[RELEASE, i] <= t1:  # else the end of the dead time sets both
                    local[LEVEL, i], local[DECAY, i] = old_level[j], old_decay[j]
                light_rate = np.log(l1[i] / l0[i]) / tau if parasitic > 0.0 or len(described) > 0 else 0.0
                state = _state(begin, i, plain, smooth, rates)
                r, a, b2 = w[i + R * BLOCK], w[i + A * BLOCK], w[i + B2 * BLOCK]
                step = (
                    state, _state(end, i, plain, smooth, rates), u0[i], r, tau, a, b2, l0[i], light_rate,
                    modes(state, u0[i], r, a, b2, chain),
                )  # fmt: skip
                found, count = events_in_step(
                    first + i, i, t0, t1, step, chain, local, count_drawn, laws, found, count, scratch
                )
            length_before = length
    for i in range(n):
        for j in range(6):
            states[j, i] = end[j, i]
        for j in range(FIELDS):
            comparators[j, i] = local[j, i]
        drawn[i] = count_drawn[i]
    return found[0][:count], found[1][:count], found[2][:count]
