"""Light of each pixel's own in groups: one trajectory for every light, one comparator for each of its pixels."""

from __future__ import annotations

from concurrent.futures import Executor

import numpy as np

from pixelid.simulate.full_field import FullField, Twins
from pixelid.simulate.laws import Rules
from pixelid.stimuli.pixel_lights import PixelLights


class Grouped:
    """The sensor's pixels, light by light; pixels whose light is not known stay silent."""

    def __init__(self, stimulus: PixelLights, rules: Rules, twins: Twins | None = None) -> None:
        self._stimulus, self._rules, self._twins = stimulus, rules, twins
        self._of_pixel = stimulus.of_pixel.ravel()

    def run(self, pool: Executor):
        """(event lists of lights, the end, that that is all): in one delivery, since steps differ between lights."""
        yield list(pool.map(self._events, np.unique(self._of_pixel[self._of_pixel >= 0]))), self._stimulus.end_s, True

    def _events(self, light: int):
        places = np.flatnonzero(self._of_pixel == light)
        twins = None if self._twins is None else self._twins.only(places)
        pixels = FullField(self._stimulus.lights[light], self._rules, len(places), twins, places)
        return pixels.all_events()
