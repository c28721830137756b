"""Signed maps of the residuals, cleared of what the fitted parameters can absorb, and how far they leave zero.

For a feature f over events (a cell's indicator, the residual before, …), weights demeaned within each pixel and
polarity (whose threshold is fitted) and projected off the tangents J of the free parameters, f⊥,

    T = Σ f⊥ e / √(Σ f⊥²)

is standard normal when the model is right, to first order whatever the parameters' errors: a score test.  Three
responses are mapped: the residual e (thresholds or times shifted), its spread (e² − 1 + v/s²)/√2, where the posterior
mean of the event's threshold, of variance v, took v/s² of the residual's, and the product with the same pixel's
residual before (memory).

Spreads are also compared between polarities, over all pixels: of them noise is fitted together.  Most parameters are
told by levels, though they move spreads too (noise goes with the threshold, so that another threshold of ON events
could pass for noise of theirs): there the projection is off the tangents of spreads, levels, and levels of whole groups
about their population's threshold.

The largest |T| is judged twice: against independent normals over all cells (the parametric answer), and by flipping
the signs of whole pixels (pixels are the exchangeable unit).  The larger p counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from pixelid.gap.criteria import Criteria
from pixelid.gap.detect.covariates import POLARITY, Factor
from pixelid.gap.detect.residuals import Residuals, Tangents
from pixelid.likelihood.density import sum_by
from pixelid.likelihood.event_times import EventTimes

Scores = dict[tuple[str, str], float]  # (response, label) → score

SKEWNESS_OF_SQUARE = np.sqrt(8.0)  # of (e² − 1)/√2, e standard normal


@dataclass(frozen=True)
class Cell:
    """One cell of a map: response ("level", "spread", "memory"), factor and label in words, score, events, and the
    mean of the response there."""

    response: str
    factor: str
    label: str
    score: float
    events: int
    mean: float


@dataclass(frozen=True)
class Maps:
    """cells: by |score|, largest first;  p: of the largest;  background: events that no threshold explains."""

    cells: tuple[Cell, ...]
    p: float
    p_normal: float
    p_pixels: float | None
    background: int

    @property
    def scores(self) -> Scores:
        """Every cell's score."""
        return {(c.response, c.label): c.score for c in self.cells}


