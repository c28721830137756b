"""What an approximate likelihood gets wrong, found by simulation and taken back (indirect inference).

Some effects enter the density of single events approximately (`APPROXIMATE`): a jittered timestamp hides when the pixel
was reset, which ties neighbouring events together.  The fit then settles a little off, and its residuals show cells
that no missing effect has made.  Both can be measured: the grown model is simulated, with as many pixels under the same
light, and fitted in the same way.  What the refit is off by is taken back from the parameters (Gouriéroux, Monfort &
Renault 1993, J. Appl. Econometrics 8, S85), and of the maps only what the simulated maps do not show counts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm

from pixelid.gap.climb import Climbed, climbed
from pixelid.gap.covariates import factors
from pixelid.gap.maps import Cell, maps
from pixelid.gap.residuals import residuals, tangents
from pixelid.gap.workbench import Look, Workbench
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import Model
from pixelid.simulate import simulate

APPROXIMATE = ("timestamp_jitter",)
TURNS, REPLICAS = 2, 2  # the second turn simulates what the first has corrected


@dataclass(frozen=True)
class Corrected:
    """model: such that a fit to what it simulates gives the fitted model;  shift: (d,) from fitted to corrected;
    spread: what the shift's own uncertainty multiplies standard errors by;  look: with only what replicas do not show
    """

    model: Model
    shift: np.ndarray
    spread: float
    look: Look


def corrected(bench: Workbench, current: Climbed, seen: Look, seed: int) -> Corrected:
    """The fitted model and its maps, cleared of what the approximation puts into them."""
    coordinates = current.coordinates
    lower, upper = coordinates.bounds()
    truth, bias = current.x, []
    scores: list[dict] = []
    for turn in range(TURNS):
        scores = []
        for copy in range(REPLICAS):
            refit, found = _refitted(bench, coordinates.model_at(truth), current, seen, seed + 7919 * (1 + turn) + copy)
            bias.append(refit.x - truth)
            scores.append(found)
        truth = np.clip(current.x - np.mean(bias, axis=0), lower, upper)
    many = len(bias)
    spread = float(np.sqrt(1.0 + 1.0 / many))
    cells = sorted((_cleared(cell, scores) for cell in seen.maps.cells), key=lambda c: -abs(c.score))
    top = abs(cells[0].score) if cells else 0.0
    p = max(seen.maps.p, float(min(1.0, len(cells) * 2.0 * norm.sf(top))))
    look = replace(seen, maps=replace(seen.maps, cells=tuple(cells), p=p), p=p)
    return Corrected(coordinates.model_at(truth), truth - current.x, spread, look)


def _refitted(bench: Workbench, truth: Model, current: Climbed, seen: Look, seed: int) -> tuple[Climbed, dict]:
    """(the model fitted to one simulated session, its map: (response, label) → score)."""
    runs = []
    for i, r in enumerate(bench.train.recordings):
        assert r.stimulus is not None
        run = simulate(truth, r.stimulus, width=bench.train.pixels, height=1, seed=seed + 101 * i, sensor_seed=seed)
        events = replace(run.events, tick_ns=r.events.tick_ns)
        runs.append(replace(r, events=events))
    likelihood = EventTimes(runs)
    likelihood.weigh_clock(truth.circuit())
    refit = climbed(likelihood, current.model, tolerance=0.05, max_steps=25)
    here = residuals(likelihood, refit.model.circuit())
    tangent = tangents(likelihood, refit.coordinates, refit.x, here)
    found = maps(likelihood, here, tangent, factors(likelihood, here, like=seen.factors), seed)
    return refit, {(c.response, c.label): c.score for c in found.cells}


def _cleared(cell: Cell, scores: list[dict]) -> Cell:
    key = (cell.response, cell.label)
    known = [s[key] for s in scores if key in s]
    if not known:
        return cell
    return replace(cell, score=(cell.score - float(np.mean(known))) / float(np.sqrt(1.0 + 1.0 / len(known))))
