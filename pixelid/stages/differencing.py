"""Differencing amplifier: amplifies the change since the last event; reset, finite bandwidth, leak."""

from __future__ import annotations

import math
from collections.abc import Mapping

from pixelid.parameters.parameter import Parameter
from pixelid.stages.circuit import Circuit
from pixelid.stages.effect import Effect


def leaked(circuit: Circuit, duration_s, light):
    """What drifts into the change, in ON thresholds, over a time; light: ∫ L dt over it [s · radiance].

    Linear in both, so `leaked(circuit, 1.0, L)` is the rate of drift [1/s] under radiance L.
    """
    return circuit.leak_hz * duration_s + circuit.leak_hz_per_radiance * light


def leaks(circuit: Circuit) -> bool:
    """Whether anything drifts into the change."""
    return leaked(circuit, 1.0, 0.0) != 0 or leaked(circuit, 0.0, 1.0) != 0


class DifferencingPole(Effect):
    name = "differencing_pole"
    stage = "differencing"
    sentence = "The differencing amplifier has a finite bandwidth, so its reset is incomplete."
    equation = "d yd/dt = ωd (ysf − yd), restarted from ysf at release"
    source = "Low & Lee, arXiv 2409.17988 (16 kHz: DVS128 reference simulator)"
    parameters = (Parameter("diff_cutoff_hz", 16000.0, "Hz", 1e-1, 1e8, "log"),)
    vanishes_at = math.inf
    trades_places = True

    def apply(self, circuit: Circuit, values: Mapping[str, float]) -> Circuit:
        return circuit.with_(differencing=2.0 * math.pi * values["diff_cutoff_hz"])


class Leak(Effect):
    name = "leak"
    stage = "differencing"
    sentence = "The reset switch leaks: ON events at a steady rate, whatever the light does."
    equation = "change += rate · C_on · (t − tr)"
    source = "Nozaki & Delbruck, IEEE TED 2017"
    parameters = (Parameter("leak.rate_hz", 0.1, "Hz", 1e-6, 1e4, "log"),)

    def apply(self, circuit: Circuit, values: Mapping[str, float]) -> Circuit:
        return circuit.with_(leak_hz=values["leak.rate_hz"])


class ParasiticPhotocurrent(Effect):
    name = "parasitic_photocurrent"
    stage = "differencing"
    sentence = "Light falling on the reset switch makes it leak: ON events at a rate proportional to the light."
    equation = "change += rate · C_on · ∫ L dt"
    source = "Nozaki & Delbruck, IEEE TED 2017"
    parameters = (Parameter("parasitic_photocurrent.rate_hz_per_radiance", 3e-3, "Hz/radiance", 1e-9, 1e4, "log"),)

    def apply(self, circuit: Circuit, values: Mapping[str, float]) -> Circuit:
        return circuit.with_(leak_hz_per_radiance=values["parasitic_photocurrent.rate_hz_per_radiance"])


EFFECTS = (DifferencingPole(), Leak(), ParasiticPhotocurrent())
