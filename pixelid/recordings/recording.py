"""A recording: events, the stimulus that caused them when it is known, and what is known of both."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from pixelid.errors import InputError, shown
from pixelid.recordings.events import Events
from pixelid.recordings.triggers import Triggers
from pixelid.results import Table, html_page
from pixelid.stimuli.pixel_lights import Light, PixelLights
from pixelid.stimuli.stimulus import Stimulus

LATENCY_S = 1e-3


@dataclass(frozen=True, repr=False)
class Recording:
    """Events of one condition and the stimulus behind them (None when it is unknown).

    Example:
        >>> from pixelid.recordings import Events, Recording
        >>> Recording(Events.empty(2, 2), condition="dark")
        Recording 'dark': 0 events of 2 × 2 pixels in 0 s; light unknown

    condition: a short label of the experiment, used to group recordings
    sensor: free text
    pooled: pixel addresses are meaningless, the events of all pixels are pooled
    source: the file it came from, if any
    attributes: whatever else the file said (biases, temperature_k, …)
    triggers: edges on the camera's trigger inputs, where the file holds them
    exposures: an ATIS' exposure measurements as events: begin (p = 0) and end (p = 1) of the time in which a pixel's
        photocurrent moves a fixed charge
    label: a name of its own, where that of the file or the condition is another recording's, too
    """

    events: Events
    stimulus: Light | None = None
    condition: str = ""
    sensor: str = ""
    pooled: bool = False
    source: Path | None = None
    attributes: dict = field(default_factory=dict)
    triggers: Triggers | None = None
    exposures: Events | None = None
    label: str = ""

    def __repr__(self) -> str:
        e, on = self.events, float(self.events.p.mean()) if len(self.events) else None
        share = "" if on is None else f", {100 * on:.0f} % ON"
        light = "light unknown" if self.stimulus is None else repr(self.stimulus)
        return (
            f"Recording {self.name!r}: {len(e)} {'pooled ' * self.pooled}events of {e.width} × {e.height} pixels in "
            f"{e.duration_s:.4g} s{share}; {light}"
        )

    def _repr_html_(self) -> str:
        e = self.events
        rows = [
            ("events", str(len(e))),
            ("pixels", f"{e.width} × {e.height}{', pooled' if self.pooled else ''}"),
            ("duration", f"{e.duration_s:.4g} s"),
            ("light", "unknown" if self.stimulus is None else repr(self.stimulus)),
            ("sensor", self.sensor),
            ("file", str(self.source or "")),
        ]
        table = Table("", ("recording", self.name), tuple(row for row in rows if row[1]), frozenset({"recording"}))
        return html_page(f"recording {self.name}", [table])

    def plot(self) -> np.ndarray:
        """Event rates (ON up, OFF down) above the light: matplotlib axes."""
        from pixelid.recordings.figures import draw_recording

        return draw_recording(self)

    @property
    def name(self) -> str:
        """The label, else the file's stem, else the condition."""
        return self.label or (self.source.stem if self.source else (self.condition or "recording"))

    def check_stimulus_covers_events(self) -> None:
        """Raise InputError when an event lies outside the stimulus, in time or place, or there is no stimulus.

        Three kinds of late events are legitimate: a stimulus of interpolation "previous" holds its last value;
        latency and jitter carry an event past the last sample by up to `LATENCY_S`; and a saturated
        readout empties its queue after the stimulus has ended, at its service rate, the fastest of the recording.
        """
        if self.stimulus is None:
            raise InputError(f"{self.name}: no stimulus; attach it: `pixelid convert FILE OUT.h5 --stimulus light.csv`")
        size = (self.events.width, self.events.height)
        if self.stimulus.size not in (None, size) and not self.pooled:
            raise InputError(
                f"{self.source or self.name}: stimulus: expected light for {size[0]} x {size[1]} pixels, found "
                f"{self.stimulus.size[0]} x {self.stimulus.size[1]}"
            )
        if len(self.events) == 0:
            return
        t, start, last = self.events.t, self.stimulus.start_s, self.stimulus.end_s
        end = last + LATENCY_S
        late = self.stimulus.interpolation != "previous" and t[-1] * 1e-9 > end
        if t[0] * 1e-9 < start - LATENCY_S or (late and not _drains(t, t[np.searchsorted(t, last * 1e9) :])):
            raise InputError(
                f"{self.source or self.name}: stimulus: expected to cover the events "
                f"{t[0] * 1e-9:.10g}..{t[-1] * 1e-9:.10g} s, found {start:.10g}..{last:.10g} s; {_way(t, last - start)}"
            )

    def within_stimulus(self) -> Recording:
        """The recording without the events that a latency carried past the end of the stimulus."""
        if self.stimulus is None or self.stimulus.interpolation == "previous":
            return self
        inside = self.events.t <= self.stimulus.end_s * 1e9
        return self if inside.all() else replace(self, events=self.events.select(inside))

    def with_stimulus(self, stimulus: Light | str | Path) -> Recording:
        """The same events with another stimulus: a light, or the name or file of one, which is opened.

        Raises:
            InputError: it is neither, or of another sensor's size.
        """
        from pixelid.stimuli.files import load_stimulus

        light = load_stimulus(stimulus) if isinstance(stimulus, str | Path) else stimulus
        if not isinstance(light, Stimulus | PixelLights):
            raise InputError(f"stimulus: expected a Stimulus, a name or a file, found {shown(stimulus)}")
        size = (self.events.width, self.events.height)
        if light.size not in (None, size) and not self.pooled:
            found = f"{light.size[0]} x {light.size[1]}"
            raise InputError(f"stimulus: expected light for {size[0]} x {size[1]} pixels, found {found}")
        return replace(self, stimulus=light)


def _way(t: np.ndarray, light_s: float) -> str:
    """What to do about events outside their light."""
    much_longer = 100.0  # events than light: units are 1000 apart
    if float(t[-1] - t[0]) * 1e-9 > much_longer * light_s:
        return "is the unit of either's times right (--time-unit)?"
    return (
        "if the light has its own clock, say where it starts: pixelid convert --align trigger|first-event|auto|SECONDS"
    )


def _drains(t: np.ndarray, late: np.ndarray) -> bool:
    """Whether the `late` ones of all event times `t` follow each other at the recording's shortest interval."""
    if len(late) < 10:
        return False
    slowest = np.percentile(np.diff(late), 95)
    return bool(slowest <= 1.5 * max(np.percentile(np.diff(t), 5), 1))
