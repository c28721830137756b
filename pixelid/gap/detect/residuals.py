"""What is left of each event under a model: residuals that are independent standard normal when the model is right.

S_k = P(no event of either polarity up to t_k | the past) is uniform at the event (time rescaling; Brown, Barbieri,
Ventura, Kass & Frank 2002, Neural Computation 14, 325).  For thresholds drawn anew for each event,

    S_k = Φ((M_p − z_k)/s_k) Φ((M_o − m_k)/s_o)         residual e_k = −Φ⁻¹(S_k)

with z_k the level at the event, m_k the extreme that the other polarity had reached, M and s the posterior mean and
spread of the thresholds.  With the other polarity far away, e_k = (z_k − M_p)/s_k: how far beyond its threshold, in
standard deviations, the change was when the event came.  e > 0 late, e < 0 early.

Where a share f of events gets lost, the other polarity's may have been: its factor becomes f + (1 − f) Φ.  (Events
after a lost one of their own polarity are no part of this: `losses.py`.)

An event at the end of a silence (`density_release.py`) came with a chance P all at once: S_k is drawn uniformly between
1 − P and 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr, ndtri_exp

from pixelid.fit.coordinates import Coordinates
from pixelid.likelihood.density_forward import spreads_of_others
from pixelid.likelihood.event_times import EventTimes
from pixelid.likelihood.layout import NOTHING, StackedChanges
from pixelid.likelihood.losses import missed_of
from pixelid.stages.circuit import Circuit

DRAWS = 0  # seed of what is drawn for events at the end of a silence: the same whenever asked
STEP = 1e-4  # of a coordinate's longest move, one-sided difference: a relative error about as large
FAR_SD, SHORTER = 0.1, 0.1  # a level that moves by more in one step is asked with a shorter one
LARGEST = 40.0  # residual: beyond it Φ is 0 in double precision


@dataclass(frozen=True)
class Residuals:
    """e: (n,) residuals, 0 for background events;  log_scale: (n,) log of the spread they are measured in;
    log_rate: (n,) log speed of the change at the event;  background: (n,) events left to the background;
    changes: from which those under circuits close by are derived;  at_release: (n,) events at the end of a silence, or
    empty;  taken: (n,) share of the residual's variance that the posterior mean of its threshold takes;
    apart: (g,) mean level of each pixel's and polarity's events about the population, in standard deviations
    """

    e: np.ndarray
    log_scale: np.ndarray
    log_rate: np.ndarray
    background: np.ndarray
    changes: StackedChanges
    at_release: np.ndarray
    taken: np.ndarray
    apart: np.ndarray

    @property
    def late(self) -> np.ndarray:
        """(n,) s by which each event comes after the model's expectation, to first order."""
        late = np.where(self.background, 0.0, self.e * np.exp(self.log_scale - self.log_rate))
        late[np.flatnonzero(self.at_release)] = 0.0
        return late


@dataclass(frozen=True)
class Tangents:
    """How the level behind each residual, in units of its scale, (n, d), its log scale (n, d) and the groups' levels
    `apart` (g, d) move with the d free parameters, the events given.  (A residual itself also shrinks as its scale
    grows: that is no shift.)"""

    level: np.ndarray
    log_scale: np.ndarray
    apart: np.ndarray