def map_residuals(
    likelihood: EventTimes,
    residual: Residuals,
    tangent: Tangents,
    factors: Sequence[Factor],
    criteria: Criteria,
    seed: int,
) -> Maps:
    """The maps of a likelihood's residuals.

    Args:
        likelihood: Of n events.
        residual: (n,) residuals under a fitted model.
        tangent: (n, d) how they move with its free parameters.
        factors: Ways to sort the events into cells; the first serves for memory.
        criteria: Which cells are judged.
        seed: Of the signs flipped.
    """
    kept = ~residual.background
    max_residual_sd = 8.0  # beyond, residuals count as this: one event must not make a map
    e = np.clip(residual.e, -max_residual_sd, max_residual_sd)
    group, pixel, pixels = likelihood.group, likelihood.pixel, likelihood.pixels  # also those without a scored event
    spread = np.where(kept, (e * e - 1.0 + residual.taken) / np.sqrt(2.0), 0.0)
    last = _last_residual(likelihood, np.where(kept, e, 0.0))
    level, log_scale = tangent.level, np.sqrt(2.0) * tangent.log_scale
    levels = _Response(np.where(kept, e, 0.0), level, pixel, group, kept)
    within = _Response(spread, log_scale, pixel, group, kept)
    across = _Response(spread, log_scale, pixel, np.zeros_like(group), kept)
    groups = np.arange(len(residual.apart))
    every = np.ones_like(groups, np.bool_)
    thresholds = _Response(residual.apart, tangent.apart, groups // 2, groups, every, demean=False)
    polarity = Factor("polarity", group % 2, tuple(f"all {sign} events" for sign in POLARITY))
    jobs = (
        ("level", _Basis(pixels, levels), factors, 0.0),
        ("spread", _Basis(pixels, within), factors, SKEWNESS_OF_SQUARE),
        ("spread", _Basis(pixels, across, levels, thresholds), (polarity,), SKEWNESS_OF_SQUARE),
    )
    cells: list[Cell] = []
    by_pixel: list[np.ndarray] = []
    for name, basis, some, skewness in jobs:
        for factor in some:
            scored, sums = basis.scores(factor, name, skewness, criteria)
            cells += scored
            by_pixel.append(sums)
    memory = _memory(e * kept, last, factors[0], pixel, pixels, criteria.min_cell_events)
    cells += memory[0]
    by_pixel.append(memory[1])
    sums = np.concatenate(by_pixel, axis=1)
    cells.sort(key=lambda c: -abs(c.score))
    p_normal, p_pixels = chance_of_largest(cells), flip_signs(sums, seed)
    return Maps(tuple(cells), max(p_normal, p_pixels or 0.0), p_normal, p_pixels, int((~kept).sum()))


def chance_of_largest(cells: Sequence[Cell]) -> float:
    """p of the first of cells that are sorted by |score|, after Bonferroni; 1 where there is none."""
    return float(min(1.0, len(cells) * 2.0 * norm.sf(abs(cells[0].score)))) if cells else 1.0


class _Response:
    """n responses and their tangents J (n, d), demeaned within groups, or as they are.

    pixel, group: (n,) of each;  kept: (n,) those that count
    size: (groups,) responses of each group that are kept
    """

    def __init__(self, value, J, pixel, group, kept, *, demean=True):
        self.pixel, self.group, self.kept, self._demean = pixel, group, kept, demean
        self.groups = int(group.max(initial=0)) + 1
        self.size = np.maximum(np.bincount(group, kept, self.groups), 1.0)
        self.value = self._cleared(value)
        self.J = np.column_stack([self._cleared(J[:, j]) for j in range(J.shape[1])])

    def _cleared(self, column):
        column = np.where(self.kept, column, 0.0)
        if not self._demean:
            return column
        mean = sum_by(self.group, column, self.groups) / self.size
        return np.where(self.kept, column - mean[self.group], 0.0)


class _Basis:
    """A response and what its maps are projected off: its tangents, beside those of other responses."""

    def __init__(self, pixels: int, own: _Response, *beside: _Response):
        self.pixels, self.own, every = pixels, own, (own, *beside)
        q, r = np.linalg.qr(np.concatenate([response.J for response in every]))
        left = np.abs(np.diag(r))
        # Score that one unit of a coordinate can move: what is left of a column below it is rounding
        min_column_norm = 1e-3
        q = q[:, left > max(min_column_norm, 1e-9 * left.max(initial=0.0))]
        parts = np.split(q, np.cumsum([len(response.J) for response in every])[:-1])
        self.Q = parts[0]
        self.along = np.zeros((q.shape[1], self.pixels))
        for response, part in zip(every, parts, strict=True):
            self.along += self._sums(response.pixel, part.T * response.value, self.pixels)

    @staticmethod
    def _sums(index, rows, size):
        """(d, size) of rows (d, n) by index; d may be 0."""
        return np.array([np.bincount(index, row, size) for row in rows]).reshape(len(rows), size)

    def scores(self, factor: Factor, name: str, skewness: float, criteria: Criteria) -> tuple[list[Cell], np.ndarray]:
        """(cells, (pixels, cells) each pixel's part of the standardised score); skewness: of one event's response."""
        k, own = len(factor.labels), self.own
        count = np.bincount(factor.cell, own.kept, k)
        at = np.flatnonzero(own.kept)
        joint = np.bincount(own.group[at] * k + factor.cell[at], minlength=own.groups * k).reshape(own.groups, k)
        summed = np.bincount(own.pixel * k + factor.cell, own.value, self.pixels * k).reshape(self.pixels, k)
        # f demeaned within groups: Σ f² = Σ_g n_gb (1 − n_gb/n_g);  its sums against demeaned columns are plain sums
        share = joint / own.size[:, None]
        square = (joint * (1.0 - share)).sum(axis=0)
        cube = (joint * (1.0 - share) * (1.0 - 2.0 * share)).sum(axis=0)
        project = self._sums(factor.cell, self.Q.T, k)  # (d, cells)
        variance = square - (project**2).sum(axis=0)
        unfitted = variance > criteria.min_cell_share_unfitted * np.maximum(square, 1.0)
        usable = (count >= criteria.min_cell_events) & unfitted
        sums = (summed - self.along.T @ project)[:, usable] / np.sqrt(variance[usable])
        raw = np.bincount(factor.cell, own.value, k) / np.maximum(count, 1.0)
        total = normal_score(sums.sum(axis=0), skewness * cube[usable] / variance[usable] ** 1.5)
        cells = [
            Cell(name, factor.name, factor.labels[b], float(total[i]), int(count[b]), float(raw[b]))
            for i, b in enumerate(np.flatnonzero(usable))
        ]
        return cells, sums


def normal_score(standardised, skewness) -> np.ndarray:
    """The standard normal value as rare as a standardised sum of this skewness, both (m,).

    The sum is taken for a χ² with as many degrees of freedom as have its skewness, and that brought to a normal law by
    its cube root (Wilson & Hilferty 1931, PNAS 17, 684).
    """
    standardised = np.asarray(standardised, dtype=np.float64)
    skewness = np.broadcast_to(np.asarray(skewness, dtype=np.float64), standardised.shape)
    sign = np.where(skewness < 0.0, -1.0, 1.0)
    negligible_skewness = 1e-3  # a score of 5 moves by 4e-3
    inverse = np.maximum(np.abs(skewness), negligible_skewness) ** 2 / 8.0  # of the degrees of freedom
    ratio = np.maximum(1.0 + sign * standardised * np.sqrt(2.0 * inverse), 0.0)
    normal = sign * (np.cbrt(ratio) - (1.0 - 2.0 * inverse / 9.0)) / np.sqrt(2.0 * inverse / 9.0)
    return np.where(np.abs(skewness) < negligible_skewness, standardised, normal)


def _last_residual(likelihood: EventTimes, e: np.ndarray) -> np.ndarray:
    """(n,) residual of the same pixel's previous event in the same recording, 0 where it has none."""
    order = np.lexsort((likelihood.time_s, likelihood.pixel, likelihood.recording_of_event))
    key = likelihood.recording_of_event[order] * likelihood.pixels + likelihood.pixel[order]
    last = np.zeros(len(e))
    follows = np.flatnonzero(key[1:] == key[:-1]) + 1
    last[order[follows]] = e[order[follows - 1]]
    return last


def _memory(e, last, factor: Factor, pixel, pixels: int, min_events: int) -> tuple[list[Cell], np.ndarray]:
    """Cells of e · (residual before)."""
    k = len(factor.labels)
    variance = np.bincount(factor.cell, last**2, k)
    count = np.bincount(factor.cell, last != 0.0, k)
    usable = count >= min_events
    sums = np.bincount(pixel * k + factor.cell, e * last, pixels * k).reshape(pixels, k)
    sums = sums[:, usable] / np.sqrt(variance[usable])
    mean = np.bincount(factor.cell, e * last, k) / np.maximum(count, 1)
    cells = [
        Cell("memory", factor.name, factor.labels[b], float(sums[:, i].sum()), int(count[b]), float(mean[b]))
        for i, b in enumerate(np.flatnonzero(usable))
    ]
    return cells, sums


def flip_signs(sums: np.ndarray, seed: int) -> float | None:
    """p of the largest studentised |Σ over units| of sums (units, cells) under random signs of whole units (pixels, or
    stretches of time); None for too few units."""
    shown = sums[np.abs(sums).sum(axis=1) > 0]
    min_units = 8  # to flip the signs of: 2⁻⁷, the least p of fewer, tells nothing at a chance of 1 %
    if len(shown) < min_units:
        return None
    scale = np.sqrt((shown**2).sum(axis=0))
    scaled = shown / np.where(scale > 0, scale, 1.0)
    observed = np.abs(scaled.sum(axis=0)).max()
    flips = 1999  # resolves p to 5e-4
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], (flips, len(shown)))
    largest = np.abs(signs @ scaled).max(axis=1)
    return float((1 + np.sum(largest >= observed - 1e-12)) / (1 + flips))
