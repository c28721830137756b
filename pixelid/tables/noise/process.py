"""The circuit's own noise as a Gaussian process: white noise on ln L through photoreceptor, follower and amplifier.

At one radiance L the stages are linear.  With states x (photoreceptor slope and output, followers, amplifier)

    dx/dt = A x + b n(t),   one-sided PSD of n = density / L + floor

x is stationary and Gaussian with the covariance P that solves A P + P Aᵀ = −Q (Lyapunov), and from a known x(0) it has
mean e^{At} x(0) and covariance P − e^{At} P e^{Aᵀt}.  The slope of the photoreceptor is kept divided by ωn, so that all
states have the unit of ln L.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pixelid.dynamics.linear import linear_stages, stationary_covariance
from pixelid.dynamics.slew import slews
from pixelid.errors import InputError
from pixelid.stages.circuit import Circuit

PER_OCTAVE = 5  # lags; 8 change rates by less than 0.3 %
LAST_LAG = 30.0  # of the slowest time constant: e⁻³⁰ is left of what was


@dataclass(frozen=True)
class NoiseProcess:
    """The noise of one circuit at one radiance.

    Attributes:
        A: (n, n) 1/s, dynamics of the states; the amplifier's output is the last.
        P: (n, n) their stationary covariance, (log radiance)².
        input: index of the state that the amplifier sees, and that a reset stores.
        differencing: cutoff of the amplifier in rad/s; infinite: it follows at once (and has no state of its own).
    """

    A: np.ndarray
    P: np.ndarray
    input: int
    differencing: float

    @property
    def sigma(self) -> float:
        """Standard deviation of the amplifier's output, log radiance."""
        return math.sqrt(self.P[-1, -1])

    @cached_property
    def seen(self) -> np.ndarray:
        """(2, n) rows that give the amplifier's output and its slope."""
        row = np.zeros(len(self.A))
        row[-1] = 1.0
        return np.stack([row, self.A[-1]])

    @cached_property
    def seen_covariance(self) -> np.ndarray:
        """(2, 2) of output and slope; they are uncorrelated."""
        return np.diag(np.diag(self.seen @ self.P @ self.seen.T))

    @property
    def slope_sigma(self) -> float:
        """Standard deviation of the output's slope, log radiance per second."""
        return math.sqrt(self.seen_covariance[1, 1])

    @property
    def zero_crossings_hz(self) -> float:
        """Upward crossings of the mean per second (Rice)."""
        return self.slope_sigma / self.sigma / (2.0 * math.pi)

    @cached_property
    def regression(self) -> np.ndarray:
        """(n, 2) mean of the states given output and slope."""
        return self.P @ self.seen.T / np.diag(self.seen_covariance)

    def hidden(self, least: float) -> tuple[np.ndarray, np.ndarray]:
        """Hidden states, what output and slope do not identify: independent, of unit variance at any crossing.

        (n, hidden) what the states deviate by from `regression` per hidden state, and (hidden, n) rows that give them.

        Args:
            least: share of the greatest variance (of states in their standard deviations) from which on one counts.
        """
        scale = np.sqrt(np.diag(self.P))
        left = self.P - self.regression @ self.seen_covariance @ self.regression.T
        values, vectors = np.linalg.eigh(left / np.outer(scale, scale))
        kept = values > least * values[-1]
        kept[:2] = False  # output and slope take two directions
        sd, vectors = np.sqrt(values[kept]), vectors[:, kept]
        reading = (vectors / scale[:, None] / sd).T @ (np.eye(len(self.A)) - self.regression @ self.seen)
        return scale[:, None] * vectors * sd, reading

    @cached_property
    def lags(self) -> np.ndarray:
        """(lags,) s, spaced evenly in ln, from far below the time of a slope to far above the slowest time constant."""
        curvature = self.seen[1] @ self.A
        slope_time = self.slope_sigma / math.sqrt(curvature @ self.P @ curvature)
        slowest = 1.0 / float(np.min(-np.linalg.eigvals(self.A).real))
        first_lag = 0.02  # of the time in which a slope is lost: crossings come back far later
        octaves = math.log2(LAST_LAG * slowest / (first_lag * slope_time))
        return first_lag * slope_time * 2.0 ** (np.arange(math.ceil(PER_OCTAVE * octaves) + 1) / PER_OCTAVE)

    @cached_property
    def propagators(self) -> np.ndarray:
        """(lags, n, n) e^{A lag}: those of the first octave by Padé, each further octave by squaring."""
        from scipy.linalg import expm

        found = [expm(self.A * lag) for lag in self.lags[:PER_OCTAVE]]
        while len(found) < len(self.lags):
            found += [E @ E for E in found[-PER_OCTAVE:]]
        return np.array(found[: len(self.lags)])

    def propagator(self, time_s: float) -> np.ndarray:
        """(n, n) e^{A t}."""
        from scipy.linalg import expm

        return expm(self.A * time_s)


def noise_process(circuit: Circuit, radiance: float, floor: float = 0.0) -> NoiseProcess:
    """The noise of a circuit under constant light.

    Args:
        circuit: its stages, and its shot noise.
        radiance: of the scene, without the circuit's dark current.
        floor: one-sided PSD [1/Hz] of white noise on ln L that does not depend on light.

    Raises:
        InputError: for a stage that is not linear, a lower cutoff, fewer than three poles (the noise would have no
            slope and cross a threshold infinitely often), and a circuit without noise.
    """
    if circuit.lower_cutoff > 0:
        raise InputError("lower_cutoff: noise events of a circuit with a lower cutoff are not computed")
    if slews(circuit):
        raise InputError("slew_limit: noise events of a slew-limited follower are not computed")
    light = radiance + circuit.dark
    density = circuit.shot_density / light + floor
    if not (density > 0 and math.isfinite(density)):
        raise InputError(f"noise at radiance {radiance:g}: expected shot_noise.density or a floor above 0")
    A, drive, stored = linear_stages(circuit, light)
    if len(A) < 3:
        raise InputError(
            "noise: expected at least three poles (photoreceptor, source follower, amplifier), found "
            f"{len(A)}: noise through fewer crosses a threshold at no finite rate"
        )
    P = 0.5 * density * stationary_covariance(A, drive)
    return NoiseProcess(A, P, stored, float(circuit.differencing))
