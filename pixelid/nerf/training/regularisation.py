"""How strongly a field is held smooth, by events of pixels that training has not seen.

At the beginning of the last stage training goes ahead from the same state, with the same batches, under several weights
of what holds the field smooth.  A weight other than the usual one is taken where held-out events are explained better
under it, and chance would do as well in less than `ALPHA`, all weights together (Bonferroni); ties are the usual one's.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pixelid.nerf.options import ALPHA
from pixelid.nerf.training.gain import Gain, paired

FACTORS = (1 / 3, 3.0)  # of the usual weights
AHEAD = 1 / 30  # of all steps, that each weight is tried for


@dataclass(frozen=True)
class Trial:
    """What one factor came to: mean held-out loss, share gained over the usual weights, and the chance of as much."""

    factor: float
    loss: float
    gain: float = 0.0
    p_value: float = 1.0


@dataclass(frozen=True)
class Regularisation:
    """factor: of the weight of the total variation, in the last stage;  trials: that it was chosen by, if any."""

    factor: float = 1.0
    trials: tuple[Trial, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """The entry "regularisation" of reconstruction.json."""
        trials = [
            {"factor": t.factor, "loss": t.loss, "heldout_gain": t.gain, "p_value": t.p_value} for t in self.trials
        ]
        return {"factor": self.factor, "trials": trials}


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
