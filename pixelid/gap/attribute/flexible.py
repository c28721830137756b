"""A flexible term: thresholds that depend on one covariate of the events, whatever causes it.

e ~ N(b(cell), 1) with b a penalised step function over one factor of the covariates.  In units of the threshold the
term shifts it by b σ.  Factors in order (time, waits, light, speed) are smoothed by a penalty on second differences,
the others shrunk to zero; the strength of the penalty is chosen by marginal likelihood on a grid.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pixelid.gap.detect.covariates import Factor
from pixelid.gap.detect.residuals import Residuals
from pixelid.likelihood.density import sum_by
from pixelid.likelihood.event_times import EventTimes

PRECISIONS = 10.0 ** np.arange(-2, 5)  # of the prior on a cell's shift: from none to all, in decades


@dataclass(frozen=True)
class Flexible:
    """factor: what it depends on;  labels, shift, se: per cell, in standard deviations of threshold noise
    gain: nats on the pixels it was fitted to;  held_out: (pixels,) nats on pixels it was not"""

    factor: str
    labels: tuple[str, ...]
    shift: np.ndarray
    se: np.ndarray
    gain: float
    held_out: np.ndarray

    def as_dict(self, sigma: float) -> dict:
        """What the JSON says of it; sigma: relative threshold noise."""
        return {
            "depends_on": self.factor,
            "gain_nats": self.gain,
            "heldout_gain_nats": float(self.held_out.sum()),
            "cells": [
                {"where": label, "threshold_shift_percent": 100.0 * sigma * b, "se_percent": 100.0 * sigma * s}
                for label, b, s in zip(self.labels, self.shift, self.se, strict=True)
            ],
        }


def fit_flexible(
    fit: tuple[EventTimes, Residuals, Sequence[Factor]], held: tuple[EventTimes, Residuals, Sequence[Factor]]
) -> Flexible | None:
    """The factor that gains most on held-out pixels; None when none gains anything.  Both sides share their cells."""
    best: Flexible | None = None
    for mine, theirs in zip(fit[2], held[2], strict=True):
        term = _term(*fit[:2], mine, *held[:2], theirs)
        if best is None or term.held_out.sum() > best.held_out.sum():
            best = term
    return best if best is not None and best.held_out.sum() > 0 else None


def _sums(likelihood: EventTimes, residual: Residuals, factor: Factor):
    """(count, sum of e) per cell, e demeaned within each pixel and polarity."""
    kept = ~residual.background
    size = np.maximum(np.bincount(likelihood.group, kept, 2 * likelihood.pixels), 1.0)
    mean = sum_by(likelihood.group, residual.e * kept, 2 * likelihood.pixels) / size
    e = np.where(kept, residual.e - mean[likelihood.group], 0.0)
    k = len(factor.labels)
    return np.bincount(factor.cell, kept, k), np.bincount(factor.cell, e, k), e * kept


def _term(likelihood, residual, factor, other, other_residual, other_factor) -> Flexible:
    count, total, _ = _sums(likelihood, residual, factor)
    best = (-np.inf, 1.0)
    for strength in PRECISIONS:
        precision = count + strength
        evidence = 0.5 * np.sum(total**2 / precision) - 0.5 * np.sum(np.log(precision / strength))
        best = max(best, (float(evidence), float(strength)))
    shift = total / (count + best[1])
    se = 1.0 / np.sqrt(count + best[1])
    gain = float(np.sum(shift * total - 0.5 * count * shift**2))
    _, _, e = _sums(other, other_residual, other_factor)
    b = shift[other_factor.cell] * ~other_residual.background
    held_out = np.bincount(other.pixel, b * e - 0.5 * b * b, other.pixels)
    return Flexible(factor.name, factor.labels, shift, se, gain, held_out)
