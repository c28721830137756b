"""What events say about the light, in pieces that a field can follow: quiet intervals, and bursts taken as one.

A sharp edge crosses many thresholds while the image moves by a fraction of a pixel.  Where within the edge each event
falls is beyond a field whose cells are pixels, and losses of single differences are then least when the edge has lost
its contrast: the many events inside are missed either way, and the one long interval after them by less.  So events
with less than `shortest` between them are merged into a burst, whose ends lie half of that away in the quiet before
and after.  Of the quiet interval's own threshold the burst takes what the light moves by in that half at the
interval's mean slope or at the burst's own, whichever is more: next to a flat surface all of it is crossed at the edge.
After its last event an edge goes on until some time before the next one would have come, on average half of it: what of
that is past the dead time is put there, and taken from the interval after if an event of the other polarity follows.
The light's change over a burst is the sum of all that and of what happened within dead times, when the pixel did not
look.

Dead times.  A threshold that took T seconds of looking to reach (less the amplifier's lag after its reset) means a
slope of 1/T thresholds per second.  Through a dead time goes the steeper of the slopes before and after, if both have
one sign: an interval's mean slope says little about its end next to a faster one.  Through the last one of a burst an
edge goes on as above.

A leak moves the level in the quiet, too, but not by its length times the leak: light that changed as well is what kept
a long quiet from ending before.  Where the true light is known, the level before a burst hardly depends on how long a
pixel leaked (0.3 to 0.5 thresholds after 2 to 40 ms at 40 Hz in a textured scene), so the shares do not ask for it;
reckoned with all of the leak, bursts of ON events had 0.1 to 0.3 thresholds too little.

Events that stand alone stay as they are: intervals from the end of a dead time to the next event.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

NOISE = 0.03  # thresholds per event, mismatch and noise together, where no fit says: DVS128 nominal values
INSIDE = 0.3  # thresholds: of a level interpolated between two events
BEYOND = 0.5  # of the time to the next event of an edge that had none: when it ended, no time likelier
# Thresholds that an edge crosses in a dead time at most: a factor of ten in light, at a threshold of a quarter.  An
# interval about as long as the dead time would tell of hundreds, and be the loudest of a recording.
MOST_UNSEEN = 10.0
GUESSED = 0.3  # of what is put into a dead time, as a share of it


class Stretches(NamedTuple):
    """(M,) each, by pixel and time; pixel: int32, and float32 where seven digits do.

    begin, end: s;  pixel: row-major index;  rise, fall: how many nominal ON and OFF thresholds the level crosses in
    between, shares and dead times included;  variance: of that count, thresholds²;  reset: whether it is a single whole
    interval, at whose begin the amplifier was reset;  burst: whether it is a merged burst
    """

    begin: np.ndarray
    end: np.ndarray
    pixel: np.ndarray
    rise: np.ndarray
    fall: np.ndarray
    variance: np.ndarray
    reset: np.ndarray
    burst: np.ndarray


def stretches(
    t, pixel, on, dead: float, lag: float, shortest: float | np.ndarray, noise: float = NOISE,
    size: np.ndarray | None = None,
) -> Stretches:  # fmt: skip
    """Stretches of events sorted by (pixel, time).

    t: (N,) s;  pixel: (N,);  on: (N,) bool;  dead: s;  lag: s, time constant of the amplifier after its reset;
    shortest: s, intervals shorter than that are merged (0: none), or (N,) of those that end with each event;  noise: of
    a threshold, relative;  size: (N,) of each event's threshold, relative to the nominal one (default 1)
    """
    size, shortest = np.ones(1) if size is None else size, np.atleast_1d(shortest)
    columns = t, pixel, on, size, dead, lag, shortest, noise
    n = _cut(*columns, *_columns(0))  # counted first: room for twice the events would take more than they do
    out = _columns(n)
    _cut(*columns, *out)
    return Stretches(*out)


def _columns(n: int) -> tuple[np.ndarray, ...]:
    """Room for n stretches, 34 bytes each."""
    kinds = (np.float64, np.float64, np.int32, np.float32, np.float32, np.float32, np.bool_, np.bool_)
    return tuple(np.empty(n, kind) for kind in kinds)


@njit(inline="always")
def _of(values, i):
    """The value of event i; one number where all are alike."""
    return values[i] if len(values) > 1 else values[0]


@njit(cache=True, nogil=True)
def _looking(t, i, dead, lag):
    """Seconds from the reset before event i to the event, the amplifier's lag taken off."""
    length = max(t[i] - t[i - 1] - dead, 0.0)
    if lag > 0.0:
        length -= lag * (1.0 - np.exp(-length / lag))
    return max(length, dead / MOST_UNSEEN, 1e-7)


@njit(cache=True, nogil=True)
def _moved(t, on, i, dead, lag, away):
    """Thresholds by which the light moves in `away` s at the slope between events i − 1 and i, if that has a sign."""
    return away / _looking(t, i, dead, lag) if on[i] == on[i - 1] else 0.0


