"""Rates of the events that a circuit's own noise makes, from the statistics of its crossings.

**Crossings.**  Between two resets the amplifier's output is a smooth Gaussian process z(t) that starts from a known
state.  Let n_i(t, w) be the expected density of crossings of threshold i (ON upward, OFF downward) with slope w, and
q_i(t, w) that of first passages.  Every crossing is a first passage, or comes a lag after one:

    n(t) = q(t) + ∫ q(t′) K(t − t′) dt′

with K the intensity of crossings a lag after a crossing (Siegert 1951 and Durbin 1985 state this for Markov processes,
where it is exact).  n and K are Gaussian densities in closed form.  z alone is not Markov: the state at a crossing is
z, its slope, and further states, which are taken as they are at any crossing of that level with that slope.  That is
the one approximation; against simulation it costs below 1 % (`docs/methods/noise.md`).

**Rates need no time grid.**  With n → n_s and K → n_s (Rice) at long times, integration over all times gives

    Q (1 + ∫(K − n_s)) = ∫(n − n_s) + T n_s,   Σ Q = 1

for the shares Q of exits and the mean time T: one small linear system per reference.  Slopes are Gauss nodes of
the Rayleigh weight w e^{−w²/2}.

**Events.**  At an event the state is (polarity, level of z, slope).  During the dead time it evolves freely, then the
reference is the follower's noisy output, and the next event is drawn: a Markov chain, whose stationary law gives rates.
Levels are nodes of a uniform grid; what falls between is shared by four-point interpolation, which keeps cubic
functions exact.  Threshold noise is an average over draws of both thresholds (`threshold_draws`).

**Leak** moves the reference slowly against the noise: the pixel forgets its last event but the reference, which then
falls at the leak's rate through references of known exit rate (`crossings.settled`).

The reference after a reset that has just followed a crossing is far from the mean: an ON event by noise is followed by
OFF events as the output relaxes.  That the chain follows; rates without it would be wrong several-fold.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pixelid.stages.circuit import Circuit
from pixelid.stages.differencing import leaked
from pixelid.tables.noise.process import NoiseProcess, noise_process

SLOPES = 4  # 3 and 12 change exit rates by less than 0.3 %
SPACING = 0.35  # of references, in standard deviations of the output
GRID = 0.3  # of the stored reference, in standard deviations of the output: e⁻⁸ at thresholds of 4
MARGIN = 2.0  # standard deviations of references beyond the larger threshold
QUIET = 9.0  # a threshold of so many standard deviations is crossed at e⁻⁴⁰ of the bandwidth: never


@dataclass(frozen=True)
class NoiseRates:
    """Noise events of one pixel per second.

    Attributes:
        on_hz, off_hz: rates.
        wait_s: mean time from the end of the dead time to the next event.
    """

    on_hz: float
    off_hz: float
    wait_s: float


def noise_rates(circuit: Circuit, radiance: float, floor: float = 0.0) -> NoiseRates:
    """Rates of ON and OFF noise events of a pixel with the circuit's mean thresholds, under constant light.

    Args:
        circuit: its `shot_density`, thresholds, their noise, dead time and leak.
        radiance: of the scene, without the circuit's dark current.
        floor: one-sided PSD [1/Hz] of further white noise on ln L, whatever the light.

    Raises:
        InputError: see `noise_process`.

    Example:
        >>> from pixelid.model.shipped import find_model
        >>> circuit = find_model("dvs128").circuit().with_(shot_density=3.2e-4, noise=0.0)
        >>> rates = noise_rates(circuit, 24.0)
        >>> rates.on_hz > rates.off_hz > 0
        True
    """
    return rates_of(noise_process(circuit, radiance, floor), circuit, radiance)


def rates_of(process: NoiseProcess, circuit: Circuit, radiance: float) -> NoiseRates:
    """The same of a process that is already there; only thresholds, dead time and leak are read of the circuit."""
    drift = circuit.on_threshold * float(leaked(circuit, 1.0, radiance + circuit.dark))
    least = min(circuit.on_threshold, circuit.off_threshold) * (1.0 - 2.0 * circuit.noise)
    if least > QUIET * process.sigma:
        wait = circuit.on_threshold / drift if drift > 0 else math.inf
        return NoiseRates(1.0 / (wait + circuit.refractory), 0.0, wait)
    chain = _chain(process, circuit, drift)
    share = _stationary(chain.moved)
    wait = float(share @ chain.waited)
    rate = 1.0 / (wait + circuit.refractory)
    on = float(share[: len(share) // 2].sum())
    return NoiseRates(rate * on, rate * (1.0 - on), wait)


def mean_rates(circuit: Circuit, radiance: float, floor: float = 0.0) -> tuple[float, float]:
    """(ON, OFF) noise events per pixel and second, averaged over pixels whose thresholds differ by the mismatch.

    Rates of pixels differ by e^{± b² σ}, b the threshold in standard deviations of the noise: the average is far above
    the rate of the average pixel.  Arguments and errors as `noise_rates`.
    """
    process = noise_process(circuit, radiance, floor)
    factors, weights = threshold_draws(circuit.mismatch)
    total = np.zeros(2)
    for (on, off), weight in zip(factors, weights, strict=True):
        pixel = circuit.with_(
            on_threshold=circuit.on_threshold * on,
            off_threshold=circuit.off_threshold * off,
            leak_hz=circuit.leak_hz / on,  # the leak is one for all pixels, in mean thresholds
            leak_hz_per_radiance=circuit.leak_hz_per_radiance / on,
        )
        rates = rates_of(process, pixel, radiance)
        total += weight * np.array([rates.on_hz, rates.off_hz])
    return float(total[0]), float(total[1])


@dataclass(frozen=True)
class _Chain:
    """moved: (states, states) shares;  waited: (states,) mean s from release to the next event."""

    moved: np.ndarray
    waited: np.ndarray


def _chain(process: NoiseProcess, circuit: Circuit, drift: float) -> _Chain:
    from pixelid.tables.noise import crossings

    p = process
    slopes_unit, omega = rayleigh_nodes(SLOPES)
    slopes = slopes_unit * p.slope_sigma
    # ∫ n dw = Σ ω (n / (w e^{−w²/2σ²}))|node σ², and n = w f: the slope itself cancels
    factors = omega * np.exp(0.5 * slopes_unit**2) * p.slope_sigma**2
    lags = p.lags
    weights = lags * math.log(lags[1] / lags[0])
    weights[[0, -1]] *= 0.5
    means = p.seen @ p.propagators @ p.regression
    covariances = _triangle(p.seen_covariance - means @ p.seen_covariance @ np.swapaxes(means, 1, 2))
    released = _release(p, circuit.refractory)
    draws, draw_weights = threshold_draws(circuit.noise)
    on, off = circuit.on_threshold * draws[:, 0], circuit.off_threshold * draws[:, 1]
    offsets, offset_weights = _offset_nodes(released.sd / p.sigma)
    reach = max(on.max(), off.max()) + MARGIN * p.sigma
    nodes = np.linspace(-reach, reach, max(math.ceil(2.0 * reach / (SPACING * p.sigma)) + 1, 8))
    m, count = len(slopes), len(nodes)
    shape = (len(draws), count)
    between = np.empty((*shape, 2 * m, 2 * m))
    stationary = np.empty((*shape, 2 * m))
    states = 2 * count * m
    exits, times = np.empty((*shape, states)), np.empty(shape)
    for a in range(len(draws)):
        for k, reference in enumerate(nodes):
            up, down = reference + on[a], reference - off[a]
            rice = p.zero_crossings_hz * np.exp(-0.5 * (np.array([up, down]) / p.sigma) ** 2)
            stationary[a, k] = np.outer(rice, omega).ravel()
            crossings.between_crossings(
                means, covariances, up, down, slopes, factors, weights, stationary[a, k], between[a, k]
            )
    resolvents = np.linalg.inv(np.eye(2 * m) + between)
    for a in range(len(draws)):
        crossings.settled(nodes, on[a], off[a], slopes, stationary[a], resolvents[a], drift, exits[a], times[a])
    moved, waited = np.zeros((states, states)), np.zeros(states)
    crossings.transitions(
        nodes, slopes, omega, p.zero_crossings_hz, p.sigma, factors, weights, released.maps, released.spread,
        released.tails, released.covariances, released.reference, released.sd, offsets, offset_weights, on, off,
        draw_weights, resolvents, exits, times, moved, waited,
    )  # fmt: skip
    return _Chain(moved, waited)


@dataclass(frozen=True)
class _Release:
    """Output and slope after a reset: linear in output and slope at the event, in the reference, and noise."""

    maps: np.ndarray
    spread: np.ndarray
    tails: np.ndarray
    covariances: np.ndarray
    reference: np.ndarray
    sd: float


def _release(p: NoiseProcess, dead_s: float) -> _Release:
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
    covariances = _triangle(seen @ V @ np.swapaxes(seen, 1, 2) + free)
    return _Release(seen @ mean, np.ascontiguousarray(seen @ gain), tails, covariances, mean[p.input], sd)


def _triangle(matrices: np.ndarray) -> np.ndarray:
    """(lags, 3) entries 00, 01, 11 of symmetric (lags, 2, 2)."""
    return np.ascontiguousarray(np.stack([matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 1]], axis=1))


def _stationary(moved: np.ndarray) -> np.ndarray:
    """The law that the chain leaves unchanged."""
    system = moved.T - np.eye(len(moved))
    system[-1] = 1.0
    right = np.zeros(len(moved))
    right[-1] = 1.0
    return np.linalg.solve(system, right)


def _offset_nodes(relative_sd: float) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights of the stored reference, a normal draw of so many standard deviations of the output.

    The mean wait is about 1 / (e^{−(C + c)²/2σ²} + e^{−(C − c)²/2σ²}) of the reference c, which has poles at
    c = ± iπσ²/2C: a uniform grid of spacing h errs by e^{−π²σ²/hC}, polynomials need a narrow draw.
    """
    if relative_sd < 0.25:
        return _hermite(1 if relative_sd < 1e-3 else 3 if relative_sd < 0.08 else 5)
    spacing = min(GRID / relative_sd, 0.6)
    nodes = spacing * np.arange(-math.ceil(4.5 / spacing), math.ceil(4.5 / spacing) + 1)
    weights = np.exp(-0.5 * nodes**2)
    return nodes, weights / weights.sum()


