"""The stages around one constant light, where they are linear, and the covariance of noise that passes them."""

from __future__ import annotations

import math

import numpy as np

from pixelid.dynamics.equations import photoreceptor_rates
from pixelid.dynamics.of_circuit import dynamics_of
from pixelid.dynamics.slew import without_slew_limit
from pixelid.stages.circuit import Circuit


def has_pole(circuit: Circuit) -> bool:
    """Whether a stage limits the bandwidth of white noise: without one the noise has no level."""
    return len(linear_stages(circuit, 1.0)[0]) > 0


def linear_stages(circuit: Circuit, light: float) -> tuple[np.ndarray, np.ndarray, int]:
    """(A (n, n), drive (n,), stored): dx/dt = A x + drive · (ln L − its mean) of the stages, around a constant light.

    The amplifier's output is the last state, and `stored` the one that a reset stores.  Left out are a lower cutoff,
    and a slew limit: noise is slow compared with it.

    Args:
        circuit: its stages.
        light: of the photoreceptor, with dark current.
    """
    dynamics, rates = dynamics_of(without_slew_limit(circuit)), []
    if circuit.photoreceptor == "one_pole":
        a, b2 = photoreceptor_rates(dynamics, light)
        rates.append(a / b2)
    rates += [w for w in (circuit.follower, circuit.extra_pole, circuit.differencing) if math.isfinite(w)]
    second_order = circuit.photoreceptor == "second_order"
    n = len(rates) + 2 * second_order
    A, drive = np.zeros((n, n)), np.zeros(n)
    first = 0
    if second_order:
        a, b2 = photoreceptor_rates(dynamics, light)
        root = math.sqrt(a)
        A[0, 0], A[0, 1], A[1, 0], first = -b2, -root, root, 2
        drive[0] = root
    for k, rate in enumerate(rates, first):
        A[k, k] = -rate
        if k:
            A[k, k - 1] = rate
        else:
            drive[0] = rate
    return A, drive, n - 2 if n > 1 and math.isfinite(circuit.differencing) else n - 1


def stationary_covariance(A: np.ndarray, drive: np.ndarray) -> np.ndarray:
    """(n, n) P of A P + P Aᵀ = −drive driveᵀ: of the states under white noise of two-sided PSD 1 (one-sided 2)."""
    from scipy.linalg import solve_continuous_lyapunov

    P = solve_continuous_lyapunov(A, -np.outer(drive, drive))
    return 0.5 * (P + P.T)
