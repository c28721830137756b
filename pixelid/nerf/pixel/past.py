"""How long a pixel remembers before every output, and how many samples of that past are needed.

Samples of the past are spread over the memory of the slowest pole (`intervals`), far longer in the dark than in light.
Where light is bright and the camera slow, the image hardly moves while a pixel remembers: samples from before that
show nothing, and those within it show nearly the same.  The light that the scene shows at both ends of a stretch says
how slow the pixel was there, and the speed of the image how finely its past must be sampled.

Where even a bright pixel needs all samples, nothing is asked of the scene, and memory is that of the darkest light.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pixelid.nerf.events.intervals import CHAIN, COVERED, Intervals, own_past, rows_of
from pixelid.nerf.pixel.model import Pixel

BRIGHT = 1.0  # radiance of white, in the unit of the views
# With these, changes of a half-trained scene are nearer to those by 1200 samples than with 30 over the memory of the
# darkest light, or within 0.003 thresholds of them (docs/methods/reconstruction.md, "Samples").
DIMMER = 4.0  # a pixel is taken to have seen that much less light before than at the ends of a stretch
FINE = 0.125  # pixels that the image may move between samples of the past
FEWEST = 2  # of them, where the image does not move


def past_of(
    pixel: Pixel, every: Intervals, starts: np.ndarray, samples: int, darkest: float, crossing_s: float,
    light: Callable[[np.ndarray, np.ndarray], np.ndarray],
) -> tuple[float | np.ndarray, int | np.ndarray]:  # fmt: skip
    """The rates and numbers of past samples with which chains are drawn (`intervals.chains`).

    Args:
        pixel: whose memory it is.
        every: stretches.
        starts: (runs,) where the chains begin, indices into `every.starts`.
        samples: S, the most.
        darkest: least radiance that any pixel sees.
        crossing_s: s in which the image moves by a pixel where it is fastest; 0 where that is not known.
        light: radiance that the scene shows at times (n,) to pixels (n,).

    Returns:
        ω [rad/s] and how many past samples an output places itself: one of each, or (runs, CHAIN) of each.
    """
    slowest, own = pixel.slowest(darkest), own_past(samples)
    if not crossing_s > 0 or _needed(pixel.slowest(BRIGHT / DIMMER), crossing_s) >= own:
        return slowest, own
    rows, of = rows_of(every, starts), every.stretches
    t = np.concatenate([of.begin[rows[:, :1]], of.end[rows]], axis=1)
    seen = light(t.ravel(), np.repeat(of.pixel[rows[:, 0]], CHAIN + 1).astype(np.int64)).reshape(t.shape)
    dimmest = np.maximum(np.minimum(seen[:, :-1], seen[:, 1:]) / DIMMER, darkest)
    rate = pixel.slowest(dimmest)
    return rate, np.minimum(_needed(rate, crossing_s), own).astype(np.int64)


def _needed(rate, crossing_s: float):
    """Samples by which the image moves `FINE` at most, over what a pole of `rate` remembers."""
    return np.maximum(np.ceil(-np.log1p(-COVERED) / (rate * FINE * crossing_s)), FEWEST)
