"""A finite pool of pixels under one light, each a Markov chain: its last reference, and nothing before it.

After an event the pixel is in reset for the dead time ρ.  At its release t_r it takes a reference, and with the signals
common to all pixels (y, the amplifier that is never reset, and s, what it is reset to)

    change(t) = y(t) − s(t_r) − (y(t_r) − s(t_r)) e^{−ωd (t − t_r)}

An ON threshold C (1 + σ ξ) above the largest change so far has not been crossed, so a pixel released at t_r is still
waiting at t with the probability

    S = Φ((C_on − max change)/(σ C_on)) Φ((C_off − max −change)/(σ C_off))

and what S loses in a step is the expected number of events of the polarity whose maximum has moved.  `flow` carries
this forward: the pixels released in one step are a cohort (share, mean and variance of the release time), whose
events in later steps are releases ρ later.  Every cohort is followed until nothing of it waits, so the cost is the
number of steps times the steps that a crossing takes, whatever the number of pixels.  Quantities are exact to second
order in the step.

The number of events of one pixel in a bin has the second factorial moment Σ 2 E[events before in the same bin], which
the cohorts carry along; with the mean it gives the variance of counts.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.special import ndtr

SHORT, LONG = 16, 256  # steps: of the blocks whose extremes let a cohort skip what cannot make it fire
REACH = 5.0  # standard deviations of a threshold: the 3e-7 of the pixels beyond fire there
EDGE = 1e-9  # of them, for rounding
# Of the pool: smaller cohorts join the next.  Each such jump is noise of derivatives: 1e-4 of them (3e-5 made 1e-2).
LEAST_SHARE = 3e-7
LEAST_SPREAD = 1e-3  # of a threshold: a noise of zero has no density
FIRST = 24  # references of pixels whose last event is long ago, evenly between the thresholds
STEP_SD = 2.0  # standard deviations of a threshold that the signals move in a step
RESET_SD = 0.6  # of them: most that the rest of a reset departs from a straight line in a step
MOST_AGAIN = 16  # events of a pixel within a step; a model with more has longer steps than suit it
FADED = 1e-6  # of them: less of a reset's rest is none
MOST_STEPS = 256  # of a bin
PER_SD = 128  # places of the table of the normal distribution; Hermite's cubic between them is good to 1e-11
_Z = np.arange(-REACH, REACH + 1.5 / PER_SD, 1.0 / PER_SD)
ABOVE, DENSITY = ndtr(-_Z), np.exp(-0.5 * _Z**2) / math.sqrt(2.0 * math.pi)


class Signals(NamedTuple):
    """What all pixels share.  The unit of time is a bin; a bin has equal steps, n in all.

    first: (bins + 1,) step at which each bin begins;  place: (n + 1,) time at the ends of steps
    level, output: (n + 1,) log radiance, what the amplifier is reset to and its output when never reset, with what
        leaks
    level_slope, output_slope: (n + 1,) per bin
    high, low: (blocks,) extremes of `output` over blocks of SHORT steps;  higher, lower: of LONG steps
    """

    first: np.ndarray
    place: np.ndarray
    level: np.ndarray
    output: np.ndarray
    level_slope: np.ndarray
    output_slope: np.ndarray
    high: np.ndarray
    low: np.ndarray
    higher: np.ndarray
    lower: np.ndarray


class Comparator(NamedTuple):
    """A pixel's comparator; times in bins.

    on, off: its thresholds, log radiance;  noise: relative, from event to event;  memory: relative, of the polarity
    before;  drift: relative, per bin;  dead: reset after an event;  blind: silence beyond it;  rate: at which the
    rest of the reset fades, per bin
    """

    on: float
    off: float
    noise: float
    memory: float
    drift: float
    dead: float
    blind: float
    rate: float


def divide(level: np.ndarray, output: np.ndarray, noise: float, rate: float, longest: float = 1.0) -> np.ndarray:
    """(bins,) steps of each bin, from the signals at the edges of bins (bins + 1,).

    Args:
        level, output: as in `Signals`, at the edges.
        noise: standard deviation of thresholds, log radiance.
        rate: as in `Comparator`.
        longest: step, in bins.
    """
    speed = np.maximum(np.abs(np.diff(level)), np.abs(np.diff(output)))
    padded = np.pad(speed, 1, mode="edge")  # a bin in which the light jumps is slow itself
    speed = np.maximum(np.maximum(padded[:-2], padded[2:]), speed)
    by_change = speed / (STEP_SD * noise)
    # What is left of a reset, speed/rate, bends within a step; less than so much cannot.
    by_reset = np.where(speed > RESET_SD * noise * rate, np.sqrt(speed * rate / (8.0 * RESET_SD * noise)), 1.0)
    wanted = np.clip(np.maximum(by_change, by_reset), 1.0 / longest, MOST_STEPS)
    return (2 ** np.ceil(np.log2(wanted))).astype(np.int64)


def places(steps: np.ndarray) -> np.ndarray:
    """(n + 1,) ends of the steps, in bins, of bins with so many (bins,)."""
    first = np.concatenate([[0], np.cumsum(steps)])
    bins = np.repeat(np.arange(len(steps)), steps)
    return np.append(bins + (np.arange(first[-1]) - first[bins]) / steps[bins], float(len(steps)))


def signals(steps: np.ndarray, level: np.ndarray, output: np.ndarray) -> Signals:
    """The signals (n + 1,) at the ends of so many steps per bin (bins,), with their extremes over blocks."""
    extremes = []
    for size in (SHORT, LONG):
        first = np.arange(0, len(output) - 1, size)
        last = np.minimum(first + size, len(output) - 1)
        for extreme in (np.maximum, np.minimum):
            extremes.append(extreme(extreme.reduceat(output[:-1], first), output[last]))
    first = np.concatenate([[0], np.cumsum(steps)])
    place = places(steps)
    slopes = np.gradient(level, place), np.gradient(output, place)
    return Signals(first, place, np.ascontiguousarray(level), np.ascontiguousarray(output), *slopes, *extremes)


def flow(shared: Signals, comparator: Comparator) -> tuple[np.ndarray, np.ndarray]:
    """What one pixel does.

    Args:
        shared: over n steps.
        comparator: of the pixel.

    Returns:
        (2, n) expected ON and OFF events per step; (2, bins) second factorial moment of ON and OFF counts per bin.
    """
    events, twice = np.zeros((2, len(shared.output) - 1)), np.zeros((2, len(shared.first) - 1))
    _flow(shared, comparator, events, twice)
    return events, twice


def queued(events: np.ndarray, times: np.ndarray, service_s: float) -> np.ndarray:
    """Expected events (2, n) of the pool per step as one arbiter lets them go, `service_s` each.

    First come, first served, by the expected queue: what arrives in a step waits for those before it and for half of
    its own.

    times: (n + 1,) s, ends of the steps
    """
    out = np.zeros_like(events)
    _queued(np.ascontiguousarray(events), times, service_s, out)
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _queued(events, times, service_s, out):
    n = events.shape[1]
    waiting, j = 0.0, 0
    for k in range(n):
        width = times[k + 1] - times[k]
        come = events[0, k] + events[1, k]
        if come > 0.0:
            lasts = max(width, come * service_s)  # those that come in a step leave over so long
            begin = times[k] + (waiting + 1.0) * service_s
            while j < n and times[j + 1] <= begin:
                j += 1
            m = j
            while m < n and times[m] < begin + lasts:
                share = (min(times[m + 1], begin + lasts) - max(times[m], begin)) / lasts
                out[0, m] += events[0, k] * share
                out[1, m] += events[1, k] * share
                m += 1
        waiting = max(waiting + come - width / service_s, 0.0)


@njit(inline="always")
def _step_of(first, time):
    """(step, place within it) of a time in bins."""
    b = int(time)
    x = (time - b) * (first[b + 1] - first[b])
    k = int(x)
    return first[b] + k, x - k


@njit(inline="always")
def _between(x, k, place, values, slopes):
    """Hermite's cubic at the place x of step k."""
    width = place[k + 1] - place[k]
    return _cubic(x, values[k], values[k + 1], width * slopes[k], width * slopes[k + 1])


