"""Where the light's time zero lies on the camera's clock, from the events themselves.

Between two events of a pixel the differencing amplifier sees the filtered log radiance Y change
by about one threshold: Y(t_k − o) − Y(t_(k−1) − o) = ±C.  First the signed events per bin are correlated with d ln L/dt
over all offsets; then each distinct candidate is refined by least squares on those changes, with the rate error,
a filter whose bandwidth follows the light, dead time and both thresholds free.  The filter takes up what the pixel
delays, so the offset is the clock's own, as far as such a filter describes the pixel; a fit of the circuit then keeps a
delay free (`delay_s`).

Errors are those of a least-squares estimate whose residuals are correlated within blocks of time (sandwich covariance,
Liang & Zeger 1986, Biometrika 73, 13).  Two candidates are as good as each other when the difference of their squared
residuals is within DISTINCT standard errors, over the same blocks: a periodic light repeats itself, and no offset can
be told from the next.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from scipy.optimize import least_squares
from scipy.signal import find_peaks

from pixelid.errors import InputError
from pixelid.recordings.clocks import CRYSTAL, Alignment, ClockPrior
from pixelid.recordings.recording import Recording
from pixelid.statistics import SD_PER_MEDIAN, Z95
from pixelid.stimuli.pixel_lights import Light, pixel_lights
from pixelid.stimuli.stimulus import Stimulus

MOST_BINS = 1 << 21  # of the correlation, 16 MiB a transform
MOST_CHANGES = 40_000  # events of the refinement: seconds of work; errors of microseconds
COMPARED = 6_000  # events by which candidates are compared
CANDIDATES = 6  # peaks of the correlation that are refined
BLOCKS = 24  # of time, whose residuals count as independent
DISTINCT = 4.0  # standard errors by which the best candidate must be better than the next
LEAST_CORRELATION = 6.0  # of the best peak, in units of the correlation's own spread: 1e-9 each, 2e6 offsets tried
RATE_BOUND = 5e-4  # of a clock: crystals are within 1e-4, ceramic resonators within 5e-4
FAST_POLE_S = 1e-5  # lag of a pole too fast for the filter to know (a differencing amplifier's, 16 kHz)
LAG_KNOWN = 0.03  # of the filter's own lag: how well its form describes a pixel; tests/statistical/test_alignment.py
ONE_S = 1e-3  # offsets closer than this are one: the refinement moves freely over it
SOFT = 0.3  # thresholds' units from which a residual counts linearly: noise is some 0.1, missed events are 1
MOST_SAMPLES = 1 << 18  # of the filter
MOST_LIGHTS = 8  # of pixels' own, those with most events: more would tell no other offset
FINER = 4  # samples of the filter per sample of the light: with one, a chirp to 1500 Hz at 50 µs is found 47 µs late
# The loss of a change (see SOFT) is 0.003 to 0.005 where a filter explains the events, 0.45 where it explains nothing;
# searches that end in a wrong place leave 0.04 to 0.45 on average.  A third of the events may be noise.
LARGEST_LOSS = 0.15
# where the refinement starts: ln of stiffness, damping, damping by light and follower rate (1/s² and 1/s, at the
# light's geometric mean), dead time (0.1 ms), ln of the thresholds; fast pixels, and a slow one
STARTS = (
    (np.log(4e8), np.log(4e3), np.log(8e3), np.log(2e4), 0.5, np.log(0.25), np.log(0.25)),
    (np.log(2.5e7), np.log(2e3), np.log(500.0), np.log(2e4), 0.5, np.log(0.25), np.log(0.25)),
    (np.log(1.5e6), np.log(2e3), np.log(30.0), np.log(2e4), 0.5, np.log(0.25), np.log(0.25)),
)


@dataclass(frozen=True)
class _Seen:
    """Light as alignment looks at it.

    lights: (t (n,), log radiance (n,)) of each;  of_pixel: (pixels,) which of them each pixel sees
    """

    lights: tuple[tuple[np.ndarray, np.ndarray], ...]
    of_pixel: np.ndarray


def _seen(recording: Recording, light: Light) -> tuple[Recording, _Seen]:
    """The light (of pixels' own the `MOST_LIGHTS` with most events), and the recording of the pixels that see it.

    Raises:
        InputError: where the light is constant.
    """
    grouped = pixel_lights(light, recording.events.pixel)
    size = recording.events.width * recording.events.height
    if grouped is None:
        assert isinstance(light, Stimulus)
        lights, of_pixel = [light], np.zeros(size, np.int64)
    else:
        if grouped.of_pixel.size != size:
            raise InputError(
                f"{recording.name}: expected light of {recording.events.width} x {recording.events.height} pixels, "
                f"found {grouped.size[0]} x {grouped.size[1]}"
            )
        which = grouped.of_pixels(recording.events.pixel)
        chosen = np.argsort(-np.bincount(which, minlength=len(grouped.lights)), kind="stable")[:MOST_LIGHTS]
        place = np.full(len(grouped.lights) + 1, -1)  # the last: of pixels without light
        place[chosen] = np.arange(len(chosen))
        lights, of_pixel = [grouped.lights[k] for k in chosen], place[grouped.of_pixel.ravel()]
        recording = replace(recording, events=recording.events.select(of_pixel[recording.events.pixel] >= 0))
    highest = max(float(one.radiance.max()) for one in lights)
    logs = tuple((one.t, np.log(np.maximum(one.radiance.astype(np.float64), 1e-6 * highest))) for one in lights)
    if max(float(np.ptp(log)) for _, log in logs) < 1e-3:
        raise InputError("--align auto: the light is constant; nothing in it can be found among the events")
    return recording, _Seen(logs, of_pixel)


def alignment_from_events(recording: Recording, light: Light) -> Alignment:
    """Where the light's time zero lies on the camera's clock, from events against changes of the light.

    Raises:
        InputError: constant light, too few events, no offset that they follow, and two as good as each other.
    """
    recording, seen = _seen(recording, light)
    changes = _changes(recording, seen.of_pixel, MOST_CHANGES)
    if len(changes.time) < 50:
        raise InputError(f"{recording.name}: --align auto: expected at least 50 events that follow one of their pixel")
    offsets = _candidates(recording, seen)
    few = _changes(recording, seen.of_pixel, COMPARED)
    fits = sorted((_refined(few, seen.lights, offset) for offset in offsets), key=lambda fit: fit.cost)
    best = fits[0]
    if best.cost > LARGEST_LOSS * len(few.time):
        raise InputError(
            f"{recording.name}: --align auto: the events do not follow this light closely enough at any offset to say "
            "where it starts; give --align SECONDS, or record a trigger"
        )
    for other in fits[1:]:
        if abs(other.offset - best.offset) < ONE_S:
            continue
        apart = other.by_block - best.by_block
        error = float(np.std(apart, ddof=1) * np.sqrt(len(apart)))
        if apart.sum() < DISTINCT * error:
            where = f"{best.offset:.6f} or at {other.offset:.6f} s of the camera's clock"
            raise InputError(
                f"{recording.name}: --align auto: the light may start at {where}, and the events cannot say which; "
                "give --align SECONDS, or record a trigger"
            )
    if len(changes.time) > len(few.time):
        best = _refined(changes, seen.lights, best.offset, best)
    half = Z95 * np.sqrt(np.maximum(np.diag(best.covariance), 0.0))
    at_start = np.array([1.0, light.start_s])
    return Alignment(
        best.offset,
        "auto",
        (best.offset - float(half[0]), best.offset + float(half[0])),
        best.rate,
        (best.rate - float(half[1]), best.rate + float(half[1])),
        ClockPrior(0.5 * (light.start_s + light.end_s), light.duration_s, None, 0.0, CRYSTAL),
        start_half_s=Z95 * float(np.sqrt(max(at_start @ best.covariance @ at_start, 0.0))),
    )


@dataclass(frozen=True)
class _Changes:
    """Intervals between events of one pixel: begin and end (s, from `origin`), sign of the event at the end, and which
    light the pixel sees."""

    begin: np.ndarray
    time: np.ndarray
    sign: np.ndarray
    light: np.ndarray
    origin: float


def _changes(recording: Recording, light_of_pixel: np.ndarray, most: int) -> _Changes:
    """Intervals of as many pixels, chosen evenly over the sensor, as hold about `most` events."""
    events = recording.events
    pixel = events.pixel
    every = max(1, round(len(events) / most))
    if every > 1:
        present = np.unique(pixel)
        if len(present) >= 4 * every:
            keep = np.isin(pixel, present[::every])
            events, pixel = events.select(keep), pixel[keep]
        else:  # few pixels with many events each: whole stretches of time, spread over the recording
            part = (np.arange(len(events)) * 64 // len(events)) % every == 0
            events, pixel = events.select(part), pixel[part]
    order = np.lexsort((events.t, pixel))
    t, pixel, p = events.t[order], pixel[order], events.p[order]
    origin = int(recording.events.t[0])
    seconds = (t - origin) * 1e-9
    same = pixel[1:] == pixel[:-1]
    sign = np.where(p[1:] == 1, 1.0, -1.0)
    light = light_of_pixel[pixel[1:][same]]
    return _Changes(seconds[:-1][same], seconds[1:][same], sign[same], light, origin * 1e-9)


def _candidates(recording: Recording, light: _Seen) -> list[float]:
    """Offsets (s, camera's clock) at which signed events and d ln L/dt correlate best, distinct ones."""
    events, t = recording.events, light.lights[0][0]
    origin = events.t[0] * 1e-9
    lasting = events.duration_s + float(t[-1] - t[0])
    width = max(lasting / MOST_BINS, 1e-4)
    bins = int(events.duration_s / width) + 1
    index = ((events.t - events.t[0]) * 1e-9 / width).astype(np.int64)
    sign, seen_by = np.where(events.p == 1, 1.0, -1.0), light.of_pixel[events.pixel]
    n = int((t[-1] - t[0]) / width) + 1
    size = 1 << int(np.ceil(np.log2(bins + n)))
    correlation, length = np.zeros(size), 1.0
    for k, (when, log_light) in enumerate(light.lights):
        counts = np.bincount(index, np.where(seen_by == k, sign, 0.0), bins)
        change = np.diff(np.interp(t[0] + width * np.arange(n + 1), when, log_light))
        counts, change = counts - counts.mean(), change - change.mean()
        spectra = [np.fft.rfft(series, size) for series in (counts, change)]
        correlation += np.fft.irfft(spectra[0] * np.conj(spectra[1]), size)
        length = max(length, _correlation_length(change))
    lags = np.arange(size)
    lags[lags >= bins] -= size  # negative: the light began before the first event
    spread = SD_PER_MEDIAN * float(np.median(np.abs(correlation - np.median(correlation)))) + 1e-300
    order = np.argsort(lags)
    heights = correlation[order]
    peaks, _ = find_peaks(np.concatenate([[-np.inf], heights, [-np.inf]]))
    peaks -= 1
    peaks = peaks[np.argsort(heights[peaks])[::-1][: 20 * CANDIDATES]]
    if not len(peaks) or heights[peaks[0]] < LEAST_CORRELATION * spread:
        raise InputError(f"{recording.name}: --align auto: the events do not follow this light at any offset")
    apart = max(1, round(length))
    kept: list[int] = []
    for peak in peaks:
        if all(abs(peak - other) > apart for other in kept) and heights[peak] > 0.3 * heights[peaks[0]]:
            kept.append(int(peak))
    return [float(origin + width * lags[order][peak] - t[0]) for peak in kept[:CANDIDATES]]


def _correlation_length(change: np.ndarray) -> float:
    """Bins over which the light's change stays like itself (half height of its autocorrelation)."""
    spectrum = np.abs(np.fft.rfft(change, 2 * len(change))) ** 2
    own = np.fft.irfft(spectrum)
    below = np.flatnonzero(own < 0.5 * own[0])
    return float(below[0]) if len(below) else 1.0


@dataclass(frozen=True)
class _Fit:
    """offset s, rate error; covariance (2, 2) of both; cost: sum of squared residuals, by_block its parts;
    x: (9,) all parameters, as `_refined` scales them"""

    offset: float
    rate: float
    covariance: np.ndarray
    cost: float
    by_block: np.ndarray
    x: np.ndarray


def _refined(
    changes: _Changes, lights: Sequence[tuple[np.ndarray, np.ndarray]], offset: float, start: _Fit | None = None
) -> _Fit:
    """Least squares on changes between events: offset, rate error, filter, dead time and two thresholds."""
    t = lights[0][0]
    duration = float(t[-1] - t[0])
    fine = max(min(float(np.median(np.diff(when))) for when, _ in lights) / FINER, duration / MOST_SAMPLES)
    grid = t[0] + fine * np.arange(int(duration / fine) + 2)
    u = np.array([np.interp(grid, when, log_light) for when, log_light in lights])
    relative = np.exp(u - u.mean())
    members = [slice(None)] if len(lights) == 1 else [np.flatnonzero(changes.light == k) for k in range(len(lights))]
    begin = offset - changes.origin
    middle = 0.5 * float(changes.time.min() + changes.time.max())
    on = changes.sign > 0
    y = np.empty_like(u)
    latest = np.full(4, np.nan)

    def residuals(x: np.ndarray) -> np.ndarray:
        shift, rate, dead, thresholds = 1e-3 * x[0], RATE_BOUND * x[1], 1e-4 * x[6], np.exp(x[7:9])
        if not np.array_equal(x[2:6], latest):
            for k in range(len(u)):
                _filter(u[k], relative[k], fine, *np.exp(x[2:6]), y[k])
            latest[:] = x[2:6]

        def seen(when: np.ndarray) -> np.ndarray:
            place, out = when - begin - shift - rate * (when - middle), np.empty(len(when))
            for mine, filtered in zip(members, y, strict=True):
                out[mine] = np.interp(place[mine], grid, filtered)
            return out

        return (seen(changes.time) - seen(changes.begin + dead)) / np.where(on, *thresholds) - changes.sign

    def jacobian_at(x: np.ndarray) -> np.ndarray:
        return _jacobian(residuals, x, 1e-3)

    shortest = max(float(np.quantile(changes.time - changes.begin, 1e-3)), 1e-6)
    lower = np.array([-20.0, -1.0, *np.log([1e2, 1e1, 1e-1, 1e2]), 0.0, *np.log([0.01, 0.01])])
    upper = np.array([20.0, 1.0, *np.log([1e11, 1e6, 1e6, 1e6]), 1e4 * shortest + 1e-3, *np.log([3.0, 3.0])])
    best = None
    # Correlation has found when events come, which is later than the light by the filter's lag.
    begun = [(-1e3 * _lag(x), 0.0, *x) for x in STARTS] if start is None else [(0.0, *start.x[1:])]
    for x0 in begun:
        x0 = np.clip(np.asarray(x0), lower + 1e-6, upper - 1e-6)
        fit = least_squares(
            residuals,
            x0,
            jac=jacobian_at,  # pyright: ignore[reportArgumentType]
            bounds=(lower, upper),
            loss="soft_l1",
            f_scale=SOFT,
            x_scale="jac",
            max_nfev=40,
        )
        best = fit if best is None or fit.cost < best.cost else best
    assert best is not None
    x = best.x
    r, jacobian = residuals(x), jacobian_at(x)
    weight = 1.0 / np.sqrt(1.0 + (r / SOFT) ** 2)  # of soft_l1
    block = np.minimum((BLOCKS * (changes.time - changes.time.min()) / np.ptp(changes.time)).astype(int), BLOCKS - 1)
    scores = np.zeros((BLOCKS, len(x)))
    np.add.at(scores, block, jacobian * (weight * r)[:, None])
    free = (x > lower + 1e-5) & (x < upper - 1e-5)  # what sits on a bound does not move
    bread = np.zeros((len(x), len(x)))
    bread[np.ix_(free, free)] = np.linalg.pinv((jacobian.T @ (jacobian * weight[:, None]))[np.ix_(free, free)])
    units = np.array([1e-3, RATE_BOUND])
    covariance = (bread @ (scores.T @ scores) @ bread)[:2, :2] * np.outer(units, units)
    # light time τ of an event at `when`: τ = (1 − rate) when − begin − shift + rate · middle
    rate = RATE_BOUND * float(x[1])
    zero = (begin + 1e-3 * float(x[0]) - rate * middle) / (1.0 - rate)
    unknown = FAST_POLE_S**2 + (LAG_KNOWN * _lag(x[2:])) ** 2  # of the lag; it may differ as much between begin and end
    covariance += np.diag([unknown, unknown / np.ptp(changes.time) ** 2])  # at the middle of the events
    turn = np.array([[1.0, zero - middle], [0.0, 1.0]])  # to the light's time zero, which may be far away
    covariance = turn @ covariance @ turn.T
    estimate = np.array([changes.origin + zero, 1.0 / (1.0 - rate) - 1.0])
    gain = covariance[:, 1] / (covariance[1, 1] + CRYSTAL**2)  # what is known of clocks beforehand
    estimate -= gain * estimate[1]
    covariance -= np.outer(gain, covariance[1])
    loss = 2.0 * SOFT**2 * (np.sqrt(1.0 + (r / SOFT) ** 2) - 1.0)
    return _Fit(
        offset=float(estimate[0]),
        rate=float(estimate[1]),
        covariance=covariance,
        cost=float(loss.sum()),
        by_block=np.bincount(block, loss, BLOCKS),
        x=x,
    )


def _lag(x) -> float:
    """Seconds by which a filter (its part of a start) delays slow changes."""
    return float((np.exp(x[1]) + np.exp(x[2])) / np.exp(x[0]) + np.exp(-x[3]))


@njit(cache=True)
def _filter(u, relative, step, stiffness, damping, damping_of_light, follower, out):
    """Fill `out` with u behind a second-order low-pass whose rates follow the light, and a first-order one.

    y'' + (damping + damping_of_light · relative) y' + stiffness · relative (y − u) = 0 by the implicit trapezoid, which
    is stable at any step and of second order; at rest at the first sample.
    """
    y, v, s = u[0], 0.0, u[0]
    keep = np.exp(-follower * step)
    half = 0.5 * step
    out[0] = s
    for k in range(1, len(u)):
        light = 0.5 * (relative[k - 1] + relative[k])
        a, b = stiffness * light, damping + damping_of_light * light
        target = 0.5 * (u[k - 1] + u[k])
        # v1 = v − step (b (v + v1)/2 + a ((y + y1)/2 − target)),  y1 = y + step (v + v1)/2
        v1 = (v * (1.0 - half * b - half * half * a) - step * a * (y - target)) / (1.0 + half * b + half * half * a)
        y1 = y + half * (v + v1)
        s = 0.5 * (y + y1) + (s - 0.5 * (y + y1)) * keep
        y, v = y1, v1
        out[k] = s


def _jacobian(function, x: np.ndarray, step: float) -> np.ndarray:
    columns = []
    for k in range(len(x)):
        move = np.zeros(len(x))
        move[k] = step
        columns.append((function(x + move) - function(x - move)) / (2.0 * step))
    return np.stack(columns, axis=1)
