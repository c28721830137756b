"""First events after a step of light, from the pixel's differential equations solved to 1e-9 by SciPy."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

HEADER = "camera,lens,polarity,irradiance_W_m2,bias_config,median"
IRRADIANCES = (0.006, 0.02, 0.06, 0.2, 0.6)


@dataclass(frozen=True)
class Pixel:
    """Of one sensor: photoreceptor, cutoffs [rad/s], dark light [W/m²], thresholds and delays per setting and edge."""

    alpha: float
    beta: float
    gamma: float
    follower: float
    differencing: float
    dark: float
    off_fraction: float
    thresholds: tuple[tuple[float, float], ...]
    delays_s: tuple[tuple[float, float], ...]

    def light(self, irradiance: float, on: bool) -> float:
        """After the step, dark current included."""
        return irradiance * (1.0 if on else self.off_fraction) + self.dark

    def dominant_pole(self, irradiance: float, on: bool) -> float:
        """Magnitude of the photoreceptor's slowest pole after the step [rad/s]."""
        light = self.light(irradiance, on)
        return float(np.abs(np.roots([1.0, self.beta + self.gamma * light, self.alpha * light])).min())

    def latency_s(self, irradiance: float, on: bool, setting: int) -> float:
        """From the step to the time stamp."""
        light = self.light(irradiance, on)
        step = abs(np.log(light / self.light(irradiance, not on)))
        a, b = self.alpha * light, self.beta + self.gamma * light
        threshold = self.thresholds[setting][0 if on else 1]

        def slope(t, x):
            v, y, s, d = x
            return [a * (step - y) - b * v, v, self.follower * (y - s), self.differencing * (s - d)]

        def crossing(t, x):
            return x[3] - threshold

        crossing.terminal = True  # pyright: ignore[reportFunctionMemberAccess]
        slowest = 1 / self.dominant_pole(irradiance, on) + 1 / self.follower + 1 / self.differencing
        end = 40.0 * slowest
        solved = solve_ivp(slope, (0.0, end), np.zeros(4), "LSODA", events=crossing, rtol=1e-9, atol=1e-12)
        return float(solved.t_events[0][0]) + self.delays_s[setting][0 if on else 1]


def drawn_pixel(rng: np.random.Generator, settings: int = 4) -> Pixel:
    """Some sensor: every number over a factor of 3 to 30 about those that sensors have."""
    corner = 10 ** rng.uniform(4.5, 5.5)
    beta = 10 ** rng.uniform(4.3, 5.7)
    on, off = np.sort(rng.uniform(0.1, 0.8, (2, settings)))
    off_fraction = rng.uniform(0.1, 0.3)
    return Pixel(
        alpha=corner * beta, beta=beta, gamma=0.034 * corner, follower=2 * np.pi * 10 ** rng.uniform(2.7, 4.0),
        differencing=2 * np.pi * 10 ** rng.uniform(4.0, 5.0), dark=10 ** rng.uniform(-5.0, -3.5),
        off_fraction=off_fraction, thresholds=tuple(zip(on.tolist(), off.tolist(), strict=True)),
        delays_s=tuple(map(tuple, 10 ** rng.uniform(-5.3, -4.3, (settings, 2)))),
    )  # fmt: skip


def write_table(path: Path, pixel: Pixel, scatter: float, rng: np.random.Generator, law=lambda irradiance: 1.0) -> Path:
    """A CSV of every setting, edge and irradiance, medians off by `scatter`; law: factor of α at an irradiance."""
    lines = [HEADER]
    for setting in range(len(pixel.thresholds)):
        for irradiance in IRRADIANCES:
            for on in (True, False):
                own = replace(pixel, alpha=pixel.alpha * law(irradiance))
                t = own.latency_s(irradiance, on, setting) * np.exp(scatter * rng.standard_normal())
                lines.append(f"SIM,lens,{int(on)},{irradiance:g},{setting},{1e6 * t:.6g}")
    path.write_text("\n".join(lines) + "\n")
    return path


def as_camera(pixel: Pixel):
    """The pixel as a camera of the package, thresholds known."""
    from pixelid.lowlight.latency_poles import HELD_SD
    from pixelid.model.model import Model, expected_parameters
    from pixelid.parameters.parameter import Prior
    from pixelid.tables.latency.camera import UNIT, Camera, Setting
    from pixelid.tables.latency.model import EFFECTS

    on, off = pixel.thresholds[1]
    model = Model("SIM", "second_order", EFFECTS, expected_parameters("second_order", EFFECTS), radiance_unit=UNIT)
    model = model.set({
        "alpha": pixel.alpha, "beta": pixel.beta, "gamma": pixel.gamma, "on_threshold": on, "off_threshold": off,
        "sf_cutoff_hz": pixel.follower / (2 * np.pi), "diff_cutoff_hz": pixel.differencing / (2 * np.pi),
        "dark_current.radiance": pixel.dark, "shot_noise.density": 1e-12,
    })  # fmt: skip
    known = {
        name: replace(p, prior=Prior(np.log(p.value), HELD_SD)) if name in ("on_threshold", "off_threshold") else p
        for name, p in model.parameters.items()
    }
    settings = tuple(
        Setting(str(k), float(k), float(k), *thresholds, *delays)
        for k, (thresholds, delays) in enumerate(zip(pixel.thresholds, pixel.delays_s, strict=True))
    )
    return Camera("SIM", replace(model, parameters=known), settings, {"lens": 1.0}, pixel.off_fraction)
