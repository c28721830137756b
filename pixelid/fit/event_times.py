"""The log posterior of a circuit under the event-time likelihood, with its gradient and information matrix.

The trajectories are differentiated along each coordinate once; everything after them (thresholds, strays, survival)
by the backward pass of `likelihood/density.py`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit

from pixelid.fit.coordinates import Coordinates
from pixelid.fit.objective import Local, Objective
from pixelid.likelihood.density import NUMBERS, Density, density
from pixelid.likelihood.event_times import EventTimes
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

    def gradient(self, x: np.ndarray) -> np.ndarray:
        return self._differentiated(x, None)

    def local(self, x: np.ndarray) -> Local:
        gathered, here = self.density(x)
        information = _Information(self.likelihood, self.coordinates.circuit(x), gathered, here, len(x))
        gradient = self._differentiated(x, information)
        value = here.total + self.coordinates.log_prior(x)
        prior_curvature = self.coordinates.prior_gradient_and_curvature(x)[1]
        return Local(value, gradient, information.matrix() + np.diag(prior_curvature))

    def _differentiated(self, x: np.ndarray, information: _Information | None) -> np.ndarray:
        """The gradient at x; the tangents it is made of also go to `information`."""
        circuit = self.coordinates.circuit(x)
        gathered, here = self.density(x)
        gradient = self.coordinates.prior_gradient_and_curvature(x)[0].copy()
        for i in range(len(x)):
            tangent = self._tangent(x, i, circuit, gathered)
            gradient[i] += here.by_number @ tangent.numbers
            if tangent.gathered is not None:
                gradient[i] += here.by_change @ tangent.gathered
            if information is not None:
                information.add(i, tangent)
        return gradient

    def _tangent(self, x: np.ndarray, i: int, circuit: Circuit, gathered: np.ndarray) -> Tangent:
        stepped = x.astype(complex)
        stepped[i] += 1j * IMAGINARY
        along = self.coordinates.circuit(stepped)
        numbers = np.array([np.imag(getattr(along, name)) for name in NUMBERS]) / IMAGINARY
        if only_density_differs(circuit, along):
            return Tangent(None, numbers)
        moved = x.copy()
        moved[i] += STEP * self.coordinates.longest_moves()[i]
        difference = self.likelihood.gathered(self.coordinates.circuit(moved), locate=False)
        with np.errstate(over="ignore", invalid="ignore"):  # intervals whose density is zero
            difference -= gathered
            difference /= moved[i] - x[i]
        if not np.isfinite(difference.sum()):
            np.nan_to_num(difference, copy=False, posinf=0.0, neginf=0.0)
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
        c, weight, groups = self.circuit, 1.0 / self.variance, len(self.seen)
        dz, dr, sums = np.empty(len(self.kept)), np.empty(len(self.kept)), np.zeros(groups)
        gathered = tangent.gathered
        moved = np.empty((4, 0)) if gathered is None else gathered[: 4 * self.n].reshape(4, self.n)
        _levels_along(
            self.kept, moved, gathered is not None, self.event, self.sign, self.group, self.time, self.growth,
            self.z, self.rate, weight, self.on, c.threshold_drift, d_on, d_drift, dz, dr, sums,
        )  # fmt: skip
        mean = np.where(self.seen, sums / self.safe, 0.0)
        d_centre = np.where(self.is_on, d_on, d_off)
        d_own = d_centre + np.where(self.seen, self.share * (mean - d_centre), 0.0)
        noise = 2.0 * c.noise * self.own * (d_noise * self.own + c.noise * d_own)
        d_weights = np.zeros(groups)
        _residuals_along(
            self.group, self.rate, self.width, self.clock_share, weight, mean, noise, 2.0 * c.jitter * d_jitter, dz, dr,
            self.events[i], d_weights,
        )  # fmt: skip
        spread = 2.0 * c.mismatch * self.centre * (d_mismatch * self.centre + c.mismatch * d_centre)
        d_mean_variance = spread - d_weights / self.safe**2
        self.groups[i, 0] = np.where(self.seen, (mean - d_centre) / np.sqrt(self.mean_variance), 0.0)
        self.groups[i, 1] = np.where(self.seen, np.sqrt(0.5) * d_mean_variance / self.mean_variance, 0.0)

    def matrix(self) -> np.ndarray:
        """(parameters, parameters)."""
        events = self.events.reshape(len(self.events), -1)
        groups = self.groups.reshape(len(self.groups), -1)
        return events @ events.T + groups @ groups.T


@njit(cache=True, nogil=True, error_model="numpy")
def _levels_along(
    kept, moved, there, event, sign, group, time, growth, z, rate, weight, on, drift, d_on, d_drift, dz, dr, sums
):  # fmt: skip
    """Fill the derivatives of level and rate of the events kept, and the groups' weighted sums of dz."""
    for k in range(len(kept)):
        level, slope = d_on * event[2, k], d_on * event[3, k]
        if there:
            j = kept[k]
            level += moved[0, j] + on * moved[2, j]
            slope += moved[1, j] + on * moved[3, j]
        growing = d_drift * time[k] / growth[k]
        dz[k] = sign[k] * level / growth[k] - growing * z[k]
        dr[k] = sign[k] * slope / growth[k] - growing * rate[k] - (dz[k] * drift + z[k] * d_drift) / growth[k]
        sums[group[k]] += weight[k] * dz[k]


@njit(cache=True, nogil=True, error_model="numpy")
def _residuals_along(group, rate, width, share, weight, mean, noise, d_jitter, dz, dr, rows, d_weights):
    """Fill a column's three rows: level within its group, log rate, log scale; and how the groups' weights change."""
    half = np.sqrt(0.5)
    for k in range(len(dz)):
        g, w = group[k], weight[k]
        d_variance = noise[g] + 2.0 * rate[k] * dr[k] * width[k] + rate[k] * rate[k] * share[k] * d_jitter
        rows[0, k] = (dz[k] - mean[g]) * np.sqrt(w)
        rows[1, k] = dr[k] / rate[k]
        rows[2, k] = half * d_variance * w
        d_weights[g] -= d_variance * w * w