@njit(cache=True, nogil=True)
def _beyond(t, i, dead, lag):
    """(within its dead time, after that) thresholds by which an edge goes on after its last event i.

    At the slope before event i, until a time before the next event would have come, none likelier.
    """
    looked = _looking(t, i, dead, lag)
    share = dead / (dead + looked)
    return dead / looked * (1.0 - BEYOND * share), BEYOND * (1.0 - share)


@njit(cache=True, nogil=True)
def _burst(t, on, size, first, k, j, last, dead, lag, noise):
    """(rise, fall, variance) from just after event k to the end of the dead time of event j.

    first, last: events of the pixel
    """
    rise, fall, variance = 0.0, 0.0, 0.0
    for i in range(k, j + 1):
        crossed = _of(size, i) if i > k else 0.0
        same, slope, unseen = i < last and on[i] == on[i + 1], i > first and on[i - 1] == on[i], 0.0
        if same:
            unseen = dead / _looking(t, i + 1, dead, lag)
        if slope and i == j and k < j < last:
            unseen = max(unseen, _beyond(t, i, dead, lag)[0])
        elif slope and same:
            unseen = max(unseen, dead / _looking(t, i, dead, lag))
        if unseen > 0.0:
            unseen *= _of(size, i + 1 if same else i)
            crossed += unseen
            variance += ((GUESSED if same else BEYOND) * unseen) ** 2
        if on[i]:
            rise += crossed
        else:
            fall += crossed
        variance += (_of(size, i) * noise) ** 2
    return rise, fall, variance


@njit(cache=True, nogil=True)
def _cut(
    t, pixel, on, size, dead, lag, shortest, noise, begins, ends, pixels, rises, falls, variances, resets, bursts
):  # fmt: skip
    """Fill the columns of `Stretches` (M,), where they are not empty; how many stretches there are."""
    n, first, fill = 0, 0, len(begins) > 0
    while first < len(t):
        last = first
        while last + 1 < len(t) and pixel[last + 1] == pixel[first]:
            last += 1
        # the burst that begins with event k, how much of its threshold is the burst's, and how long before it begins
        k, before, earlier = first, 0.0, 0.0
        while True:
            j = k
            while j < last and t[j + 1] - t[j] - dead < _of(shortest, j + 1):
                j += 1
            length = t[j + 1] - t[j] - dead if j < last else 0.0  # of the quiet interval after it
            away = 0.5 * _of(shortest, j + 1) if j < last else 0.0
            after, over = 0.0, 0.0  # of its threshold what is the burst's, and how far the burst went beyond its last
            if j > k and j < last:
                after, over = away / length, min(_moved(t, on, j, dead, lag, away), _beyond(t, j, dead, lag)[1])
                if on[j + 1] == on[j]:
                    after, over = max(after, over), 0.0
            if j > k:
                if fill:
                    begins[n] = t[k] - (earlier if before > 0.0 else 0.0)
                    ends[n] = t[j] + dead + away if j < last else t[j]
                    rise, fall, variance = _burst(t, on, size, first, k, j, last, dead, lag, noise)
                    if on[k]:
                        rise += before * _of(size, k)
                    else:
                        fall += before * _of(size, k)
                    if j < last and on[j + 1]:
                        rise += after * _of(size, j + 1)
                    elif j < last:
                        fall += after * _of(size, j + 1)
                    if on[j]:
                        rise += over * _of(size, j)
                    else:
                        fall += over * _of(size, j)
                    variance += ((before > 0.0) + (after > 0.0)) * INSIDE**2
                    pixels[n], rises[n], falls[n], variances[n] = pixel[k], rise, fall, variance
                    resets[n], bursts[n] = False, True
                n += 1
            if j == last:
                break
            ends_at_burst = j + 1 < last and t[j + 2] - t[j + 1] - dead < _of(shortest, j + 2)
            k, before, earlier = j + 1, 0.0, away
            if ends_at_burst:
                before = min(max(away / length, _moved(t, on, k + 1, dead, lag, away)), 1.0 - after + over)
            begin = t[j] + dead + (away if after > 0.0 else 0.0)
            end = t[k] - (away if ends_at_burst else 0.0)
            if end > begin:
                if fill:
                    crossed = (1.0 - before - after) * _of(size, k)
                    whole = before == 0.0 and after == 0.0
                    begins[n], ends[n], pixels[n] = begin, end, pixel[k]
                    rises[n], falls[n] = (crossed, 0.0) if on[k] else (0.0, crossed)
                    if on[j]:
                        rises[n] -= over * _of(size, j)
                    else:
                        falls[n] -= over * _of(size, j)
                    variances[n] = (_of(size, k) * noise) ** 2 + (0.0 if whole else INSIDE**2)
                    resets[n], bursts[n] = whole, False
                n += 1
        first = last + 1
    return n
