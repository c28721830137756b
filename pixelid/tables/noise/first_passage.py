"""Rates of the events that a circuit's own noise makes, from the statistics of its crossings.

**Crossings.**  Between two resets the amplifier's output is a smooth Gaussian process z(t) that starts from a known
state.  Let n_i(t, w) be the expected density of crossings of threshold i (ON upward, OFF downward) with slope w, and
q_i(t, w) that of first passages.  Every crossing is a first passage, or comes a lag after one:

    n(t) = q(t) + ∫ q(t′) K(t − t′) dt′

with K the intensity of crossings a lag after a crossing (Siegert 1951 and Durbin 1985 state this for Markov processes,
where it is exact).  n and K are Gaussian densities in closed form.  z alone is not Markov: the state at a crossing is
z, its slope, and hidden states.  At any crossing they are normal; at a first passage, or soon after an event, they are
not, and their law is carried as the first terms of its Hermite series, density and mean (`hidden.Hidden`): every
quantity above has one component per term.  That is the one approximation (`docs/methods/noise.md`).

**Rates need no time grid.**  With n → n_s and K → n_s (Rice) at long times, integration over all times gives

    Q (1 + ∫(K − n_s)) = ∫(n − n_s) + T n_s,   Σ Q = 1

for the shares Q of exits and the mean time T: one small linear system per reference.  Slopes are Gauss nodes of
the Rayleigh weight w e^{−w²/2}.

**Events.**  At an event the state is (polarity, level of z, slope, term of the hidden states).  During the dead time it
evolves freely, then the reference is the follower's noisy output, and the next event is drawn: a Markov chain, whose
stationary law gives rates.  Levels are nodes of a uniform grid; what falls between is shared by four-point
interpolation, which keeps cubic functions exact.  Threshold noise is an average over draws of both thresholds
(`threshold_draws`).

**Leak** moves the reference slowly against the noise: the pixel forgets its last event but the reference, which then
falls at the leak's rate through references of known exit rate (`crossings.exits_long_after`).

The reference after a reset that has just followed a crossing is far from the mean: an ON event by noise is followed by
OFF events as the output relaxes.  That the chain follows; rates without it would be wrong several-fold.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pixelid.stages.circuit import Circuit
from pixelid.stages.differencing import leaked
from pixelid.tables.noise.chain import (
    QUIET,
    Chain,
    Crossings,
    Resets,
    chain_of,
    drawn_thresholds,
    fineness,
    leak_cycle_s,
    release,
)
from pixelid.tables.noise.process import NoiseProcess, noise_process
from pixelid.tables.noise.quadrature import ROUGH, WHOLE, Resolution, mismatch_draws


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


def rates_of(process: NoiseProcess, circuit: Circuit, radiance: float, resolution: Resolution = WHOLE) -> NoiseRates:
    """The same of a process that is already there; only thresholds, dead time and leak are read of the circuit."""
    ((on, off),) = rates_of_pixels(process, circuit, np.ones((1, 2)), radiance, resolution)
    rate = on + off
    return NoiseRates(on, off, 1.0 / rate - circuit.refractory if rate > 0 else math.inf)


def rates_of_pixels(
    process: NoiseProcess, circuit: Circuit, factors: np.ndarray, radiance: float, resolution: Resolution = WHOLE
) -> np.ndarray:
    """(pixels, 2) ON and OFF rates of pixels whose thresholds are `factors` (pixels, 2) times the circuit's.

    What follows a reset soon is computed once for all of them; one or two do with their own.
    """
    drift, found = leak_drift(circuit, radiance), np.zeros((len(factors), 2))
    pixels = [pixel_of(circuit, on, off) for on, off in factors.tolist()]
    noisy = np.array([not is_quiet(process, pixel) for pixel in pixels], bool)
    for k in np.flatnonzero(~noisy) if drift > 0 else ():
        found[k, 0] = 1.0 / (leak_cycle_s(process, pixels[k], drift, resolution) + circuit.refractory)
    if not noisy.any():
        return found
    at = Crossings.of(process, resolution)
    released = release(at, circuit.refractory)
    fine = np.array([fineness(pixel, released, process, resolution) for pixel in pixels])
    if len(pixels) <= 2:
        shared = [(resolution.spacing_of(fine[k]), np.arange(len(pixels)) == k) for k in range(len(pixels))]
    else:
        shared = [(resolution.spacing, 1.0 - fine), (resolution.fine, fine)]
    for spacing, weight in shared:
        some = np.flatnonzero(noisy & (weight > 0))
        if not len(some):
            continue
        drawn = [drawn_thresholds(pixels[k]) for k in some]
        on, off = (np.concatenate([one[side] for one in drawn]) for side in (0, 1))
        resets = Resets.of(at, released, on, off, drift, spacing)
        for k in some:
            found[k] += weight[k] * _of_chain(
                chain_of(process, pixels[k], drift, resolution, resets), circuit.refractory
            )
    return found


def _of_chain(chain: Chain, dead_s: float) -> np.ndarray:
    """(2,) ON and OFF events per second."""
    if chain.wait_s < 0:  # waits beyond any number's use, of either sign by rounding
        return np.zeros(2)
    return np.array([chain.on_share, 1.0 - chain.on_share]) / (chain.wait_s + dead_s)


def is_quiet(process: NoiseProcess, circuit: Circuit) -> bool:
    """Whether noise does not reach the thresholds."""
    least = min(circuit.on_threshold, circuit.off_threshold) * (1.0 - 2.0 * circuit.noise)
    return least > QUIET * process.sigma


def leak_drift(circuit: Circuit, radiance: float) -> float:
    """By how much a leak moves the reference in a second, log units."""
    return circuit.on_threshold * float(leaked(circuit, 1.0, radiance + circuit.dark))


def mean_rates(
    circuit: Circuit, radiance: float, floor: float = 0.0, resolution: Resolution = WHOLE
) -> tuple[float, float]:
    """(ON, OFF) noise events per pixel and second, averaged over pixels whose thresholds differ by the mismatch.

    Rates of pixels differ by e^{± b² σ}, b the threshold in standard deviations of the noise: the average is far above
    the rate of the average pixel.  Each pixel's rate is `ROUGH`, unless its thresholds are so nearly alike that an
    event brings another; what finer resolution changes of the others is nearly the same for all, and is taken from
    those that their average ON and OFF event is of.  Arguments and errors as `noise_rates`.
    """
    process = noise_process(circuit, radiance, floor)
    factors, weights, rates = _of_pixels(process, circuit, radiance, resolution)
    if resolution == ROUGH:
        return float(weights @ rates[:, 0]), float(weights @ rates[:, 1])
    released = release(Crossings.of(process, ROUGH), circuit.refractory)
    alone = len(factors) == 1
    alike = [alone or fineness(pixel_of(circuit, *f), released, process, resolution) > 0 for f in factors.tolist()]
    rates[alike] = rates_of_pixels(process, circuit, factors[alike], radiance, resolution)
    mean, others = weights @ rates, ~np.array(alike)
    if others.any():
        some = weights[others, None] * rates[others]
        typical = _typical(factors[others], some)
        rough, fine = (
            rates_of_pixels(process, circuit, typical, radiance, each).diagonal() for each in (ROUGH, resolution)
        )
        mean += some.sum(0) * (np.divide(fine, rough, out=np.ones(2), where=rough > 0) - 1.0)
    return float(mean[0]), float(mean[1])


def typical_thresholds(
    circuit: Circuit, radiance: float, floor: float = 0.0, resolution: Resolution = ROUGH
) -> np.ndarray:
    """(2, 2) factors on the ON and OFF threshold (columns) of the pixel that the average ON and OFF event (rows) is of.

    Thresholds of b standard deviations of the noise, which differ by a share m, are lower there by a share of b² m².
    ln mean rate changes with a parameter as the mean of ln rates weighted by pixels' rates does: as that pixel's,
    but for m².  Arguments and errors as `noise_rates`.
    """
    factors, weights, rates = _of_pixels(noise_process(circuit, radiance, floor), circuit, radiance, resolution)
    return _typical(factors, weights[:, None] * rates)


def _typical(factors: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """(2, 2) of pixels (pixels, 2), rates times weights."""
    total = rates.sum(0)[:, None]
    return np.where(total > 0, rates.T @ factors / np.where(total > 0, total, 1.0), 1.0)


def typical_rates(
    circuit: Circuit, radiance: float, thresholds: np.ndarray, floor: float = 0.0, resolution: Resolution = WHOLE
) -> tuple[float, float]:
    """(ON, OFF) noise events per second, each of a pixel of its own: thresholds as of `typical_thresholds`."""
    rates = rates_of_pixels(noise_process(circuit, radiance, floor), circuit, thresholds, radiance, resolution)
    return float(rates[0, 0]), float(rates[1, 1])


def _of_pixels(
    process: NoiseProcess, circuit: Circuit, radiance: float, resolution: Resolution
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(pixels, 2) factors on their thresholds, (pixels,) their weights, and (pixels, 2) `ROUGH` ON and OFF rates."""
    factors, weights = mismatch_draws(
        circuit.on_threshold, circuit.off_threshold, circuit.mismatch, process.sigma, resolution.pixels
    )
    return factors, weights, rates_of_pixels(process, circuit, factors, radiance, ROUGH)


def pixel_of(circuit: Circuit, on: float, off: float) -> Circuit:
    """A pixel whose thresholds are so many times the mean ones; the leak, in mean thresholds, is one for all pixels."""
    return circuit.with_(
        on_threshold=circuit.on_threshold * on,
        off_threshold=circuit.off_threshold * off,
        leak_hz=circuit.leak_hz / on,
        leak_hz_per_radiance=circuit.leak_hz_per_radiance / on,
    )
