"""What lost events make of the density: the change since the last event that was *recorded* holds two thresholds.

Each event is lost with probability f.  With probability 1 − f none was lost since the last recorded one and the density
is the usual one.  Else, nearly always, one was, of the polarity of the event at hand or of the other (half each): its
threshold, and what the light did in the dead time after it, add to the level,

    f/2 · r · [ N(z; 2 C_p + r T, 2 s² + (r T)²)  +  N(z; C_p − C_p' + r T, s² + s'² + (r T)²) ]

with rate r, dead time T (in which the rate may have been another), and s the scatter of a threshold drawn.  Which of
the two it was is decided by the larger density, as for background events: those are the events that can have had a lost
one before them, and what else they may be competes with it.  Two lost in a row are rarer than f² and count as
background.  The survivals get f for the chance that a crossing is missing; an event after a lost one needs no survival.
Only f itself is fitted to these events: they say nothing of thresholds or dynamics.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from pixelid.likelihood.layout import Layout

BACKGROUND_HZ = 1e-3  # of events that no circuit explains, per polarity of a pixel
MISSED = 1e-6  # chance that a crossing has no event, whatever the circuit


@dataclass(frozen=True)
class Losses:
    """What a share `fraction` of lost events adds.

    gain: (n,) to the log-likelihood of each event
    after: (n,) chance that an event came after a lost one
    slope, information: first derivative of the log-likelihood by the fraction, and what its second expects
    """

    fraction: float
    gain: np.ndarray
    after: np.ndarray
    slope: float
    information: float


def losses_of(layout: Layout, fraction: float, dead_s: float, numbers, event, background, group, end) -> Losses:
    """The losses of a layout's events.

    Args:
        layout: Of n events in g groups.
        fraction: Of the events that are lost, f.
        dead_s: After each of them.
        numbers, event, background, group, end: What `density_forward.forward` took and filled.
    """
    k = np.flatnonzero(background & (event.level != 0.0))  # a level of 0: the circuit cannot have fired
    own, z, rate = layout.group[k], event.level[k], event.rate[k]
    spread = (numbers.noise * group.mean) ** 2 + group.variance
    waited = rate * dead_s
    scatter = waited**2  # the rate was another one then
    one = _normal(z - 2.0 * group.mean[own] - waited, 2.0 * spread[own] + scatter)
    other = _normal(z - group.mean[own] + group.mean[own ^ 1] - waited, spread[own] + spread[own ^ 1] + scatter)
    opposite = layout.group ^ 1
    margin = (group.mean[opposite] - event.reached) / np.sqrt(spread[opposite])
    reached, missed = np.where(event.reached > 0.0, ndtr(-margin), 0.0), MISSED + fraction
    survival = 1.0 - (1.0 - missed) * reached
    ratio = fraction * 0.5 * rate * (one + other) / (BACKGROUND_HZ * survival[k])
    gain = np.where(background, 0.0, np.log1p(-fraction))
    after = np.zeros(layout.events)
    gain[k], after[k] = np.log1p(ratio), ratio / (1.0 + ratio)
    usual, unusual = float((~background).sum()), float(after.sum())
    unfinished = np.exp(end)
    slope = unusual / fraction - usual / (1.0 - fraction) + float(((1.0 - after) * reached / survival).sum())
    slope += float(((1.0 - unfinished) / ((1.0 - missed) * unfinished)).sum())
    return Losses(fraction, gain, after, slope, unusual / fraction**2 + usual / (1.0 - fraction) ** 2)


def _normal(away: np.ndarray, variance: np.ndarray) -> np.ndarray:
    return np.exp(-0.5 * away**2 / variance) / np.sqrt(2.0 * np.pi * variance)
