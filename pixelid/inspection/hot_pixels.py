"""Hot pixels: those that fire far more than all others, by Poisson's law and with room to spare.

Two kinds of evidence, by what is known of the light.  Over a whole recording a pixel must stand out from the population
*and* from its neighbours, since edges and lamps of a scene fire much too (`hot_of_counts`).  Under full-field light
all pixels see the same, so a pixel that fires ON in stretches where the others are silent is hot, however rarely it
fires (`find_hot_pixels_in_silence`): a few events per second that drown in the response to a chirp show there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pixelid.inspection.timestamps import TimestampSignature
from pixelid.recordings.kept import seconds_looked_at
from pixelid.recordings.recording import Recording
from pixelid.statistics import SD_PER_MEDIAN

ROBUST_SIGMAS = 6.0
OVER_NEIGHBOURS = 5.0
MIN_EVENTS = 10
NEIGHBOURHOOD = 5

STRETCHES = 64  # per recording
MAX_FIRING = 0.2  # share of pixels that may fire in a quiet stretch
MIN_SILENT_EVENTS, MIN_PIXELS = 5, 8
MAX_CHANCE = 1e-9  # of any pixel doing so by accident


@dataclass(frozen=True)
class HotPixel:
    """A pixel that fires at `rate_hz`, regardless of what its surroundings do."""

    x: int
    y: int
    rate_hz: float
    events: int


@dataclass(frozen=True)
class HotInSilence:
    """Pixels that are hot where others are silent.

    Attributes:
        pixels: (k,) flat indices.
        signature: rate, interval, chance and gain of the effect `hot_pixels`.
    """

    pixels: np.ndarray
    signature: TimestampSignature


def median_around(
    image: np.ndarray, kept: np.ndarray | None = None, side: int = NEIGHBOURHOOD, centre: bool = True
) -> np.ndarray:
    """The median of an image about every pixel.

    Args:
        image: (height, width).
        kept: (pixels,) bool, those that have a value; None for all.
        side: of the square; where pixels are missing, as many that are kept, the nearest.
        centre: whether the pixel itself counts.

    Returns:
        (pixels,), 0 for pixels that are not kept.
    """
    if kept is None:
        from scipy.ndimage import median_filter

        footprint = np.ones((side, side), bool)
        footprint[side // 2, side // 2] = centre
        return median_filter(image, footprint=footprint, mode="mirror").ravel()
    from scipy.spatial import KDTree

    there = np.flatnonzero(kept)
    position = np.column_stack(np.divmod(there, image.shape[1]))
    most = min(side * side, len(there))
    _, nearest = KDTree(position).query(position, k=most)
    nearest = nearest.reshape(len(there), most)  # itself first
    values, around = image.ravel()[there], np.zeros(image.size)
    around[there] = np.median(values[nearest if centre or most == 1 else nearest[:, 1:]], axis=1)
    return around


def hot_of_counts(image: np.ndarray, duration_s: float, kept: np.ndarray | None = None) -> list[HotPixel]:
    """Hot pixels of a recording of any scene, fastest first.

    A pixel is hot when its count exceeds the active pixels' median by 6 robust standard deviations of the log
    count, and 5 times the median of the 5 × 5 pixels about it, each with 6 standard deviations of Poisson noise
    to spare.

    Args:
        image: (height, width) events per pixel.
        duration_s: in so many seconds.
        kept: (pixels,) bool; None for all.
    """
    if image.sum() < MIN_EVENTS or duration_s <= 0:
        return []
    width = image.shape[1]
    image = image.astype(np.float64)
    counts = image.ravel()
    active = counts[counts > 0]
    middle = float(np.median(active))
    log = np.log(active)
    spread = SD_PER_MEDIAN * float(np.median(np.abs(log - np.median(log))))
    population = max(middle * np.exp(ROBUST_SIGMAS * min(spread, 1.0)), OVER_NEIGHBOURS * middle)
    hot = np.flatnonzero(counts > max(population + 6 * np.sqrt(population), MIN_EVENTS))
    if len(hot):  # whose neighbours are looked at
        usual = counts.mean() if kept is None else counts[kept].mean()
        around = OVER_NEIGHBOURS * np.maximum(median_around(image, kept)[hot], usual)
        hot = hot[counts[hot] > around + 6 * np.sqrt(around)]
    hot = hot[np.argsort(-counts[hot], kind="stable")]
    return [HotPixel(int(k % width), int(k // width), float(counts[k] / duration_s), int(counts[k])) for k in hot]


def find_hot_pixels_in_silence(recordings: Sequence[Recording]) -> HotInSilence | None:
    """The hot pixels of one sensor's recordings under full-field light.

    Recordings are cut into short stretches; a stretch is quiet when at most a fifth of the pixels fire in it.  What a
    pixel fires in quiet stretches is compared with what the other pixels do there, by Poisson's law.  A pixel of low
    thresholds fires there, too, but OFF as well as ON, as the light comes and goes: that share of its ON events, and no
    more, the light explains.

    Returns:
        None where there are none, or no quiet stretch to see them in.
    """
    from scipy.stats import chi2, poisson

    pixels = np.unique(np.concatenate([r.events.pixel for r in recordings]))
    if len(pixels) < MIN_PIXELS:
        return None
    fired, fired_off, quiet_s = _fired_in_silence(recordings, pixels)
    usual = np.sort(fired)[: max(int(0.8 * len(fired)), 1)]
    expected = (usual.sum() + 1.0) / len(usual)
    events = sum(len(r.events) for r in recordings)
    on = sum(int(np.count_nonzero(r.events.p == 1)) for r in recordings)
    # as many ON events per OFF event as the light makes in all, and what chance may add to so few
    explained = (fired_off + np.sqrt(fired_off)) * on / max(events - on, 1)
    expected = np.maximum(expected, explained)
    chance = len(pixels) * poisson.sf(fired - 1, expected)
    hot = (fired >= MIN_SILENT_EVENTS) & (chance < MAX_CHANCE)
    count, total = int(hot.sum()), float(fired[hot].sum() - hot.sum() * usual.mean())
    if count == 0 or quiet_s <= 0:
        return None
    exposure = count * quiet_s
    interval = (float(chi2.ppf(0.025, 2 * total) / 2 / exposure), float(chi2.ppf(0.975, 2 * total + 2) / 2 / exposure))
    gain = float(np.sum(fired[hot] * np.log(fired[hot] / expected[hot]) - fired[hot] + expected[hot]))
    signature = TimestampSignature(
        effect="hot_pixels",
        parameter="hot_pixels.rate_hz",
        value=total / exposure,
        interval=interval,
        p=float(chance[hot].max()),
        nats_per_event=gain / max(float(fired[hot].sum()), 1.0),
        concerned=float(fired[hot].sum()) / events,
        where=f"{count} of {len(pixels)} pixels fire ON while the others are silent",
    )
    return HotInSilence(pixels[hot], signature)


def quiet_seconds(recordings: Sequence[Recording]) -> float:
    """Seconds of stretches in which at most a fifth of the pixels fire."""
    return _fired_in_silence(recordings, np.unique(np.concatenate([r.events.pixel for r in recordings])))[2]


def _fired_in_silence(recordings: Sequence[Recording], pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """(ON events of each pixel in quiet stretches, OFF events, seconds of them)."""
    fired, fired_off, quiet_s = np.zeros(len(pixels)), np.zeros(len(pixels)), 0.0
    for r in recordings:
        if r.stimulus is None:
            continue
        start, end = seconds_looked_at(r)
        span = max(end - start, 1e-9)
        cell = np.clip(((r.events.t * 1e-9 - start) / span * STRETCHES).astype(np.int64), 0, STRETCHES - 1)
        row = np.searchsorted(pixels, r.events.pixel)
        every = np.bincount(row * STRETCHES + cell, minlength=len(pixels) * STRETCHES).reshape(-1, STRETCHES)
        on = np.bincount(row * STRETCHES + cell, r.events.p == 1, len(pixels) * STRETCHES).reshape(-1, STRETCHES)
        quiet = (every > 0).mean(axis=0) <= MAX_FIRING
        fired += on[:, quiet].sum(axis=1)
        fired_off += (every - on)[:, quiet].sum(axis=1)
        quiet_s += quiet.sum() * span / STRETCHES
    return fired, fired_off, quiet_s
