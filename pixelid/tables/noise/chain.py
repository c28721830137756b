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
THRESHOLDS = 0.3  # of thresholds that are interpolated between, the same: a Gaussian within 6e-4
QUIET = 9.0  # a threshold of so many standard deviations is crossed at e⁻⁴⁰ of the bandwidth: never


@dataclass(frozen=True)
class Chain:
    """A circuit's noise events as a chain over (polarity, level of the output, slope, moment of the hidden states).

    Attributes:
        resets: of its process and dead time.
        on, off, draw_weights: (draws,) thresholds as they are drawn.
        stationary, resolvents: (draws, k, 2 m s) Rice's intensities, by slope and moment of the hidden states, and
            (draws, k, 2 m s, 2 m s) their first passages.
        drift: of the reference by leak, log radiance per second.
        moved: (states, states) shares;  waited: (states,) mean s from release to the next event.
    """

    resets: Resets
    on: np.ndarray
    off: np.ndarray
    draw_weights: np.ndarray
    stationary: np.ndarray
    resolvents: np.ndarray
    drift: float
    moved: np.ndarray
    waited: np.ndarray

    @cached_property
    def share(self) -> np.ndarray:
        """(states,) the law of states at events that the chain leaves unchanged.

        With 1 the sum over states (their first moments) and e any law of states, x = M x and 1 x = 1 are one system,
        (I − M + e 1) x = e.
        """
        size = len(self.moved)
        total = np.zeros(size)
        total[:: self.resets.at.hidden.moments] = 1.0
        law = total / total.sum()
        system = law[:, None] * total - self.moved.T
        system[np.arange(size), np.arange(size)] += 1.0
        return np.linalg.solve(system, law)

    @property
    def on_share(self) -> float:
        """Of events that are ON."""
        moments = self.resets.at.hidden.moments
        of_on = int((self.resets.states[0] >= 0).sum()) * len(self.resets.at.slopes) * moments
        return min(max(float(self.share[:of_on:moments].sum()), 0.0), 1.0)

    @property
    def wait_s(self) -> float:
        """Mean s from release to the next event."""
        return float(self.share @ self.waited)


