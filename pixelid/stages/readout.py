"""Readout: from comparator to timestamp."""

from __future__ import annotations

from collections.abc import Mapping

from pixelid.parameters.parameter import Parameter
from pixelid.stages.circuit import Circuit
from pixelid.stages.effect import Effect


class LostEvents(Effect):
    name = "lost_events"
    stage = "readout"
    sentence = "Events get lost on their way out, by chance: the next one of the pixel comes a threshold late."
    equation = "each event is dropped with probability `fraction`, after its pixel has been reset"
    source = "docs/model.md: a loss that knows neither light nor pixel"
    parameters = (Parameter("lost_events.fraction", 0.05, "1", 1e-5, 0.5, "log"),)

    def apply(self, circuit: Circuit, values: Mapping[str, float]) -> Circuit:
        return circuit.with_(lost=values["lost_events.fraction"])


class ReadoutLatency(Effect):
    name = "readout_latency"
    stage = "readout"
    sentence = "One arbiter serves all pixels: events queue and are stamped when they leave."
    equation = "departure_k = max(arrival_k, departure_{k−1}) + service_s, first come first served"
    source = "Finateu et al., ISSCC 2020 (shared readout of an array); docs/model.md"
    parameters = (Parameter("readout_latency.service_s", 1e-6, "s", 1e-10, 1e-1, "log"),)
    in_event_times = False

    def apply(self, circuit: Circuit, values: Mapping[str, float]) -> Circuit:
        return circuit.with_(service=values["readout_latency.service_s"])


class SharedReadout(Effect):
    name = "shared_readout"
    stage = "readout"
    sentence = "All pixels that wait are read in one cycle; the others wait until it ends."
    equation = "a cycle of n events lasts (cycle_s + event_s n)(1 + spread ξ); a pixel is reset when it is read"
    source = "docs/results/real-data.md: bursts of a real camera"
    parameters = (
        Parameter("shared_readout.event_s", 2e-6, "s", 1e-9, 1e-3, "log"),
        Parameter("shared_readout.cycle_s", 1e-5, "s", 1e-9, 1e-2, "log"),
        Parameter("shared_readout.spread", 0.05, "1", 1e-3, 0.5, "log", free=False),
    )
    in_event_times = False

    def apply(self, circuit: Circuit, values: Mapping[str, float]) -> Circuit:
        return circuit.with_(
            per_event=values["shared_readout.event_s"],
            per_cycle=values["shared_readout.cycle_s"],
            cycle_spread=values["shared_readout.spread"],
        )


class TimestampJitter(Effect):
    name = "timestamp_jitter"
    stage = "readout"
    sentence = "Timestamps jitter."
    equation = "t → t + σ ξ"
    source = "docs/model.md: noise of the time stamp, whatever its cause"
    parameters = (Parameter("timestamp_jitter.sigma_s", 5e-5, "s", 1e-10, 1e-1, "log"),)

    def apply(self, circuit: Circuit, values: Mapping[str, float]) -> Circuit:
        return circuit.with_(jitter=values["timestamp_jitter.sigma_s"])


class TimestampQuantisation(Effect):
    name = "timestamp_quantisation"
    stage = "readout"
    sentence = "Timestamps sit on a grid: a clock tick or a readout scan."
    equation = "t → tick · round(t / tick)"
    source = "docs/model.md: the clock of the time stamp"
    parameters = (Parameter("timestamp_quantisation.tick_s", 1e-6, "s", 1e-9, 1e-1, "log", free=False),)
    in_event_times = False

    def apply(self, circuit: Circuit, values: Mapping[str, float]) -> Circuit:
        return circuit.with_(tick=values["timestamp_quantisation.tick_s"])


EFFECTS = (LostEvents(), ReadoutLatency(), SharedReadout(), TimestampJitter(), TimestampQuantisation())
