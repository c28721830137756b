"""How far an approximation is off, as radiance grows, and where it crosses 1 %, 10 % and 50 %.

error = approximate / exact − 1 of a quantity: the slowest photoreceptor pole's magnitude, the −3 dB frequency or the
step time (`response.py`), of the photoreceptor alone or of the whole pixel.  Positive: too large.

Crossings are bracketed on a logarithmic grid over eleven decades around β²/α and refined by Brent's method.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.optimize import brentq

from pixelid.lowlight import poles, response
from pixelid.stages.circuit import Circuit

LEVELS = (0.01, 0.1, 0.5)
QUANTITIES = ("dominant_pole", "bandwidth", "step_time")
SEARCHED = (1e-5, 1e6)  # in units of the natural radiance
GRID = {"dominant_pole": 4001, "bandwidth": 221, "step_time": 221}

Function = Callable[..., np.ndarray]


def natural_radiance(circuit: Circuit) -> float:
    """β²/α, the radiance where ε = αL/β² is one; for one-pole models the radiance of a 100 rad/s cutoff."""
    if circuit.photoreceptor == "one_pole":
        return 100.0 / circuit.corner
    return circuit.beta**2 / circuit.alpha


def quantity(name: str, at: np.ndarray) -> float:
    """One of `QUANTITIES` of a chain of poles (n,) rad/s."""
    return {"bandwidth": response.bandwidth_hz, "step_time": response.step_time_s}[name](at)


def error_function(circuit: Circuit, approximation: str, name: str, scope: str) -> Function:
    """radiance (…) → signed relative error (…)."""
    if name == "dominant_pole":
        return lambda L: poles.corner(circuit, L, approximation) / poles.dominant(circuit, L) - 1.0

    def at(L: float) -> float:
        wrong = quantity(name, poles.approximate(circuit, L, scope, approximation))
        return wrong / quantity(name, poles.exact(circuit, L, scope)) - 1.0

    return np.vectorize(at, otypes=[float])


def crossings(error: Function, low: float, high: float, points: int) -> dict:
    """Where `error` crosses ± each of `LEVELS` between radiances low and high.

    Returns {"searched": [low, high], "at_lowest": error, "largest_under", "largest_over": extremes on the grid,
    "levels": {"1%": {"first": radiance or None, "crossings": [{"radiance", "error", "direction"}]}}}; direction, as
    radiance grows: "leaves" (the error's size passes the level outwards) or "returns".
    """
    logs = np.linspace(np.log(low), np.log(high), points)
    values = error(np.exp(logs))
    content: dict = {
        "searched": [low, high],
        "at_lowest": values[0],
        "largest_under": min(values.min(), 0.0),
        "largest_over": max(values.max(), 0.0),
        "levels": {},
    }
    for level in LEVELS:
        here = []
        for signed in (-level, level):
            above = values > signed
            for k in np.flatnonzero(above[1:] != above[:-1]):
                root = brentq(lambda x, s=signed: float(error(np.exp(x))) - s, logs[k], logs[k + 1], xtol=1e-13)
                outward = bool(above[k]) == (signed < 0)
                here.append(
                    {
                        "radiance": float(np.exp(root)),  # type: ignore[arg-type]
                        "error": signed,
                        "direction": "leaves" if outward else "returns",
                    }
                )
        here.sort(key=lambda entry: entry["radiance"])
        leaving = [entry["radiance"] for entry in here if entry["direction"] == "leaves"]
        beyond = abs(values[0]) > level
        content["levels"][f"{100 * level:g}%"] = {
            "first": 0.0 if beyond else (leaving[0] if leaving else None),
            "crossings": here,
        }
    return content


def all_radii(circuit: Circuit) -> dict:
    """`crossings` of every approximation, quantity and scope, nested in that order.

    The slowest photoreceptor pole has the scope "photoreceptor" only.
    """
    centre = natural_radiance(circuit)
    low, high = centre * SEARCHED[0], centre * SEARCHED[1]
    result: dict = {}
    for approximation in poles.APPROXIMATIONS:
        if approximation == "at_dark" and circuit.dark == 0:
            result[approximation] = result["one_pole"]  # the same line
            continue
        result[approximation] = {}
        for name in QUANTITIES:
            scopes = poles.SCOPES if poles.stages(circuit) and name != "dominant_pole" else poles.SCOPES[:1]
            result[approximation][name] = {
                scope: crossings(error_function(circuit, approximation, name, scope), low, high, GRID[name])
                for scope in scopes
            }
    return result


def regimes(circuit: Circuit) -> dict:
    """The map of regimes, in signal radiance (dark current subtracted; None where a border does not exist).

    epsilon_one: ε = αE/β² = 1;  gamma_one: γE/β = 1;  critical: the two radiances with (β + γE)² = 4αE, between which
    the pair is complex (None when γβ ≥ α: it never is; from 0 on where it is in the dark current alone)
    lowest_damping: smallest ζ, reached at gamma_one
    """
    if circuit.photoreceptor == "one_pole":
        return {"epsilon_one": None, "gamma_one": None, "critical": None, "lowest_damping": None}
    a, b, c = circuit.alpha, circuit.beta, circuit.gamma
    critical = None
    if a > b * c:
        # γ²E² + (2βγ − 4α)E + β² = 0, the small root without cancellation
        half = 2 * a - b * c
        root = math.sqrt(half * half - (b * c) ** 2)
        low, high = b * b / (half + root) - circuit.dark, (half + root) / c**2 - circuit.dark
        critical = [max(low, 0.0), high] if high > 0 else None
    return {
        "epsilon_one": _border(b * b / a - circuit.dark),
        "gamma_one": _border(b / c - circuit.dark),
        "critical": critical,
        "lowest_damping": math.sqrt(b * c / a),
    }


def _border(radiance: float) -> float | None:
    return radiance if radiance > 0 else None
