"""Stamps as evidence for a circuit: their likelihood, with all true times that they can stand for summed over.

Times drawn from one model speak for it, and against every other, by as much as the stamps leave open.  Here nothing is
drawn: each pixel's chain of events is summed over the windows of its stamps (`lattice.py`).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pixelid.gap.imputation.imputed import Imputation
from pixelid.gap.imputation.paths import Lights, draw_paths
from pixelid.stages.circuit import Circuit


@dataclass(frozen=True)
class Stamps:
    """The stamps of some recordings.

    imputation: Their windows, and the times drawn last: these tell each pixel's thresholds and the order of its stamps.
    lights: What circuits made of the light before.
    """

    imputation: Imputation
    lights: Lights = field(default_factory=Lights)

    @property
    def events(self) -> int:
        """Number of stamps."""
        return sum(len(r.events) for r in self.imputation.fine)

    def per_pixel(self, circuit: Circuit) -> np.ndarray:
        """(pixels,) nats, in order of the pixels."""
        imputation, rng = self.imputation, np.random.default_rng(0)  # of times that are not used
        return draw_paths(imputation.fine, imputation.windows, imputation.times, circuit, rng, self.lights).per_pixel

    def log_likelihood(self, circuit: Circuit) -> float:
        """Nats."""
        return float(self.per_pixel(circuit).sum())
