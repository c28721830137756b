"""The log posterior of a circuit under the pooled-rate likelihood."""

from __future__ import annotations

import numpy as np

from pixelid.fit.coordinates import Coordinates
from pixelid.fit.objective import Local, Objective
from pixelid.likelihood.pooled_rate import PooledRate

STEP = 1e-4  # central difference in fitting coordinates
DELAY_STEP_S = 1e-7


class PooledRateObjective(Objective):
    """Poisson log posterior; information Σ ∂λ ∂λᵀ / λ.  Gradient by central differences of the expected counts."""

    def __init__(self, likelihood: PooledRate, coordinates: Coordinates) -> None:
        self.likelihood = likelihood
        self.coordinates = coordinates

    def expected(self, x: np.ndarray) -> np.ndarray:
        """(bins,) expected counts at x."""
        return self.likelihood.expected(self.coordinates.circuit(x), self.coordinates.values(x))

    def value(self, x: np.ndarray) -> float:
        return self.likelihood.log_likelihood(self.expected(x)) + self.coordinates.log_prior(x)

    def local(self, x: np.ndarray) -> Local:
        here = self.expected(x)
        columns = []
        for i, parameter in enumerate(self.coordinates.parameters):
            step = DELAY_STEP_S if parameter.transform == "linear" and parameter.unit == "s" else STEP
            up, down = x.copy(), x.copy()
            up[i] += step
            down[i] -= step
            columns.append((self.expected(up) - self.expected(down)) / (2.0 * step))
        kept = self.likelihood.kept
        J, here_kept = np.stack(columns, axis=1)[kept], here[kept]
        gradient, curvature = self.coordinates.prior_gradient_and_curvature(x)
        return Local(
            self.likelihood.log_likelihood(here) + self.coordinates.log_prior(x),
            J.T @ (self.likelihood.observed[kept] / here_kept - 1.0) + gradient,
            (J / here_kept[:, None]).T @ J + np.diag(curvature),
        )
