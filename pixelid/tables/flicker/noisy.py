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

from dataclasses import dataclass

import numpy as np

from pixelid.statistics import dispersion
from pixelid.tables.counts import information, maximise
from pixelid.tables.flicker.phases import BINS, COARSE, PhaseTable, coarse

NAMES = ("amplitude_over_on_threshold", "off_over_on_threshold", "phase_cycles", "noise_over_on_threshold", "rate_hz",
         "background_on_hz", "background_off_hz", "memory")  # fmt: skip
LOWER = np.array([np.log(1e-3), np.log(0.1), -np.inf, np.log(0.03), np.log(1.0), np.log(1e-4), np.log(1e-4), 0.0])
UPPER = np.array([np.log(50.0), np.log(10.0), np.inf, np.log(3.0), np.log(1e5), np.log(1e3), np.log(1e3), 1.0])
LINEAR = ("phase_cycles", "memory")
# On these bounds something is absent (background, noise of the rate), complete (memory) or round (phase); on those of
# the others the fit has run away
RATIOS = ("amplitude_over_on_threshold", "off_over_on_threshold", "noise_over_on_threshold")
AT_BOUND = 1e-6


def _normal(g: np.ndarray) -> np.ndarray:
    return (g - g.mean()) * 2.0 / np.ptp(g)


_FINE = 4096
_THETA = 2.0 * np.pi * np.arange(_FINE) / _FINE
SHAPES = {
    "sine": _normal(np.sin(_THETA)),
    "deep sine": _normal(np.log1p(0.9 * np.sin(_THETA))),
    "rectified": _normal(np.log(0.1 + np.abs(np.sin(0.5 * _THETA)))),
}


def shape_at(shape: str, cycles: np.ndarray) -> np.ndarray:
    """g of a shape at phases in cycles, interpolated."""
    g = SHAPES[shape]
    x = (cycles % 1.0) * _FINE
    k = np.floor(x).astype(int) % _FINE
    return g[k] + (x - np.floor(x)) * (g[(k + 1) % _FINE] - g[k])


def rates(x: np.ndarray, shape: str, bins: int = BINS) -> np.ndarray:
    """(2, bins, bins) rates of ON and OFF events by (phase of reset, phase now) at coordinates x (logs; cycles)."""
    a, ratio, phase, s, nu, b_on, b_off, memory = (*np.exp(x[:2]), x[2], *np.exp(x[3:7]), x[7])
    g = a * shape_at(shape, (np.arange(bins) + 0.5) / bins - phase)
    z = g[None, :] - memory * g[:, None]
    return np.stack(
        [
            b_on + nu * np.exp(-0.5 * (np.maximum(1.0 - z, 0.0) / s) ** 2),
            b_off + nu * np.exp(-0.5 * (np.maximum(ratio + z, 0.0) / s) ** 2),
        ]
    )


@dataclass(frozen=True)
class GroupFit:
    """x: coordinates in the order of `NAMES`;  information: (8, 8) Fisher, already divided by the dispersion;
    log_likelihood, dispersion, converged; expected: (2, BINS) counts by phase now
    """

    x: np.ndarray
    information: np.ndarray
    log_likelihood: float
    dispersion: float
    converged: bool
    expected: np.ndarray

    @property
    def ratios_at_bound(self) -> list[str]:
        """Ratios to the ON threshold that sit on a bound of the search."""
        on = (self.x < LOWER + AT_BOUND) | (self.x > UPPER - AT_BOUND)
        return [name for name, here in zip(NAMES, on, strict=True) if here and name in RATIOS]

    @property
    def values(self) -> dict[str, float]:
        """Parameters in their own units."""
        return {n: float(v if n in LINEAR else np.exp(v)) for n, v in zip(NAMES, self.x, strict=True)}


def fit_group(
    table: PhaseTable, shape: str = "sine", start: np.ndarray | None = None, memory: float | None = None
) -> GroupFit:
    """Poisson fit of the eight parameters by damped scoring, from several phases.

    start: coordinates of a similar fit, whose phase alone is doubted;  memory: held at this value unless None.
    """
    observed = np.stack([table.on, table.off])
    total = max(float(table.exposure.sum()), 1e-9)
    b = [max(0.3 * float(c.sum()) / total, 1e-3) for c in observed]
    nu = 30.0 * (b[0] + b[1])
    phases = (0.0, 0.25, 0.5, 0.75)
    starts = [start + shift * np.eye(8)[2] for shift in phases] if start is not None else [
        np.array([np.log(a), 0.0, phase, np.log(s), np.log(nu), np.log(b[0]), np.log(b[1]), 0.7])
        for phase in phases for a, s in ((0.3, 0.3), (2.0, 0.2))
    ]  # fmt: skip
    lower, upper = LOWER.copy(), UPPER.copy()
    if memory is not None:
        lower[7] = upper[7] = memory
    bounds = lower, upper

    def of_shape(x: np.ndarray) -> np.ndarray:
        return rates(x, shape)

    def of_coarse(x: np.ndarray) -> np.ndarray:
        return rates(x, shape, COARSE)

    rough = coarse(table)
    counts = np.stack([rough.on, rough.off])
    ends = [maximise(np.clip(x, *bounds), of_coarse, counts, rough.exposure, bounds, 25) for x in starts]
    first = max(ends, key=lambda end: end.log_likelihood)
    best = maximise(first.x, of_shape, observed, table.exposure, bounds, 300)
    mean = of_shape(best.x) * table.exposure
    scatter = dispersion(observed, mean)
    x = best.x.copy()
    x[2] %= 1.0
    fisher = information(x, of_shape, table.exposure) / max(scatter, 1.0)
    return GroupFit(x, fisher, best.log_likelihood, scatter, best.converged, mean.sum(1))
