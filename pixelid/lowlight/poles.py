"""The poles of a pixel linearised about constant light, and two approximations of its slowest photoreceptor pole.

Around an effective radiance E = L + L_dark the photoreceptor is s² + b s + a with a = αE, b = β + γE (docs/model.md).
Poles are written as p = −s, in rad/s, so that they are positive where real.

    slow pole       p₁ = 2a / (b + √(b² − 4a)),  |p₁| = √a where the pair is complex
    one pole        ωc = (α/β) E                          Low & Lee, arXiv 2409.17988, low-light limit
    at dark         ωc = p₁(L_dark) + p₁'(L_dark) L       the tangent of the exact slow pole in the dark

From p² − bp + a = 0 the tangent's slope is p₁' = (α − γp₁)/√(b² − 4a), and ½√(α/E) where the pair is complex.
Without dark current the two approximations are the same line.
"""

from __future__ import annotations

import math

import numpy as np

from pixelid.errors import InputError
from pixelid.stages.circuit import Circuit
from pixelid.stages.modulation import OF_LIGHT

APPROXIMATIONS = ("one_pole", "at_dark")
SCOPES = ("photoreceptor", "pixel")


def check(circuit: Circuit) -> None:
    """Raise InputError for a circuit whose photoreceptor has no bandwidth, or one that no analysis here follows."""
    changed = [m.quantity for m in circuit.described if m.quantity in OF_LIGHT and m.strength != 0.0]
    if changed:
        raise InputError(
            f"described effects of {' and '.join(dict.fromkeys(changed))} change with the light what this analysis "
            "takes as the photoreceptor's own; it does not follow them: leave them out"
        )
    if circuit.photoreceptor == "unlimited":
        raise InputError("this model's photoreceptor has no bandwidth limit: there are no poles to analyse")


def pair(circuit: Circuit, radiance) -> np.ndarray:
    """(…, 2) complex photoreceptor poles [rad/s], slow one first, at signal radiance (…); one-pole models: (…, 1)."""
    effective = np.asarray(radiance, dtype=float) + circuit.dark
    if circuit.photoreceptor == "one_pole":
        return (circuit.corner * effective)[..., None].astype(complex)
    a, b = circuit.alpha * effective, circuit.beta + circuit.gamma * effective
    root = np.sqrt((b * b - 4 * a).astype(complex))
    return np.stack([2 * a / (b + root), 0.5 * (b + root)], axis=-1)


def stages(circuit: Circuit) -> dict[str, float]:
    """First-order poles [rad/s] after the photoreceptor, by name; the lower cutoff is not among them."""
    cutoffs = {
        "source_follower": circuit.follower,
        "extra_pole": circuit.extra_pole,
        "differencing": circuit.differencing,
    }
    return {name: cutoff for name, cutoff in cutoffs.items() if math.isfinite(cutoff)}


def exact(circuit: Circuit, radiance: float, scope: str) -> np.ndarray:
    """(n,) complex poles at one radiance: of the photoreceptor, or of the whole pixel."""
    return _with_stages(circuit, pair(circuit, radiance), scope)


def approximate(circuit: Circuit, radiance: float, scope: str, approximation: str) -> np.ndarray:
    """(n,) complex poles when the pair is replaced by one pole; the later stages stay as they are."""
    return _with_stages(circuit, np.array([corner(circuit, radiance, approximation)], dtype=complex), scope)


def _with_stages(circuit: Circuit, poles: np.ndarray, scope: str) -> np.ndarray:
    return poles if scope == "photoreceptor" else np.append(poles, later_poles(circuit))


def later_poles(circuit: Circuit) -> np.ndarray:
    """(n,) complex poles [rad/s] after the photoreceptor."""
    return np.array(list(stages(circuit).values()), dtype=complex)


def dominant(circuit: Circuit, radiance) -> np.ndarray:
    """(…) magnitude of the photoreceptor's slowest pole [rad/s]."""
    return np.abs(pair(circuit, radiance)[..., 0])


def ratio(circuit: Circuit) -> float:
    """α/β [rad/s per radiance], the slope of the one-pole approximation."""
    return circuit.corner if circuit.photoreceptor == "one_pole" else circuit.alpha / circuit.beta


def corner(circuit: Circuit, radiance, approximation: str) -> np.ndarray:
    """(…) cutoff [rad/s] of an approximation of `APPROXIMATIONS`; a tangent that falls ends just above zero."""
    radiance = np.asarray(radiance, dtype=float)
    if approximation == "one_pole" or circuit.photoreceptor == "one_pole" or circuit.dark == 0:
        return ratio(circuit) * (radiance + circuit.dark)
    a, b = circuit.alpha * circuit.dark, circuit.beta + circuit.gamma * circuit.dark
    p = float(dominant(circuit, 0.0))
    if b * b > 4 * a:
        slope = (circuit.alpha - circuit.gamma * p) / math.sqrt(b * b - 4 * a)
    else:
        slope = 0.5 * math.sqrt(circuit.alpha / circuit.dark)
    least_corner = 1e-6  # of the pole in the dark, where its tangent would be negative: it has failed long before
    return np.maximum(p + slope * radiance, least_corner * p)
