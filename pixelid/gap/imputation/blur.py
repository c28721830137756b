"""What unknown times leave of events: levels behind them are blurred, and columns of them weighed accordingly.

With event k stamped late by ξ_k of variance σ_k², its level moves by r_k ξ_k with its own time and by g_k ξ_{k−1} with
that of the event before (`marginal.py`).  In units of the threshold noise s_k the covariance has three diagonals,

    V = 1 + (σ_k² r_k² + σ_{k−1}² g_k²)/s_k²        and        σ_{k−1}² g_k r_{k−1} / (s_k s_{k−1})  below,

one block per pixel and recording.  With V = L Lᵀ, a column of levels c counts as L⁻¹c: inner products of such columns
are those of the Fisher information with the times integrated out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky_banded, solve_banded

from pixelid.gap.imputation.imputed import Imputation
from pixelid.likelihood.density import sum_by
from pixelid.likelihood.event_times import NUDGE_S, EventTimes
from pixelid.stages.circuit import Circuit


@dataclass(frozen=True)
class Slopes:
    """How the levels behind n events move with the times of the events.

    own, before: (n,) 1/s, by the event's own time and by that of the event before
    order: (n,) the events by recording, pixel and time;  follows: (n,) in that order, whether the event above is the
        one before;  aside: (n,) events without a cause, whose `before` is 0
    """

    own: np.ndarray
    before: np.ndarray
    order: np.ndarray
    follows: np.ndarray
    aside: np.ndarray


def slopes_of(likelihood: EventTimes, circuit: Circuit, here) -> Slopes:
    """The slopes under a circuit;  here: `likelihood.terms(circuit)`."""
    there = likelihood.released_later(circuit, here)
    aside = here.background | there.background
    before = np.where(aside, 0.0, (there.z - here.z) / NUDGE_S)
    order = np.lexsort((likelihood.time_s, likelihood.pixel, likelihood.recording_of_event))
    key = likelihood.pixel * len(likelihood.recordings) + likelihood.recording_of_event
    follows = np.concatenate([[False], np.diff(key[order]) == 0])[: len(order)]
    return Slopes(np.exp(here.log_rate), before, order, follows, aside)


def of_intervals(likelihood: EventTimes, values: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """(n,), (n,) of each interval's event, and of the event before it; values: per recording, of all its events."""
    own, before = [np.empty(0)], [np.empty(0)]
    for recording, value, intervals in zip(likelihood.recordings, values, likelihood.intervals, strict=True):
        order = np.lexsort((recording.events.t, recording.events.pixel))
        place = np.empty(len(order), np.int64)
        place[order] = np.arange(len(order))
        own.append(value[intervals.event])
        before.append(value[order[place[intervals.event] - 1]])
    return np.concatenate(own), np.concatenate(before)


@dataclass(frozen=True)
class Blur:
    """Columns of n levels weighed by L⁻¹.

    order: (n,) of `Slopes`;  factor: (2, n) L, its diagonal and the one below;  share: (n,) 1/V_kk
    group: (n,) 2 · pixel + ON;  groups: their number
    units: (n, 2) columns that are 1 for OFF and for ON events, weighed
    """

    order: np.ndarray
    factor: np.ndarray
    share: np.ndarray
    group: np.ndarray
    groups: int
    units: np.ndarray

    def weigh(self, column: np.ndarray) -> np.ndarray:
        """L⁻¹ times a column (n,)."""
        return _solved(self.order, self.factor, column)

    def without_pixel_means(self, column: np.ndarray) -> np.ndarray:
        """A weighed column (n,) without what a shift of each pixel's two thresholds makes of it."""
        pixel, pixels = self.group // 2, self.groups // 2
        off, on = self.units.T
        a, b, d = (sum_by(pixel, x, pixels) for x in (off * off, off * on, on * on))
        u, v = (sum_by(pixel, x * column, pixels) for x in (off, on))
        determinant = a * d - b * b
        both = determinant > 1e-12 * a * d
        least = np.where(both, determinant, 1.0)
        by_off = np.where(both, (d * u - b * v) / least, u / np.where(a > 0, a, 1.0))
        by_on = np.where(both, (a * v - b * u) / least, v / np.where(d > 0, d, 1.0))
        return column - by_off[pixel] * off - by_on[pixel] * on


def blur_by(likelihood: EventTimes, circuit: Circuit, sd_s: Sequence[np.ndarray]) -> Blur:
    """The blur of events by times known to a standard deviation.

    Args:
        likelihood: Of n events.
        circuit: The model's.
        sd_s: Per recording, of all its events, s.
    """
    here = likelihood.terms(circuit)
    slopes = slopes_of(likelihood, circuit, here)
    own, before = of_intervals(likelihood, [np.asarray(sd) ** 2 for sd in sd_s])
    r, g = (np.where(slopes.aside, 0.0, rate / here.scale) for rate in (slopes.own, slopes.before))
    diagonal = 1.0 + own * r**2 + before * g**2
    order = slopes.order
    below = np.zeros(len(order))
    if len(order) > 1:
        shared = before[order[1:]] * g[order[1:]] * r[order[:-1]]
        below[:-1] = np.where(slopes.follows[1:], shared, 0.0)
    factor = cholesky_banded(np.array([diagonal[order], below]), lower=True, check_finite=False)
    rising = likelihood.group % 2 == 1
    units = np.stack([_solved(order, factor, 1.0 * side) for side in (~rising, rising)], axis=1)
    return Blur(order, factor, 1.0 / diagonal, likelihood.group, likelihood.layout.groups, units)


def spreads(imputation: Imputation, likelihood: EventTimes) -> list[np.ndarray]:
    """Per recording of a likelihood of some of the imputed pixels, (n,) s: by how much the times of its events are
    unknown."""
    found = []
    for fine, window, t, own in zip(
        imputation.fine, imputation.windows, imputation.times, likelihood.recordings, strict=True
    ):
        order = np.lexsort((t, fine.events.pixel))
        kept = np.isin(fine.events.pixel[order], own.events.pixel)
        spread = np.empty(len(own.events))
        spread[np.lexsort((own.events.t, own.events.pixel))] = window.spreads_s[order][kept]
        found.append(spread)
    return found


def _solved(order: np.ndarray, factor: np.ndarray, column: np.ndarray) -> np.ndarray:
    """L⁻¹ times a column (n,), both in the order of the events."""
    out = np.empty(len(column))
    if len(column):
        out[order] = solve_banded((1, 0), factor, column[order], check_finite=False)
    return out
