"""The comparator of each pixel: thresholds, reset, dead time, and the events of one step.

State of n pixels, `comparators` (8, n) float64 and `drawn` (n,) int64, carried from step to step:

    LEVEL    what the amplifier restarted from, less the drift since: change = d − level − decay
    DECAY    what is left of (d − level at release) e^{−ωd (t − tr)}
    RELEASE  end of the dead time in progress [s]; +∞ when the pixel is live
    ON, OFF  the thresholds of the next event, without drift;   BASE_ON, BASE_OFF  the pixel's means
    LAST     time of the last event [s]; −∞ before the first
    drawn    how many threshold pairs this pixel has drawn
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pixelid.dynamics.equations import PRESENT_BELOW
from pixelid.simulate import random
from pixelid.simulate.crossing import first_crossing
from pixelid.simulate.relaxing import first_crossing_relaxing, set_at_reset
from pixelid.simulate.step import light_integral, probe

LEVEL, DECAY, RELEASE, ON, OFF, BASE_ON, BASE_OFF, LAST = range(8)
FIELDS = 8
LEAST = 0.01  # relative draws of thresholds are repeated until they exceed this
UNMOVED = (0.0, 0.0)  # thresholds to which nothing is added
_RETRY = 1 << 40  # counters of repeated draws


@njit(forceinline=True, error_model="numpy")
def _relative(key, pixel, counter, sigma):
    """Two independent draws of 1 + σ ξ, each truncated to stay above LEAST."""
    first, second = random.normal_pair(key, pixel, counter)
    a, b = 1.0 + sigma * first, 1.0 + sigma * second
    attempt = 0
    while min(a, b) < LEAST and attempt < 1000:
        attempt += 1
        first, second = random.normal_pair(key, pixel, counter + attempt * _RETRY)
        a = 1.0 + sigma * first if a < LEAST else a
        b = 1.0 + sigma * second if b < LEAST else b
    return max(a, LEAST), max(b, LEAST)


@njit(forceinline=True, error_model="numpy")
def _shifted(mean, relative, factor, shift):
    """A pixel's threshold times a factor, with the draw's noise and shifted, of the least that a draw may be."""
    return max(mean * (factor + (relative - 1.0)) + shift, LEAST * mean)


@njit(forceinline=True, error_model="numpy")
def draw_thresholds(pixel, place, comparators, drawn, key, noise, factors, shifts):
    """Fresh ON and OFF thresholds for the next event of `pixel`, held at column `place`, moved by `shifts`; factors: of
    its thresholds, before noise."""
    on, off = 1.0, 1.0
    if noise > 0.0:
        on, off = _relative(key, pixel, drawn[place], noise)
        drawn[place] += 1
    comparators[ON, place] = _shifted(comparators[BASE_ON, place], on, factors[0], shifts[0])
    comparators[OFF, place] = _shifted(comparators[BASE_OFF, place], off, factors[1], shifts[1])


@njit(cache=True, nogil=True, error_model="numpy")
def start(first_pixel, on, off, mismatch, noise, seed, synchronous, level, out, comparators, drawn):
    """Fill the comparators of pixels first_pixel, … at the first sample; level, out: (n,) reset level and output.

    Synchronous: every reference is taken there.  Otherwise each pixel starts part of the way to its next event:
    its change begins at a value uniform between −C_off and C_on, as if its last event were long ago.
    """
    spread, event = random.stream_key(seed, random.MISMATCH), random.stream_key(seed, random.THRESHOLD)
    phase = random.stream_key(seed, random.PHASE)
    for i in range(comparators.shape[1]):
        pixel = first_pixel + i
        a, b = _relative(spread, pixel, 0, mismatch)
        comparators[BASE_ON, i], comparators[BASE_OFF, i] = on * a, off * b
        drawn[i] = 0
        draw_thresholds(pixel, i, comparators, drawn, event, noise, (1.0, 1.0), UNMOVED)
        comparators[RELEASE, i], comparators[LAST, i] = np.inf, -np.inf
        if synchronous:
            comparators[LEVEL, i], comparators[DECAY, i] = level[i], out[i] - level[i]
        else:
            span = comparators[ON, i] + comparators[OFF, i]
            offset = random.uniform(phase, pixel, 0) * span - comparators[OFF, i]
            comparators[LEVEL, i], comparators[DECAY, i] = out[i] - offset, 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def room(size):
    """Empty lists of events: times [s], pixels, polarities."""
    return np.empty(size), np.empty(size, np.int64), np.empty(size, np.uint8)


@njit(cache=True, nogil=True, error_model="numpy")
def grown(fired):
    """The same events with twice the room."""
    times, pixels, polarities = room(2 * len(fired[0]))
    for k in range(len(fired[0])):
        times[k], pixels[k], polarities[k] = fired[0][k], fired[1][k], fired[2][k]
    return times, pixels, polarities


@njit(cache=True, nogil=True, error_model="numpy")
def fire(pixel, place, time, polarity, comparators, drawn, laws, fired, count):
    """An event at `time` [s]: fresh thresholds, and a dead time that `events_in_step` ends.  Returns (fired, count)."""
    refractory, _, _, _, noise, key, history, _, _, _ = laws
    if count == len(fired[0]):
        fired = grown(fired)
    fired[0][count], fired[1][count], fired[2][count] = time, pixel, polarity
    comparators[LAST, place], comparators[RELEASE, place] = time, time + refractory
    comparators[LEVEL, place], comparators[DECAY, place] = np.nan, 0.0
    draw_thresholds(pixel, place, comparators, drawn, key, noise, history[polarity], UNMOVED)
    return fired, count + 1


@njit(cache=True, nogil=True, error_model="numpy")
def events_in_step(pixel, place, t0, t1, step, chain, comparators, drawn, laws, fired, count, scratch):
    """Carry one pixel through the step t0 … t1, with its release, crossings and resets in the order they happen.

    laws: `laws.Laws`, leak and parasitic in log radiance per second (and radiance);
    fired: (times (m,) s, pixels (m,), polarities (m,)), grown as needed.
    Returns (fired, count).
    """
    refractory, leak, parasitic, drift, noise, key, history, described, relaxing, silent = laws
    tau, wd = step[4], chain[3]
    x = 0.0
    level, decay = comparators[LEVEL, place], comparators[DECAY, place]
    decay = decay if abs(decay) > 1e-15 else 0.0
    release = comparators[RELEASE, place]
    if release < np.inf:
        if release > t1:
            return fired, count
        x = min(max(release - t0, 0.0), tau)
        here = probe(x, step, chain)
        level, decay = here[0], here[1] - here[0] if wd < PRESENT_BELOW else 0.0
        comparators[RELEASE, place] = np.inf
    else:
        here = probe(x, step, chain)
    while True:
        begin, seen = x, here  # from where on the change is compared: the reference may be older
        if silent > 0.0:
            begin = max(x, comparators[LAST, place] + silent - t0)
            if begin >= tau:
                break
            seen = here if begin == x else probe(begin, step, chain)
        if relaxing[0] != 0.0 or relaxing[1] != 0.0:
            at, polarity = first_crossing_relaxing(
                begin, seen, step, chain, (level, decay, x, leak, parasitic), comparators[ON, place],
                comparators[OFF, place], drift, relaxing, t0, comparators[LAST, place], scratch,
            )  # fmt: skip
        else:
            at, polarity = first_crossing(
                begin, seen, step, chain, (level, decay, x, leak, parasitic),
                comparators[ON, place] * (1.0 + drift * t0), comparators[ON, place] * drift,
                comparators[OFF, place] * (1.0 + drift * t0), comparators[OFF, place] * drift, scratch, tau,
            )  # fmt: skip
        if polarity < 0:
            break
        if count == len(fired[0]):
            fired = grown(fired)
        fired[0][count], fired[1][count], fired[2][count] = t0 + at, pixel, polarity
        count += 1
        dead, shifts = refractory, UNMOVED
        if len(described) > 0:
            on, off, longer = set_at_reset(
                described, 2.0 * polarity - 1.0, t0 + at, step[7] * np.exp(step[8] * at), abs(step[8])
            )
            dead, shifts = max(dead + longer, 0.0), (on, off)
        comparators[LAST, place] = t0 + at
        draw_thresholds(pixel, place, comparators, drawn, key, noise, history[polarity], shifts)
        if t0 + at + dead > t1:
            comparators[RELEASE, place] = t0 + at + dead
            comparators[LEVEL, place], comparators[DECAY, place] = np.nan, 0.0
            return fired, count
        x = min(at + dead, tau)
        here = probe(x, step, chain)
        level, decay = here[0], here[1] - here[0] if wd < PRESENT_BELOW else 0.0
    level -= leak * (tau - x)
    if parasitic > 0.0:
        level -= parasitic * light_integral(step[7] * np.exp(step[8] * x), step[8], tau - x)
    comparators[LEVEL, place] = level
    comparators[DECAY, place] = decay * np.exp(-wd * (tau - x)) if decay != 0.0 else 0.0
    return fired, count
