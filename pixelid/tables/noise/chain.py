"""The Markov chain of noise events: from the state at one event to the state at the next (see `first_passage.py`)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pixelid.stages.circuit import Circuit
from pixelid.tables.noise.hidden import Hidden, lags_last, normal_laws
from pixelid.tables.noise.process import NoiseProcess
from pixelid.tables.noise.quadrature import WHOLE, Resolution, offset_nodes, rayleigh_nodes, threshold_draws

# Standard deviations of the output: `Resolution.fine` for thresholds that differ by less, `spacing` for those that
# differ by twice as much
ALIKE = 0.1
MARGIN = 2.0  # standard deviations of references beyond the larger threshold
SOLVED, PRODUCTS = 1e-12, 200  # relative residual of the stationary law, and products with the chain to get there
QUIET = 9.0  # a threshold of so many standard deviations is crossed at e⁻⁴⁰ of the bandwidth: never


@dataclass(frozen=True)
class Chain:
    """A circuit's noise events as a chain over (polarity, level of the output, slope, moment of the hidden states).

    Attributes:
        at: of its process;  drift: of the reference by leak, log radiance per second.
        release: what is known after a reset;  offsets, offset_weights: nodes of the stored reference.
        on, off, draw_weights: (draws,) thresholds as they are drawn.
        nodes: (k,) references, and levels of the states.
        stationary, resolvents: (draws, k, 2 m s) Rice's intensities, by slope and moment of the hidden states, and
            (draws, k, 2 m s, 2 m s) their first passages.
        moved: (states, states) shares;  waited: (states,) mean s from release to the next event.
    """

    at: Crossings
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
        """(states,) the law of states at events that the chain leaves unchanged.

        With 1 the sum over states (their first moments) and e any law of states, x = M x and 1 x = 1 are one system,
        (I − M + e 1) x = e.  Events forget those before soon, so that a few dozen products with M solve it.
        """
        from scipy.sparse.linalg import gmres

        size = len(self.moved)
        total = np.zeros(size)
        total[:: self.at.hidden.moments] = 1.0
        law = total / total.sum()
        system = np.outer(law, total) - self.moved.T
        system[np.arange(size), np.arange(size)] += 1.0
        share, unfinished = gmres(system, law, rtol=SOLVED, atol=0.0, restart=PRODUCTS, maxiter=1)
        return np.linalg.solve(system, law) if unfinished else share


@dataclass(frozen=True)
class Crossings:
    """What `crossings` wants of a process.

    Attributes:
        process: the noise.
        slopes, omega, factors: (m,) nodes of slopes, their weights, and what turns densities into intensities.
        weights: (lags,) of integrals.
        means, laws, hidden: of output, slope and hidden states a lag after a crossing, see
            `crossings.between_crossings`.
    """

    process: NoiseProcess
    slopes: np.ndarray
    omega: np.ndarray
    factors: np.ndarray
    weights: np.ndarray
    means: np.ndarray
    laws: np.ndarray
    hidden: Hidden

    @classmethod
    def of(cls, p: NoiseProcess, resolution: Resolution) -> Crossings:
        """At nodes of slopes and lags."""
        slopes_unit, omega = rayleigh_nodes(resolution.slopes)
        # ∫ n dw = Σ ω (n / (w e^{−w²/2σ²}))|node σ², and n = w f: the slope itself cancels
        factors = omega * np.exp(0.5 * slopes_unit**2) * p.slope_sigma**2
        weights = p.lags * math.log(p.lags[1] / p.lags[0])
        weights[[0, -1]] *= 0.5
        moved = p.propagators @ p.regression
        ended = p.P - moved @ p.seen_covariance @ np.swapaxes(moved, 1, 2)
        loading, reading = p.hidden(resolution.least_hidden)
        hidden = Hidden.of(p, reading, moved, np.zeros(moved.shape[:2]), p.propagators @ loading, ended)
        laws = normal_laws(p.seen @ ended @ p.seen.T)
        return cls(p, slopes_unit * p.slope_sigma, omega, factors, weights, lags_last(p.seen @ moved), laws, hidden)

    def rates(self, up: np.ndarray, down: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rice's intensities (k, 2 m s) of k pairs of levels, and (k, 2 m s, 2 m s) their first passages."""
        from pixelid.tables.noise import crossings

        moments = self.hidden.moments
        size = 2 * len(self.slopes) * moments
        stationary, between = np.zeros((len(up), size)), np.empty((len(up), size, size))
        for k, levels in enumerate(np.stack([up, down], axis=1)):
            rice = self.process.zero_crossings_hz * np.exp(-0.5 * (levels / self.process.sigma) ** 2)
            stationary[k, ::moments] = np.outer(rice, self.omega).ravel()
            crossings.between_crossings(
                self.means, self.laws, self.hidden.arrays, *levels, self.slopes, self.factors, self.weights,
                stationary[k], between[k],
            )  # fmt: skip
        return stationary, np.linalg.inv(np.eye(size) + between)