def threshold_draws(relative_sd: float) -> tuple[np.ndarray, np.ndarray]:
    """(draws, 2) factors of the ON and OFF threshold and (draws,) weights: both independent and normal.

    The centre and both Gauss–Hermite neighbours along each axis: exact to the fifth order in either threshold.  What
    depends on both at once is left out, of fourth order in the relative sd.
    """
    if relative_sd <= 0:
        return np.ones((1, 2)), np.ones(1)
    step = math.sqrt(3.0) * min(relative_sd, 0.5)
    factors = 1.0 + step * np.array([(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)])
    return factors, np.array([1, 0.5, 0.5, 0.5, 0.5]) / 3.0


@lru_cache
def _hermite(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights of a standard normal draw."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(count)
    return nodes, weights / weights.sum()


@lru_cache
def rayleigh_nodes(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss nodes and weights of a slope of density w e^{−w²/2}: Golub & Welsch, the recurrence by Stieltjes."""
    x, weight = np.polynomial.legendre.leggauss(400)
    x = 5.0 * (x + 1.0)  # e⁻⁵⁰ is left beyond 10
    weight = weight * x * np.exp(-0.5 * x * x)
    weight /= weight.sum()
    alpha, beta = np.zeros(count), np.zeros(count)
    before, now, norm = np.zeros_like(x), np.ones_like(x), 1.0
    for k in range(count):
        size = float(weight @ now**2)
        alpha[k], beta[k] = float(weight @ (x * now**2)) / size, size / norm
        before, now, norm = now, (x - alpha[k]) * now - (beta[k] if k else 0.0) * before, size
    side = np.sqrt(beta[1:])
    nodes, vectors = np.linalg.eigh(np.diag(alpha) + np.diag(side, 1) + np.diag(side, -1))
    return nodes, vectors[0] ** 2
