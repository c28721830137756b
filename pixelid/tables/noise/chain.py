"""The Markov chain of noise events: from the state at one event to the state at the next (see `first_passage.py`)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pixelid.stages.circuit import Circuit
from pixelid.tables.noise.process import NoiseProcess
from pixelid.tables.noise.quadrature import offset_nodes, rayleigh_nodes, threshold_draws

SLOPES = 3  # 6 change rates by less than 0.2 %
SPACING = 0.2  # of references, in standard deviations of the output; 0.1 changes rates by 2 % at equal thresholds
MARGIN = 2.0  # standard deviations of references beyond the larger threshold
QUIET = 9.0  # a threshold of so many standard deviations is crossed at e⁻⁴⁰ of the bandwidth: never


@dataclass(frozen=True)
class Chain:
    """A circuit's noise events as a chain over (polarity, level of the output, slope).

    Attributes:
        process: the noise;  drift: of the reference by leak, log radiance per second.
        slopes, omega, factors: (m,) nodes of slopes, their weights, and what turns densities into intensities.
        means, covariances: of output and slope a lag after a crossing, see `crossings.between_crossings`.
        release: the same after a reset;  offsets, offset_weights: nodes of the stored reference.
        on, off, draw_weights: (draws,) thresholds as they are drawn.
        nodes: (k,) references, and levels of the states.
        stationary, resolvents: (draws, k, 2 m) Rice's intensities and (draws, k, 2 m, 2 m) their first passages.
        moved: (states, states) shares;  waited: (states,) mean s from release to the next event.
    """

    process: NoiseProcess
    slopes: np.ndarray
    omega: np.ndarray
    factors: np.ndarray
    means: np.ndarray
    covariances: np.ndarray
    release: Release
    offsets: np.ndarray
    offset_weights: np.ndarray
    on: np.ndarray
    off: np.ndarray
    draw_weights: np.ndarray
    nodes: np.ndarray
    stationary: np.ndarray
    resolvents: np.ndarray
    drift: float
    moved: np.ndarray
    waited: np.ndarray

    @cached_property
    def share(self) -> np.ndarray:
        """(states,) the law of states at events that the chain leaves unchanged."""
        system = self.moved.T - np.eye(len(self.moved))
        system[-1] = 1.0
        right = np.zeros(len(self.moved))
        right[-1] = 1.0
        return np.linalg.solve(system, right)


@dataclass(frozen=True)
class _Crossings:
    """What `crossings` wants of a process: slopes, omega, factors (m,), weights (lags,), means (lags, 2, 2) and
    covariances (lags, 3)."""

    process: NoiseProcess
    slopes: np.ndarray
    omega: np.ndarray
    factors: np.ndarray
    weights: np.ndarray
    means: np.ndarray
    covariances: np.ndarray

    @classmethod
    def of(cls, p: NoiseProcess) -> _Crossings:
        """At nodes of slopes and lags."""
        slopes_unit, omega = rayleigh_nodes(SLOPES)
        # ∫ n dw = Σ ω (n / (w e^{−w²/2σ²}))|node σ², and n = w f: the slope itself cancels
        factors = omega * np.exp(0.5 * slopes_unit**2) * p.slope_sigma**2
        weights = p.lags * math.log(p.lags[1] / p.lags[0])
        weights[[0, -1]] *= 0.5
        means = p.seen @ p.propagators @ p.regression
        covariances = triangle(p.seen_covariance - means @ p.seen_covariance @ np.swapaxes(means, 1, 2))
        return cls(p, slopes_unit * p.slope_sigma, omega, factors, weights, means, covariances)

    def rates(self, up: np.ndarray, down: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rice's intensities (k, 2 m) of k pairs of levels, and (k, 2 m, 2 m) their first passages."""
        from pixelid.tables.noise import crossings

        m = len(self.slopes)
        stationary, between = np.empty((len(up), 2 * m)), np.empty((len(up), 2 * m, 2 * m))
        for k, levels in enumerate(np.stack([up, down], axis=1)):
            rice = self.process.zero_crossings_hz * np.exp(-0.5 * (levels / self.process.sigma) ** 2)
            stationary[k] = np.outer(rice, self.omega).ravel()
            crossings.between_crossings(
                self.means, self.covariances, *levels, self.slopes, self.factors, self.weights, stationary[k],
                between[k],
            )  # fmt: skip
        return stationary, np.linalg.inv(np.eye(2 * m) + between)


