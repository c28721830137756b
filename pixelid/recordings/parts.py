"""Long recordings in parts: what streams through memory instead of lying in it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import TypeVar, cast

import numpy as np

from pixelid.recordings.columns import PART_EVENTS
from pixelid.recordings.events import Events
from pixelid.recordings.recording import Recording
from pixelid.recordings.triggers import Triggers
from pixelid.stimuli.pixel_lights import Light

Either = TypeVar("Either", bound="Recording | LongRecording")
WHOLE_EVENTS = 1 << 22  # up to which a recording lies in memory whole: inspection takes 67 bytes an event, 280 MB


@dataclass(frozen=True)
class LongRecording:
    """A recording whose events do not lie in memory.

    Attributes:
        head: everything but events and trigger edges.
        read: makes an iterator over its parts, each a recording with the events and edges of a stretch of time; it may
            be called as often as wanted, the file is read again.
    """

    head: Recording
    read: Callable[[], Iterator[Recording]]

    @property
    def stimulus(self) -> Light | None:
        """The light behind it, if it is known."""
        return self.head.stimulus

    @property
    def name(self) -> str:
        """As a recording's."""
        return self.head.name

    def check_stimulus_covers_events(self) -> None:
        """As a recording's, from its first event and its last `WHOLE_EVENTS`.  Raises InputError likewise."""
        first: list[Recording] = []
        last: deque[Recording] = deque(maxlen=WHOLE_EVENTS // PART_EVENTS)
        for part in self.read():
            if len(part.events):
                first = first or [replace(part, events=part.events.select(np.s_[:1]))]
                last.append(part)
        joined(self.head, [*first, *last]).check_stimulus_covers_events()

    def with_stimulus(self, stimulus: Light) -> LongRecording:
        """The same events with another stimulus."""
        return self.map(lambda part: part.with_stimulus(stimulus))

    def map(self, function: Callable[[Recording], Recording]) -> LongRecording:
        """The recording whose head and parts are what `function` makes of them."""
        return LongRecording(function(self.head), lambda: map(function, self.read()))


class Totals:
    """Events, and the times of the first and last (ns), part by part."""

    def __init__(self) -> None:
        self.events = 0
        self.ends: list[int] = []

    def add(self, part: Recording) -> int:
        """Take in a part that follows those before; returns how many events there are so far."""
        self.events += len(part.events)
        self.ends = [*self.ends[:1], *part.events.t[:1].tolist(), *part.events.t[-1:].tolist()]
        return self.events

    @property
    def duration_s(self) -> float:
        """Seconds between the first and the last event."""
        return float(self.ends[-1] - self.ends[0]) * 1e-9 if self.events > 1 else 0.0


def joined(head: Recording, parts: Iterable[Recording]) -> Recording:
    """One recording of its parts."""
    parts = list(parts)
    every = [part.events for part in parts if len(part.events)] or [head.events]
    t, x, y, p = (np.concatenate([getattr(events, name) for events in every]) for name in "txyp")
    events = Events(t, x, y, p, head.events.width, head.events.height, head.events.tick_ns)
    return replace(head, events=events, triggers=Triggers.joined(part.triggers for part in parts))


def as_whole(recording: Recording | LongRecording) -> Recording:
    """The recording with all its events in memory."""
    return joined(recording.head, recording.read()) if isinstance(recording, LongRecording) else recording


def joined_if_short(long: LongRecording) -> Recording | LongRecording:
    """The whole recording where it has at most `WHOLE_EVENTS` events, else the same."""
    parts, held = [], 0
    for part in (reading := long.read()):
        parts.append(part)
        held += len(part.events)
        if held > WHOLE_EVENTS:
            reading.close()  # type: ignore[attr-defined]
            return long
    return joined(long.head, parts)


def as_long(recording: Recording | LongRecording) -> LongRecording:
    """The recording as one that comes in parts, also where it lies in memory."""
    if isinstance(recording, LongRecording):
        return recording
    events = recording.events
    head = replace(recording, events=Events.empty(events.width, events.height, events.tick_ns), triggers=None)

    def parts() -> Iterator[Recording]:
        for k in range(0, max(len(events), 1), PART_EVENTS):
            some = events.select(np.s_[k : k + PART_EVENTS])
            yield replace(head, events=some, triggers=recording.triggers if k == 0 else None)

    return LongRecording(head, parts)


def like(recording: Either, long: LongRecording) -> Either:
    """What was made of a recording part by part, in memory if that lies there."""
    return cast(Either, long if isinstance(recording, LongRecording) else as_whole(long))