def leak_cycle_s(process: NoiseProcess, circuit: Circuit, drift: float, resolution: Resolution) -> float:
    """Mean time from the dead time's end to the next ON event by leak, s, where thresholds are far beyond the noise.

    The reference falls by itself until some standard deviations are left to the threshold, and noise does the rest:
    what happens there does not depend on the threshold.  Where it falls from depends on the state at the last event.
    """
    from pixelid.tables.noise import crossings

    p, at = process, Crossings.of(process, resolution)
    left = np.arange(-MARGIN, QUIET + 1.0 + resolution.spacing, resolution.spacing) * p.sigma  # to the threshold
    off = -2.0 * left[-1]  # out of reach
    stationary, resolvents = at.rates(left, np.full(len(left), off))
    count, moments = len(left), at.hidden.moments
    exits, times = np.empty((count, count * stationary.shape[1])), np.empty(count)
    crossings.exits_long_after(left, 0.0, -off, moments, stationary, resolvents, drift, exits, times)
    at_event = exits[-1].reshape(2, count, len(at.slopes), moments)[0, :, :, 0]
    released = release(p, circuit.refractory, resolution)
    kept = float((at_event * (released.reference[0] * left[:, None] + released.reference[1] * at.slopes)).sum())
    return float(times[-1] + (kept + circuit.on_threshold - left[-1]) / drift)


def chain_of(process: NoiseProcess, circuit: Circuit, drift: float, resolution: Resolution = WHOLE) -> Chain:
    """The chain of a circuit's thresholds, threshold noise and dead time; drift: of its references by leak, 1/s."""
    from pixelid.tables.noise import crossings

    p, at = process, Crossings.of(process, resolution)
    released = release(p, circuit.refractory, resolution)
    draws, draw_weights = threshold_draws(circuit.noise)
    on, off = circuit.on_threshold * draws[:, 0], circuit.off_threshold * draws[:, 1]
    offsets, offset_weights = offset_nodes(released.sd / p.sigma)
    # an OFF threshold that is never reached needs no references; an ON threshold may be reached by leak alone
    never = (QUIET + 1.0) * p.sigma
    reach = max(on.max() if drift > 0 else min(on.max(), never), min(off.max(), never)) + MARGIN * p.sigma
    spacing = _spacing(circuit, released, p, resolution)
    # at whole multiples of the spacing, so that what interpolation errs by is smooth in all parameters
    half = max(math.ceil(reach / (spacing * p.sigma)), 4)
    nodes = spacing * p.sigma * np.arange(-half, half + 1)
    count, moments = len(nodes), at.hidden.moments
    rates = [at.rates(nodes + on[a], nodes - off[a]) for a in range(len(draws))]
    stationary, resolvents = (np.stack(each) for each in zip(*rates, strict=True))
    states = count * stationary.shape[2]
    exits, times = np.empty((len(draws), count, states)), np.empty((len(draws), count))
    for a in range(len(draws)):
        crossings.exits_long_after(
            nodes, on[a], off[a], moments, stationary[a], resolvents[a], drift, exits[a], times[a]
        )
    moved, late = np.zeros((states, states)), np.zeros((states, len(draws), count))
    crossings.transitions(
        nodes, at.slopes, at.omega, p.zero_crossings_hz, p.sigma, at.factors, at.weights, released.maps,
        released.spread, released.tails, released.laws, released.hidden.arrays, released.start_spread,
        released.reference, released.sd, offsets, offset_weights, on, off, draw_weights, resolvents, moved, late,
    )  # fmt: skip
    late = late.reshape(states, -1)
    moved += late @ exits.reshape(-1, states)
    waited = late @ times.ravel()
    return Chain(
        at=at, release=released, offsets=offsets, offset_weights=offset_weights, on=on, off=off,
        draw_weights=draw_weights, nodes=nodes, stationary=stationary, resolvents=resolvents, drift=drift, moved=moved,
        waited=waited,
    )  # fmt: skip


