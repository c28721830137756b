"""The log posterior of a circuit under the event-time likelihood, with its gradient and information matrix.

The trajectories are differentiated along each coordinate once; everything after them (thresholds, strays, survival)
by the backward pass of `likelihood/density.py`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pixelid.fit.coordinates import Coordinates
from pixelid.fit.objective import Local, Objective
from pixelid.likelihood.density import NUMBERS, Density, density
from pixelid.likelihood.event_times import EventTimes, sum_by
from pixelid.stages.circuit import Circuit

# Circuit numbers that leave the trajectories and changes alone and act in the density only.
DENSITY_ONLY = (*NUMBERS, "tick")
# Difference of the changes, in fitting coordinates.  One-sided: the changes bend by about themselves per unit, so the
# error is 1e-6 relative, and their own error 1e-14 adds 1e-8.
STEP = 1e-6
IMAGINARY = 1e-30  # complex step of the circuit's numbers


@dataclass(frozen=True)
class Tangent:
    """Derivatives along one coordinate: of `EventTimes.gathered` (None: it does not move) and of `NUMBERS` (6,)."""

    gathered: np.ndarray | None
    numbers: np.ndarray


class EventTimesObjective(Objective):
    """The log posterior of a model under the event-time likelihood."""

    def __init__(self, likelihood: EventTimes, coordinates: Coordinates) -> None:
        self.likelihood = likelihood
        self.coordinates = coordinates
        self._latest: tuple[bytes, np.ndarray, Density] | None = None

    def density(self, x: np.ndarray) -> tuple[np.ndarray, Density]:
        """(gathered changes, density) at x; the latest is remembered."""
        key = np.asarray(x, dtype=float).tobytes()
        if self._latest is None or self._latest[0] != key:
            circuit = self.coordinates.circuit(x)
            gathered = self.likelihood.gathered(circuit)
            self._latest = key, gathered, density(self.likelihood, circuit, gathered)
        return self._latest[1], self._latest[2]

    def value(self, x: np.ndarray) -> float:
        return self.density(x)[1].total + self.coordinates.log_prior(x)

    def local(self, x: np.ndarray) -> Local:
        circuit = self.coordinates.circuit(x)
        gathered, here = self.density(x)
        prior_gradient, prior_curvature = self.coordinates.prior_gradient_and_curvature(x)
        information = _Information(self.likelihood, circuit, gathered, here, len(x))
        gradient = prior_gradient.copy()
        for i in range(len(x)):
            tangent = self._tangent(x, i, circuit, gathered)
            gradient[i] += here.by_number @ tangent.numbers
            if tangent.gathered is not None:
                gradient[i] += here.by_change @ tangent.gathered
            information.add(i, tangent)
        value = here.total + self.coordinates.log_prior(x)
        return Local(value, gradient, information.matrix() + np.diag(prior_curvature))

    def _tangent(self, x: np.ndarray, i: int, circuit: Circuit, gathered: np.ndarray) -> Tangent:
        stepped = x.astype(complex)
        stepped[i] += 1j * IMAGINARY
        along = self.coordinates.circuit(stepped)
        numbers = np.array([np.imag(getattr(along, name)) for name in NUMBERS]) / IMAGINARY
        if only_density_differs(circuit, along):
            return Tangent(None, numbers)
        moved = x.copy()
        moved[i] += STEP * self.coordinates.longest_moves()[i]
        forward = self.likelihood.gathered(self.coordinates.circuit(moved), locate=False)
        difference = np.nan_to_num((forward - gathered) / (moved[i] - x[i]), posinf=0.0, neginf=0.0)
        n = self.likelihood.events
        difference[6 * n : 7 * n] = 0.0  # whether an event comes too early is not differentiable
        return Tangent(difference, numbers)


def only_density_differs(a: Circuit, b: Circuit) -> bool:
    """Whether two circuits have the same trajectories and changes."""
    return replace(a, **{name: getattr(b, name) for name in DENSITY_ONLY}) == b


class _Information:
    """Gauss–Newton information of the event-time density, by its blocks:

    level within a group (residuals about the weighted mean), log rate, log scale, per event; the groups' weighted
    means about the population, and the log variance of those means.
    """

    def __init__(self, likelihood: EventTimes, circuit: Circuit, gathered: np.ndarray, here: Density, count: int):
        n = likelihood.events
        self.kept = np.flatnonzero(~here.stray)
        self.event = gathered[: 7 * n].reshape(7, n)[:4, self.kept]
        self.sign, self.group = likelihood.sign[self.kept], likelihood.group[self.kept]
        self.time = likelihood.time_s[self.kept]
        self.on = circuit.on_threshold
        self.growth = 1.0 + circuit.threshold_drift * self.time
        self.z, self.rate, self.variance = (part[self.kept] for part in (here.z, here.rate, here.variance))
        self.clock_share = likelihood.clock_share[self.kept]
        self.width = self.clock_share * (likelihood.tick_s[self.kept] ** 2 / 12.0 + circuit.jitter**2)
        self.circuit, self.n = circuit, n
        groups = len(here.weight_sum)
        self.is_on = np.arange(groups) % 2 == 1
        self.centre = np.where(self.is_on, circuit.on_threshold, circuit.off_threshold)
        self.seen = here.weight_sum > 0
        self.safe = np.where(self.seen, here.weight_sum, 1.0)
        spread = (circuit.mismatch * self.centre) ** 2
        self.mean_variance = spread + 1.0 / self.safe
        self.share = spread / self.mean_variance  # of a group's own threshold that its events tell
        self.own = self.centre + self.share * (here.weighted_mean - self.centre)
        self.events = np.zeros((count, 3, len(self.kept)))
        self.groups = np.zeros((count, 2, groups))

    def add(self, i: int, tangent: Tangent) -> None:
        """Fill column i."""
        d_on, d_off, d_noise, d_mismatch, d_drift, d_jitter = tangent.numbers
        dz, dr = d_on * self.event[2], d_on * self.event[3]
        if tangent.gathered is not None:
            moved = tangent.gathered[: 7 * self.n].reshape(7, self.n)[:4][:, self.kept]
            dz, dr = dz + moved[0] + self.on * moved[2], dr + moved[1] + self.on * moved[3]
        dz, dr = self.sign * dz / self.growth, self.sign * dr / self.growth
        if d_drift != 0.0:
            growing = d_drift * self.time / self.growth
            dz, dr = dz - growing * self.z, dr - growing * self.rate
        d_centre = np.where(self.is_on, d_on, d_off)
        c = self.circuit
        weight = 1.0 / self.variance
        groups = len(self.seen)
        mean = np.where(self.seen, sum_by(self.group, weight * dz, groups) / self.safe, 0.0)
        d_own = d_centre + np.where(self.seen, self.share * (mean - d_centre), 0.0)
        noise = 2.0 * c.noise * self.own * (d_noise * self.own + c.noise * d_own)
        d_variance = (
            noise[self.group]
            + 2.0 * self.rate * dr * self.width
            + 2.0 * self.rate**2 * self.clock_share * c.jitter * d_jitter
        )
        d_weights = -sum_by(self.group, d_variance * weight * weight, groups)
        spread = 2.0 * c.mismatch * self.centre * (d_mismatch * self.centre + c.mismatch * d_centre)
        d_mean_variance = spread - d_weights / self.safe**2
        self.events[i, 0] = (dz - mean[self.group]) * np.sqrt(weight)
        self.events[i, 1] = dr / self.rate
        self.events[i, 2] = np.sqrt(0.5) * d_variance * weight
        self.groups[i, 0] = np.where(self.seen, (mean - d_centre) / np.sqrt(self.mean_variance), 0.0)
        self.groups[i, 1] = np.where(self.seen, np.sqrt(0.5) * d_mean_variance / self.mean_variance, 0.0)

    def matrix(self) -> np.ndarray:
        """(parameters, parameters)."""
        events = self.events.reshape(len(self.events), -1)
        groups = self.groups.reshape(len(self.groups), -1)
        return events @ events.T + groups @ groups.T
