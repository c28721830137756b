"""Gauss–Newton information of the event-time density along given tangents.

Its blocks, each a standardised residual or a log scale whose squares the log-likelihood sums: per event the level
within its group (about the weighted mean), the log rate, and the log scale; per group the weighted mean about the
population, and the log variance of that mean.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from pixelid.likelihood.density import Terms
from pixelid.likelihood.layout import EventRows, StackedChanges


@dataclass(frozen=True)
class Tangent:
    """Derivatives along one coordinate: of all changes (None: they do not move) and of the `NUMBERS` (6,)."""

    changes: StackedChanges | None
    numbers: np.ndarray


class Information:
    """The information (d, d) of d tangents, taken one by one so that only one of them need be in memory."""

    def __init__(self, terms: Terms, tangents: int) -> None:
        self.terms = terms
        self.kept = np.flatnonzero(~terms.background)
        self.seen = terms.weight_sum > 0
        self.is_on = np.arange(len(self.seen)) % 2 == 1
        self.events = np.zeros((tangents, 3, len(self.kept)))
        self.groups = np.zeros((tangents, 2, len(self.seen)))

    def add(self, i: int, tangent: Tangent) -> None:
        """Fill column i."""
        t, group = self.terms, self.terms.group
        c, at = t.numbers, t.layout
        d_on, d_off, d_noise, d_mismatch, d_drift, d_jitter = tangent.numbers
        d_level, d_rate = np.empty(len(self.kept)), np.empty(len(self.kept))
        moved = EventRows(*np.empty((7, 0))) if tangent.changes is None else tangent.changes.events
        _levels_along(
            self.kept, at.sign, at.time_s, t.changes.events, moved, t.event, c.on_threshold, c.threshold_drift,
            d_on, d_drift, d_level, d_rate,
        )  # fmt: skip
        safe = np.where(self.seen, group.W, 1.0)
        of_kept, weight = at.group[self.kept], t.event.weight[self.kept]
        d_mean = np.bincount(of_kept, weight * d_level, len(safe)) / safe
        d_centre = np.where(self.is_on, d_on, d_off)
        share = np.where(self.seen, group.spread / t.mean_variance, 0.0)  # of a group's threshold that its events tell
        d_own = d_centre + share * (d_mean - d_centre)
        d_noise_variance = 2.0 * c.noise * group.mean * (d_noise * group.mean + c.noise * d_own)
        d_weight_sum = np.zeros(len(safe))
        _residuals_along(
            self.kept, at.group, t.event, t.clock_share, d_mean, d_noise_variance, 2.0 * c.jitter * d_jitter,
            d_level, d_rate, self.events[i], d_weight_sum,
        )  # fmt: skip
        d_spread = 2.0 * c.mismatch * group.centre * (d_mismatch * group.centre + c.mismatch * d_centre)
        d_mean_variance = d_spread - d_weight_sum / safe**2
        self.groups[i, 0] = np.where(self.seen, (d_mean - d_centre) / np.sqrt(t.mean_variance), 0.0)
        self.groups[i, 1] = np.where(self.seen, np.sqrt(0.5) * d_mean_variance / t.mean_variance, 0.0)

    def matrix(self) -> np.ndarray:
        """(d, d)."""
        events = self.events.reshape(len(self.events), -1)
        groups = self.groups.reshape(len(self.groups), -1)
        return events @ events.T + groups @ groups.T


@njit(cache=True, nogil=True, error_model="numpy")
def _levels_along(kept, sign, time, rows, moved, event, on, drift, d_on, d_drift, d_level, d_rate):
    """Fill the derivatives of level and rate of the events kept; `moved`: of the changes, empty where they rest."""
    for i in range(len(kept)):
        k = kept[i]
        growth = 1.0 + drift * time[k]
        change, slope = d_on * rows.drift[k], d_on * rows.drift_slope[k]
        if len(moved.change) > 0:
            change += moved.change[k] + on * moved.drift[k]
            slope += moved.slope[k] + on * moved.drift_slope[k]
        growing = d_drift * time[k] / growth
        z, rate = event.level[k], event.rate[k]
        d_level[i] = sign[k] * change / growth - growing * z
        d_rate[i] = sign[k] * slope / growth - growing * rate - (d_level[i] * drift + z * d_drift) / growth


@njit(cache=True, nogil=True, error_model="numpy")
def _residuals_along(
    kept, group, event, clock_share, d_mean, d_noise_variance, d_jitter_variance, d_level, d_rate, rows, d_weight_sum
):  # fmt: skip
    """Fill a column's three rows: level within its group, log rate, log scale; and how the groups' weights change."""
    half = np.sqrt(0.5)
    for i in range(len(kept)):
        k = kept[i]
        g, w, rate = group[k], event.weight[k], event.rate[k]
        d_variance = d_noise_variance[g] + 2.0 * rate * d_rate[i] * event.clock[k]
        d_variance += rate * rate * clock_share[k] * d_jitter_variance
        rows[0, i] = (d_level[i] - d_mean[g]) * np.sqrt(w)
        rows[1, i] = d_rate[i] / rate
        rows[2, i] = half * d_variance * w
        d_weight_sum[g] -= d_variance * w * w
