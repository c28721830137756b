"""The noise of a fit, shared out between thresholds and shot noise, and put right by what simulated replicates show.

Where a fit that knows no shot noise ends is a little off, and so is what the filter of `likelihood/shot_noise.py` then
finds.  Replicates made from a guess are off in the same way, so what they are off by is taken from the guess (indirect
inference: Gouriéroux, Monfort & Renault 1993, J. Appl. Econometrics 8, S85).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from pixelid.fit.maximise import Maximum
from pixelid.fit.shot_noise import DENSITY, EFFECT, NOISE, OTHER_PARAMETERS, with_division
from pixelid.gap.shot_noise.replicates import MAX_SHIFT, Replicate, moderated, variance_said, well_known
from pixelid.likelihood.shot_noise import LEAST_THRESHOLDS, Division
from pixelid.model.model import Model

# Of the logarithm of a density, from what the filter found to what replicates make of it: one that shows less than a
# tenth of what it was made with (the filter may find none at all) does not tell by how much to go on.
MAX_LOG_CORRECTION = math.log(10.0)
MOST_ANSWER = 3.0  # of a step, by which the next is shortened: what exceeds it is of other coordinates' steps
LEAST_STEP = 0.01  # whose answer tells anything beside how refits scatter
FARTHEST = 2.0 * MAX_LOG_CORRECTION  # of one step: from any density that is told to one that is not
MEDIAN_VARIANCE = 0.5 * math.pi  # of the median of normals, over that of their mean
MAX_LOG_ERROR = 0.5  # of a replicate's density: one so far from the others' ended at a lesser optimum


@dataclass(frozen=True)
class Guess:
    """What replicates are simulated with.

    Attributes:
        fit: Whose noise is shared out.
        found: By the filter, in the measured events.
        x: (d,) coordinates of the fit, its noise that of the thresholds alone.
        density: Of shot noise.
        step: (d + 1,) by which the correction that led here moved x and the logarithm of the density.
        excess: (d + 1,) by which refits of the guess before were off from the measured one.
    """

    fit: Maximum
    found: Division
    x: np.ndarray
    density: float
    step: np.ndarray | None = None
    excess: np.ndarray | None = None

    @classmethod
    def first(cls, fit: Maximum, found: Division) -> Guess:
        """As the filter has it."""
        return cls(fit, found, with_division(fit.coordinates, fit.x, found), found.density)

    @property
    def is_told(self) -> bool:
        """Whether replicates showed enough of the noise in them to be put right by."""
        return abs(math.log(self.density / self.found.density)) < MAX_LOG_CORRECTION

    @property
    def model(self) -> Model:
        """With shot noise of a fixed density."""
        model = self.fit.coordinates.model_at(np.clip(self.x, *self.fit.coordinates.bounds()))
        return with_shot_noise(model, self.density)

    def corrected(self, made: Sequence[Replicate], background: np.ndarray | None = None) -> Guess:
        """By what replicates made from it are off by; by less where refits answer a step by more than its length, as
        those of a memory of the polarity do (deviations under shot noise reverse as they do under one).

        background: (2,) OFF and ON events without a cause that were measured, where these shall tell the density as
        well as the filter does: with poles that are far off it finds nearly the same noise whatever there is
        """
        k = _noise_index(self.fit)
        truth = vector(self.model, self.fit)
        moved = np.median([np.clip(one.x - truth, -MAX_SHIFT, MAX_SHIFT) for one in made], axis=0)
        off = np.where(well_known(self.fit), moved, 0.0)
        denser = np.median([math.log(one.division.density / self.found.density) for one in made])
        if background is not None:
            more = np.mean([np.log(one.background + 1.0) for one in made], axis=0) - np.log(background + 1.0)
            denser = 0.5 * (denser + float(np.mean(more / self.background_per_density())))
        excess = np.append(truth + off - self.fit.x, denser)
        step = -excess / self._answer(excess)
        step[-1] = np.clip(step[-1], -FARTHEST, FARTHEST)
        x = truth + step[:-1]
        variance = math.exp(2.0 * self.fit.x[k])
        seen = float(np.median([one.division.thresholds * math.exp(2.0 * one.x[k]) for one in made]))
        thresholds = math.exp(2.0 * self.x[k]) + self.found.thresholds * variance - seen
        x[k] = 0.5 * math.log(np.clip(thresholds, LEAST_THRESHOLDS * variance, variance))
        return replace(self, x=x, density=self.density * math.exp(step[-1]), step=step, excess=excess)

    def _answer(self, excess: np.ndarray) -> np.ndarray:
        """(d + 1,) by how many times its length refits have answered the last step, 1 to `MOST_ANSWER`; at first 1."""
        if self.step is None or self.excess is None:
            return np.ones_like(excess)
        moved = np.abs(self.step) > LEAST_STEP
        ratio = np.divide(excess - self.excess, self.step, out=np.ones_like(excess), where=moved)
        return np.clip(ratio, 1.0, MOST_ANSWER)

    def error(self, made: Sequence[Replicate]) -> float:
        """Standard error of the log density, from how replicates made from it scatter."""
        logs = np.log([one.division.density for one in made])
        expected = (OTHER_PARAMETERS * self.found.error) ** 2
        return math.sqrt(moderated(logs.var(ddof=1), expected, len(made)) * (1.0 + 1.0 / len(made)))

    def widened(self, made: Sequence[Replicate]) -> np.ndarray:
        """(d,) by how many times coordinates err more than the likelihood says, at least once.

        From how replicates made from it scatter, each coordinate's variance moderated by that of all (as errors of the
        density are), and the error of their median.  What the events hold little of is not corrected, nor widened.
        """
        said, known = variance_said(self.fit), well_known(self.fit)
        degrees = len(made) - 1
        ratio = np.var([one.x for one in made], axis=0, ddof=1)[known] / said[known]
        usual = np.median(ratio) / (chi2.median(degrees) / degrees) if known.any() else 1.0
        variance = np.maximum(moderated(ratio, max(usual, 1.0), len(made)), 1.0)
        factor = np.ones(len(said))
        factor[known] = np.sqrt(variance * (1.0 + MEDIAN_VARIANCE / len(made)))
        return factor

    def background_per_density(self) -> np.ndarray:
        """(2,) d log background events, OFF and ON, / d log density, at most: they come at a rate of
        exp(−C²/(2 · 2 · variance of the level)) (Rice 1944), level and reference apart."""
        values = self.fit.values
        thresholds = np.array([values["off_threshold"], values["on_threshold"]])
        return thresholds**2 / (4.0 * self.density * self.found.quiet)


def sound(made: Sequence[Replicate]) -> bool:
    """Whether replicates of one guess were all fitted as they should."""
    logs = np.log([max(one.division.density, 1e-300) for one in made])
    return bool(np.abs(logs - np.median(logs)).max() < MAX_LOG_ERROR)


def with_shot_noise(model: Model, density: float) -> Model:
    """The model with shot noise of a fixed density."""
    return model.with_effect(EFFECT, {"density": density}).fix({DENSITY: None})


def vector(model: Model, fit: Maximum) -> np.ndarray:
    """(d,) the model's values in the coordinates of the fit; delays of recordings are the fit's."""
    own = {name: parameter.value for name, parameter in model.nuisances.items()}  # such as phases of each recording
    known = {**own, **model.values}
    return np.array([
        p.to_coordinate(known[p.name]) if p.name in known else at
        for p, at in zip(fit.coordinates.parameters, fit.x, strict=True)
    ])  # fmt: skip


def _noise_index(fit: Maximum) -> int:
    return fit.coordinates.names.index(NOISE)
