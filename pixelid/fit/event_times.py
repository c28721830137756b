"""The log posterior of a circuit under the event-time likelihood, with exact gradient and its information matrix."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pixelid.fit.coordinates import Coordinates
from pixelid.fit.objective import Local, Objective
from pixelid.likelihood.event_times import EventTimes, Terms, sum_by
from pixelid.stages.circuit import Circuit

# Circuit numbers that leave the trajectories and changes alone and act in the density only.
DENSITY_ONLY = ("on_threshold", "off_threshold", "noise", "mismatch", "threshold_drift", "jitter", "tick")
STEP = 3e-5  # central difference of the changes, in fitting coordinates: error ~ 1e-9 relative
IMAGINARY = 1e-30  # complex step of the density


class EventTimesObjective(Objective):
    """The log posterior of a model under the event-time likelihood."""

    def __init__(self, likelihood: EventTimes, coordinates: Coordinates) -> None:
        self.likelihood = likelihood
        self.coordinates = coordinates

    def value(self, x: np.ndarray) -> float:
        return self.likelihood.log_likelihood(self.coordinates.circuit(x)) + self.coordinates.log_prior(x)

    def local(self, x: np.ndarray) -> Local:
        circuit = self.coordinates.circuit(x)
        gathered = self.likelihood.gathered(circuit)
        here = self.likelihood.terms(circuit, gathered)
        tangents = [self._tangent(x, i, circuit, gathered) for i in range(len(x))]
        gradient = np.array([t.total.imag for t in tangents]) / IMAGINARY
        information = _information(here, tangents, self.likelihood.group)
        prior_gradient, prior_curvature = self.coordinates.prior_gradient_and_curvature(x)
        return Local(
            float(here.total) + self.coordinates.log_prior(x),
            gradient + prior_gradient,
            information + np.diag(prior_curvature),
        )

    def _tangent(self, x: np.ndarray, i: int, circuit: Circuit, gathered: np.ndarray) -> Terms:
        """The terms with an imaginary step along coordinate i."""
        stepped = x.astype(complex)
        stepped[i] += 1j * IMAGINARY
        along = self.coordinates.circuit(stepped)
        if only_density_differs(circuit, along):
            direction = gathered.astype(complex)
        else:
            up, down = x.copy(), x.copy()
            up[i] += STEP
            down[i] -= STEP
            a = self.likelihood.gathered(self.coordinates.circuit(up), locate=False)
            b = self.likelihood.gathered(self.coordinates.circuit(down), locate=False)
            direction = gathered + 1j * IMAGINARY * (a - b) / (2.0 * STEP)
        return self.likelihood.terms(along, direction)


def only_density_differs(a: Circuit, b: Circuit) -> bool:
    """Whether two circuits have the same trajectories and changes."""
    return replace(a, **{name: getattr(b, name) for name in DENSITY_ONLY}) == b


def _information(here: Terms, tangents: list[Terms], group: np.ndarray) -> np.ndarray:
    """Gauss–Newton information of the event-time density, by its blocks:

    level within a group (residuals about the weighted mean), weighted means about the population,
    log rate, log scale, and log variance of the weighted means.
    """
    n = len(tangents)
    seen = here.weight_sum > 0
    kept = ~here.stray
    weight = kept / here.scale**2
    columns = []
    for t in tangents:
        dz = t.z.imag / IMAGINARY
        mean = np.where(seen, sum_by(group, weight * dz, len(seen)) / np.where(seen, here.weight_sum, 1.0), 0.0)
        between = np.where(seen, (mean - t.centre.imag / IMAGINARY) / np.sqrt(here.mean_variance), 0.0)
        spread = np.where(seen, t.mean_variance.imag / IMAGINARY / here.mean_variance, 0.0)
        columns.append(
            np.concatenate(
                [
                    kept * (dz - mean[group]) / here.scale,
                    between,
                    kept * t.log_rate.imag / IMAGINARY,
                    kept * np.sqrt(2.0) * t.scale.imag / IMAGINARY / here.scale,
                    np.sqrt(0.5) * spread,
                ]
            )
        )
    J = np.stack(columns, axis=1)
    return J.T @ J if n else np.zeros((0, 0))