def _spacing(circuit: Circuit, released: Release, p: NoiseProcess, resolution: Resolution) -> float:
    """Of references, in standard deviations of the output."""
    noise = circuit.noise * math.hypot(circuit.on_threshold, circuit.off_threshold)
    step = math.hypot(noise, math.sqrt(2.0) * math.hypot(released.sd, released.reference[1] * p.slope_sigma))
    apart = abs(circuit.on_threshold - circuit.off_threshold)
    fine = _below(apart, ALIKE * p.sigma) * _below(step, 0.5 * resolution.spacing * p.sigma)
    return resolution.spacing + fine * (resolution.fine - resolution.spacing)


def _below(x: float, limit: float) -> float:
    """1 up to a limit, 0 beyond twice that, smooth in between: what is computed must not jump."""
    share = min(max(2.0 - x / limit, 0.0), 1.0)
    return share * share * (3.0 - 2.0 * share)


@dataclass(frozen=True)
class Release:
    """Output, slope and hidden states after a reset: linear in output and slope at the event, in the reference, and
    noise."""

    maps: np.ndarray
    spread: np.ndarray
    tails: np.ndarray
    laws: np.ndarray
    reference: np.ndarray
    sd: float
    hidden: Hidden
    start_spread: np.ndarray


def release(p: NoiseProcess, dead_s: float, resolution: Resolution) -> Release:
    """What is known a dead time after an event, and then at each lag.

    The amplifier restarts from the stored reference, so its output is the never-reset one less what that had lagged
    behind at release, fading at its own cutoff.
    """
    n = len(p.A)
    silent = p.propagator(dead_s)
    mean = silent @ p.regression
    V = p.P - mean @ p.seen_covariance @ mean.T
    stored = np.zeros(n)
    stored[p.input] = 1.0
    variance = max(float(V[p.input, p.input]), 0.0)
    # below rounding of P the reference is exact, and so is what it says about the other states
    sd = math.sqrt(variance) if variance > 1e-12 * p.P[p.input, p.input] else 0.0
    gain = V[:, p.input] / sd if sd > 0 else np.zeros(n)
    V = V - np.outer(gain, gain)
    restart = np.eye(n)
    restart[-1] = stored
    seen, moved = p.seen @ p.propagators, p.propagators @ restart
    tails = np.zeros((len(p.lags), 2))
    if math.isfinite(p.differencing):
        fade = np.exp(-p.differencing * p.lags)
        tails = np.stack([fade, -p.differencing * fade], axis=1)
        seen = seen - tails[:, :, None] * p.seen[0]
    ended = moved @ V @ np.swapaxes(moved, 1, 2) + p.P - p.propagators @ p.P @ np.swapaxes(p.propagators, 1, 2)
    loading, reading = p.hidden(resolution.least_hidden)
    hidden_start = silent @ loading
    start_spread = hidden_start[p.input] / sd if sd > 0 else np.zeros(hidden_start.shape[1])
    carried = moved @ (hidden_start - np.outer(gain, start_spread))
    hidden = Hidden.of(p, reading, moved @ mean, moved @ gain, carried, ended)
    return Release(
        lags_last(seen @ mean), lags_last(seen @ gain), lags_last(tails), normal_laws(p.seen @ ended @ p.seen.T),
        mean[p.input], sd, hidden, start_spread,
    )  # fmt: skip
