"""Where events may follow a light: lights and changes as alignment looks at them, and offsets worth a refinement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.signal import correlate, correlation_lags, find_peaks

from pixelid.errors import InputError
from pixelid.recordings.alignment_filter import (
    DEAD_S,
    STARTS,
    Changes,
    LogLight,
    Refined,
    lag_s,
    refine,
    scan,
    soft_loss,
)
from pixelid.recordings.recording import Recording
from pixelid.stimuli.pixel_lights import Light, pixel_lights
from pixelid.stimuli.stimulus import Stimulus

MOST_BINS = 1 << 21  # of the correlation, 16 MiB a transform
WIDEST_BIN_S = 2e-3  # that leads to the right start: refinements move by as much
MOST_EVENTS = 300_000  # sorted by pixel
MOST_LIGHTS = 8  # of pixels' own, those with most events: more would tell no other offset
LEAST_COMMON = 0.4  # of the best's changes: of two or more periods, a shift by one leaves half
NEAR_S = 2e-3  # offsets closer than this are one, known as badly as they differ


def is_too_long(recording: Recording, light: Light) -> bool:
    """Whether events and light last longer than all offsets between them can be searched in fine enough bins."""
    return recording.events.duration_s + light.duration_s > MOST_BINS * WIDEST_BIN_S


def lights_of(
    recording: Recording, light: Light
) -> tuple[Recording, tuple[tuple[np.ndarray, np.ndarray], ...], np.ndarray]:
    """(recording of the pixels that see one, (t, log radiance) of each light, which of them each pixel sees).

    Of pixels' own lights, the `MOST_LIGHTS` with most events.

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
    return recording, logs, of_pixel


def changes_of(recording: Recording, light_of_pixel: np.ndarray, polarity: int) -> Changes:
    """The intervals between two events of one pixel, sorted by time, of as many pixels as have `MOST_EVENTS`."""
    events = recording.events
    every = 1 + len(events) // MOST_EVENTS
    if every > 1:  # evenly over the sensor
        events = events.select(np.isin(events.pixel, np.unique(events.pixel)[::every]))
    order = np.lexsort((events.t, events.pixel))
    t, pixel, p = events.t[order], events.pixel[order], events.p[order]
    origin = int(events.t[0]) if len(events) else 0
    seconds = (t - origin) * 1e-9
    same = np.flatnonzero(pixel[1:] == pixel[:-1])
    same = same[np.argsort(t[1:][same], kind="stable")]
    sign = np.where(p[1:] == 1, polarity, -polarity).astype(np.float64)
    return Changes(seconds[:-1][same], seconds[1:][same], sign[same], light_of_pixel[pixel[1:][same]], origin * 1e-9)


def stretches(changes: Changes, most: int) -> Changes:
    """About `most` of them, whole stretches of time spread over the recording: neighbours share their residuals."""
    count = len(changes.time)
    every = max(1, round(count / most))
    stretch = np.arange(count) * (64 * every) // max(count, 1)
    return changes if every == 1 else changes.select(stretch % every == 0)


def correlation(recording: Recording, light: Light, polarity: int = 1) -> float:
    """The highest correlation of signed events and changes of the light over all offsets; 0 of constant light."""
    try:
        recording, lights, of_pixel = lights_of(recording, light)
    except InputError:
        return 0.0
    return best_offsets(recording, lights, of_pixel, polarity)[1] if len(recording.events) > 1 else 0.0


def best_offsets(
    recording: Recording, lights: Sequence[tuple[np.ndarray, np.ndarray]], of_pixel: np.ndarray, polarity: int
) -> tuple[np.ndarray, float]:
    """(offsets (s, camera's clock) at which signed events and d ln L/dt correlate best; the highest correlation)."""
    events, t = recording.events, lights[0][0]
    origin = events.t[0] * 1e-9
    lasting = events.duration_s + float(t[-1] - t[0])
    width = max(lasting / MOST_BINS, 1e-4)
    bins = int(events.duration_s / width) + 1
    index = ((events.t - events.t[0]) * 1e-9 / width).astype(np.int64)
    sign, seen_by = np.where(events.p == 1, polarity, -polarity), of_pixel[events.pixel]
    n = int((t[-1] - t[0]) / width) + 1
    heights, length, powers = np.zeros(bins + n - 1), 1.0, np.zeros(2)
    for k, (when, log_light) in enumerate(lights):
        counts = np.bincount(index, np.where(seen_by == k, sign, 0.0), bins)
        change = np.diff(np.interp(t[0] + width * np.arange(n + 1), when, log_light))
        counts, change = counts - counts.mean(), change - change.mean()
        heights += correlate(counts, change, method="fft")
        length = max(length, _correlation_length(change))
        powers += [float(counts @ counts), float(change @ change)]
    peaks, _ = find_peaks(np.concatenate([[-np.inf], heights, [-np.inf]]))
    peaks = peaks[np.argsort(heights[peaks - 1])[::-1]] - 1
    kept: list[int] = []
    candidates = 8  # peaks of the correlation
    for peak in peaks[: 20 * candidates]:
        if all(abs(peak - other) > length for other in kept):
            kept.append(int(peak))
    offsets = origin + width * correlation_lags(bins, n)[kept[:candidates]] - t[0]
    return offsets, float(heights.max() / max(np.sqrt(powers.prod()), 1e-300))


