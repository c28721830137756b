"""Distributions of the time between successive noise events of a pixel, by the polarities of both.

Up to 8 of the slowest time constant first passages follow the renewal equation of `first_passage.py` in
time.  A pixel that is still waiting then has forgotten all but its reference: it fires at that reference's rate, along
which a leak moves it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pixelid.parallel import map_threads
from pixelid.stages.circuit import Circuit
from pixelid.tables.noise.chain import Chain, chain_of
from pixelid.tables.noise.first_passage import is_quiet, leak_drift, pixel_of
from pixelid.tables.noise.process import LAST_LAG, noise_process
from pixelid.tables.noise.quadrature import ROUGH, mismatch_draws

LATE = 160  # times at which a waiting pixel is followed, spaced evenly in ln t


@dataclass(frozen=True)
class NoiseIntervals:
    """Waits from the end of the dead time to the next event.

    Attributes:
        time_s: (times,) increasing, the dead time not included.
        passed: (2, 2, times) share of all intervals that began with an ON (0) or OFF (1) event and ended with an ON or
            OFF event within the time.
        dead_s: dead time, which an interval between events has in addition to its wait.
    """

    time_s: np.ndarray
    passed: np.ndarray
    dead_s: float

    def within(self, interval_s: np.ndarray) -> np.ndarray:
        """(2, 2, n) the same at any intervals between events, dead time included."""
        from scipy.interpolate import PchipInterpolator

        wait = np.clip(np.asarray(interval_s, float) - self.dead_s, self.time_s[0], self.time_s[-1])
        return PchipInterpolator(np.log(self.time_s), self.passed, axis=2)(np.log(wait))


def noise_intervals(circuit: Circuit, radiance: float, floor: float = 0.0) -> NoiseIntervals:
    """Intervals between noise events of a pixel with the circuit's mean thresholds.

    Arguments and errors as `first_passage.noise_rates`; the noise must reach the thresholds.
    """
    process = noise_process(circuit, radiance, floor)
    return intervals_of(chain_of(process, circuit, leak_drift(circuit, radiance)), circuit.refractory)


def mean_intervals(circuit: Circuit, radiance: float, edges_s: np.ndarray, floor: float = 0.0) -> np.ndarray | None:
    """(2, 2, n) share of all intervals, of pixels whose thresholds differ by the mismatch, between (n + 1,) edges.

    By the polarities of the events before and after, ON first; None where noise does not reach a pixel's thresholds but
    a leak does.  Other arguments and errors as `first_passage.noise_rates`.
    """
    process = noise_process(circuit, radiance, floor)
    leaks = leak_drift(circuit, radiance) > 0.0
    factors, weights = mismatch_draws(
        circuit.on_threshold, circuit.off_threshold, circuit.mismatch, process.sigma, ROUGH.pixels
    )

    def per_second(factor: np.ndarray) -> np.ndarray | None:
        """(2, 2, edges) intervals of one pixel per second that are shorter."""
        one = pixel_of(circuit, *factor)
        if is_quiet(process, one):
            return None if leaks else np.zeros((2, 2, len(edges_s)))
        chain = chain_of(process, one, leak_drift(one, radiance), ROUGH)
        wait = float(chain.share @ chain.waited)
        if wait < 0:  # beyond any number's use (`first_passage.rates_of`)
            return np.zeros((2, 2, len(edges_s)))
        return intervals_of(chain, one.refractory).within(np.maximum(edges_s, one.refractory)) / (wait + one.refractory)

    found = map_threads(per_second, factors)
    if any(one is None for one in found):
        return None
    shares = np.diff(np.einsum("k,kabt->abt", weights, np.array(found)), axis=2)
    return shares / shares.sum() if shares.sum() > 0 else None


def intervals_of(chain: Chain, dead_s: float) -> NoiseIntervals:
    """The same of a chain that is already there."""
    from pixelid.tables.noise import passages

    c, at, r = chain, chain.at, chain.release
    lags = at.process.lags
    forgotten = 8.0  # slowest time constants; e⁻⁸ is left of what a pixel knew beside its reference
    known = int(np.searchsorted(lags, lags[-1] * forgotten / LAST_LAG)) + 1
    lags = lags[:known]
    draws, count, size = c.stationary.shape
    crossed, begun = np.zeros((2, draws, count, len(lags), size)), np.zeros((2, draws, count))
    passages.crossings_after_events(
        c.share, c.nodes, at.slopes, at.factors, r.maps[..., :known], r.spread, r.tails, r.laws,
        r.hidden.arrays, r.start_spread, r.reference, r.sd, c.offsets, c.offset_weights, c.on, c.off, c.draw_weights,
        crossed, begun,
    )  # fmt: skip
    rates = _by_polarity(np.einsum("akq,akqi->aki", c.stationary, c.resolvents), at.hidden.moments)
    rates = np.maximum(rates, 1e-300)
    longest = 60.0  # mean waits: e⁻⁶⁰ is left
    late = np.geomspace(lags[-1], max(longest * float(c.share @ c.waited), 2.0 * lags[-1]), LATE + 1)
    passed = np.zeros((2, 2, len(lags) + LATE))
    between = np.empty((len(lags), size, size))
    for a in range(draws):
        for k, reference in enumerate(c.nodes):
            source = np.ascontiguousarray(crossed[:, a, k])
            if np.abs(begun[:, a, k]).max() < 1e-9:
                continue
            passages.crossings_between(
                at.means[..., :known], at.laws, at.hidden.arrays, reference + c.on[a], reference - c.off[a],
                at.slopes, at.factors, between,
            )  # fmt: skip
            quick = np.zeros((2, len(lags), size))
            passages.first_passages(lags, source, between, quick)
            quick = _by_polarity(quick, at.hidden.moments)
            passed[:, :, : len(lags)] += quick.swapaxes(1, 2)
            left = begun[:, a, k] - quick[:, -1].sum(-1)
            gone = _waiting(c.nodes, rates[a], k, c.drift, late)
            passed[:, :, len(lags) :] += quick[:, -1, :, None] + left[:, None, None] * gone[None, :, 1:]
    return NoiseIntervals(np.append(lags, late[1:]), np.maximum.accumulate(passed, axis=2), dead_s)


def _by_polarity(exits: np.ndarray, moments: int) -> np.ndarray:
    """(…, 2) shares of ON and OFF exits, of (…, 2 m s) by slope and moment of the hidden states."""
    return exits.reshape(*exits.shape[:-1], 2, -1, moments)[..., 0].sum(-1)


def _waiting(nodes: np.ndarray, rates: np.ndarray, k: int, drift: float, time: np.ndarray) -> np.ndarray:
    """(2, times) share that has fired ON and OFF since the first time of a pixel that waits at reference k.

    time: (times,) s since the reference was stored, from where it has fallen at `drift`.
    """
    if drift <= 0.0:
        total = rates[k].sum()
        return (rates[k] / total)[:, None] * -np.expm1(-total * (time - time[0]))
    # along the way the rates are log-linear between references; below the last they stay
    until = max((nodes[k] - nodes[0]) / drift, 1.01 * time[0])
    fine = np.unique(np.concatenate([time, np.linspace(time[0], until, 40 * (k + 1))]))
    place = nodes[k] - drift * fine
    along = np.exp([np.interp(place, nodes, np.log(rates[:, i])) for i in range(2)])
    total = along.sum(0)
    middle = np.sqrt(total[1:] * total[:-1])
    hazard = np.concatenate([[0.0], np.cumsum(middle * np.diff(fine))])
    fired = np.exp(-hazard[:-1]) * -np.expm1(-np.diff(hazard))
    share = 0.5 * (along / total)[:, 1:] + 0.5 * (along / total)[:, :-1]
    grown = np.concatenate([np.zeros((2, 1)), np.cumsum(share * fired, axis=1)], axis=1)
    return grown[:, np.searchsorted(fine, time)]
