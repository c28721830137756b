"""The rate of events of a noisy comparator under periodic light, and its fit to a phase table.

After a reset at phase r the amplifier shows z = ± A (g(θ − φ) − k g(r − φ)) at phase θ; k = 1 when it remembers the
level
it was reset at, less when that level fades (a lower cutoff, leak) before the next event.  Fast noise of standard
deviation s
rides on it and crosses a threshold C at Rice's rate (Rice 1944), about which a saturated comparator fires at ν; events
that no light explains come on top:

    λ_±(r, θ) = b_± + ν exp(−½ max(C_± − z, 0)² / s²)

Only A/C_on, A/C_off, s/C_on, φ, ν, k and b appear: the scale of A and C together is a gauge.
g has mean 0 and peak-to-peak 2, and A is half the band-limited peak-to-peak log contrast.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pixelid.flicker.phases import BINS, PhaseTable

NAMES = ("amplitude_over_on_threshold", "off_over_on_threshold", "phase_cycles", "noise_over_on_threshold", "rate_hz",
         "background_on_hz", "background_off_hz", "memory")  # fmt: skip
LOWER = np.array([np.log(1e-3), np.log(0.1), -np.inf, np.log(0.03), np.log(1.0), np.log(1e-4), np.log(1e-4), 0.0])
UPPER = np.array([np.log(50.0), np.log(10.0), np.inf, np.log(3.0), np.log(1e5), np.log(1e3), np.log(1e3), 1.0])
LINEAR = ("phase_cycles", "memory")
STEP = 1e-4


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


def rates(x: np.ndarray, shape: str) -> np.ndarray:
    """(2, BINS, BINS) rates of ON and OFF events by (phase of reset, phase now) at coordinates x (logs; cycles)."""
    a, ratio, phase, s, nu, b_on, b_off, memory = (*np.exp(x[:2]), x[2], *np.exp(x[3:7]), x[7])
    g = a * shape_at(shape, (np.arange(BINS) + 0.5) / BINS - phase)
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
    ends = [_climb(np.clip(x, *bounds), observed, table.exposure, shape, 25, bounds) for x in starts]
    x, _, _ = max(ends, key=lambda end: end[1])
    x, value, converged = _climb(x, observed, table.exposure, shape, 300, bounds)
    rate = rates(x, shape)
    mean = rate * table.exposure
    dispersion = _dispersion(observed, mean)
    x[2] %= 1.0
    return GroupFit(
        x, _information(x, table.exposure, shape) / max(dispersion, 1.0), value, dispersion, converged, mean.sum(1)
    )


def _value(x, observed, exposure, shape) -> float:
    rate = rates(x, shape)
    return float((observed * np.log(rate)).sum() - (rate * exposure).sum())


def _slopes(x, shape) -> np.ndarray:
    """(8, 2, BINS, BINS) derivatives of the rates."""
    return np.stack([(rates(x + d, shape) - rates(x - d, shape)) / (2 * STEP) for d in STEP * np.eye(len(x))])


def _information(x, exposure, shape) -> np.ndarray:
    J = _slopes(x, shape)
    return np.einsum("iabc,jabc->ij", J, J * exposure / rates(x, shape))


def _climb(x, observed, exposure, shape, steps, bounds) -> tuple[np.ndarray, float, bool]:
    lower, upper = bounds
    value, damping = _value(x, observed, exposure, shape), 1e-2
    for _ in range(steps):
        rate, J = rates(x, shape), _slopes(x, shape)
        gradient = (J * (observed / rate - exposure)).sum((1, 2, 3))
        free = ~(((x <= lower) & (gradient <= 0)) | ((x >= upper) & (gradient >= 0)) | (lower == upper))
        H = np.einsum("iabc,jabc->ij", J, J * exposure / rate)[np.ix_(free, free)]
        move = np.zeros(len(x))
        while damping < 1e10:
            step = np.linalg.solve(H + damping * np.diag(np.diag(H) + 1e-9), gradient[free])
            move[free] = step / max(1.0, np.abs(step).max())
            trial = np.clip(x + move, lower, upper)
            new = _value(trial, observed, exposure, shape)
            if new > value:
                break
            damping *= 4.0
        else:
            return x, value, bool(np.abs(gradient[free]) @ np.sqrt(np.diag(np.linalg.pinv(H))) < 0.5)
        gain, x, value, damping = new - value, trial, new, max(damping / 5.0, 1e-8)
        if gain < 1e-6:
            return x, value, True
    return x, value, False


def _dispersion(observed: np.ndarray, mean: np.ndarray) -> float:
    """Pearson χ² per cell, cells gathered along phase until each expects at least 5 events."""
    o, m = observed.ravel(), mean.ravel()
    group = np.floor(np.cumsum(m) / 5.0).astype(int)
    o, m = np.bincount(group, o), np.bincount(group, m)
    keep = m > 1.0
    return float(((o - m)[keep] ** 2 / m[keep]).mean())