@njit(inline="always")
def _cubic(x, begin, end, a, b):
    """Hermite's cubic from `begin` to `end` with slopes a and b there, at x from 0 to 1."""
    rise = end - begin
    return begin + x * (a + x * (3.0 * rise - 2.0 * a - b + x * (a + b - 2.0 * rise)))


@njit(inline="always")
def above(z):
    """(1 − Φ(z), φ(z)) of a standard normal that ends at ±REACH."""
    if z <= EDGE - REACH:
        return 1.0, 0.0
    if z >= REACH - EDGE:
        return 0.0, 0.0
    x = (z + REACH) * PER_SD
    k = int(x)
    x -= k
    a, b = DENSITY[k], DENSITY[k + 1]
    at = k / PER_SD - REACH
    above = _cubic(x, ABOVE[k], ABOVE[k + 1], -a / PER_SD, -b / PER_SD)
    return above, _cubic(x, a, b, -at * a / PER_SD, -(at + 1.0 / PER_SD) * b / PER_SD)


@njit(inline="always")  # a call would copy the signals: a third of the time
def _quiet_until(shared, k, n, level, reach, highest, lowest):
    """The step up to which no change from `level`, give or take `reach`, exceeds the largest so far; k for none."""
    after = k
    for size, high, low in ((LONG, shared.higher, shared.lower), (SHORT, shared.high, shared.low)):
        if after == k and k % size == 0:
            block = k // size
            while block < len(high) and high[block] - level + reach <= highest and level - low[block] + reach <= lowest:
                block += 1
            after = min(block * size, n)
    return after


