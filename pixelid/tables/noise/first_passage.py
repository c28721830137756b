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
from pixelid.tables.noise.chain import QUIET, chain_of, leak_cycle_s
from pixelid.tables.noise.process import NoiseProcess, noise_process
from pixelid.tables.noise.quadrature import WHOLE, Resolution, mismatch_draws


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
    drift = leak_drift(circuit, radiance)
    if is_quiet(process, circuit):
        wait = leak_cycle_s(process, circuit, drift, resolution) if drift > 0 else math.inf
        return NoiseRates(1.0 / (wait + circuit.refractory), 0.0, wait)
    chain = chain_of(process, circuit, drift, resolution)
    share = chain.share
    wait = float(share @ chain.waited)
    if wait < 0:  # waits beyond any number's use, of either sign by rounding
        return NoiseRates(0.0, 0.0, math.inf)
    rate = 1.0 / (wait + circuit.refractory)
    on = min(max(float(share[: len(share) // 2 : chain.at.hidden.moments].sum()), 0.0), 1.0)
    return NoiseRates(rate * on, rate * (1.0 - on), wait)


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
    the rate of the average pixel.  Arguments and errors as `noise_rates`.
    """
    on, off = _of_pixels(circuit, radiance, floor, resolution)[1].sum(0)
    return float(on), float(off)


def typical_thresholds(
    circuit: Circuit, radiance: float, floor: float = 0.0, resolution: Resolution = WHOLE
) -> np.ndarray:
    """(2, 2) factors on the ON and OFF threshold (columns) of the pixel that the average ON and OFF event (rows) is of.

    Thresholds of b standard deviations of the noise, which differ by a share m, are lower there by a share of b² m².
    ln mean rate changes with a parameter as the mean of ln rates weighted by pixels' rates does: as that pixel's,
    but for m².  Arguments and errors as `noise_rates`.
    """
    factors, rates = _of_pixels(circuit, radiance, floor, resolution)
    total = rates.sum(0)[:, None]
    return np.where(total > 0, rates.T @ factors / np.where(total > 0, total, 1.0), 1.0)


def typical_rates(
    circuit: Circuit, radiance: float, thresholds: np.ndarray, floor: float = 0.0, resolution: Resolution = WHOLE
) -> tuple[float, float]:
    """(ON, OFF) noise events per second, each of a pixel of its own: thresholds as of `typical_thresholds`."""
    process = noise_process(circuit, radiance, floor)
    of_on, of_off = (rates_of(process, pixel_of(circuit, *f), radiance, resolution) for f in thresholds)
    return of_on.on_hz, of_off.off_hz


def _of_pixels(
    circuit: Circuit, radiance: float, floor: float, resolution: Resolution
) -> tuple[np.ndarray, np.ndarray]:
    """(pixels, 2) factors on their thresholds, and their ON and OFF rates times the pixels' weights."""
    process = noise_process(circuit, radiance, floor)
    factors, weights = mismatch_draws(
        circuit.on_threshold, circuit.off_threshold, circuit.mismatch, process.sigma, resolution.pixels
    )
    rates = [rates_of(process, pixel_of(circuit, *f), radiance, resolution) for f in factors]
    return factors, weights[:, None] * np.array([[r.on_hz, r.off_hz] for r in rates])


def pixel_of(circuit: Circuit, on: float, off: float) -> Circuit:
    """A pixel whose thresholds are so many times the mean ones; the leak, in mean thresholds, is one for all pixels."""
    return circuit.with_(
        on_threshold=circuit.on_threshold * on,
        off_threshold=circuit.off_threshold * off,
        leak_hz=circuit.leak_hz / on,
        leak_hz_per_radiance=circuit.leak_hz_per_radiance / on,
    )
