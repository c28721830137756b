"""Curves over radiance: poles, bandwidth and step time, exact and approximate, with bands where a fit gives them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pixelid.lowlight import poles, radii
from pixelid.stages.circuit import Circuit

POINTS = 73


def radiances(circuit: Circuit, points: int = POINTS) -> np.ndarray:
    """(points,) radiances from far below to far above the complex range, as far as it matters to look at."""
    centre = radii.natural_radiance(circuit)
    critical = radii.regimes(circuit)["critical"]
    high = min(max(3 * critical[1], 1e2 * centre), 1e4 * centre) if critical else 1e3 * centre
    return np.geomspace(1e-3 * centre, high, points)


def exact_curves(circuit: Circuit, radiance: np.ndarray) -> dict[str, np.ndarray]:
    """Name → (n,) over radiance (n,): pole magnitudes [rad/s], −3 dB frequency [Hz] and step time [s] of the pixel."""
    pair = np.abs(poles.pair(circuit, radiance))
    at = [poles.exact(circuit, L, "pixel") for L in radiance]
    return {
        "slow_pole": pair[:, 0],
        "fast_pole": pair[:, -1],
        "bandwidth_hz": np.array([radii.quantity("bandwidth", p) for p in at]),
        "step_time_s": np.array([radii.quantity("step_time", p) for p in at]),
    }


def all_curves(circuit: Circuit) -> dict:
    """`exact_curves`, and the same of each approximation, as they stand in lowlight.json under "curves"."""
    radiance = radiances(circuit)
    content: dict = {"radiance": radiance, "exact": exact_curves(circuit, radiance)}
    content["exact"] |= {name: np.full(len(radiance), cutoff) for name, cutoff in poles.stages(circuit).items()}
    content["complex"] = np.abs(poles.pair(circuit, radiance)[:, 0].imag) > 0
    for kind in poles.APPROXIMATIONS:
        at = [poles.approximate(circuit, L, "pixel", kind) for L in radiance]
        content[kind] = {
            "slow_pole": poles.corner(circuit, radiance, kind),
            "bandwidth_hz": np.array([radii.quantity("bandwidth", p) for p in at]),
            "step_time_s": np.array([radii.quantity("step_time", p) for p in at]),
        }
    return content


def bands(circuit: Circuit, draws: Sequence[Circuit]) -> dict:
    """95 % bands of the exact curves, the borders and the first radii of the slowest pole, over circuits drawn.

    {"draws": n, "radiance": (m,), "curves": name → [low (m,), high (m,)], "epsilon_one", "critical": [low, high]…,
    "first": approximation → "1%" → [low, high]}; None where a draw in ten or more has no such radiance.
    """
    band_points = 25
    radiance = radiances(circuit, band_points)
    each = [exact_curves(c, radiance) for c in draws]
    borders = [radii.regimes(c) for c in draws]
    content: dict = {
        "draws": len(draws),
        "radiance": radiance,
        "curves": {name: np.percentile([e[name] for e in each], [2.5, 97.5], axis=0) for name in each[0]},
        "epsilon_one": _interval([b["epsilon_one"] for b in borders]),
        "critical": [_interval([b["critical"] and b["critical"][i] for b in borders]) for i in (0, 1)],
        "first": {},
    }
    for kind in poles.APPROXIMATIONS:
        firsts = [_first(c, kind) for c in draws]
        content["first"][kind] = {level: _interval([f[level] for f in firsts]) for level in firsts[0]}
    return content


def _first(circuit: Circuit, approximation: str) -> dict[str, float | None]:
    """Level → first radius of the slowest pole."""
    centre = radii.natural_radiance(circuit)
    error = radii.error_function(circuit, approximation, "dominant_pole", "photoreceptor")
    levels = radii.crossings(error, centre * radii.SEARCHED[0], centre * radii.SEARCHED[1], 441)["levels"]
    return {level: entry["first"] for level, entry in levels.items()}


def _interval(values: list) -> list[float] | None:
    numbers = [value for value in values if value is not None]
    if len(numbers) < 0.9 * len(values):
        return None
    return np.percentile(numbers, [2.5, 97.5]).tolist()