@njit(cache=True, nogil=True, error_model="numpy")
def _flow(shared, comparator, events, twice):
    n = events.shape[1]
    chains = 1 if comparator.memory == 0.0 else 2
    # by the polarity before: share, and moments of the release time within the step; then events so far in its bin
    waiting = np.zeros((chains, n + 1, 5))
    last = len(shared.first) - 1 - 1e-9
    for i in range(FIRST):
        z = -comparator.off + (comparator.on + comparator.off) * (i + 0.5) / FIRST
        width = (comparator.on + comparator.off) / FIRST
        _cohort(
            shared, comparator, events, twice, waiting, 0, 0, 0.0, 1.0 / FIRST, width * width / 12.0, 0.0,
            0.0, shared.output[0] - z, 0.0, z, True,
        )  # fmt: skip
    for j in range(n):
        for chain in range(chains):
            for again in range(MOST_AGAIN + 1):  # events within the step of their release come back to it
                share = waiting[chain, j, 0]
                if share < LEAST_SHARE or again == MOST_AGAIN:
                    if share > 0.0:  # nothing is lost: they join those released a step later
                        waiting[chain, j + 1, 0] += share
                        waiting[chain, j, 0] = 0.0
                    break
                mean = waiting[chain, j, 1] / share
                variance = max(waiting[chain, j, 2] / share - mean * mean, 0.0)
                on_before, off_before = waiting[chain, j, 3] / share, waiting[chain, j, 4] / share
                for m in range(5):
                    waiting[chain, j, m] = 0.0
                release = shared.place[j] + mean * (shared.place[j + 1] - shared.place[j])
                release = min(max(release, 0.0), last)
                k, x = _step_of(shared.first, release)
                slope = shared.level_slope[k] + x * (shared.level_slope[k + 1] - shared.level_slope[k])
                variance *= (slope * (shared.place[j + 1] - shared.place[j])) ** 2
                level = _between(x, k, shared.place, shared.level, shared.level_slope)
                gap = _between(x, k, shared.place, shared.output, shared.output_slope) - level
                _cohort(
                    shared, comparator, events, twice, waiting, chain, j, release, share, variance, on_before,
                    off_before, level, gap, 0.0, False,
                )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def _cohort(
    shared, comparator, events, twice, waiting, chain, j, release, share, variance, on_before, off_before,
    level, gap, begin, first,
):  # fmt: skip
    """Follow the pixels released at `release` (bins) until all have fired or the signals end."""
    n = events.shape[1]
    output = shared.output
    grown = 1.0 + comparator.drift * release
    swing = 0.0 if first or comparator.memory == 0.0 else comparator.memory * (1.0 if chain == 0 else -1.0)
    on, off = comparator.on * grown * (1.0 + swing), comparator.off * grown * (1.0 - swing)
    on_sd = math.sqrt((max(comparator.noise, LEAST_SPREAD) * comparator.on * grown) ** 2 + variance)
    off_sd = math.sqrt((max(comparator.noise, LEAST_SPREAD) * comparator.off * grown) ** 2 + variance)
    own_bin = int(release - comparator.dead) if release >= comparator.dead else -1
    on_zone, off_zone = on - REACH * on_sd, off - REACH * off_sd
    start = release + comparator.blind if not first else release
    if start >= len(shared.first) - 1:
        return
    k, x = _step_of(shared.first, start)  # where the comparison begins
    left = gap * math.exp(-comparator.rate * (start - release))
    now = begin
    highest, lowest = max(begin, on_zone), max(-begin, off_zone)
    on_z, off_z = (highest - on) / on_sd, (lowest - off) / off_sd
    on_left, on_density = above(on_z)
    off_left, off_density = above(off_z)
    share /= max(on_left * off_left, 1e-3)  # no threshold is below where the change begins
    if not first and comparator.blind > 0.0:  # what has been crossed meanwhile fires at once
        now = output[k] + x * (output[k + 1] - output[k]) - level - left
        on_z, off_z = (now - on) / on_sd, (-now - off) / off_sd
        on_left, on_density = above(on_z)
        off_left, off_density = above(off_z)
        highest, lowest = max(now, on_zone), max(-now, off_zone)
        for polarity in range(2):
            at_once, before = (1.0 - on_left, on_before) if polarity == 0 else (1.0 - off_left, off_before)
            if at_once > 0.0:
                _fire(
                    shared, comparator, events, twice, waiting, polarity, j, k, share * at_once, x, 0.0, own_bin,
                    before, on_before, off_before,
                )  # fmt: skip
    while k < n:
        after_quiet = _quiet_until(shared, k, n, level, abs(left), highest, lowest) if x == 0.0 else k
        if after_quiet > k:
            left *= math.exp(-comparator.rate * (shared.place[after_quiet] - shared.place[k]))
            k = after_quiet
            if k >= n:
                return
            now = output[k] - level - left
            continue
        if left != 0.0:
            width = shared.place[k + 1] - shared.place[k]
            left = left * math.exp(-comparator.rate * (1.0 - x) * width) if abs(left) > FADED * on_sd else 0.0
        after = output[k + 1] - level - left
        if after > highest:
            z = (after - on) / on_sd
            survivors, density = above(z)
            if survivors < on_left:
                _crossed(
                    shared, comparator, events, twice, waiting, 0, j, k, x, now, after, share * off_left,
                    on_left - survivors, on, on_sd, on_z, z, on_density, density, own_bin, on_before, on_before,
                    off_before,
                )  # fmt: skip
            highest, on_z, on_left, on_density = after, z, survivors, density
        elif -after > lowest:
            z = (-after - off) / off_sd
            survivors, density = above(z)
            if survivors < off_left:
                _crossed(
                    shared, comparator, events, twice, waiting, 1, j, k, x, -now, -after, share * on_left,
                    off_left - survivors, off, off_sd, off_z, z, off_density, density, own_bin, off_before, on_before,
                    off_before,
                )  # fmt: skip
            lowest, off_z, off_left, off_density = -after, z, survivors, density
        if on_left == 0.0 or off_left == 0.0:
            return
        k, x, now = k + 1, 0.0, after


