"""What a likelihood that does not know an effect makes of it, found by simulation (indirect inference).

The model with the effect is simulated, with as many pixels under the same light, and fitted in the same way as the
measurement.  What the refit is off by is taken back from the parameters (Gouriéroux, Monfort & Renault 1993, J. Appl.
Econometrics 8, S85), and of the maps only what the simulated replicates do not show counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri_exp
from scipy.stats import t as student

from pixelid.fit.again import simulate_again
from pixelid.fit.cache import FitCache
from pixelid.fit.maximise import Maximum, maximise
from pixelid.gap.criteria import Criteria
from pixelid.gap.detect.diagnostics import Diagnostics, diagnose
from pixelid.gap.detect.maps import Cell, Scores, chance_of_largest
from pixelid.gap.detect.pixels import PixelEvidence
from pixelid.likelihood.event_times import EventTimes
from pixelid.likelihood.shot_noise import Division, share_out
from pixelid.model.model import Model

# Standard error (log units) of a coordinate beyond which it is left where it is (nothing in the events pulls it back),
# and the farthest that one is shifted: the correction is first order.
MAX_KNOWN_ERROR, MAX_SHIFT = 0.3, 0.3
MAX_BACKGROUND_RATIO = 3.0  # to the measured number of background events: a refit with more ended at a lesser optimum
NOTHING_TOLD = Division(1e-300, 1.0, np.inf, 0.0, 1.0)  # of the noise in a replicate without a usable event
PRIOR_DEGREES = 10.0  # of freedom that all cells of a kind lend to the spread of one


@dataclass(frozen=True)
class Corrected:
    """A model corrected for what the likelihood does not know.

    Attributes:
        model: Such that a fit to what it simulates gives the fitted model.
        shift: (d,) of the coordinates, from fitted to corrected.
        seen: Diagnostics with only what replicates do not show.
        widened: (d,) by how many times the coordinates err more than the likelihood says.
    """

    model: Model
    shift: np.ndarray
    seen: Diagnostics
    widened: np.ndarray


@dataclass(frozen=True)
class Replicate:
    """The model fitted to one simulated session (or to the measured one).

    Attributes:
        x: (d,) where.
        scores: Of its maps.
        background: (2,) OFF and ON events without a cause.
        division: Of its noise, by the filter.
    """

    x: np.ndarray
    scores: Scores
    background: np.ndarray
    division: Division


def variance_said(fit: Maximum) -> np.ndarray:
    """(d,) variance of the coordinates by the likelihood's information."""
    return np.maximum(np.diag(np.linalg.pinv(fit.information)), 0.0)


def well_known(fit: Maximum) -> np.ndarray:
    """(d,) which coordinates the events hold."""
    error = np.sqrt(variance_said(fit))
    return (error > 0) & (error < MAX_KNOWN_ERROR)


def moderated(own, usual, replicates: int):
    """Variances between a few replicates, with `PRIOR_DEGREES` of freedom at what is usual (Smyth 2004)."""
    degrees = replicates - 1
    return (PRIOR_DEGREES * usual + degrees * own) / (PRIOR_DEGREES + degrees)


def make_replicate(
    evidence: PixelEvidence,
    truth: Model,
    fit: Maximum,
    seen: Diagnostics,
    criteria: Criteria,
    seed: int,
    cache: FitCache | None = None,
) -> Replicate:
    """A session of as many pixels under the same light, simulated under `truth`, fitted like the one measured."""
    training = evidence.training
    made = EventTimes(simulate_again(training.recordings, truth, training.flat_pixels, None, seed))
    likelihood = made.weighed(truth.circuit())
    refit = maximise(likelihood, fit.model, tolerance=0.05, max_steps=25, cache=cache)
    if refit.unexplained > MAX_BACKGROUND_RATIO * (seen.maps.background + MAX_BACKGROUND_RATIO):
        start = fit.model.set({name: truth.values[name] for name in fit.coordinates.names if name in truth.values})
        start = replace(start, nuisances=truth.nuisances)
        again = maximise(likelihood, start, tolerance=0.05, max_steps=40, cache=cache)
        refit = again if again.value > refit.value else refit
    left = diagnose(likelihood, refit, criteria, seed, background_fraction=None, like=seen.factors)
    division = share_out(likelihood, refit.model.circuit(), seed, free_jitter=True) or NOTHING_TOLD
    background = background_by_polarity(likelihood, left.residual.background)
    return Replicate(refit.x, left.maps.scores, background, division)


def background_by_polarity(likelihood: EventTimes, background: np.ndarray) -> np.ndarray:
    """(2,) OFF and ON events without a cause."""
    return np.bincount((likelihood.sign > 0).astype(np.int64), background, 2)


def subtract_replicates(
    seen: Diagnostics, shown: Sequence[Scores], clear: float = 0.0
) -> tuple[tuple[Cell, ...], float]:
    """(the cells by |score| with what replicates show taken out, p of the largest).

    clear: standard errors from zero that the mean of the replicates must be in a cell to be taken out of it
    """

    def off(cell: Cell) -> float:
        return abs(sum(s.get((cell.response, cell.label), 0.0) for s in shown)) / np.sqrt(len(shown))

    apart = tuple(c for c in seen.maps.cells if off(c) >= clear)
    others = [c for c in seen.maps.cells if off(c) < clear]
    left = sorted([*_subtracted(apart, shown), *others], key=lambda c: -abs(c.score))
    return tuple(left), chance_of_largest(left)


def _subtracted(cells: tuple[Cell, ...], scores: Sequence[Scores]) -> list[Cell]:
    """The cells with what replicates show on average taken out, as normal scores.

    A cell's spread over replicates is estimated from few, so it borrows from all cells of its kind: a moderated t
    (Smyth 2004, Stat. Appl. Genet. Mol. Biol. 3, 3), never narrower than the 1 of an exact likelihood.
    """
    n = len(scores)
    table = np.array([[s.get((c.response, c.label), np.nan) for s in scores] for c in cells]).reshape(len(cells), n)
    mean = np.where(np.isnan(table).any(axis=1), 0.0, table.mean(axis=1))
    variance = table.var(axis=1, ddof=1) if n > 1 else np.full(len(cells), np.nan)
    kinds = np.array([c.response for c in cells])
    left = []
    for cell, m, v in zip(cells, mean, variance, strict=True):
        alike = variance[(kinds == cell.response) & np.isfinite(variance)]
        usual = float(alike.mean()) if len(alike) else 1.0
        own = v if np.isfinite(v) else usual
        score = (cell.score - m) / np.sqrt(max(1.0, moderated(own, usual, n)) * (1.0 + 1.0 / n))
        tail = student.logsf(abs(score), PRIOR_DEGREES + n - 1)
        left.append(replace(cell, score=float(np.sign(score) * -ndtri_exp(tail))))
    return left
