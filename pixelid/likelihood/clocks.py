"""Clocks of recordings: what an alignment has left of a delay, and the rate at which two clocks part.

An event that the camera stamps t belongs to the light at

    t − delay − ρ (t − at)

with the delay [s] at the moment `at`.  Every recording has a delay of its own; all have one rate R, what the camera
counts per second of the light less one, as all are made with one pair of clocks.  A light that an alignment has
stretched by 1 + r already parts by ρ = (R − r)/(1 + R).  Both are nuisances of a model (`alignment.delay_s[NAME]`,
`alignment.clock_rate`), and numbers of its circuit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from pixelid.recordings.clocks import AlignedClock, clock_of
from pixelid.recordings.recording import Recording
from pixelid.stages.circuit import Circuit
from pixelid.stimuli.pixel_lights import Light


@dataclass(frozen=True)
class Clock:
    """A recording's clock against that of its light: they part by `slope` in a second, and agree at `at_s`.

    slope may be a symbol of an engine.
    """

    at_s: float
    slope: Any = 0.0

    def on_light(self, t: Any) -> Any:
        """(n,) times of the light at times (n,) of the recording, in an engine's numbers."""
        return t - self.slope * (t - self.at_s)

    def stretched(self, light: Light) -> Light:
        """The light as it ran on the recording's clock: its moment s at t = (s − ρ at)/(1 − ρ)."""
        slope = float(self.slope)
        return light.shifted(-slope * self.at_s / (1.0 - slope), 1.0 / (1.0 - slope))


def clock_in(recording: Recording, circuit: Circuit) -> Clock | None:
    """The clock of a recording by a circuit; None where they are one, or as the alignment has it."""
    rate = circuit.clock_rate
    clock = None if rate is None else clock_of(recording)
    if clock is None or rate is None:
        return None
    return Clock(clock.prior.at_s, (rate - clock.rate_error) / (1.0 + rate))


def light_on_clock(recording: Recording, light: Light, circuit: Circuit) -> Light:
    """A recording's light as it ran on the recording's clock, but for the circuit's delay."""
    clock = clock_in(recording, circuit)
    return light if clock is None else clock.stretched(light)


def names_of(recordings: Sequence[Recording]) -> list[str]:
    """One name per recording, numbered where two share one."""
    return numbered([recording.name for recording in recordings])


def numbered(names: list[str]) -> list[str]:
    """The names, with their place where two are alike."""
    return [name if names.count(name) == 1 else f"{name} #{i}" for i, name in enumerate(names)]


__all__ = ["AlignedClock", "Clock", "clock_in", "light_on_clock", "names_of", "numbered"]
