"""Comparator: ON and OFF thresholds, their spread, noise and drift, and the dead times after an event."""

from __future__ import annotations

from collections.abc import Mapping

from pixelid.parameters.parameter import Parameter
from pixelid.stages.circuit import Circuit
from pixelid.stages.effect import Effect

PARAMETERS = (
    Parameter("on_threshold", 0.2, "log radiance", 1e-3, 10.0, "log"),
    Parameter("off_threshold", 0.2, "log radiance", 1e-3, 10.0, "log"),
)


def apply(circuit: Circuit, values: Mapping[str, float]) -> Circuit:
    """The circuit with its mean thresholds."""
    return circuit.with_(on_threshold=values["on_threshold"], off_threshold=values["off_threshold"])


def drifts_to_zero(drift: float, until_s: float) -> bool:
    """Whether thresholds that drift by `drift` per second are as good as gone at `until_s`."""
    least_growth = 0.01  # of a threshold by its drift: what is left of it; less is no comparator
    return 1.0 + drift * until_s <= least_growth


def memory_factor(memory, alike):
    """What a threshold is multiplied by after an event: of the same polarity (alike = 1), of the other (−1), none (0).

    The noise of a draw, σ C_i, is not multiplied.  Numbers or arrays; also compiled.
    """
    return 1.0 + memory * alike


class ThresholdMismatch(Effect):
    name = "threshold_mismatch"
    stage = "comparator"
    sentence = "Thresholds differ from pixel to pixel."
    equation = "C_i = C (1 + σ ξ_i), ξ_i standard normal, ON and OFF independent"
    source = "Lichtsteiner, Posch & Delbruck, JSSC 2008 (2.1 % of log units per pixel)"
    parameters = (Parameter("threshold_mismatch.sigma", 0.03, "1", 1e-4, 1.0, "log"),)

    def apply(self, circuit: Circuit, values: Mapping[str, float]) -> Circuit:
        return circuit.with_(mismatch=values["threshold_mismatch.sigma"])


class ThresholdNoise(Effect):
    name = "threshold_noise"
    stage = "comparator"
    sentence = "The threshold of a pixel varies from event to event."
    equation = "C → C (1 + σ ξ), one draw per event and polarity"
    source = "docs/model.md: one Gaussian draw per event; Lichtsteiner, Posch & Delbruck, JSSC 2008"
    parameters = (Parameter("threshold_sigma", 0.04, "1", 1e-5, 1.0, "log"),)

    def apply(self, circuit: Circuit, values: Mapping[str, float]) -> Circuit:
        return circuit.with_(noise=values["threshold_sigma"])


class ThresholdDrift(Effect):
    name = "threshold_drift"
    stage = "comparator"
    sentence = "Thresholds drift during the recording."
    equation = "C(t) = C (1 + d t)"
    source = "docs/model.md: to first order in time"
    parameters = (Parameter("threshold_drift.per_s", 0.05, "1/s", -10.0, 10.0, "linear"),)
    on_boundary = False

    def apply(self, circuit: Circuit, values: Mapping[str, float]) -> Circuit:
        return circuit.with_(threshold_drift=values["threshold_drift.per_s"])


class PolarityMemory(Effect):
    name = "polarity_memory"
    stage = "comparator"
    sentence = "A threshold depends on the polarity of the pixel's previous event."
    equation = "C_i,p → C_i,p (1 + strength · p · p_before), σ C_i,p as before; first event: C_i,p"
    source = "docs/model.md: what an event leaves behind moves the next threshold, to first order"
    parameters = (Parameter("polarity_memory.strength", 0.05, "1", -0.5, 0.5, "linear"),)
    on_boundary = False

    def apply(self, circuit: Circuit, values: Mapping[str, float]) -> Circuit:
        return circuit.with_(polarity_memory=values["polarity_memory.strength"])


class RefractoryPeriod(Effect):
    name = "refractory_period"
    stage = "comparator"
    sentence = "After each event the pixel is held in reset for a dead time."
    equation = "no event and no integration for refractory_s after an event"
    source = "Lichtsteiner, Posch & Delbruck, JSSC 2008"
    parameters = (Parameter("refractory_s", 1e-4, "s", 1e-8, 1.0, "log"),)

    def apply(self, circuit: Circuit, values: Mapping[str, float]) -> Circuit:
        return circuit.with_(refractory=values["refractory_s"])


class DeadTimeWithoutReset(Effect):
    name = "dead_time_without_reset"
    stage = "comparator"
    sentence = "After each event the pixel is silent for a while, but its reference is that of the event."
    equation = "no event for s after an event; then the change since that event is compared, and fires at once beyond C"
    source = "docs/model.md: the refractory period of simulators that keep the reference, such as v2e"
    parameters = (Parameter("dead_time_without_reset.s", 2e-3, "s", 1e-7, 1.0, "log"),)

    def apply(self, circuit: Circuit, values: Mapping[str, float]) -> Circuit:
        return circuit.with_(silent=values["dead_time_without_reset.s"])


class HotPixels(Effect):
    name = "hot_pixels"
    stage = "comparator"
    sentence = "A few pixels fire regardless of the light."
    equation = "count pixels fire extra ON events as a Poisson process at rate_hz"
    source = "docs/model.md: a Poisson process of its own"
    parameters = (
        Parameter("hot_pixels.rate_hz", 100.0, "Hz", 1e-3, 1e6, "log"),
        Parameter("hot_pixels.count", 1.0, "pixels", 0.0, 1e7, "linear", free=False),
    )
    in_event_times = False

    def apply(self, circuit: Circuit, values: Mapping[str, float]) -> Circuit:
        return circuit.with_(hot_hz=values["hot_pixels.rate_hz"], hot_count=round(values["hot_pixels.count"]))


EFFECTS = (
    ThresholdMismatch(), ThresholdNoise(), ThresholdDrift(), PolarityMemory(), RefractoryPeriod(),
    DeadTimeWithoutReset(), HotPixels(),
)  # fmt: skip