@njit(inline="always")  # a call would copy the signals: a third of the time
def _crossed(
    shared, comparator, events, twice, waiting, polarity, j, k, x, now, after, share, mass, threshold, sd, a, b, pa, pb,
    own_bin, before, on_before, off_before,
):  # fmt: skip
    """Events of the `mass` of thresholds a to b standard deviations off, with densities pa and pb there.

    The change goes straight from `now` at the place x of step k to `after`.
    """
    if mass > 1e-8:  # of less the table does not show the mean
        mean = (pa - pb) / mass
        spread = max(1.0 + (max(a, -REACH) * pa - min(b, REACH) * pb) / mass - mean * mean, 0.0)
    else:
        mean, spread = 0.5 * (max(a, -REACH) + min(b, REACH)), 0.0
    speed = (after - now) / (1.0 - x)
    at = min(max(x + (threshold + sd * mean - now) / speed, x), 1.0)
    _fire(
        shared, comparator, events, twice, waiting, polarity, j, k, share * mass, at, spread * (sd / speed) ** 2,
        own_bin, before, on_before, off_before,
    )  # fmt: skip


@njit(inline="always")  # a call would copy the signals: a third of the time
def _fire(
    shared, comparator, events, twice, waiting, polarity, j, k, fired, at, variance, own_bin, before, on_before,
    off_before,
):  # fmt: skip
    """Count `fired` pixels at the place `at` of step k; release them a dead time later, not before step j."""
    events[polarity, k] += fired
    width = shared.place[k + 1] - shared.place[k]
    time = shared.place[k] + at * width
    this_bin = int(shared.place[k])
    same = this_bin == own_bin
    if same:
        twice[polarity, this_bin] += 2.0 * fired * before
    release = time + comparator.dead
    if release >= len(shared.first) - 1:
        return
    m, x = _step_of(shared.first, release)
    # Shared between the two steps whose middles are nearest, so that expectations are smooth in every parameter.
    other = m + 1 if x > 0.5 else m - 1
    part = abs(x - 0.5)
    on_before = (on_before if same else 0.0) + (1.0 if polarity == 0 else 0.0)
    off_before = (off_before if same else 0.0) + (1.0 if polarity == 1 else 0.0)
    chain = polarity if waiting.shape[0] == 2 else 0
    for step, weight in ((m, 1.0 - part), (other, part)):
        step = max(step, j)
        if step >= waiting.shape[1] - 1:
            continue
        own = shared.place[step + 1] - shared.place[step]
        x = (release - shared.place[step]) / own
        cell, mass = waiting[chain, step], weight * fired
        cell[0] += mass
        cell[1] += mass * x
        cell[2] += mass * (x * x + variance * (width / own) ** 2)
        cell[3] += mass * on_before
        cell[4] += mass * off_before
