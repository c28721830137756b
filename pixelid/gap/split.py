"""Lock: which pixels fit, which select, which confirm, decided by a seed before anything is looked at.

Pixels are the exchangeable unit: events of one pixel share its thresholds.  Five of twelve fit the
candidates, a quarter judges between them, and the last third is not touched until the verdict is in.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pixelid.errors import InputError
from pixelid.recordings.recording import Recording

MIN_PIXELS = 8  # below which nothing can be set aside: parts of three, two and three


@dataclass(frozen=True)
class Split:
    """Pixels by flat index, per sensor size shared by all recordings.

    fit, select, confirm: (k,) pixel indices;  apart: whether the three differ (False: too few pixels, all in each)
    """

    fit: np.ndarray
    select: np.ndarray
    confirm: np.ndarray
    apart: bool

    def without(self, pixels: np.ndarray) -> Split:
        """The split when some pixels are set aside for good."""
        fit, select, confirm = (np.setdiff1d(part, pixels) for part in (self.fit, self.select, self.confirm))
        return Split(fit, select, confirm, self.apart)

    @property
    def everyone(self) -> np.ndarray:
        """All pixels of the split."""
        return np.union1d(self.train, self.confirm)

    @property
    def train(self) -> np.ndarray:
        """Everything that may be looked at before confirmation."""
        return np.union1d(self.fit, self.select)


def split_pixels(recordings: Sequence[Recording], seed: int) -> Split:
    """The split of the pixels that have events.

    Raises InputError when the recordings come from sensors of different size, or hold no events.
    """
    sizes = {(r.sensor, r.events.width, r.events.height) for r in recordings}
    if len(sizes) > 1:
        raise InputError("the recordings come from different sensors; look for the gap of one sensor at a time")
    pixels = np.unique(np.concatenate([r.events.pixel for r in recordings]))
    if len(pixels) == 0:
        raise InputError("the recordings hold no events")
    if len(pixels) < MIN_PIXELS:
        return Split(pixels, pixels, pixels, False)
    order = np.random.default_rng(seed).permutation(pixels)
    last = -(-len(order) // 3)
    first = len(order) - last - len(order) // 4
    return Split(np.sort(order[:first]), np.sort(order[first:-last]), np.sort(order[-last:]), True)
