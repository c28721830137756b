"""The density that is sampled: exact log posterior of a fit's free coordinates, and its pieces for model criticism."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pixelid.fit.data import event_times_of
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.pooled_rate import PooledRateObjective
from pixelid.fit.result import FitResult
from pixelid.likelihood.pooled_rate import PooledRate
from pixelid.recordings.recording import Recording

MOST_UNITS = 512  # pixels whose log-likelihoods are kept apart; more share units


class Target:
    """Log posterior in fitting coordinates (logs where the parameter says so).

    Priors: the model's Gaussian ones, else flat in the fitting coordinate within the bounds.  Per-pixel thresholds are
    integrated out in closed form (likelihood/event_times.py).  Pooled counts: the log-likelihood is divided by the
    measured dispersion, as the fit's errors are.

    pieces: (r + 1 + p,) log-likelihood of the r recordings given the thresholds, of the thresholds themselves, and of
    the p pixels (or units of several pixels), which add up to the same total.
    """

    def __init__(self, result: FitResult, recordings: Sequence[Recording]) -> None:
        self.coordinates = result.coordinates
        self.lower, self.upper = self.coordinates.bounds()
        self.recordings = tuple(recordings)
        self.pooled = result.observation == "pooled_rate"
        self._dispersion = float(result.details.get("dispersion", 1.0))
        if self.pooled:
            self._counts = PooledRate(recordings)
            self._pooled = PooledRateObjective(self._counts, self.coordinates)
            self.units = 0
        else:
            self._density = event_times_of(result, recordings)
            self.units = min(self._density.likelihood.pixels, MOST_UNITS)
        self.evaluations = 0

    @property
    def objective(self) -> EventTimesObjective | PooledRateObjective:
        """The same density as an optimiser sees it."""
        return self._pooled if self.pooled else self._density

    def inside(self, x: np.ndarray) -> bool:
        """Whether x respects the bounds."""
        return bool(((x >= self.lower) & (x <= self.upper)).all())

    def value(self, x: np.ndarray) -> float:
        """The log posterior, −∞ outside the bounds."""
        return self(x)[0]

    def __call__(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """(log posterior, pieces)."""
        size = len(self.recordings) + 1 + self.units
        if not self.inside(x):
            return -np.inf, np.full(size, np.nan)
        self.evaluations += 1
        prior = self.coordinates.log_prior(x)
        if self.pooled:
            pieces = np.append(self._pooled_pieces(x) / self._dispersion, 0.0)
            total = pieces.sum()
        else:
            terms = self._density.terms(x)
            total = terms.total
            units = np.bincount(np.arange(len(terms.per_pixel)) % self.units, terms.per_pixel, self.units)
            pieces = np.concatenate([terms.per_recording, [total - terms.per_recording.sum()], units])
        if not np.isfinite(total):
            return -np.inf, np.full(size, np.nan)
        return total + prior, pieces

    def _pooled_pieces(self, x: np.ndarray) -> np.ndarray:
        """(r,) Poisson log-likelihoods of the recordings, without the constant of the counts."""
        return self._counts.per_recording(self._pooled.expected(x))
