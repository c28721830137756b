"""Shot noise, which no density of single events knows: found by simulating it (indirect inference).

To the likelihood, noise before the photoreceptor is threshold noise; what gives it away is where events scatter, that
an event's deviation reverses the one before, and that pixels fire in constant light.  So the noise that the fit calls
the thresholds' is shared out: a share of its variance to shot noise, whose density follows from what replicas scatter
more, the rest to the thresholds.  Replicas at several shares, fitted like the measurement, show how each cell of the
maps depends on the share; the share whose maps come nearest is taken, and shot noise is named when nothing then tells
measurement and replicas apart.  How sure the share is, replicas say whose own is left out and then looked for.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm

from pixelid import stages
from pixelid.gap.climb import Climbed
from pixelid.gap.replicas import FARTHEST, POOLED, Corrected, Replica, cleared, replica, strays_of, well_known
from pixelid.gap.workbench import Look, Workbench
from pixelid.model.model import Model

EFFECT, STRENGTH, NOISE = "shot_noise", "shot_noise.density", "threshold_sigma"
NONE = 0.02  # as good as no shot noise
CLEAR, LEFT = 20.0, 0.3  # nats by which replicas without shot noise must be off; part of that which may remain with it
HOPELESS = 0.6  # part of what is off that may remain with the best share tried, at most, for closer ones to be tried
SHARES = (0.3, 0.6, 0.8, 0.95)
LEAST, MOST = 0.05, 0.99  # share
TELLING = 0.25  # share from which a replica tells what a density adds, and checks how well its share is found
TRIES, ENOUGH, TOO_MUCH = 4, 0.1, 2.0  # relative growth of the noise variance by which the first replica must differ
FINAL, SAME = 4, 0.1  # replicas at the share taken; by how much it may differ from the one they leave
FAR = 10.0  # standard deviations: cells that differ by more count as this
BENT = 20.0  # scores beyond grow as their logarithm only: there the share does not move them evenly
BROKEN = 0.5  # relative: a replica whose noise is so far from the others' has lost its way
COARSE = 0.05  # part of what shot noise explains by which replicas of the best density may be off
UNSURE, DRIFTING = 0.05, 1.3  # relative half width of the interval at least; replicas' other parameters are off, too
VAST = 30.0  # as `FAR`, for a first sight
SPREADING, REVERSING = 1.5, 5.0  # mean square score of spreads over that of levels; of deviations in a row, either way
UNEVEN = 2.0  # variance of the number of strays over Poisson's: pixels share thresholds


@dataclass(frozen=True)
class ShotNoise:
    """density, interval: found;  corrected: the model with it, and what is left beside its replicas;
    gain: nats by which the maps come nearer (half the sum of squared scores);  left: by which they are still off"""

    density: float
    interval: tuple[float, float]
    corrected: Corrected
    gain: float
    left: float


def scattering(seen: Look) -> bool:
    """Whether the maps look like shot noise at first sight: spreads are off, not levels, and deviations reverse."""
    scores = {kind: [c.score for c in seen.maps.cells if c.response == kind] for kind in ("level", "spread", "memory")}
    level, spread = (float(np.mean(np.clip(scores[kind], -VAST, VAST) ** 2)) for kind in ("level", "spread"))
    memory = [0.0, *scores["memory"]]
    return spread > SPREADING * level and min(memory) < -REVERSING and max(memory) > REVERSING


def shot_noise(bench: Workbench, current: Climbed, seen: Look, seed: int) -> ShotNoise | None:
    """Shot noise that explains what is left under a fitted model.

    None where a replica's noise cannot be told, or replicas with it come little nearer than those without.
    """
    if NOISE not in current.coordinates.names:
        return None
    shared = _Shared(bench, current, seen, seed)
    if not shared.calibrated():
        return None
    measured = Replica(current.x, seen.maps.scores, strays_of(bench.train, seen.residual.stray))
    nothing, *far = [_distance(measured, shared.replica(share)) for share in (NONE, *SHARES)]
    alike = 0.5 * len(measured.scores)  # between replicas of one model
    if nothing - min(far) < 0.5 * CLEAR or min(far) - alike > HOPELESS * (nothing - alike):
        return None
    share = shared.nearest(measured)
    final = [shared.replica(share) for _ in range(FINAL)]
    if abs(shared.nearest(measured) - share) > SAME:
        share = shared.nearest(measured)
        final = [shared.replica(share) for _ in range(FINAL)]
    share = shared.nearest(measured)
    model, density = shared.truth(share)
    among = [_distance(one, other) for one, other in itertools.combinations(final, 2)]
    floor, off = float(np.median(among)), float(np.median([_distance(measured, r) for r in final]))
    if nothing - floor < CLEAR or off - floor > LEFT * (nothing - floor) or not shared.sound(FINAL):
        return None
    cells, _ = cleared(seen, [r.scores for r in final])
    # replicas scatter about each other as the measurement about them, heavy tails of cells and all; and what they
    # are simulated from is itself known to a part of what it explains only
    chance = np.hypot(max(float(np.std(among, ddof=1)), np.sqrt(alike)), COARSE * (nothing - floor))
    p = 2.0 * float(norm.sf(max(off - floor, 0.0) / chance))
    usual = np.mean([r.strays for r in final], axis=0)
    chance = np.sqrt(UNEVEN * (usual + 1.0) * (1.0 + 1.0 / FINAL))
    error = shared.error(share)
    chance = np.hypot(chance, usual * shared.strays_per_density() * error)
    p = min(p, 2.0 * len(usual) * float(norm.sf(np.abs((measured.strays - usual) / chance).max())), 1.0)
    look = replace(seen, maps=replace(seen.maps, cells=cells, p=p), p=p)
    half = max(1.96 * error, UNSURE)
    interval = (density * np.exp(-half), density * np.exp(half))
    before = 0.5 * sum(min(c.score**2, FAR**2) for c in seen.maps.cells)
    after = 0.5 * sum(min(c.score**2, FAR**2) for c in cells)
    corrected = Corrected(model, _vector(model, current) - current.x, look)
    return ShotNoise(density, interval, corrected, before - after, off - floor)


@dataclass(frozen=True)
class _Made:
    """A replica, the density and noise variance it was simulated with, and by how much its coordinates then moved."""

    replica: Replica
    density: float
    thresholds: float
    variance: float
    moved: np.ndarray

    @property
    def share(self) -> float:
        """Of its noise, as a fit sees it, that is shot noise."""
        return float(np.clip(1.0 - self.thresholds / self.variance, 0.0, 1.0))

    @property
    def per_density(self) -> float:
        """Noise variance that a fit sees per density."""
        return (self.variance - self.thresholds) / self.density


class _Shared:
    """The noise of a fit, shared out between thresholds and shot noise; it learns from every replica made."""

    def __init__(self, bench: Workbench, current: Climbed, seen: Look, seed: int) -> None:
        self.bench, self.current, self.seen, self.seed = bench, current, seen, seed
        self.at = current.coordinates.names.index(NOISE)
        self.variance = float(current.values[NOISE]) ** 2
        self.known = well_known(current)
        self.known[self.at] = False
        self.bounds = current.coordinates.bounds()
        self.made: list[_Made] = []

    def calibrated(self) -> bool:
        """Find a density whose noise the fit can tell beside the noise it has already."""
        density = 0.1 * stages.effect(EFFECT).parameters[0].value
        for _ in range(TRIES):
            made = self._make(self.current.model, self.current.x, density)
            grown = (made.variance - made.thresholds) / self.variance
            if ENOUGH < grown < TOO_MUCH:
                self.made.append(made)
                return True
            density *= float(np.clip(0.5 / max(grown, 0.02), 0.03, 30.0))
        return False

    def truth(self, share: float) -> tuple[Model, float]:
        """(model with its share of the noise as shot noise, density)."""
        telling = self._telling()
        # what all of the noise being shot noise would move the other coordinates by
        bias = np.median([np.clip(m.moved / m.share, -FARTHEST, FARTHEST) for m in telling], axis=0)
        x = self.current.x - share * np.where(self.known, bias, 0.0)
        x[self.at] = self.current.x[self.at] + 0.5 * np.log(1.0 - share)
        density = share * self.variance / float(np.median([m.per_density for m in telling]))
        return _with(self.current.coordinates.model_at(np.clip(x, *self.bounds)), density), density

    def replica(self, share: float) -> Replica:
        """One replica at a share, which the next ones learn from."""
        model, density = self.truth(share)
        self.made.append(self._make(model, _vector(model, self.current), density))
        return self.made[-1].replica

    def sound(self, fewest: int) -> bool:
        """Whether enough replicas with much shot noise have kept their way."""
        return len(_telling(self._sound())) >= fewest

    def nearest(self, measured: Replica) -> float:
        """The share whose maps come nearest to the measured ones."""
        return float(np.clip(_found(measured, self._sound()), LEAST, MOST))

    def error(self, share: float) -> float:
        """Standard error of the log density at a share: what replicas are off by whose own share is looked for, and
        how far apart their noise per density is."""
        sound = self._sound()
        telling = _telling(sound)
        off = [_found(one.replica, [m for m in sound if m is not one]) - one.share for one in telling]
        rms = DRIFTING * float(np.sqrt(np.mean(np.square(off))))
        apart = float(np.std(np.log([m.per_density for m in telling])))
        return float(np.hypot(rms / share, apart * np.sqrt(1.0 + 1.0 / len(telling))))

    def strays_per_density(self) -> np.ndarray:
        """(2,) d log strays / d log density: strays tell no more than how well the density is known."""
        telling = _telling(self._sound())
        density = np.log([m.density for m in telling])
        strays = np.log([m.replica.strays + 1.0 for m in telling])
        return np.abs(np.polyfit(density - density.mean(), strays, 1)[0])

    def _telling(self) -> list[_Made]:
        return _telling(self.made) or self.made[:1]

    def _sound(self) -> list[_Made]:
        """Replicas that have not lost their way."""
        usual = float(np.median([m.per_density for m in self._telling()]))
        return [m for m in self.made if abs(m.variance - m.thresholds - usual * m.density) < BROKEN * m.variance]

    def _make(self, model: Model, x: np.ndarray, density: float) -> _Made:
        seed = self.seed + 31 * (len(self.made) + 1)
        made = replica(self.bench, _with(model, density), self.current, self.seen, seed)
        thresholds, variance = (float(np.exp(2.0 * at[self.at])) for at in (x, made.x))
        return _Made(made, density, thresholds, variance, made.x - x)


def _telling(made: list[_Made]) -> list[_Made]:
    return [m for m in made if m.share > TELLING]


def _found(one: Replica, made: list[_Made]) -> float:
    """The share of a replica (or of the measurement): each cell's score follows a parabola over the others' shares."""
    keys = [key for key in one.scores if all(key in m.replica.scores for m in made)]
    shares = np.array([m.share for m in made])
    scores = _bent([[m.replica.scores[key] for key in keys] for m in made])
    curves, *_ = np.linalg.lstsq(np.vander(shares, 3), scores, rcond=None)
    spare = max(len(made) - 3, 1)
    own = np.sum((scores - np.vander(shares, 3) @ curves) ** 2, axis=0) / spare
    variance = np.maximum((spare * own + POOLED * max(float(np.mean(own)), 1.0)) / (spare + POOLED), 1.0)
    tried = np.linspace(0.0, 1.1, 1101)
    off = (_bent([one.scores[key] for key in keys]) - np.vander(tried, 3) @ curves) ** 2 / variance
    return float(tried[np.argmin(off.sum(axis=1))])


def _bent(scores) -> np.ndarray:
    return BENT * np.arcsinh(np.asarray(scores, dtype=np.float64) / BENT)


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
