"""The noise of a fit, shared out between thresholds and shot noise, and what simulated replicates say of the share."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pixelid import stages
from pixelid.fit.cache import FitCache
from pixelid.fit.maximise import Maximum
from pixelid.gap.detect.diagnostics import Diagnostics
from pixelid.gap.detect.pixels import PixelEvidence
from pixelid.gap.options import Options
from pixelid.gap.shot_noise.replicates import MAX_SHIFT, PRIOR_DEGREES, Replicate, make_replicate, well_known
from pixelid.model.model import Model

EFFECT, STRENGTH, NOISE = "shot_noise", "shot_noise.density", "threshold_sigma"
MIN_SHARE, MAX_SHARE = 0.05, 0.99
MIN_TELLING_SHARE = 0.25  # from which a replicate tells what a density adds, and checks how well its share is found
# Relative growth of the noise variance by which the first replicate must differ, and the densities tried to get there.
CALIBRATION_TRIES, MIN_GROWTH, MAX_GROWTH, WANTED_GROWTH = 4, 0.1, 2.0, 0.5
MAX_NOISE_ERROR = 0.5  # relative: a replicate whose noise is so far from the others' ended at a lesser optimum
LINEAR_SCORE = 20.0  # scores beyond are compressed to their logarithm: there the share does not move them evenly
OTHER_PARAMETERS = 1.3  # times the error of a share found with all else known: replicates' other parameters are off too


@dataclass(frozen=True)
class Made:
    """A replicate, the density and threshold variance it was simulated with, the noise variance that a fit sees in it,
    and by how much its coordinates then moved."""

    replicate: Replicate
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


@dataclass(frozen=True)
class Shares:
    """What is known of how a fit's noise can be shared out.

    Attributes:
        evidence, fit, seen: The fit, what it was fitted to and what it leaves.
        options: Of the search.
        cache: Fits already made.
        made: Replicates so far, from which the next ones are set up.
    """

    evidence: PixelEvidence
    fit: Maximum
    seen: Diagnostics
    options: Options
    cache: FitCache | None
    made: tuple[Made, ...] = ()

    def calibrated(self) -> Shares | None:
        """With a first replicate, at a density whose noise the fit can tell beside the noise it has; None if none."""
        density = 0.1 * stages.effect(EFFECT).parameters[0].value
        for _ in range(CALIBRATION_TRIES):
            made = self._make(self.fit.model, self.fit.x, density)
            grown = (made.variance - made.thresholds) / self._variance
            if MIN_GROWTH < grown < MAX_GROWTH:
                return replace(self, made=(*self.made, made))
            density *= float(np.clip(WANTED_GROWTH / max(grown, 0.02), 0.03, 30.0))
        return None

    def truth(self, share: float) -> tuple[Model, float]:
        """(model with its share of the noise as shot noise, density)."""
        telling = _telling(self.made) or self.made[:1]
        # what all of the noise being shot noise would move the other coordinates by
        bias = np.median([np.clip(m.moved / m.share, -MAX_SHIFT, MAX_SHIFT) for m in telling], axis=0)
        known = well_known(self.fit)
        known[self._noise_index] = False
        x = self.fit.x - share * np.where(known, bias, 0.0)
        x[self._noise_index] = self.fit.x[self._noise_index] + 0.5 * np.log(1.0 - share)
        density = share * self._variance / float(np.median([m.per_density for m in telling]))
        model = self.fit.coordinates.model_at(np.clip(x, *self.fit.coordinates.bounds()))
        return with_shot_noise(model, density), density

    def with_replicate(self, share: float) -> Shares:
        """With one more replicate, at a share."""
        model, density = self.truth(share)
        return replace(self, made=(*self.made, self._make(model, vector(model, self.fit), density)))

    def sound(self, fewest: int) -> bool:
        """Whether enough replicates with much shot noise were fitted as they should."""
        return len(_telling(self._sound())) >= fewest

    def nearest(self, measured: Replicate) -> float:
        """The share whose maps come nearest to the measured ones."""
        return float(np.clip(_nearest(measured, self._sound()), MIN_SHARE, MAX_SHARE))

    def error(self, share: float) -> float:
        """Standard error of the log density at a share: what replicates are off by whose own share is looked for, and
        how far apart their noise per density is."""
        sound = self._sound()
        telling = _telling(sound)
        off = [_nearest(one.replicate, tuple(m for m in sound if m is not one)) - one.share for one in telling]
        rms = OTHER_PARAMETERS * float(np.sqrt(np.mean(np.square(off))))
        apart = float(np.std(np.log([m.per_density for m in telling])))
        return float(np.hypot(rms / share, apart * np.sqrt(1.0 + 1.0 / len(telling))))

    def background_per_density(self) -> np.ndarray:
        """(2,) d log background events / d log density: they tell no more than how well the density is known."""
        telling = _telling(self._sound())
        density = np.log([m.density for m in telling])
        background = np.log([m.replicate.background + 1.0 for m in telling])
        return np.abs(np.polyfit(density - density.mean(), background, 1)[0])

    @property
    def _noise_index(self) -> int:
        return self.fit.coordinates.names.index(NOISE)

    @property
    def _variance(self) -> float:
        return float(self.fit.values[NOISE]) ** 2

    def _sound(self) -> tuple[Made, ...]:
        """Replicates whose noise agrees with the others'."""
        usual = float(np.median([m.per_density for m in _telling(self.made) or self.made[:1]]))
        return tuple(
            m for m in self.made if abs(m.variance - m.thresholds - usual * m.density) < MAX_NOISE_ERROR * m.variance
        )

    def _make(self, model: Model, x: np.ndarray, density: float) -> Made:
        seed = self.options.seed + 31 * (len(self.made) + 1)
        truth = with_shot_noise(model, density)
        made = make_replicate(self.evidence, truth, self.fit, self.seen, self.options.criteria, seed, self.cache)
        thresholds, variance = (float(np.exp(2.0 * at[self._noise_index])) for at in (x, made.x))
        return Made(made, density, thresholds, variance, made.x - x)


