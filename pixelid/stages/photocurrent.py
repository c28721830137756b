"""Photocurrent: light and dark current in, with their fluctuations."""

from __future__ import annotations

import math
from collections.abc import Mapping

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

    def apply(self, circuit: Circuit, values: Mapping[str, float]) -> Circuit:
        return circuit.with_(
            flicker_modulation=values["mains_flicker.modulation"],
            flicker_hz=values["mains_flicker.frequency_hz"],
            flicker_phase=values["mains_flicker.phase_rad"],
        )


EFFECTS = (DarkCurrent(), ShotNoise(), MainsFlicker())
