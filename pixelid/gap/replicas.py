"""What a likelihood that does not know an effect makes of it, found by simulation (indirect inference).

The model with the effect is simulated, with as many pixels under the same light, and fitted in the same way as the
measurement.  What the refit is off by is taken back from the parameters (Gouriéroux, Monfort & Renault 1993, J. Appl.
Econometrics 8, S85), and of the maps only what the simulated maps do not show counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri_exp
from scipy.stats import norm
from scipy.stats import t as student

from pixelid.gap.climb import Climbed, climbed
from pixelid.gap.covariates import factors
from pixelid.gap.maps import Cell, Scores, maps
from pixelid.gap.residuals import residuals, tangents
from pixelid.gap.side_by_side import side_by_side
from pixelid.gap.workbench import Look, Workbench, finer
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import Model
from pixelid.recordings.recording import Recording
from pixelid.simulate import simulate

KNOWN = 0.3  # standard error (log units) of a coordinate beyond which it is left where it is: nothing pulls it back
FARTHEST = 0.3  # shift of a coordinate
STUCK = 3.0  # times the measured number of strays: more than a replica should have
POOLED = 10.0  # degrees of freedom that all cells of a kind lend to the spread of one


@dataclass(frozen=True)
class Corrected:
    """model: such that a fit to what it simulates gives the fitted model;  shift: (d,) from fitted to corrected;
    look: with only what replicas do not show
    """

    model: Model
    shift: np.ndarray
    look: Look


@dataclass(frozen=True)
class Replica:
    """The model fitted to one simulated session.

    x: where;  scores: its map;  strays: (2,) OFF and ON events without a cause
    """

    x: np.ndarray
    scores: Scores
    strays: np.ndarray


def well_known(current: Climbed) -> np.ndarray:
    """(d,) which coordinates the events hold."""
    error = np.sqrt(np.maximum(np.diag(np.linalg.pinv(current.information)), 0.0))
    return (error > 0) & (error < KNOWN)


def simulated_again(
    recordings: Sequence[Recording], truth: Model, pixels: int, between: str | None, seed: int
) -> list[Recording]:
    """The recordings with the events that a sensor of so many pixels would have given under `truth`.

    between: how their stimuli run between samples; None: as they are
    """

    def copied(job: tuple[int, Recording]) -> Recording:
        i, r = job
        light = r.stimulus if between is None else finer(r, between).stimulus
        assert light is not None
        run = simulate(truth, light, width=pixels, height=1, seed=seed + 101 * i, sensor_seed=seed)
        return replace(r, events=replace(run.events, tick_ns=r.events.tick_ns))

    return side_by_side(copied, enumerate(recordings))


def replica(bench: Workbench, truth: Model, current: Climbed, seen: Look, seed: int) -> Replica:
    """A session of as many pixels under the same light, simulated under `truth`, fitted like the one measured."""
    likelihood = EventTimes(simulated_again(bench.train.recordings, truth, bench.train.pixels, None, seed))
    likelihood.weigh_clock(truth.circuit())
    refit = climbed(likelihood, current.model, tolerance=0.05, max_steps=25)
    if refit.strays > STUCK * (seen.maps.strays + STUCK):  # a climb that lost its way: from the truth, then
        start = current.model.set({name: truth.values[name] for name in current.coordinates.names})
        again = climbed(likelihood, start, tolerance=0.05, max_steps=40)
        refit = again if again.value > refit.value else refit
    here = residuals(likelihood, refit.model.circuit())
    tangent = tangents(likelihood, refit.coordinates, refit.x, here)
    found = maps(likelihood, here, tangent, factors(likelihood, refit.model.circuit(), here, like=seen.factors), seed)
    return Replica(refit.x, found.scores, strays_of(likelihood, here.stray))


def strays_of(likelihood: EventTimes, stray: np.ndarray) -> np.ndarray:
    """(2,) OFF and ON events without a cause."""
    return np.bincount((likelihood.sign > 0).astype(np.int64), stray, 2)


def cleared(seen: Look, shown: Sequence[Scores]) -> tuple[tuple[Cell, ...], float]:
    """(the cells by |score| with what replicas show taken out, p of the largest)."""
    cells = sorted(_cleared(seen.maps.cells, shown), key=lambda c: -abs(c.score))
    top = abs(cells[0].score) if cells else 0.0
    return tuple(cells), float(min(1.0, len(cells) * 2.0 * norm.sf(top)))


def _cleared(cells: tuple[Cell, ...], scores: Sequence[Scores]) -> list[Cell]:
    """The cells with what replicas show on average taken out, as normal scores.

    A cell's spread over replicas is estimated from few, so it borrows from all cells of its kind: a moderated t (Smyth
    2004, Stat. Appl. Genet. Mol. Biol. 3, 3), never narrower than the 1 of an exact likelihood.
    """
    n = len(scores)
    table = np.array([[s.get((c.response, c.label), np.nan) for s in scores] for c in cells]).reshape(len(cells), n)
    mean = np.where(np.isnan(table).any(axis=1), 0.0, table.mean(axis=1))
    variance = table.var(axis=1, ddof=1) if n > 1 else np.full(len(cells), np.nan)
    kinds = np.array([c.response for c in cells])
    found = []
    for cell, m, v in zip(cells, mean, variance, strict=True):
        alike = variance[(kinds == cell.response) & np.isfinite(variance)]
        usual = float(alike.mean()) if len(alike) else 1.0
        own = v if np.isfinite(v) else usual
        spread = np.sqrt(max(1.0, (POOLED * usual + (n - 1) * own) / (POOLED + n - 1)) * (1.0 + 1.0 / n))
        score = (cell.score - m) / spread
        tail = student.logsf(abs(score), POOLED + n - 1)
        found.append(replace(cell, score=float(np.sign(score) * -ndtri_exp(tail))))
    return found