def with_shot_noise(model: Model, density: float) -> Model:
    """The model with shot noise of a fixed density."""
    return model.with_effect(EFFECT, {"density": density}).fix({STRENGTH: None})


def vector(model: Model, fit: Maximum) -> np.ndarray:
    """(d,) the model's values in the coordinates of the fit; delays of recordings are the fit's."""
    own = {name: parameter.value for name, parameter in model.nuisances.items()}  # such as phases of each recording
    known = {**own, **model.values}
    return np.array([
        p.to_coordinate(known[p.name]) if p.name in known else at
        for p, at in zip(fit.coordinates.parameters, fit.x, strict=True)
    ])  # fmt: skip


def _telling(made: tuple[Made, ...]) -> tuple[Made, ...]:
    return tuple(m for m in made if m.share > MIN_TELLING_SHARE)


def _nearest(one: Replicate, made: tuple[Made, ...]) -> float:
    """The share of a replicate (or of the measurement): each cell's score follows a parabola over the others'."""
    keys = [key for key in one.scores if all(key in m.replicate.scores for m in made)]
    shares = np.array([m.share for m in made])
    scores = _compressed([[m.replicate.scores[key] for key in keys] for m in made])
    curves, *_ = np.linalg.lstsq(np.vander(shares, 3), scores, rcond=None)
    spare = max(len(made) - 3, 1)
    own = np.sum((scores - np.vander(shares, 3) @ curves) ** 2, axis=0) / spare
    moderated = (spare * own + PRIOR_DEGREES * max(float(np.mean(own)), 1.0)) / (spare + PRIOR_DEGREES)
    tried = np.linspace(0.0, 1.1, 1101)
    off = _compressed([one.scores[key] for key in keys]) - np.vander(tried, 3) @ curves
    return float(tried[np.argmin((off**2 / np.maximum(moderated, 1.0)).sum(axis=1))])


def _compressed(scores) -> np.ndarray:
    return LINEAR_SCORE * np.arcsinh(np.asarray(scores, dtype=np.float64) / LINEAR_SCORE)
