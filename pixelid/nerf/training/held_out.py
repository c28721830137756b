"""What events of pixels that training has not seen decide: which scene explains more, when to stop, how smooth.

Comparisons are paired over pixels of the sensor, the independent units: what a scene gets wrong at a place is wrong for
all events there, and what is hard in an event for every scene cancels.

Smoothness.  At the beginning of the last stage training goes ahead from the same state, with the same batches, under
several weights of what holds the field smooth.  A weight other than the usual one is taken where held-out events are
explained better under it, and chance would do as well in less than `ALPHA`, all weights together (Bonferroni); ties are
the usual one's.

Stopping.  In the last stage, whose resolution stays as it is (but in runs shorter than 95 steps above 160 cells per
side), the held-out loss is looked at `LOOKS` times, always of the same rows.

short    A training of fewer than `recipe.LEAST_STEPS` steps has converged where those that are missing would win less
         than `LEAST_SHARE` by the same line.
kept     The last state that is not demonstrably worse than the best one: the best explains more by chance in less than
         `ALPHA`, all looks so far together (Bonferroni), for the best was chosen among them.  A state later in the
         decay of the learning rate has less of the noise of its steps, so that a tie is the later one's.
stopped  A line through the last `WINDOW` looks goes on as far as looks are left, at the upper limit of its slope at
         confidence 1 − `ALPHA` (`most_gained`).  As the learning rate falls looks win less and less, so that is the
         most they can win.  Below `LEAST_SHARE`, nothing is left to win.  Looks less than `APART` steps apart show
         nothing of that: Adam's second moments remember 100 steps (β₂ = 0.99), and over less than that the loss may
         rise on its way down.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import t as student

from pixelid.nerf.options import ALPHA, LEAST_SHARE

FACTORS = (1 / 3, 3.0)  # of the usual weight
AHEAD = 1 / 30  # of all steps, that each weight is tried for
LOOKS = 8  # in the last stage
WINDOW = 5  # looks over which the loss has to stand still: three are left to tell the scatter of its line
APART = 100 // (WINDOW - 1)  # steps between looks, at least


class Gain(NamedTuple):
    """How much better rows are explained than by another pixel or scene.

    share: of the other's loss that is gone;  p_value: one-sided, of no gain at all, pixels being the units;  rows:
    compared
    """

    share: float
    p_value: float
    rows: int


def paired(old: np.ndarray, new: np.ndarray, rows: int) -> Gain:
    """The gain of losses new (pixels,) over losses old (pixels,) of the same pixels, sums over so many rows each."""
    total, (gained, spread) = float(old.sum()), _gained(old, new)
    score = gained / spread if spread > 0 else 0.0
    p_value = float(student.sf(score, len(old) - 1)) if len(old) > 1 else 1.0
    return Gain(gained / total if total > 0 else 0.0, p_value, rows)


def most_gained(looks: np.ndarray, ahead: float, alpha: float) -> float:
    """Upper limit, at confidence 1 − alpha, of the share of the last loss that a trend wins until it has gone on.

    The slope b of the line through the sums of losses has two independent errors: pixels (each has a slope of its own)
    and the course of the training, which moves all pixels together and shows as scatter about the line.

        b = Σ_k w_k ℓ_k      w_k = (k − k̄) / Σ (k − k̄)²      var b = n var(b_pixel) + s² Σ w²,  s² = Σ rest² / (m − 2)

    Args:
        looks: (m, pixels) losses at equal distances, in order.
        ahead: distances that are left.
        alpha: chance of a larger gain.

    Returns:
        The share; infinite where two looks or one pixel show no error.
    """
    m, n = looks.shape
    total = float(looks[-1].sum())
    if m < 3 or n < 2 or not total > 0:
        return float("inf")
    place = np.arange(m) - 0.5 * (m - 1)
    weights = place / (place**2).sum()
    sums, slopes = looks.sum(axis=1), weights @ looks
    rest = sums - sums.mean() - place * float(slopes.sum())
    course = float((rest**2).sum()) / (m - 2) * float((weights**2).sum())
    spread = np.sqrt(n * slopes.var(ddof=1) + course)
    return ahead * (spread * float(student.isf(alpha, m - 2)) - float(slopes.sum())) / total


def _gained(old: np.ndarray, new: np.ndarray) -> tuple[float, float]:
    """(sum of the gains of pixels (n,), its standard deviation)."""
    gains = old - new
    return float(gains.sum()), float(np.sqrt(((gains - gains.mean()) ** 2).sum()))


@dataclass(frozen=True)
class Trial:
    """What one factor came to: mean held-out loss, share gained over the usual weights, and the chance of as much."""

    factor: float
    loss: float
    heldout_gain: float = 0.0
    p_value: float = 1.0


@dataclass(frozen=True)
class Regularisation:
    """The entry "regularisation" of reconstruction.json.

    factor: of the weight of the total variation, in the last stage;  trials: that it was chosen by, if any
    """

    factor: float = 1.0
    trials: tuple[Trial, ...] = ()


def chosen(usual: np.ndarray, others: Sequence[np.ndarray], rows: int) -> Regularisation:
    """The factor that held-out losses (pixels,) speak for: under the usual weights, and under each of `FACTORS`."""
    gains = [paired(usual, other, rows) if np.isfinite(other).all() else Gain(math.nan, 1.0, rows) for other in others]
    better = [k for k, gain in enumerate(gains) if gain.p_value * len(FACTORS) < ALPHA]
    factor = FACTORS[max(better, key=lambda k: gains[k].share)] if better else 1.0
    trials = (
        Trial(each, float(losses.sum() / max(rows, 1)), gain.share, gain.p_value)
        for each, losses, gain in zip(FACTORS, others, gains, strict=True)
    )
    return Regularisation(factor, (Trial(1.0, float(usual.sum() / max(rows, 1))), *trials))


def looked_at(begin: int, end: int) -> tuple[int, ...]:
    """Steps after which is looked, of a last stage from `begin` to `end`."""
    return tuple(sorted({begin + math.ceil((end - begin) * k / LOOKS) for k in range(1, LOOKS + 1)}))


@dataclass(frozen=True)
class Look:
    """losses: (pixels,) of held-out pixels after so many steps (`residuals.loss_of_pixels`);  rows: in them."""

    iteration: int
    losses: np.ndarray
    rows: int

    @property
    def loss(self) -> float:
        """Mean over the rows."""
        return float(self.losses.sum() / max(self.rows, 1))


@dataclass
class Stopping:
    """What held-out events have said of a training so far.

    steps: after which is looked (`looked_at`);  looks: in order;  kept: which of them is kept, −1 before the first;
    scene: what training had learned then (`state.learned`)
    """

    steps: tuple[int, ...] = ()
    looks: list[Look] = dataclasses.field(default_factory=list)
    kept: int = -1
    scene: dict[str, Any] = dataclasses.field(default_factory=dict)

    @property
    def next(self) -> int | None:
        """The step after which is looked next, None after the last look."""
        return self.steps[len(self.looks)] if len(self.looks) < len(self.steps) else None

    @property
    def best(self) -> int:
        """Which look has the least loss; one that is no number is the largest."""
        return int(np.argmin([look.loss if math.isfinite(look.loss) else math.inf for look in self.looks]))

    def add(self, look: Look, scene: dict[str, Any]) -> None:
        """Note a look, and the scene where it is not demonstrably worse than the best."""
        self.looks.append(look)
        last, best = len(self.looks) - 1, self.best
        gain = paired(look.losses, self.looks[best].losses, look.rows)
        if best == last or (math.isfinite(look.loss) and gain.p_value * last >= ALPHA):
            self.kept, self.scene = last, scene

    def to_gain(self, beyond: int = 0) -> float:
        """Upper limit of the share of the held-out loss that the steps which are left can win; infinite so far.

        beyond: further steps after the last look.
        """
        if len(self.looks) < WINDOW or self.steps[1] - self.steps[0] < APART:
            return float("inf")
        losses = np.stack([look.losses for look in self.looks[-WINDOW:]])
        ahead = len(self.steps) - len(self.looks) + beyond / (self.steps[1] - self.steps[0])
        return most_gained(losses, ahead, ALPHA)

    @property
    def stopped(self) -> bool:
        """Whether nothing is left to win, with looks to come."""
        return len(self.looks) < len(self.steps) and self.to_gain() < LEAST_SHARE

    def as_dict(self, iterations: int, *, diverged: bool = False) -> dict[str, Any]:
        """The entry "stopping" of reconstruction.json, of a training that ended after so many steps.

        diverged: whether the next step did, or they left what is no number; the last state is then what there is
        """
        looks = [{"iteration": look.iteration, "loss": look.loss} for look in self.looks]
        if diverged or not looks:
            reason = "training diverged" if diverged else "no events were held out"
            return {"kept": iterations, "stopped_early": False, "reason": reason, "looks": looks}
        kept = self.looks[self.kept].iteration
        if self.stopped:
            most = max(self.to_gain(), 0.0)
            reason = f"at confidence {1 - ALPHA:g} the steps left would win at most {most:.2g} of the loss"
        else:
            reason = "all steps were made"
        if kept != self.looks[-1].iteration:
            reason += "; later steps explained held-out events demonstrably worse"
        return {"kept": kept, "stopped_early": self.stopped, "reason": reason, "looks": looks}