def _correlation_length(change: np.ndarray) -> float:
    """Bins over which the light's change stays like itself (half height of its autocorrelation)."""
    own = correlate(change, change, method="fft")[len(change) - 1 :]
    below = np.flatnonzero(own < 0.5 * own[0])
    return float(below[0]) if len(below) else 1.0


def optima(changes: Changes, light: LogLight, peaks: np.ndarray) -> tuple[list[Refined], np.ndarray]:
    """Refinements from all offsets worth one, and (2, k) lags from the best with their mean loss."""
    begun = _best_starts(changes, light, peaks)
    fits = sorted((refine(changes, light, begin, x, x[2:6], 15) for begin, x in begun), key=lambda fit: fit.cost)
    x = fits[0].x
    start = np.concatenate([[0.0, 0.0], x[2:]])
    offsets, losses = _scanned(changes, light, fits[0])
    lows, _ = find_peaks(-np.where(np.isfinite(losses), losses, 1.0))
    rivals = 5  # offsets compared with the best
    lows = [float(offsets[k]) for k in lows[np.argsort(losses[lows])][: rivals + 1] if offsets[k] != fits[0].zero_s]
    near = [*lows, *(peak - lag_s(x[2:6]) for peak in peaks[:rivals])]
    begins: list[float] = []
    for begin in near:  # not within 0.3 ms of another: each refinement moves freely by as much
        if all(abs(begin - other) > 3e-4 for other in [*begins, *(fit.zero_s for fit in fits)]):
            begins.append(begin)
    fits += [refine(changes, light, begin, start, start[2:6], 12) for begin in begins]
    best = min(fits, key=lambda fit: fit.cost).zero_s
    fits = [
        refine(changes, light, fit.begin_s, fit.x, fit.x[2:6], 30, 1e-6) if abs(fit.zero_s - best) < NEAR_S else fit
        for fit in fits
    ]
    return fits, np.stack([offsets - min(fits, key=lambda fit: fit.cost).zero_s, losses])


def _best_starts(changes: Changes, light: LogLight, peaks: np.ndarray) -> list[tuple[float, np.ndarray]]:
    """The best few (begin, parameters) of candidates × filters × shifts, thresholds by medians."""
    screened = 600  # by which starts are chosen
    few = changes.select(slice(None, None, max(1, len(changes.time) // screened)))
    on = few.sign > 0
    scored = []
    for start, filtered in zip(STARTS, light.filtered(STARTS[:, :4]), strict=True):
        lag = lag_s(start)
        for peak in peaks:
            best = (np.inf, 0.0, start)
            for begin in peak + np.linspace(-1.5 * lag - 1e-3, 1e-3, 24):
                times = few.time - begin, few.begin + DEAD_S * start[4] - begin
                end, first = (light.at(filtered, t, few.light)[0] for t in times)
                moved = few.sign * (end - first)  # towards the event, in e-folds
                x = np.array([*start[:5], *(np.log(max(_typical(moved[mine]), 0.02)) for mine in (on, ~on))])
                cost = float(soft_loss(moved * np.where(on, np.exp(-x[5]), np.exp(-x[6])) - 1.0).mean())
                best = min(best, (cost, begin, x), key=lambda entry: entry[0])
            scored.append(best)
    scored.sort(key=lambda entry: entry[0])
    return [(begin, np.array([0.0, 0.0, *x])) for _, begin, x in scored[:4]]


def _typical(moved: np.ndarray) -> float:
    return float(np.median(moved)) if len(moved) else 0.2


def _scanned(changes: Changes, light: LogLight, fit: Refined) -> tuple[np.ndarray, np.ndarray]:
    """(offsets, mean loss of the changes within the light), infinite where too few are in it."""
    lasting = max(float(changes.time.max()), light.last_s - light.first_s)
    scanned = 6_000  # offsets of the scan: each half a bin of a chirp to 300 Hz over a second
    offsets = fit.zero_s + np.arange(-scanned // 2, scanned // 2) * (2.0 * lasting / scanned)
    few = changes.select(slice(None, None, max(1, len(changes.time) // 800)))
    loss, count = scan(few, light, light.filtered(fit.x[None, 2:6])[0], offsets, fit.x)
    enough = count >= max(LEAST_COMMON * count[scanned // 2], 20)
    return offsets, np.where(enough, loss / np.maximum(count, 1), np.inf)