def residuals(likelihood: EventTimes, circuit: Circuit, changes: StackedChanges | None = None) -> Residuals:
    """The residuals of a likelihood's events under a circuit; `changes` is `changes(circuit)` when known."""
    terms = likelihood.terms(circuit, changes)
    group, other = likelihood.group, likelihood.group ^ 1
    margin = (terms.group_mean[group] - terms.z) / terms.scale
    at = likelihood.layout
    other_spread = spreads_of_others(at.alike, at.group, terms.numbers, NOTHING, terms.group)
    other_margin = (terms.group_mean[other] - terms.reached) / other_spread
    other_survives = log_ndtr(other_margin)
    if circuit.lost > 0.0:
        missed = missed_of(circuit.lost)[0]
        other_survives = np.logaddexp(np.log(missed), np.log1p(-missed) + other_survives)
    log_survival = log_ndtr(margin) + np.where(terms.reached > 0, other_survives, 0.0)
    if len(terms.at_release):
        spread = np.sqrt(terms.scale**2 + terms.group_variance[group])
        chance = np.exp(log_ndtr((terms.z - terms.group_mean[group]) / spread))
        drawn = np.random.default_rng(DRAWS).random(len(chance))
        log_survival = np.where(terms.at_release, np.log1p(-drawn * chance), log_survival)
    e = np.clip(-ndtri_exp(np.minimum(log_survival, -1e-300)), -LARGEST, LARGEST)
    shown = np.where(terms.background, 0.0, e)
    taken = np.where(terms.background | terms.at_once, 0.0, terms.group_variance[group] / terms.scale**2)
    apart = np.where(terms.weight_sum > 0.0, terms.weighted_mean - terms.centre, 0.0) / np.sqrt(terms.mean_variance)
    return Residuals(
        shown, np.log(terms.scale), terms.log_rate, terms.background, terms.changes, terms.at_release, taken,
        apart,
    )  # fmt: skip


def expected_log_rate(likelihood: EventTimes, circuit: Circuit, here: Residuals) -> np.ndarray:
    """(n,) log speed of the change at the time when each event was expected."""
    nudge_s = 1e-6  # one-sided difference of the time: short beside any filter's time constant, long beside rounding
    earlier = circuit.later_by(nudge_s)
    there = likelihood.terms(earlier, likelihood.changes(earlier, here.changes))
    rate = np.exp(here.log_rate)
    growing = np.where(here.background | there.background, 0.0, (rate - np.exp(there.log_rate)) / nudge_s)
    return np.log(np.clip(rate - growing * here.late, 0.01 * rate, 100.0 * rate))


def tangents(likelihood: EventTimes, coordinates: Coordinates, x: np.ndarray, here: Residuals) -> Tangents:
    """Derivatives of the residuals by every coordinate at x, by differences; 0 for background events.

    A level that moves far is asked again with a shorter step: what then still moves far jumps, and has no derivative.
    """
    moves = STEP * coordinates.longest_moves()
    by_level, by_scale = np.empty((len(here.e), len(x))), np.empty((len(here.e), len(x)))
    by_group = np.empty((len(here.apart), len(x)))
    for i, h in enumerate(moves):
        there = _moved(likelihood, coordinates, x, here, i, h)
        level, log_scale = compare(here, there)
        by_group[:, i] = (there.apart - here.apart) / h
        far = ~(np.abs(level) <= FAR_SD)
        if far.any():
            shorter = compare(here, _moved(likelihood, coordinates, x, here, i, SHORTER * h))
            sound = np.abs(shorter[0]) <= FAR_SD
            again = [np.where(sound, each, 0.0) / SHORTER for each in shorter]
            level, log_scale = np.where(far, again[0], level), np.where(far, again[1], log_scale)
        by_level[:, i], by_scale[:, i] = level / h, log_scale / h
    undefined = here.background[:, None] | ~np.isfinite(by_level) | ~np.isfinite(by_scale)
    by_level, by_scale = np.where(undefined, 0.0, by_level), np.where(undefined, 0.0, by_scale)
    return Tangents(by_level, by_scale, np.where(np.isfinite(by_group), by_group, 0.0))


def _moved(
    likelihood: EventTimes, coordinates: Coordinates, x: np.ndarray, here: Residuals, i: int, h: float
) -> Residuals:
    """The residuals after one coordinate's move by h."""
    moved = x.copy()
    moved[i] += h
    circuit = coordinates.circuit(moved)
    return residuals(likelihood, circuit, likelihood.changes(circuit, here.changes))


def compare(here: Residuals, there: Residuals) -> tuple[np.ndarray, np.ndarray]:
    """(shift of the level (n,) in units of its scale, change of its log scale (n,)) from one model to another.

    The shift is that of the moment when the event was expected, which does not know the residual: at the event itself
    it is larger by the residual times what the speed changed by.
    """
    log_scale = there.log_scale - here.log_scale
    level = there.e - here.e + 0.5 * (there.e + here.e) * log_scale
    return level - here.e * (there.log_rate - here.log_rate), log_scale