def leak_cycle_s(process: NoiseProcess, circuit: Circuit, drift: float) -> float:
    """Mean time from the dead time's end to the next ON event by leak, s, where thresholds are far beyond the noise.

    The reference falls by itself until some standard deviations are left to the threshold, and noise does the rest:
    what happens there does not depend on the threshold.  Where it falls from depends on the state at the last event.
    """
    from pixelid.tables.noise import crossings

    p, at = process, _Crossings.of(process)
    left = np.arange(-MARGIN, QUIET + 1.0 + SPACING, SPACING) * p.sigma  # to the threshold
    off = -2.0 * left[-1]  # out of reach
    stationary, resolvents = at.rates(left, np.full(len(left), off))
    m, count = len(at.slopes), len(left)
    exits, times = np.empty((count, 2 * count * m)), np.empty(count)
    crossings.exits_long_after(left, 0.0, -off, at.slopes, stationary, resolvents, drift, exits, times)
    at_event, released = exits[-1].reshape(2, count, m)[0], release(p, circuit.refractory)
    kept = float((at_event * (released.reference[0] * left[:, None] + released.reference[1] * at.slopes)).sum())
    return float(times[-1] + (kept + circuit.on_threshold - left[-1]) / drift)


def chain_of(process: NoiseProcess, circuit: Circuit, drift: float) -> Chain:
    """The chain of a circuit's thresholds, threshold noise and dead time; drift: of its references by leak, 1/s."""
    from pixelid.tables.noise import crossings

    p, at = process, _Crossings.of(process)
    released = release(p, circuit.refractory)
    draws, draw_weights = threshold_draws(circuit.noise)
    on, off = circuit.on_threshold * draws[:, 0], circuit.off_threshold * draws[:, 1]
    offsets, offset_weights = offset_nodes(released.sd / p.sigma)
    # an OFF threshold that is never reached needs no references; an ON threshold may be reached by leak alone
    never = (QUIET + 1.0) * p.sigma
    reach = max(on.max() if drift > 0 else min(on.max(), never), min(off.max(), never)) + MARGIN * p.sigma
    nodes = np.linspace(-reach, reach, max(math.ceil(2.0 * reach / (SPACING * p.sigma)) + 1, 8))
    m, count = len(at.slopes), len(nodes)
    rates = [at.rates(nodes + on[a], nodes - off[a]) for a in range(len(draws))]
    stationary, resolvents = (np.stack(each) for each in zip(*rates, strict=True))
    states = 2 * count * m
    exits, times = np.empty((len(draws), count, states)), np.empty((len(draws), count))
    for a in range(len(draws)):
        crossings.exits_long_after(
            nodes, on[a], off[a], at.slopes, stationary[a], resolvents[a], drift, exits[a], times[a]
        )
    moved, waited = np.zeros((states, states)), np.zeros(states)
    crossings.transitions(
        nodes, at.slopes, at.omega, p.zero_crossings_hz, p.sigma, at.factors, at.weights, released.maps,
        released.spread, released.tails, released.covariances, released.reference, released.sd, offsets,
        offset_weights, on, off, draw_weights, resolvents, exits, times, moved, waited,
    )  # fmt: skip
    return Chain(
        process=p, slopes=at.slopes, omega=at.omega, factors=at.factors, means=at.means, covariances=at.covariances,
        release=released, offsets=offsets, offset_weights=offset_weights, on=on, off=off, draw_weights=draw_weights,
        nodes=nodes, stationary=stationary, resolvents=resolvents, drift=drift, moved=moved, waited=waited,
    )  # fmt: skip


@dataclass(frozen=True)
class Release:
    """Output and slope after a reset: linear in output and slope at the event, in the reference, and noise."""

    maps: np.ndarray
    spread: np.ndarray
    tails: np.ndarray
    covariances: np.ndarray
    reference: np.ndarray
    sd: float


def release(p: NoiseProcess, dead_s: float) -> Release:
    """What is known a dead time after an event, and then at each lag.

    The amplifier restarts from the stored reference, so its output is the never-reset one less what that had lagged
    behind at release, fading at its own cutoff.
    """
    n = len(p.A)
    mean = p.propagator(dead_s) @ p.regression
    V = p.P - mean @ p.seen_covariance @ mean.T
    stored = np.zeros(n)
    stored[p.input] = 1.0
    variance = max(float(V[p.input, p.input]), 0.0)
    # below rounding of P the reference is exact, and so is what it says about the other states
    sd = math.sqrt(variance) if variance > 1e-12 * p.P[p.input, p.input] else 0.0
    gain = V[:, p.input] / sd if sd > 0 else np.zeros(n)
    V = V - np.outer(gain, gain)
    seen = p.seen @ p.propagators
    tails = np.zeros((len(p.lags), 2))
    if math.isfinite(p.differencing):
        fade = np.exp(-p.differencing * p.lags)
        tails = np.stack([fade, -p.differencing * fade], axis=1)
        seen = seen - tails[:, :, None] * p.seen[0]
    free = p.seen_covariance - p.seen @ p.propagators @ p.P @ np.swapaxes(p.propagators, 1, 2) @ p.seen.T
    covariances = triangle(seen @ V @ np.swapaxes(seen, 1, 2) + free)
    return Release(seen @ mean, np.ascontiguousarray(seen @ gain), tails, covariances, mean[p.input], sd)


def triangle(matrices: np.ndarray) -> np.ndarray:
    """(lags, 3) entries 00, 01, 11 of symmetric (lags, 2, 2)."""
    return np.ascontiguousarray(np.stack([matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 1]], axis=1))
