"""What training may add to a pixel, from nothing: effects with one strength each.

A factor cannot grow from zero, and drift and memory have signs; these are sums.  Leak and parasitic photocurrent enter
the change of every stretch, the dead time where intervals begin, drift and memory the threshold of every event, all
linearly; how much of the last two a stretch counts is the difference of two ways to cut the events (`tilts`).  Of
these the mean over the events is held: what all thresholds have in common is the scale of the scene's contrast, and the
least loss has a small one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

import numpy as np
import torch

from pixelid.nerf.events.intervals import Intervals
from pixelid.stages.circuit import Circuit


class Addition(NamedTuple):
    """One strength.

    field: of `Circuit`;  effect, parameter: names in the library;  step: what training moves it by in a hundred steps
    or so, which is what such an effect typically has;  least: bound below;  of_events: whether it sets the threshold of
    each event;  in_thresholds: whether it counts ON thresholds per second;  searched: whether the search looks for it;
    held: whether the search holds it, since training knows it to first order only;  renewed: whether the search renews
    it until it is at rest
    """

    field: str
    effect: str
    parameter: str
    step: float
    least: float = 0.0
    of_events: bool = False
    in_thresholds: bool = False
    searched: bool = True
    held: bool = False
    renewed: bool = False

    def step_from(self, circuit: Circuit) -> float:
        """The step at a circuit: what it has, where that is more."""
        return max(abs(getattr(circuit, self.field)), self.step)


ADDITIONS = {
    "refractory": Addition("refractory", "refractory_period", "refractory_s", 1e-4, held=True),
    "leak": Addition("leak_hz", "leak", "leak.rate_hz", 5.0, in_thresholds=True, renewed=True),
    "parasitic_photocurrent": Addition(  # radiance in the unit of the views, in which white is about 1
        "leak_hz_per_radiance", "parasitic_photocurrent", "parasitic_photocurrent.rate_hz_per_radiance", 5.0,
        in_thresholds=True, renewed=True,
    ),
    # Hints of a drift go on in one direction, and took one of 0.6/s to 0.86: it is not renewed until it is at rest
    "threshold_drift": Addition(
        "threshold_drift", "threshold_drift", "threshold_drift.per_s", 0.3, -math.inf, of_events=True
    ),
    # Events of one polarity follow each other within edges, where a coarse scene lacks contrast: memory was named in a
    # camera that has none
    "polarity_memory": Addition(
        "polarity_memory", "polarity_memory", "polarity_memory.strength", 0.02, -0.9, of_events=True, searched=False
    ),
}  # fmt: skip


class Tilt(NamedTuple):
    """What a strength does to the thresholds of events, per unit.

    rise, fall: (M,) by how much the counts of every stretch grow, beyond `common` times themselves;  common: relative
    growth of all thresholds, which those of the circuit have to make up for
    """

    rise: np.ndarray
    fall: np.ndarray
    common: float

    def threshold_factor(self, added: float) -> float:
        """What thresholds of the circuit are multiplied by when so much is added to it."""
        return 1.0 / max(1.0 + self.common * added, 0.1)


def threshold_factor(tilts: Mapping[str, Tilt], added: Callable[[str], torch.Tensor]) -> float:
    """What thresholds are multiplied by when `added(name)` is added to every strength that tilts them."""
    return math.prod(tilt.threshold_factor(float(added(name).detach())) for name, tilt in tilts.items())


def tilts(cut: Callable[[Circuit], Intervals], circuit: Circuit, names: Iterable[str]) -> dict[str, Tilt]:
    """What strengths do to the thresholds of events.

    cut: the stretches under a circuit;  names: of `ADDITIONS`; those that set thresholds of events count.  Counts are
    linear in these strengths, so a difference is exact but for rounding.
    """
    asked = set(names)
    found, names = {}, [name for name, addition in ADDITIONS.items() if addition.of_events and name in asked]
    if not names:
        return {}
    at = cut(circuit).stretches
    for name in names:
        field, step = ADDITIONS[name].field, ADDITIONS[name].step
        there = cut(circuit.with_(**{field: getattr(circuit, field) + step})).stretches
        rise, fall = (there.rise - at.rise) / step, (there.fall - at.fall) / step
        common = float((rise.sum() + fall.sum()) / max(at.rise.sum() + at.fall.sum(), 1e-12))
        found[name] = Tilt(rise - common * at.rise, fall - common * at.fall, common)
    return found
