"""Gauss–Newton information of the event-time density along given tangents.

Its blocks, each a standardised residual or a log scale whose squares the log-likelihood sums: per event the level
within its group (about the weighted mean), the log rate, and the log scale; per group the weighted mean about the
population, and the log variance of that mean; per event at the end of a silence its moment and the log width of that,
and the margin of its level above the threshold.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.stats import norm

from pixelid.likelihood.density import Terms
from pixelid.likelihood.density_forward import Numbers
from pixelid.likelihood.density_release import SHARE, WINDOW
from pixelid.likelihood.layout import StackedChanges
from pixelid.stages.comparator import memory_factor


@dataclass(frozen=True)
class Tangent:
    """Derivatives along one coordinate: of all changes (None: they do not move) and of the `NUMBERS` (10,)."""

    changes: StackedChanges | None
    numbers: np.ndarray


class Information:
    """The information (d, d) of d tangents, taken one by one so that only one of them need be in memory."""

    def __init__(self, terms: Terms, tangents: int) -> None:
        self.terms = terms
        usual = ~terms.background
        usual[np.flatnonzero(terms.at_release)] = False
        kept = self.kept = np.flatnonzero(usual)
        at, event, rows = terms.layout, terms.event, terms.changes.events
        self.group, self.weight = at.group[kept], event.weight[kept]
        self.growth, self.alike = 1.0 + terms.numbers.threshold_drift * at.time_s[kept], at.alike[kept]
        self.factor = memory_factor(terms.numbers.polarity_memory, self.alike)
        self.of_level = at.sign[kept], at.time_s[kept], event.level[kept], event.rate[kept]
        self.leak = rows.drift[kept], rows.drift_slope[kept]
        self.clock, self.clock_share = event.clock[kept], terms.clock_share[kept]
        self.seen = terms.weight_sum > 0
        self.is_on = np.arange(len(self.seen)) % 2 == 1
        self.events = np.zeros((tangents, 3, len(kept)))
        self.groups = np.zeros((tangents, 2, len(self.seen)))
        self.lost = np.zeros(tangents)
        self.release = terms.released
        self.at_release = np.zeros((tangents, 3, len(self.release.k)))

    def add(self, i: int, tangent: Tangent) -> None:
        """Fill column i."""
        t, group, c = self.terms, self.terms.group, self.terms.numbers
        d_on, d_off, d_noise, d_mismatch, d_drift, d_jitter, d_silent, d_memory, d_lost, _ = tangent.numbers
        if t.losses is not None:
            self.lost[i] = d_lost * np.sqrt(t.losses.information)
        d_level, d_rate = np.empty(len(self.kept)), np.empty(len(self.kept))
        moved = _NOTHING if tangent.changes is None else tangent.changes.events.of_level
        _levels_along(
            self.kept, *self.of_level, *self.leak, self.growth, self.factor, self.alike, *moved, c.on_threshold,
            c.threshold_drift, d_on, d_drift, d_memory, d_level, d_rate,
        )  # fmt: skip
        safe = np.where(self.seen, group.W, 1.0)
        d_mean = np.bincount(self.group, self.weight * d_level, len(safe)) / safe
        d_centre = np.where(self.is_on, d_on, d_off)
        share = np.where(self.seen, group.spread / t.mean_variance, 0.0)  # of a group's threshold that its events tell
        d_own = d_centre + share * (d_mean - d_centre)
        if len(self.release.k):
            width = 2.0 * c.jitter * d_jitter + SHARE**2 * c.silent * d_silent
            self._add_released(i, tangent, width / self.release.width, d_own)
        d_noise_variance = 2.0 * c.noise * group.mean * (d_noise * group.mean + c.noise * d_own)
        d_weight_sum = np.zeros(len(safe))
        _residuals_along(
            self.group, self.of_level[3], self.weight, self.clock, self.clock_share, self.factor, d_mean,
            d_noise_variance, d_memory * self.alike, 2.0 * c.jitter * d_jitter, d_level, d_rate, self.events[i],
            d_weight_sum,
        )  # fmt: skip
        d_spread = 2.0 * c.mismatch * group.centre * (d_mismatch * group.centre + c.mismatch * d_centre)
        d_mean_variance = d_spread - d_weight_sum / safe**2
        self.groups[i, 0] = np.where(self.seen, (d_mean - d_centre) / np.sqrt(t.mean_variance), 0.0)
        self.groups[i, 1] = np.where(self.seen, np.sqrt(0.5) * d_mean_variance / t.mean_variance, 0.0)

    def _add_released(self, i: int, tangent: Tangent, d_width: np.ndarray, d_own: np.ndarray) -> None:
        """Fill column i of the events at the end of a silence; d_width: (j,), of the width of their moment."""
        t, c, release = self.terms, self.terms.numbers, self.release
        at, rows, k, group = t.layout, t.changes.events, release.k, t.layout.group[release.k]
        d_on, d_drift, d_memory = (tangent.numbers[Numbers._fields.index(name)] for name in _OF_LEVEL)
        growth, factor = 1.0 + c.threshold_drift * at.time_s[k], memory_factor(c.polarity_memory, at.alike[k])
        moved = _NOTHING if tangent.changes is None else tangent.changes.events.of_level
        d_late = np.zeros(len(k)) if tangent.changes is None else -tangent.changes.events.early[k]
        d_level, d_rate = np.empty(len(k)), np.empty(len(k))
        _levels_along(
            k, at.sign[k], at.time_s[k], release.level, release.rate, rows.drift[k], rows.drift_slope[k], growth,
            factor, at.alike[k], *moved, c.on_threshold, c.threshold_drift, d_on, d_drift, d_memory, d_level, d_rate,
        )  # fmt: skip
        ahead = WINDOW * release.width - release.late
        d_level += ahead * d_rate + release.rate * (WINDOW * d_width - d_late)
        spread = np.sqrt((c.noise * t.group_mean[group] / factor) ** 2 + t.group_variance[group])
        margin = (release.level + ahead * release.rate - t.group_mean[group]) / spread
        hazard = np.exp(norm.logpdf(margin) - norm.logcdf(margin))
        bend = np.sqrt(np.maximum(hazard * (hazard + margin), 0.0))  # of −log Φ
        self.at_release[i, 0] = d_late / release.width
        self.at_release[i, 1] = np.sqrt(2.0) * d_width / release.width
        self.at_release[i, 2] = bend * (d_level - d_own[group]) / spread

    def matrix(self) -> np.ndarray:
        """(d, d)."""
        information = _products(self.events) + _products(self.groups)
        if len(self.release.k):
            information += _products(self.at_release)
        return information if self.terms.losses is None else information + np.outer(self.lost, self.lost)


def _products(residuals: np.ndarray) -> np.ndarray:
    """(d, d) sums of products of residuals (d, …); d may be 0, where a profile holds the only coordinate."""
    rows = residuals.reshape(len(residuals), math.prod(residuals.shape[1:]))
    return rows @ rows.T


_NOTHING = (np.empty(0),) * 4
_OF_LEVEL = ("on_threshold", "threshold_drift", "polarity_memory")


@njit(cache=True, nogil=True, error_model="numpy")
def _levels_along(
    kept, sign, time, level, rate, leak, leak_rate, growth, factor, alike, by_change, by_slope, by_drift,
    by_drift_slope, on, drift, d_on, d_drift, d_memory, d_level, d_rate,
):  # fmt: skip
    """Fill the derivatives of level and rate of the events kept; by_…: of the changes, empty where they rest."""
    for i in range(len(kept)):
        change, slope = d_on * leak[i], d_on * leak_rate[i]
        if len(by_change) > 0:
            k = kept[i]
            change += by_change[k] + on * by_drift[k]
            slope += by_slope[k] + on * by_drift_slope[k]
        growing = d_drift * time[i] / growth[i] + d_memory * alike[i] / factor[i]
        grown, drifting = growth[i] * factor[i], drift / growth[i]
        d_level[i] = sign[i] * change / grown - growing * level[i]
        d_rate[i] = sign[i] * slope / grown - growing * (rate[i] + drifting * level[i])
        d_rate[i] -= d_level[i] * drifting + level[i] * d_drift / growth[i] ** 2


@njit(cache=True, nogil=True, error_model="numpy")
def _residuals_along(
    group, rate, weight, clock, clock_share, factor, d_mean, d_noise_variance, d_factor, d_jitter_variance, d_level,
    d_rate, rows, d_weight_sum,
):  # fmt: skip
    """Fill a column's three rows: level within its group, log rate, log scale; and how the groups' weights change."""
    half = np.sqrt(0.5)
    for i in range(len(group)):
        g, w, r = group[i], weight[i], rate[i]
        d_variance = d_noise_variance[g] / factor[i] ** 2
        d_variance -= 2.0 * (1.0 / w - r * r * clock[i]) * d_factor[i] / factor[i]
        d_variance += 2.0 * r * d_rate[i] * clock[i] + r * r * clock_share[i] * d_jitter_variance
        rows[0, i] = (d_level[i] - d_mean[g]) * np.sqrt(w)
        rows[1, i] = d_rate[i] / r
        rows[2, i] = half * d_variance * w
        d_weight_sum[g] -= d_variance * w * w
