"""The rate of events of a noisy comparator under periodic light, and its fit to a phase table.

After a reset at phase r the amplifier shows z = ± A (g(θ − φ) − k g(r − φ)) at phase θ; k = 1 when it remembers the
level it was reset at, less when that level fades (a lower cutoff, leak) before the next event.  Fast noise of
standard deviation s rides on it and crosses a threshold C at Rice's rate (Rice 1944), about which a saturated
comparator fires at ν; events that no light explains come on top:

    λ_±(r, θ) = b_± + ν exp(−½ max(C_± − z, 0)² / s²)

Only A/C_on, A/C_off, s/C_on, φ, ν, k and b appear: the scale of A and C together is a gauge.
g has mean 0 and peak-to-peak 2, and A is half the band-limited peak-to-peak log contrast.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pixelid.statistics import dispersion
from pixelid.tables.counts import information, maximise
from pixelid.tables.flicker.phases import BINS, COARSE, PhaseTable, coarse
from pixelid.tables.flicker.waveforms import Waveform

NAMES = ("amplitude_over_on_threshold", "off_over_on_threshold", "phase_cycles", "noise_over_on_threshold", "rate_hz",
         "background_on_hz", "background_off_hz", "memory")  # fmt: skip
LOWER = np.array([np.log(1e-3), np.log(0.1), -np.inf, np.log(0.03), np.log(1.0), np.log(1e-4), np.log(1e-4), 0.0])
UPPER = np.array([np.log(50.0), np.log(10.0), np.inf, np.log(3.0), np.log(1e5), np.log(1e3), np.log(1e3), 1.0])
LINEAR = ("phase_cycles", "memory")
# On these bounds something is absent (background, noise of the rate), complete (memory) or round (phase); on those of
# the others the fit has run away
RATIOS = ("amplitude_over_on_threshold", "off_over_on_threshold", "noise_over_on_threshold")
AT_BOUND = 1e-6
PHASES = (0.0, 0.25, 0.5, 0.75)  # that searches begin at


def rates(x: np.ndarray, waveform: Waveform, bins: int = BINS) -> tuple[np.ndarray, np.ndarray]:
    """(2, bins, bins) rates of ON and OFF events by (phase of reset, phase now), and their derivatives.

    Args:
        x: (coordinates,) in the order of `NAMES` (logs; cycles), and the waveform's own numbers.
        waveform: of the light.
        bins: of phase.

    Returns:
        The rates, and (coordinates, 2, bins, bins).
    """
    a, ratio, s, nu, b_on, b_off, memory = (*np.exp(x[:2]), *np.exp(x[3:7]), x[7])
    g, by = waveform.at(x[8:], (np.arange(bins) + 0.5) / bins - x[2])

    def between(now: np.ndarray) -> np.ndarray:
        """(…, reset, now) of the level now less what is remembered of that at the reset."""
        return now[..., None, :] - memory * now[..., :, None]

    z, moved = a * between(g), a * between(by)
    found, slopes = np.empty((2, bins, bins)), np.zeros((len(x), 2, bins, bins))
    for k, (sign, level, background) in enumerate(((1.0, 1.0, b_on), (-1.0, ratio, b_off))):
        short = np.maximum(level - sign * z, 0.0) / s
        fired = nu * np.exp(-0.5 * short**2)
        found[k] = background + fired
        rising = sign * fired * short / s  # by z
        slopes[0, k], slopes[2, k], slopes[7, k] = rising * z, -rising * moved[0], rising * (-a * g[:, None])
        slopes[8:, k] = rising * moved[1:]
        slopes[3, k], slopes[4, k], slopes[5 + k, k] = fired * short**2, fired, background
        if k == 1:
            slopes[1, k] = rising * ratio
    return found, slopes


@dataclass(frozen=True)
class GroupFit:
    """waveform: of the light;  x: coordinates in the order of `NAMES`, then its numbers;  information: Fisher, already
    divided by the dispersion;  log_likelihood, dispersion, converged; expected: (2, BINS) counts by phase now
    """

    waveform: Waveform
    x: np.ndarray
    information: np.ndarray
    log_likelihood: float
    dispersion: float
    converged: bool
    expected: np.ndarray

    @property
    def ratios_at_bound(self) -> list[str]:
        """Ratios to the ON threshold that sit on a bound of the search."""
        on = (self.x[:8] < LOWER + AT_BOUND) | (self.x[:8] > UPPER - AT_BOUND)
        return [name for name, here in zip(NAMES, on, strict=True) if here and name in RATIOS]

    @property
    def free(self) -> np.ndarray:
        """(coordinates,) which are on no bound."""
        lower, upper = bounds_of(self.waveform)
        return (self.x > lower + AT_BOUND) & (self.x < upper - AT_BOUND)

    @property
    def values(self) -> dict[str, float]:
        """Parameters in their own units, the waveform's numbers last."""
        own = np.exp(self.x[8:]) if self.waveform.logarithmic else self.x[8:]
        found = {n: float(v if n in LINEAR else np.exp(v)) for n, v in zip(NAMES, self.x[:8], strict=True)}
        return found | dict(zip(self.waveform.numbers, own.tolist(), strict=True))


def bounds_of(waveform: Waveform) -> tuple[np.ndarray, np.ndarray]:
    """(coordinates,) lowest and highest."""
    return np.append(LOWER, waveform.lower), np.append(UPPER, waveform.upper)


def fit_group(
    table: PhaseTable, waveform: Waveform, starts: Sequence[np.ndarray] = (), memory: float | None = None
) -> GroupFit:
    """Poisson fit of a group's parameters by damped scoring.

    Args:
        table: counts and exposure.
        waveform: of the light.
        starts: coordinates to begin at; several phases of small and large amplitudes by default.
        memory: held at this value unless None.
    """
    observed = np.stack([table.on, table.off])
    total = max(float(table.exposure.sum()), 1e-9)
    b = [max(0.3 * float(c.sum()) / total, 1e-3) for c in observed]
    nu = 30.0 * (b[0] + b[1])
    starts = starts or [
        np.array([np.log(a), 0.0, phase, np.log(s), np.log(nu), np.log(b[0]), np.log(b[1]), 0.7, *waveform.begin])
        for phase in PHASES for a, s in ((0.3, 0.3), (2.0, 0.2))
    ]  # fmt: skip
    lower, upper = bounds_of(waveform)
    if memory is not None:
        lower[7] = upper[7] = memory
    bounds = lower, upper

    def of_waveform(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return rates(x, waveform)

    def of_coarse(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return rates(x, waveform, COARSE)

    rough = coarse(table)
    counts = np.stack([rough.on, rough.off])
    ends = [maximise(np.clip(x, *bounds), of_coarse, counts, rough.exposure, bounds, 25) for x in starts]
    first = max(ends, key=lambda end: end.log_likelihood)
    best = maximise(first.x, of_waveform, observed, table.exposure, bounds, 300)
    rate, slopes = of_waveform(best.x)
    mean = rate * table.exposure
    scatter = dispersion(observed, mean)
    x = best.x.copy()
    x[2] %= 1.0
    fisher = information(rate, slopes, table.exposure) / max(scatter, 1.0)
    return GroupFit(waveform, x, fisher, best.log_likelihood, scatter, best.converged, mean.sum(1))
