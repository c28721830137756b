"""When training stops and which of its states is kept, by events of pixels that it has not seen.

In the last stage, whose resolution stays as it is (but in runs shorter than 95 steps above 160 cells per side), the
held-out loss is looked at `LOOKS` times, always of the same rows.  Looks are compared pixel by pixel (`gain`), so what
is hard in an event for every state of the scene cancels.

kept     The last state that is not demonstrably worse than the best one: the best explains more by chance in less than
         `ALPHA`, all looks so far together (Bonferroni), for the best was chosen among them.  A state later in the
         decay of the learning rate has less of the noise of its steps, so that a tie is the later one's.
stopped  A line through the last `WINDOW` looks goes on as far as looks are left, at the upper limit of its slope at
         confidence 1 − `ALPHA` (`gain.most_gained`).  As the learning rate falls looks win less and less, so that is
         the most they can win.  Below `LEAST_SHARE`, nothing is left to win.  Looks less than `APART` steps apart show
         nothing of that: Adam's second moments remember 100 steps (β₂ = 0.99), and over less than that the loss may
         rise on its way down.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from pixelid.nerf.options import ALPHA, LEAST_SHARE
from pixelid.nerf.training.gain import most_gained, paired

LOOKS = 8  # in the last stage
WINDOW = 5  # looks over which the loss has to stand still: three are left to tell the scatter of its line
APART = 100 // (WINDOW - 1)  # steps between looks, at least


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

    def to_gain(self) -> float:
        """Upper limit of the share of the held-out loss that the looks which are left can win; infinite so far."""
        if len(self.looks) < WINDOW or self.steps[1] - self.steps[0] < APART:
            return float("inf")
        losses = np.stack([look.losses for look in self.looks[-WINDOW:]])
        return most_gained(losses, len(self.steps) - len(self.looks), ALPHA)

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