@dataclass(frozen=True)
class Crossings:
    """What `crossings` wants of a process.

    Attributes:
        process: the noise.
        slopes, omega, factors: (m,) nodes of slopes, their weights, and what turns densities into intensities.
        weights: (lags,) of integrals.
        resolution: of all this.
        means, laws, hidden: of output, slope and hidden states a lag after a crossing, see
            `crossings.between_crossings`.
    """

    process: NoiseProcess
    slopes: np.ndarray
    omega: np.ndarray
    factors: np.ndarray
    weights: np.ndarray
    resolution: Resolution
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
        return cls(
            p, slopes_unit * p.slope_sigma, omega, factors, weights, resolution, lags_last(p.seen @ moved), laws, hidden
        )  # fmt: skip

    def rates(self, up: np.ndarray, down: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rice's intensities (k, 2 m s) of k pairs of levels, and (k, 2 m s, 2 m s) their first passages."""
        from pixelid.tables.noise import crossings

        moments = self.hidden.moments
        size = 2 * len(self.slopes) * moments
        stationary, between = np.zeros((len(up), size)), np.empty((len(up), size, size))
        levels = np.stack([up, down], axis=1)
        rice = self.process.zero_crossings_hz * np.exp(-0.5 * (levels / self.process.sigma) ** 2)
        stationary[:, ::moments] = (rice[:, :, None] * self.omega).reshape(len(up), -1)
        crossings.between_crossings(
            self.means, self.laws, self.hidden.arrays, up, down, self.slopes, self.factors, self.weights, stationary,
            between,
        )  # fmt: skip
        return stationary, np.linalg.inv(np.eye(size) + between)


@dataclass(frozen=True)
class Resets:
    """What follows a reset soon, of one process and dead time: the same for all pixels, whatever their thresholds.

    Attributes:
        at: of the process;  release: what is known after a reset.
        offsets, offset_weights: nodes of the stored reference.
        nodes: (k,) references, and levels of the states.
        states: (2, k) first state of events of a polarity and level, −1 where there are none.
        on, off: thresholds, nodes of an interpolation;  soon_on, soon_off: of `crossings.after_resets` at these.
    """

    at: Crossings
    release: Release
    offsets: np.ndarray
    offset_weights: np.ndarray
    nodes: np.ndarray
    states: np.ndarray
    on: np.ndarray
    off: np.ndarray
    soon_on: np.ndarray
    soon_off: np.ndarray

    @classmethod
    def of(
        cls, at: Crossings, released: Release, on: np.ndarray, off: np.ndarray, drift: float, spacing: float
    ) -> Resets:
        """For all of some ON and OFF thresholds; spacing: of nodes, in standard deviations of the output."""
        from pixelid.tables.noise import crossings

        p = at.process
        offsets, offset_weights = offset_nodes(released.sd / p.sigma)
        # an OFF threshold that is never reached needs no references; an ON threshold may be reached by leak alone
        never, margin = (QUIET + 1.0) * p.sigma, MARGIN * p.sigma
        reach = max(on.max() if drift > 0 else min(on.max(), never), min(off.max(), never)) + margin
        # at whole multiples of the spacing, so that what interpolation errs by is smooth in all parameters
        half = max(math.ceil(reach / (spacing * p.sigma)), 4)
        nodes = spacing * p.sigma * np.arange(-half, half + 1)
        # ON events lie a threshold above references, and are shared by the two nodes on either side
        farthest = nodes[-1] + 2.0 * (nodes[1] - nodes[0])
        there = np.stack([nodes >= on.min() - farthest, nodes <= farthest - off.min()])
        each = len(at.slopes) * at.hidden.moments
        states = np.where(there, each * (np.cumsum(there).reshape(there.shape) - 1), -1)
        soon, size = [], (2, len(nodes), len(at.slopes), len(offsets))
        thresholds = [_threshold_nodes(values, THRESHOLDS * p.sigma) for values in (on, off)]
        for sign, values in zip((1.0, -1.0), thresholds, strict=True):
            found = np.zeros((*size, len(values), at.hidden.moments, each))
            crossings.after_resets(
                nodes, at.slopes, at.omega, p.zero_crossings_hz, p.sigma, at.factors, at.weights, released.maps,
                released.spread, released.tails, released.laws, released.hidden.arrays, released.start_spread,
                released.reference, released.sd, offsets, states, sign, values, found,
            )  # fmt: skip
            soon.append(found)
        return cls(at, released, offsets, offset_weights, nodes, states, *thresholds, *soon)


def _threshold_nodes(values: np.ndarray, step: float) -> np.ndarray:
    """Nodes between which thresholds are interpolated: they themselves, where these are fewer."""
    values = np.unique(values)
    if len(values) <= (values[-1] - values[0]) / step + 4.0:
        return values
    return step * np.arange(math.floor(values[0] / step) - 1, math.floor(values[-1] / step) + 3)


def _contributions(values: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """(values, nodes) weights of the nodes of `_threshold_nodes` at values, by four-point interpolation."""
    k = np.searchsorted(nodes, values)
    if (nodes[np.minimum(k, len(nodes) - 1)] == values).all():
        return np.eye(len(nodes))[k]
    u = (values - nodes[0]) / (nodes[1] - nodes[0])
    k = np.clip(u.astype(int) - 1, 0, len(nodes) - 4)
    weights, u = np.zeros((len(values), len(nodes))), u - k
    for n, line in enumerate((
        -(u - 1.0) * (u - 2.0) * (u - 3.0) / 6.0, u * (u - 2.0) * (u - 3.0) / 2.0,
        -u * (u - 1.0) * (u - 3.0) / 2.0, u * (u - 1.0) * (u - 2.0) / 6.0,
    )):  # fmt: skip
        weights[np.arange(len(values)), k + n] = line
    return weights


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
    states = np.arange(2 * count).reshape(2, count) * (stationary.shape[1] // 2)
    crossings.exits_long_after(left, states, 0.0, -off, moments, stationary, resolvents, drift, exits, times)
    at_event = exits[-1].reshape(2, count, len(at.slopes), moments)[0, :, :, 0]
    released = release(at, circuit.refractory)
    kept = float((at_event * (released.reference[0] * left[:, None] + released.reference[1] * at.slopes)).sum())
    return float(times[-1] + (kept + circuit.on_threshold - left[-1]) / drift)


def chain_of(
    process: NoiseProcess, circuit: Circuit, drift: float, resolution: Resolution = WHOLE,
    resets: Resets | None = None,
) -> Chain:  # fmt: skip
    """The chain of a circuit's thresholds, threshold noise and dead time.

    Args:
        process: its noise.
        circuit: the thresholds.
        drift: of its references by leak, 1/s.
        resolution: of what is computed.
        resets: of the process and dead time, for these thresholds and others.
    """
    from pixelid.tables.noise import crossings

    on, off, draw_weights = drawn_thresholds(circuit)
    if resets is None:
        at = Crossings.of(process, resolution)
        released = release(at, circuit.refractory)
        fine = fineness(circuit, released, process, resolution)
        resets = Resets.of(at, released, on, off, drift, resolution.spacing_of(fine))
    at, released, nodes = resets.at, resets.release, resets.nodes
    count, draws, moments = len(nodes), len(on), at.hidden.moments
    stationary, resolvents = at.rates((nodes + on[:, None]).ravel(), (nodes - off[:, None]).ravel())
    stationary = stationary.reshape(draws, count, -1)
    resolvents = resolvents.reshape(draws, count, *resolvents.shape[1:])
    states = int(resets.states.max()) + stationary.shape[2] // 2
    exits, times = np.empty((draws, count, states)), np.empty((draws, count))
    for a in range(draws):
        crossings.exits_long_after(
            nodes, resets.states, on[a], off[a], moments, stationary[a], resolvents[a], drift, exits[a], times[a]
        )
    moved, late = np.zeros((states, states)), np.zeros((states, draws, count))
    crossings.transitions(
        nodes, resets.states, at.slopes, released.start_spread, released.reference, released.sd, resets.offsets,
        resets.offset_weights, on, off, draw_weights, resets.soon_on, resets.soon_off,
        _contributions(on, resets.on), _contributions(off, resets.off), resolvents, moved, late,
    )  # fmt: skip
    late = late.reshape(states, -1)
    moved += late @ exits.reshape(-1, states)
    waited = late @ times.ravel()
    return Chain(resets, on, off, draw_weights, stationary, resolvents, drift, moved, waited)


def drawn_thresholds(circuit: Circuit) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(draws,) ON and OFF thresholds as their noise draws them, and the draws' weights."""
    draws, weights = threshold_draws(circuit.noise)
    return circuit.on_threshold * draws[:, 0], circuit.off_threshold * draws[:, 1], weights


def fineness(circuit: Circuit, released: Release, p: NoiseProcess, resolution: Resolution) -> float:
    """0 … 1: how finely references must be spaced, see `Resolution.spacing_of`."""
    noise = circuit.noise * math.hypot(circuit.on_threshold, circuit.off_threshold)
    step = math.hypot(noise, math.sqrt(2.0) * math.hypot(released.sd, released.reference[1] * p.slope_sigma))
    apart = abs(circuit.on_threshold - circuit.off_threshold)
    return _below(apart, ALIKE * p.sigma) * _below(step, 0.5 * resolution.spacing * p.sigma)


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


def release(at: Crossings, dead_s: float) -> Release:
    """What is known a dead time after an event, and then at each lag.

    The amplifier restarts from the stored reference, so its output is the never-reset one less what that had lagged
    behind at release, fading at its own cutoff.
    """
    p = at.process
    propagators = p.propagators
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
    seen, moved = p.seen @ propagators, propagators @ restart
    tails = np.zeros((len(p.lags), 2))
    if math.isfinite(p.differencing):
        fade = np.exp(-p.differencing * p.lags)
        tails = np.stack([fade, -p.differencing * fade], axis=1)
        seen = seen - tails[:, :, None] * p.seen[0]
    ended = moved @ V @ np.swapaxes(moved, 1, 2) + p.P - propagators @ p.P @ np.swapaxes(propagators, 1, 2)
    loading, reading = p.hidden(at.resolution.least_hidden)
    hidden_start = silent @ loading
    start_spread = hidden_start[p.input] / sd if sd > 0 else np.zeros(hidden_start.shape[1])
    carried = moved @ (hidden_start - np.outer(gain, start_spread))
    hidden = Hidden.of(p, reading, moved @ mean, moved @ gain, carried, ended)
    return Release(
        lags_last(seen @ mean), lags_last(seen @ gain), lags_last(tails), normal_laws(p.seen @ ended @ p.seen.T),
        mean[p.input], sd, hidden, start_spread,
    )  # fmt: skip
