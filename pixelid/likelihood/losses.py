"""What lost events make of the density: the change since the last event that was *recorded* holds two thresholds.

Each event is lost with probability f.  With probability 1 − f none was lost since the last recorded one and the density
is the usual one.  Else k were, with probability (1 − f) f^k: j of the polarity p of the event at hand and i = k − j of
the other, p'.  Their thresholds, and what the light did in the dead times after them, add to the level z, which has the
density

    r · N(z; (j + 1) C_p − i C_p' + k r T, (j + 1) s² + i s'² + (k r T)²)

with rate r, dead time T (in which the rate may have been another), and s the scatter of a threshold drawn.  How likely
each j is follows from how often neighbours among the recorded events are of opposite polarity, as in a Markov chain.
Up to `MOST_IN_A_ROW` are told apart from background; where j = i the event looks like any other.

Whether any was lost is decided by the larger density, as for background events: those are the events that can have had
a lost one before them, and what else they may be competes with it.  The survivals get f for the chance that a crossing
is missing; an event after a lost one needs no survival.
Only f itself is fitted to these events: they say nothing of thresholds or dynamics.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from pixelid.likelihood.layout import Layout

BACKGROUND_HZ = 1e-3  # of events that no circuit explains, per polarity of a pixel
MOST_IN_A_ROW = 4  # lost events that are told apart from one background event
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
    times = np.arange(1, MOST_IN_A_ROW + 1)
    shares = np.where(times < MOST_IN_A_ROW, 1.0 - fraction, 1.0) * fraction ** (times - 1)
    thresholds = group.mean[own], group.mean[own ^ 1], spread[own], spread[own ^ 1]
    many = shares[:, None] * np.array([_after_lost(int(lost), layout.turns, z, waited, *thresholds) for lost in times])
    opposite = layout.group ^ 1
    margin = (group.mean[opposite] - event.reached) / np.sqrt(spread[opposite])
    reached, missed = np.where(event.reached > 0.0, ndtr(-margin), 0.0), MISSED + fraction
    survival = 1.0 - (1.0 - missed) * reached
    mixed = many.sum(axis=0)
    ratio = fraction * rate * mixed / (BACKGROUND_HZ * survival[k])
    gain = np.where(background, 0.0, np.log1p(-fraction))
    after = np.zeros(layout.events)
    gain[k], after[k] = np.log1p(ratio), ratio / (1.0 + ratio)
    usual = float((~background).sum())
    unfinished = np.exp(end)
    of_times = many / np.maximum(mixed, 1e-300) * after[k]
    lost, ended = float((times[:, None] * of_times).sum()), usual + float(of_times[:-1].sum())
    slope = lost / fraction - ended / (1.0 - fraction) + float(((1.0 - after) * reached / survival).sum())
    slope += float(((1.0 - unfinished) / ((1.0 - missed) * unfinished)).sum())
    return Losses(fraction, gain, after, slope, lost / fraction**2 + ended / (1.0 - fraction) ** 2)


def _after_lost(lost: int, turns: float, z, waited, mean, other_mean, spread, other_spread) -> np.ndarray:
    """(k,) density of the levels z of events that this many lost ones came before."""
    total = np.zeros_like(z)
    for alike, chance in enumerate(_alike(lost, turns)):
        others = lost - alike
        if alike == others:
            continue  # their thresholds cancel: such an event looks like any other
        away = z - (alike + 1) * mean + others * other_mean - lost * waited
        variance = (alike + 1) * spread + others * other_spread + (lost * waited) ** 2  # the rate was another one then
        total += chance * _normal(away, variance)
    return total


def _alike(lost: int, turns: float) -> np.ndarray:
    """(lost + 1,) chance that so many of the lost events are of the polarity of the one at hand.

    turns: chance that neighbours are of opposite polarity
    """
    now, against = np.zeros(lost + 1), np.zeros(lost + 1)  # the one looked at last: of that polarity, or of the other
    now[0] = 1.0
    for _ in range(lost):
        same, other = (1.0 - turns) * now + turns * against, turns * now + (1.0 - turns) * against
        now, against = np.append(0.0, same[:-1]), other
    return now + against


def _normal(away: np.ndarray, variance: np.ndarray) -> np.ndarray:
    return np.exp(-0.5 * away**2 / variance) / np.sqrt(2.0 * np.pi * variance)
