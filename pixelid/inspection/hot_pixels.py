"""Hot pixels: those that fire far above both the population and their neighbours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pixelid.recordings.events import Events

ROBUST_SIGMAS = 6.0
OVER_NEIGHBOURS = 5.0
FEWEST_EVENTS = 10
NEIGHBOURHOOD = 5


@dataclass(frozen=True)
class HotPixel:
    """A pixel that fires at `rate_hz`, regardless of what its surroundings do."""

    x: int
    y: int
    rate_hz: float
    events: int


def find_hot_pixels(events: Events) -> list[HotPixel]:
    """Hot pixels, fastest first.

    A pixel is hot when its count exceeds the active pixels' median by 6 robust standard deviations of the log
    count, and 5 times the median of the 5 × 5 pixels about it, each with 6 standard deviations of Poisson noise
    to spare.  The second condition keeps edges and lamps in the scene from counting.
    """
    from scipy.ndimage import median_filter

    if len(events) < FEWEST_EVENTS or events.duration_s <= 0:
        return []
    counts = np.bincount(events.pixel, minlength=events.width * events.height).astype(np.float64)
    active = counts[counts > 0]
    middle = float(np.median(active))
    log = np.log(active)
    spread = 1.4826 * float(np.median(np.abs(log - np.median(log))))
    population = max(middle * np.exp(ROBUST_SIGMAS * min(spread, 1.0)), OVER_NEIGHBOURS * middle)
    image = counts.reshape(events.height, events.width)
    around = OVER_NEIGHBOURS * np.maximum(median_filter(image, NEIGHBOURHOOD, mode="mirror"), counts.mean()).ravel()
    needed = np.maximum(population + 6 * np.sqrt(population), around + 6 * np.sqrt(around))
    hot = np.flatnonzero(counts > np.maximum(needed, FEWEST_EVENTS))
    hot = hot[np.argsort(-counts[hot], kind="stable")]
    return [
        HotPixel(int(k % events.width), int(k // events.width), float(counts[k] / events.duration_s), int(counts[k]))
        for k in hot
    ]
