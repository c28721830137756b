"""Shot noise, which no density of single events knows: found by simulating it (indirect inference).

To the likelihood, noise before the photoreceptor is threshold noise; what gives it away is where events scatter, that
an event's deviation reverses the one before, and that pixels fire in constant light.  So the noise that the fit calls
the thresholds' is shared out: a fraction f of its variance to shot noise, whose density follows from what one replica
scatters more, the rest to the thresholds.  Replicas at a few f, fitted like the measurement, show maps; the f whose
maps come nearest is taken, and shot noise is named when nothing then tells measurement and replicas apart.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm

from pixelid import stages
from pixelid.gap.climb import Climbed
from pixelid.gap.replicas import FARTHEST, Corrected, Replica, cleared, replica, strays_of, well_known
from pixelid.gap.workbench import Look, Workbench
from pixelid.model.model import Model

EFFECT, STRENGTH, NOISE = "shot_noise", "shot_noise.density", "threshold_sigma"
NONE = 0.02  # as good as no shot noise
CLEAR, LEFT = 20.0, 0.3  # nats by which replicas without shot noise must be off; part of that which may remain with it
SHARES = (0.3, 0.6, 0.8, 0.95)
TRIES, ENOUGH, TOO_MUCH = 4, 0.1, 2.0  # relative growth of the noise variance by which the first replica must differ
FINAL = 4  # replicas at the share taken
FAR = 10.0  # standard deviations: cells that differ by more count as this
COARSE = 0.05  # part of what shot noise explains by which replicas of the best density may be off
UNSURE = 0.3  # relative half width of the interval at least: single replicas calibrate the density
UNEVEN = 2.0  # variance of the number of strays over Poisson's: pixels share thresholds


@dataclass(frozen=True)
class ShotNoise:
    """density, interval: found;  corrected: the model with it, and what is left beside its replicas;
    gain: nats by which the maps come nearer (half the sum of squared scores)"""

    density: float
    interval: tuple[float, float]
    corrected: Corrected
    gain: float


def shot_noise(bench: Workbench, current: Climbed, seen: Look, seed: int) -> ShotNoise | None:
    """Shot noise that explains what is left under a fitted model.

    None where a replica's noise cannot be told, or replicas with it come little nearer than those without.
    """
    if NOISE not in current.coordinates.names:
        return None
    shared = _Shared(bench, current, seen, seed)
    if not shared.calibrated():
        return None
    scores = {(c.response, c.label): c.score for c in seen.maps.cells}
    measured = Replica(current.x, scores, strays_of(bench.train, seen.residual.stray))
    nothing, *far = [_distance(measured, shared.replica(share)) for share in (NONE, *SHARES)]
    a, b, _ = np.polyfit(SHARES, far, 2)
    share = float(np.clip(-b / (2.0 * a), 0.05, 0.97)) if a > 0 else SHARES[int(np.argmin(far))]
    shared.replica(share)
    model, density = shared.truth(share)
    final = [replica(bench, model, current, seen, seed + 2003 + i) for i in range(FINAL)]
    among = [_distance(one, other) for one, other in itertools.combinations(final, 2)]
    floor, off = float(np.median(among)), float(np.median([_distance(measured, r) for r in final]))
    if nothing - floor < CLEAR or off - floor > LEFT * (nothing - floor):
        return None
    cells, _ = cleared(seen, final)
    # replicas scatter about each other as the measurement about them, heavy tails of cells and all; and what they
    # are simulated from is itself known to a part of what it explains only
    chance = np.hypot(max(float(np.std(among, ddof=1)), np.sqrt(0.5 * len(scores))), COARSE * (nothing - floor))
    p = 2.0 * float(norm.sf(max(off - floor, 0.0) / chance))
    usual = np.mean([r.strays for r in final], axis=0)
    chance = np.sqrt(UNEVEN * (usual + 1.0) * (1.0 + 1.0 / FINAL))
    p = min(p, 2.0 * len(usual) * float(norm.sf(np.abs((measured.strays - usual) / chance).max())), 1.0)
    look = replace(seen, maps=replace(seen.maps, cells=cells, p=p), p=p)
    error = max(1.96 * (1.0 / np.sqrt(a) if a > 0 else 1.0) * np.sqrt(1.0 + 1.0 / FINAL) / share, UNSURE)
    interval = (max(1.0 - error, 0.0) * density, (1.0 + error) * density)
    before = 0.5 * sum(min(c.score**2, FAR**2) for c in seen.maps.cells)
    after = 0.5 * sum(min(c.score**2, FAR**2) for c in cells)
    return ShotNoise(density, interval, Corrected(model, _vector(model, current) - current.x, look), before - after)


class _Shared:
    """The noise of a fit, shared out between thresholds and shot noise.

    per_density: noise variance that the fit sees per density;  bias: (d,) what the other coordinates are off by when
    all of the noise is shot noise;  both follow the latest replica.
    """

    def __init__(self, bench: Workbench, current: Climbed, seen: Look, seed: int) -> None:
        self.bench, self.current, self.seen, self.seed = bench, current, seen, seed
        self.at = current.coordinates.names.index(NOISE)
        self.variance = float(current.values[NOISE]) ** 2
        self.known = well_known(current)
        self.known[self.at] = False
        self.bounds = current.coordinates.bounds()
        self.bias = np.zeros(len(current.x))
        self.per_density = np.nan
        self.copies = 0

    def calibrated(self) -> bool:
        """Find a density whose noise the fit can tell beside the noise it has already."""
        density = 0.1 * stages.effect(EFFECT).parameters[0].value
        for _ in range(TRIES):
            self._learn(self.current.model, self.current.x, density)
            grown = self.per_density * density / self.variance
            if ENOUGH < grown < TOO_MUCH:
                return True
            density *= float(np.clip(0.5 / max(grown, 0.02), 0.03, 30.0))
        return False

    def truth(self, share: float) -> tuple[Model, float]:
        """(model with its share of the noise as shot noise, density)."""
        x = self.current.x - share * self.bias
        x[self.at] = self.current.x[self.at] + 0.5 * np.log(1.0 - share)
        density = share * self.variance / self.per_density
        return _with(self.current.coordinates.model_at(np.clip(x, *self.bounds)), density), density

    def replica(self, share: float) -> Replica:
        """One replica at a share, which the next ones learn from."""
        model, density = self.truth(share)
        return self._learn(model, _vector(model, self.current), density)

    def _learn(self, model: Model, x: np.ndarray, density: float) -> Replica:
        self.copies += 1
        made = replica(self.bench, _with(model, density), self.current, self.seen, self.seed + 31 * self.copies)
        extra = float(np.exp(2.0 * made.x[self.at]) - np.exp(2.0 * x[self.at]))
        self.per_density = max(extra, 1e-3 * self.variance) / density
        share = density * self.per_density / self.variance
        self.bias = np.where(self.known, np.clip((made.x - x) / share, -FARTHEST, FARTHEST), 0.0)
        return made


def _with(model: Model, density: float) -> Model:
    return model.with_effect(EFFECT, {"density": density}).fix({STRENGTH: None})


def _vector(model: Model, current: Climbed) -> np.ndarray:
    """(d,) the model's values in the coordinates of the fit."""
    return np.array([p.to_coordinate(model.values[p.name]) for p in current.coordinates.parameters])


def _distance(one: Replica, other: Replica) -> float:
    """Half the squared distance of two maps and their strays, in the chance of their difference."""
    maps = sum(
        min((score - other.scores[key]) ** 2 / 2.0, FAR**2) for key, score in one.scores.items() if key in other.scores
    )
    strays = np.minimum((one.strays - other.strays) ** 2 / (2.0 * UNEVEN * (other.strays + 1.0)), FAR**2)
    return 0.5 * float(maps + strays.sum())
