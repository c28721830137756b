"""Photocurrent: light and dark current in, with their fluctuations."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from pixelid.parameters.parameter import Parameter
from pixelid.stages.circuit import Circuit
from pixelid.stages.effect import Effect


class DarkCurrent(Effect):
    name = "dark_current"
    stage = "photocurrent"
    sentence = "A dark current adds to the photocurrent: contrast fades and bandwidth stops falling in low light."
    equation = "L → L + L_dark"
    source = "Low & Lee, arXiv 2409.17988, §3 (4 fA: DVS128 reference simulator)"
    parameters = (Parameter("dark_current.radiance", 4.0, "radiance", 1e-6, 1e6, "log"),)

    def apply(self, circuit: Circuit, values: Mapping[str, float]) -> Circuit:
        return circuit.with_(dark=values["dark_current.radiance"])


class ShotNoise(Effect):
    name = "shot_noise"
    stage = "photocurrent"
    sentence = "Photon and electron shot noise: noise events, more in the dark, filtered by the photoreceptor."
    equation = "white noise on ln L before the photoreceptor, one-sided PSD = density / L (density = 2q, current units)"
    source = "Graça, McReynolds & Delbruck, CVPRW 2023 (2qI)"
    parameters = (Parameter("shot_noise.density", 3.2e-4, "radiance/Hz", 1e-12, 1e3, "log"),)
    in_event_times = False

    def apply(self, circuit: Circuit, values: Mapping[str, float]) -> Circuit:
        return circuit.with_(shot_density=values["shot_noise.density"])


class MainsFlicker(Effect):
    name = "mains_flicker"
    stage = "photocurrent"
    sentence = "Mains-driven lamps modulate the light at twice the mains frequency."
    equation = "L → L (1 + m sin(2π f t + φ))"
    source = "docs/model.md (f = 100 or 120 Hz)"
    parameters = (
        Parameter("mains_flicker.modulation", 0.05, "1", 1e-5, 0.95, "log"),
        Parameter("mains_flicker.frequency_hz", 100.0, "Hz", 1.0, 1e4, "log", free=False),
        Parameter("mains_flicker.phase_rad", 0.0, "rad", -4 * math.pi, 4 * math.pi, "linear"),
    )
    starts_anew = ("mains_flicker.phase_rad",)
    on_boundary = False  # amplitude and phase: every direction from 0 is a flicker
    tried_with: ClassVar = {
        "mains_flicker.frequency_hz": (100.0, 120.0),
        "mains_flicker.phase_rad": (0.0, 0.5 * math.pi, math.pi, 1.5 * math.pi),
    }
    periodic = True

    def apply(self, circuit: Circuit, values: Mapping[str, float]) -> Circuit:
        return circuit.with_(
            flicker_modulation=values["mains_flicker.modulation"],
            flicker_hz=values["mains_flicker.frequency_hz"],
            flicker_phase=values["mains_flicker.phase_rad"],
        )


class LightSpread(Effect):
    name = "light_spread"
    stage = "photocurrent"
    sentence = "The pixels of a pool have different light: most of a spot's are in its halo."
    equation = "L_i = L e^{σ ξ_i}, ξ_i standard normal, one for each pixel"
    source = "docs/model.md: a log-normal spread of the light over the pixels that are pooled"
    parameters = (Parameter("light_spread.sigma", 0.5, "1", 1e-3, 3.0, "log"),)
    in_event_times = False

    def apply(self, circuit: Circuit, values: Mapping[str, float]) -> Circuit:
        return circuit.with_(light_spread=values["light_spread.sigma"])


class LinearLog(Effect):
    name = "linear_log"
    stage = "photocurrent"
    sentence = "In low light the response is linear in the light, not logarithmic: dark details lose contrast."
    equation = "ln L → ln knee + slope (L / knee − 1) below the knee; the photoreceptor's rates still see L"
    source = (
        "Hu, Liu & Delbruck, CVPRW 2021, arXiv 2006.07722 (v2e: a line through the origin below 20 grey levels, which "
        "is a slope of ln 20); a slope of 1 continues the logarithm without a kink"
    )
    parameters = (
        Parameter("linear_log.knee", 20.0, "radiance", 1e-6, 1e6, "log"),
        Parameter("linear_log.slope", 1.0, "1", 1e-2, 1e2, "log", free=False),
    )
    # below the knee, of the logarithm's slope at it: without a kink, and as in v2e
    tried_with: ClassVar = {"linear_log.slope": (1.0, math.log(20.0))}
    # a knee below all light does nothing, one too high much harm
    decades = tuple(d / 8.0 for d in range(-16, 13))

    def apply(self, circuit: Circuit, values: Mapping[str, float]) -> Circuit:
        return circuit.with_(knee=values["linear_log.knee"], knee_slope=values["linear_log.slope"])


def logarithm(circuit: Circuit, radiance):
    """(n,) what the pixel makes of effective radiance (n,): its logarithm, or a line below the knee."""
    logs = np.log(radiance)
    if circuit.knee == 0:
        return logs
    line = np.log(circuit.knee) + circuit.knee_slope * (radiance / circuit.knee - 1.0)
    return np.where(np.real(radiance) < np.real(circuit.knee), line, logs)


EFFECTS = (DarkCurrent(), LightSpread(), ShotNoise(), MainsFlicker(), LinearLog())
