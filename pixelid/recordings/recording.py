"""A recording: events, the stimulus that caused them when it is known, and what is known of both."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

from pixelid.errors import InputError
from pixelid.recordings.events import Events
from pixelid.stimuli.stimulus import Stimulus


@dataclass(frozen=True)
class Recording:
    """Events of one condition and the stimulus behind them (None when it is unknown).

    condition: a short label of the experiment, used to group recordings
    sensor: free text
    pooled: pixel addresses are meaningless, the events of all pixels are pooled
    source: the file it came from, if any
    attributes: whatever else the file said (biases, temperature_k, …)
    """

    events: Events
    stimulus: Stimulus | None = None
    condition: str = ""
    sensor: str = ""
    pooled: bool = False
    source: Path | None = None
    attributes: dict = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The file's stem, else the condition."""
        return self.source.stem if self.source else (self.condition or "recording")

    def check_stimulus_covers_events(self) -> None:
        """Raise InputError when an event lies outside the stimulus, or there is no stimulus."""
        if self.stimulus is None:
            raise InputError(f"{self.name}: no stimulus; this needs to know what the light did")
        if len(self.events) == 0:
            return
        t = self.events.t
        end_ns = self.stimulus.t[-1] * 1e9
        held = self.stimulus.interpolation == "previous"
        if t[0] < self.stimulus.t[0] * 1e9 - 0.5 or (t[-1] > end_ns + 0.5 and not held):
            raise InputError(
                f"{self.name}: the stimulus covers {self.stimulus.t[0]:g}..{self.stimulus.t[-1]:g} s, "
                f"events span {t[0] * 1e-9:g}..{t[-1] * 1e-9:g} s"
            )

    def with_stimulus(self, stimulus: Stimulus) -> Recording:
        """The same events beside another stimulus."""
        return replace(self, stimulus=stimulus)
