"""What lost events make of the density: the change since the last event that was *recorded* holds two thresholds.

Each event is lost with probability f.  With probability 1 − f none was lost since the last recorded one and the density
is the usual one.  Else k were, with probability (1 − f) f^k: j of the polarity p of the event at hand and i = k − j of
the other, p'.  Their thresholds, and what the light did in the dead times after them, add to the level z, which has the
density

    r · N(z; (j + 1) C_p − i C_p' + (j − i) r T, (j + 1) s² + i s'² + (k r T)²)

with rate r, dead time T (in which the rate may have been another), and s the scatter of a threshold drawn.  How likely
each j is follows from how often neighbours among the recorded events are of opposite polarity, as in a Markov chain.
Where thresholds remember the polarity before, by a share m, z counts in units of that after the last recorded event; it
is the change here, and m (a C_p + b C_p') is added to its mean, a and b from the orders that the chain makes.
Up to `MOST_IN_A_ROW` are distinguished from background; where j = i the event looks like any other, except that the
other polarity's threshold was reached.

Whether any was lost is decided by the larger density, as for background events: those are the events that can have had
a lost one before them, and what else they may be competes with it.  So the survival before an event gets f² for the
chance that a crossing is missing, and that of an unfinished interval f; an event after a lost one needs none.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from pixelid.likelihood.density_forward import spreads_of_others
from pixelid.likelihood.layout import NOTHING, Layout
from pixelid.stages.circuit import Circuit
from pixelid.stages.comparator import memory_factor

BACKGROUND_HZ = 1e-3  # of events that no circuit explains, per polarity of a pixel
# Lost events that are told apart from one background event: of 0.3 lost, one in 15 000 has more before it.
MOST_IN_A_ROW = 8
MISSED = 1e-6  # chance that a crossing has no event, whatever the circuit
TINY = 1e-300  # below any density


def missed_of(fraction: float) -> tuple[float, float]:
    """The chance that a crossing is missing before an event at the usual level, and in an unfinished interval.

    One lost event moves the level of the next.  At the usual level two were lost, of either polarity.
    """
    return MISSED + fraction**2, MISSED + fraction


class Pull(NamedTuple):
    """Derivatives of the gains by what `density_forward.forward` filled; empty arrays where no event is lost.

    by_level, by_rate: (n,);  by_mean, by_spread: (g,) by a group's mean threshold and the variance of those it draws;
    kept: (n,) chance that no lost event came before, which is how much an event's survival counts
    """

    by_level: np.ndarray
    by_rate: np.ndarray
    by_mean: np.ndarray
    by_spread: np.ndarray
    kept: np.ndarray


NO_PULL = Pull(NOTHING, NOTHING, NOTHING, NOTHING, NOTHING)


@dataclass(frozen=True)
class Losses:
    """What a share `fraction` of lost events adds.

    gain: (n,) to the log-likelihood of each event
    after: (n,) chance that an event came after a lost one
    slope, information: first derivative of the log-likelihood by the fraction, and what its second expects
    by_memory, by_dead_time: derivatives of the gains by the share m and by the dead time after lost events, 1/s
    pull: by everything else
    """

    fraction: float
    gain: np.ndarray
    after: np.ndarray
    slope: float
    information: float
    by_memory: float
    by_dead_time: float
    pull: Pull


def losses_of(layout: Layout, circuit: Circuit, numbers, event, background, group, end) -> Losses:
    """The losses of a layout's events.

    Args:
        layout: Of n events in g groups.
        circuit: Which loses a share of them, with the dead time after each and what thresholds remember.
        numbers, event, background, group, end: What `density_forward.forward` took and filled.
    """
    fraction, dead_s, memory = float(circuit.lost), float(circuit.refractory), float(circuit.polarity_memory)
    k = np.flatnonzero(background & (event.level != 0.0))  # a level of 0: the circuit cannot have fired
    before, own = layout.alike[k], layout.group[k]
    factor = memory_factor(memory, before)
    level, rate = factor * event.level[k], factor * event.rate[k]
    spread = (numbers.noise * group.mean) ** 2 + group.variance
    times = np.arange(1, MOST_IN_A_ROW + 1)
    shares = np.where(times < MOST_IN_A_ROW, 1.0 - fraction, 1.0) * fraction ** (times - 1)
    levels = _Levels(
        level,
        rate * dead_s,
        group.mean[own],
        group.mean[own ^ 1],
        spread[own],
        spread[own ^ 1],
        np.full(len(k), memory),
    )
    many, slopes = np.empty((len(times), len(k))), _Levels(*np.zeros((len(_Levels._fields), len(k))))
    for lost, share in zip(times, shares, strict=True):
        many[lost - 1] = _after_lost(_orders(int(lost), layout.turns), share, levels, before, slopes)
    chance, by_missed = _survivals(layout, fraction, event, group, numbers)
    mixed = many.sum(axis=0)
    ratio = fraction * rate * mixed / (BACKGROUND_HZ * chance[k])  # by time: rate and density of the change
    gain = np.where(background, 0.0, np.log1p(-fraction))
    after = np.zeros(layout.events)
    gain[k], after[k] = np.log1p(ratio), ratio / (1.0 + ratio)
    usual = float((~background).sum())
    unfinished, missed = np.exp(end), missed_of(fraction)[1]
    of_times = many / np.maximum(mixed, TINY) * after[k]
    lost, ended = float((times[:, None] * of_times).sum()), usual + float(of_times[:-1].sum())
    slope = lost / fraction - ended / (1.0 - fraction) + float(((1.0 - after) * by_missed / chance).sum())
    slope += float(((1.0 - unfinished) / ((1.0 - missed) * unfinished)).sum())

    by = _Levels(*(after[k] / np.maximum(mixed, TINY) * slope_of_one for slope_of_one in slopes))
    by_level, by_rate = np.zeros((2, layout.events))
    by_rate_here = after[k] / rate + by.waited * dead_s
    by_level[k], by_rate[k] = factor * by.level, factor * by_rate_here
    by_memory = float(by.remembered.sum())
    by_memory += float((before / factor * (by.level * level + by_rate_here * rate)).sum())

    def by_group(of_own: np.ndarray, of_other: np.ndarray) -> np.ndarray:
        return np.bincount(own, of_own, layout.groups) + np.bincount(own ^ 1, of_other, layout.groups)

    pull = Pull(by_level, by_rate, by_group(by.mean, by.other_mean), by_group(by.spread, by.other_spread), 1.0 - after)
    information = lost / fraction**2 + ended / (1.0 - fraction) ** 2
    return Losses(fraction, gain, after, slope, information, by_memory, float(by.waited @ rate), pull)


def _survivals(layout: Layout, fraction: float, event, group, numbers) -> tuple[np.ndarray, np.ndarray]:
    """(n,) chance that the other polarity's threshold was not reached, or its event is missing, and its derivative by
    the share of missing ones."""
    wide = spreads_of_others(layout.alike, layout.group, numbers, layout.light_reset, group)
    reached = np.where(event.reached > 0.0, ndtr((event.reached - group.mean[layout.group ^ 1]) / wide), 0.0)
    return 1.0 - (1.0 - missed_of(fraction)[0]) * reached, 2.0 * fraction * reached


class _Levels(NamedTuple):
    """(k,) levels of events, what light adds in a dead time, mean and variance of both polarities' thresholds, and the
    share of them that an event adds to the next; or derivatives by them.
    """

    level: np.ndarray
    waited: np.ndarray
    mean: np.ndarray
    other_mean: np.ndarray
    spread: np.ndarray
    other_spread: np.ndarray
    remembered: np.ndarray


class _Orders(NamedTuple):
    """(lost + 1,) each, by how many of the lost events were of the polarity of the one at hand: 0, 1, …

    chance: of that many;  first_other: that the first one lost was of the other polarity
    own, other: mean sum of the signs (relative to the event at hand) of those that events of this and of the other
        polarity followed, the last recorded one not counted
    """

    chance: np.ndarray
    first_other: np.ndarray
    own: np.ndarray
    other: np.ndarray


def _after_lost(orders: _Orders, share: float, at: _Levels, before: np.ndarray, slopes: _Levels) -> np.ndarray:
    """(k,) `share` of the density of levels of events that lost ones came before; adds its derivatives.

    before: (k,) sign of the last recorded event, relative to that of the event at hand
    """
    total, lost = np.zeros_like(at.level), len(orders.chance) - 1
    for alike, (chance, first_other, own, other) in enumerate(zip(*orders, strict=True)):
        others = lost - alike  # as many of either: the level is the usual one, but the other threshold was reached
        onwards = alike - others  # light goes on in the dead time after an event as it had come to it
        own, other = own + before * (1.0 - first_other), other + before * first_other
        of_own, of_other = alike + 1 + at.remembered * own, at.remembered * other - others
        away = at.level - of_own * at.mean - of_other * at.other_mean - onwards * at.waited
        more = (lost * at.waited) ** 2  # the rate was another one then
        variance = (alike + 1) * at.spread + others * at.other_spread + more
        density = share * chance * np.exp(-0.5 * away**2 / variance) / np.sqrt(2.0 * np.pi * variance)
        total += density
        by_away, by_variance = -away / variance * density, 0.5 * (away**2 / variance - 1.0) / variance * density
        slopes.level[:] += by_away
        slopes.mean[:] -= of_own * by_away
        slopes.other_mean[:] -= of_other * by_away
        slopes.remembered[:] -= (own * at.mean + other * at.other_mean) * by_away
        slopes.waited[:] += -onwards * by_away + 2.0 * lost**2 * at.waited * by_variance
        slopes.spread[:] += (alike + 1) * by_variance
        slopes.other_spread[:] += others * by_variance
    return total


def _orders(lost: int, turns: float) -> _Orders:
    """What so many lost events may have been, from the event at hand backwards.

    turns: chance that neighbours are of opposite polarity
    """
    alike, against = np.zeros(
        (2, 3, lost + 1)
    )  # where the one looked at last is so: chance, and it times own and other
    alike[0, 0] = 1.0
    own, other = np.array([0.0, 1.0, 0.0])[:, None], np.array([0.0, 0.0, 1.0])[:, None]
    for _ in range(lost):
        after_alike = (1.0 - turns) * (alike + own * alike[0]) + turns * (against + other * against[0])
        after_other = turns * (alike - own * alike[0]) + (1.0 - turns) * (against - other * against[0])
        alike, against = np.concatenate([np.zeros((3, 1)), after_alike[:, :-1]], axis=1), after_other
    chance, sum_own, sum_other = alike + against
    possible = np.maximum(chance, TINY)
    return _Orders(chance, against[0] / possible, sum_own / possible, sum_other / possible)
