"""Two lights, the same pixels: how much of each pixel's regular ON firing is there without light, how much is by light.

    rate of pixel i at light L = leak_i + parasitic_i · L

both log-normal over pixels and independent of each other.  Pixels that fire too rarely to show an interval count with
the chance of that (`renewal.py`); those too fast at either light are left out, and the chance of being left out is
allowed for.  Two lights determine two numbers per pixel: that the second part is proportional to light is assumed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit
from scipy.stats import norm

from pixelid.inspection.renewal import MAX_SLOW, SlowPixels

LEAKS_HZ = np.geomspace(1e-5, 2.0, 44)
PARASITIC = 44


@dataclass(frozen=True)
class LeakByLight:
    """Median pixel's leak [Hz] and parasitic rate [Hz/lux], with 95 % intervals from resampling pixels.

    leak_spread, parasitic_spread: standard deviation over pixels of the logarithm
    leaky: share of the pixels whose leak exceeds 0.05 Hz;  pixels: used
    nats_of_leak, nats_of_parasitic: what the likelihood loses without the one or the other
    measured, expected: (2, MAX_SLOW + 1) pixels with 0, 1, … intervals at each light, and as the fit has them
    """

    leak_hz: float
    leak_interval: tuple[float, float]
    leak_spread: float
    leaky: float
    leaky_interval: tuple[float, float]
    parasitic_hz_per_lux: float
    parasitic_interval: tuple[float, float]
    parasitic_spread: float
    pixels: int
    nats_of_leak: float
    nats_of_parasitic: float
    measured: np.ndarray
    expected: np.ndarray


def leak_by_light(
    tables: tuple[SlowPixels, SlowPixels],
    lux: tuple[float, float],
    cv: tuple[float, float],
    seed: int = 0,
    resamples: int = 100,
) -> LeakByLight:
    """Fit to the slow pixels of two lights; `cv` is the regularity at each."""
    both = np.intersect1d(tables[0].slow, tables[1].slow)
    rows = [t.index[np.searchsorted(t.slow, both)] for t in tables]
    pairs, index = np.unique(np.stack(rows, axis=1), axis=0, return_inverse=True)
    index = index.ravel()
    slopes = np.geomspace(1e-3, 10.0, PARASITIC) / max(lux)  # Hz/lux: up to 10 Hz at the brighter light
    rate = [LEAKS_HZ[:, None] + slopes * light for light in lux]
    seen, allowed, of_irregular, numbers, measured = 1.0, 1.0, 1.0, [], []
    for k, t in enumerate(tables):
        c = int(np.argmin(np.abs(np.log(t.cvs / cv[k]))))
        of_pattern = _at(t.table[c], t.means, 1.0 / rate[k].ravel())
        seen = seen * of_pattern[pairs[:, k]]
        allowed = allowed * _at(t.allowed[c][None], t.means, 1.0 / rate[k].ravel())[0]
        of_irregular = of_irregular * t.of_irregular[pairs[:, k]]
        numbers.append(_at(t.number[c], t.means, 1.0 / rate[k].ravel()))
        measured.append(np.bincount(t.patterns.sum(axis=1)[rows[k]], minlength=MAX_SLOW + 1))
    table = np.asarray(seen)  # (pairs, leaks × slopes)

    def mixed(at: np.ndarray, without: str = "") -> np.ndarray:
        leaks = np.eye(1, len(LEAKS_HZ))[0] if without == "leak" else _normal(np.log(LEAKS_HZ), at[0], at[1])
        steep = np.eye(1, PARASITIC)[0] if without == "parasitic" else _normal(np.log(slopes), at[2], at[3])
        return np.outer(leaks, steep).ravel()

    def cost(at: np.ndarray, weight: np.ndarray, without: str) -> float:
        mixture = mixed(at, without)
        odd = float(expit(at[4]))
        chance = (1 - odd) * (table @ mixture) / max(float(allowed @ mixture), 1e-300) + odd * of_irregular
        fence = 1e3 * (max(0.0, -2.3 - at[1]) + max(0.0, at[1] - 1.5) + max(0.0, -2.0 - at[3]) + max(0.0, at[3] - 1.5))
        fence += 1e3 * max(0.0, np.log(1e-4) - at[0])
        return fence - float(weight @ np.log(np.maximum(chance, 1e-300)))

    def best(weight: np.ndarray, start: np.ndarray, without: str = "") -> Any:
        options = {"xatol": 2e-3, "fatol": 2e-3, "maxiter": 600}
        return minimize(cost, start, (weight, without), "Nelder-Mead", options=options)

    weight = np.bincount(index, minlength=len(pairs)).astype(float)
    start = np.array([np.log(0.02), 0.0, np.log(0.1 / max(lux)), -1.0, -4.0])
    minimum = best(weight, best(weight, start).x)
    without = {name: best(weight, minimum.x, name) for name in ("leak", "parasitic")}
    rng = np.random.default_rng(seed)
    resampled = []
    for _ in range(resamples):
        again = rng.multinomial(len(both), weight / len(both)).astype(float)
        resampled.append(_quantities(best(again, minimum.x).x))
    low, high = np.quantile(resampled, [0.025, 0.975], axis=0)
    leak, spread, leaky, slope, slope_spread = _quantities(minimum.x)
    # slow at one light and the other: given the rates, the two are independent
    slow = mixed(minimum.x) * np.stack([n.sum(axis=0) for n in numbers])[::-1]
    expected = np.stack([n @ w for n, w in zip(numbers, slow, strict=True)])
    expected *= len(both) / expected.sum(axis=1, keepdims=True)
    return LeakByLight(
        leak_hz=leak,
        leak_interval=(float(low[0]), float(high[0])),
        leak_spread=spread,
        leaky=leaky,
        leaky_interval=(float(low[2]), float(high[2])),
        parasitic_hz_per_lux=slope,
        parasitic_interval=(float(low[3]), float(high[3])),
        parasitic_spread=slope_spread,
        pixels=len(both),
        nats_of_leak=float(without["leak"].fun - minimum.fun),
        nats_of_parasitic=float(without["parasitic"].fun - minimum.fun),
        measured=np.stack(measured),
        expected=expected,
    )


def _quantities(at: np.ndarray) -> tuple[float, float, float, float, float]:
    spread = float(np.exp(at[1]))
    leaky = float(norm.sf((np.log(0.05) - at[0]) / spread))
    return float(np.exp(at[0])), spread, leaky, float(np.exp(at[2])), float(np.exp(at[3]))


def _normal(x: np.ndarray, mean: float, log_spread: float) -> np.ndarray:
    weight = np.exp(-0.5 * ((x - mean) / np.exp(np.clip(log_spread, -2.5, 2.0))) ** 2)
    return weight / max(float(weight.sum()), 1e-300)


def _at(table: np.ndarray, means: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """(rows, means) read at other means, linear in their logarithm and constant beyond the ends."""
    at = np.clip(np.interp(np.log(wanted), np.log(means), np.arange(len(means))), 0, len(means) - 1.001)
    left = at.astype(int)
    part = at - left
    return table[:, left] * (1 - part) + table[:, left + 1] * part
