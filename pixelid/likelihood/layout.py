"""Where the numbers of every interval stand: rows of changes, and which pixel and recording an interval belongs to.

The changes of all recordings are one vector, so that a derivative along them is one product; its rows have names:

    events  (7, n)  EventRows, one column per interval that an event ends, section after section
    ends    (4, m)  EndRows, one column per pixel and recording, of the interval that the end cuts off

A section is a recording, or of one with light of each pixel's own a part (`sections.py`); those of a recording follow
each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from pixelid.likelihood.extremes import Extremes
from pixelid.likelihood.sections import Section
from pixelid.likelihood.sequences import Sequences
from pixelid.recordings.recording import Recording

NOTHING = np.empty(0)
NOTHING.flags.writeable = False
FLAT_BITS = 40  # of a pixel key, for the flat index: addresses have 16 bits each


class EventRows(NamedTuple):
    """Rows (n,) of `Changes` per event; `early`: by how many seconds it comes before its pixel can fire
    again, impossible from 0 on."""

    change: np.ndarray
    slope: np.ndarray
    drift: np.ndarray
    drift_slope: np.ndarray
    opposite: np.ndarray
    opposite_drift: np.ndarray
    early: np.ndarray

    @property
    def of_level(self) -> tuple[np.ndarray, ...]:
        """The rows that the level of the event's own polarity is made of."""
        return self.change, self.slope, self.drift, self.drift_slope


class EndRows(NamedTuple):
    """Rows (m,) of `Changes` per unfinished interval."""

    rise: np.ndarray
    rise_drift: np.ndarray
    fall: np.ndarray
    fall_drift: np.ndarray


@dataclass(frozen=True)
class StackedChanges:
    """The `Changes` of all recordings (or their derivatives).

    events, ends: views of `vector`;  extremes: where they were found in each section, none for derivatives
    """

    vector: np.ndarray
    events: EventRows
    ends: EndRows
    extremes: tuple[Extremes, ...] = ()


@dataclass(frozen=True)
class Shift:
    """(n,) each what is added to the changes at events and to their slopes, up for ON and down for OFF events."""

    change: np.ndarray
    slope: np.ndarray

    def apply(self, changes: StackedChanges, sign: np.ndarray, among: np.ndarray | slice = slice(None)) -> None:
        """Add it, at the events `among` (n,) only."""
        changes.events.change[among] += (sign * self.change)[among]
        changes.events.slope[among] += (sign * self.slope)[among]


@dataclass(frozen=True, eq=False)
class Layout:
    """n intervals with an event at their end, m without, of the same pixels in one or more recordings.

    pixel_keys: (pixels,) sensor and flat index of each pixel, sorted
    sign, time_s, tick_s, pixel, recording: (n,) polarity ±1, time and timestamp width of the event, whose it is
    previous_sign: (n,) polarity of the pixel's event before, ±1
    group: (n,) 2 · pixel + ON, the groups that share a threshold
    last_pixel, last_time_s, last_sign, last_recording: (m,) of the unfinished intervals; the time is the recording's
        end, the sign that of the event which began them
    event_ends, end_ends: where the columns of one section end and those of the next begin
    light, light_reset: (n,) variance of the change, and of its reference alone, by light that is not known between
        samples (`light_between_samples.py`);  light_last: (m,) of the changes in unfinished intervals
        Empty where the light is known.
    """

    recordings: int
    pixel_keys: np.ndarray
    sign: np.ndarray
    previous_sign: np.ndarray
    time_s: np.ndarray
    tick_s: np.ndarray
    pixel: np.ndarray
    recording: np.ndarray
    group: np.ndarray
    last_pixel: np.ndarray
    last_time_s: np.ndarray
    last_sign: np.ndarray
    last_recording: np.ndarray
    event_ends: np.ndarray
    end_ends: np.ndarray
    light: np.ndarray = field(default_factory=lambda: NOTHING)
    light_reset: np.ndarray = field(default_factory=lambda: NOTHING)
    light_last: np.ndarray = field(default_factory=lambda: NOTHING)

    @property
    def events(self) -> int:
        """n."""
        return len(self.sign)

    @property
    def ends(self) -> int:
        """m."""
        return len(self.last_pixel)

    @property
    def pixels(self) -> int:
        """Number of distinct pixels."""
        return len(self.pixel_keys)

    @property
    def groups(self) -> int:
        """Number of (pixel, polarity) pairs, OFF before ON."""
        return 2 * self.pixels

    @property
    def size(self) -> int:
        """Length of the vector of all changes."""
        return len(EventRows._fields) * self.events + len(EndRows._fields) * self.ends

    @cached_property
    def alike(self) -> np.ndarray:
        """(n,) 1 after an event of the same polarity, −1 after one of the other."""
        return read_only(self.sign * self.previous_sign)

    @cached_property
    def unknown(self) -> float:
        """The largest standard deviation of a change by light or noise that is not known."""
        return float(np.sqrt(max(self.light.max(initial=0.0), self.light_reset.max(initial=0.0))))

    @cached_property
    def turns(self) -> float:
        """Share of a pixel's neighbouring events that are of opposite polarity; a half where there are none."""
        order = np.lexsort((self.time_s, self.pixel, self.recording))
        pixel, recording, sign = self.pixel[order], self.recording[order], self.sign[order]
        same = (pixel[1:] == pixel[:-1]) & (recording[1:] == recording[:-1])
        return float((sign[1:] != sign[:-1])[same].mean()) if same.any() else 0.5

    def _blocks(self, vector: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(events (7, n), ends (4, m)), views."""
        at = len(EventRows._fields) * self.events
        return vector[:at].reshape(-1, self.events), vector[at:].reshape(-1, self.ends)

    def stacked(self, vector: np.ndarray, extremes: tuple[Extremes, ...] = ()) -> StackedChanges:
        """A vector (size,) by the names of its rows."""
        events, ends = self._blocks(vector)
        return StackedChanges(vector, EventRows(*events), EndRows(*ends), extremes)

    def per_section(self, vector: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Views (7, n_s), (4, m_s) of each section's columns, to be filled."""
        return [self.of_section(vector, k) for k in range(len(self.event_ends) + 1)]

    def of_section(self, vector: np.ndarray, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Views (7, n_s), (4, m_s) of one section's columns."""
        events, ends = self._blocks(vector)
        return events[:, self.events_of(k)], ends[:, self.ends_of(k)]

    def events_of(self, k: int) -> slice:
        """Columns of the events of section k."""
        return _part(self.event_ends, k)

    def ends_of(self, k: int) -> slice:
        """Columns of the unfinished intervals of section k."""
        return _part(self.end_ends, k)


def _part(ends: np.ndarray, k: int) -> slice:
    return slice(None if k == 0 else ends[k - 1], None if k == len(ends) else ends[k])


def layout_of(recordings: Sequence[Recording], intervals: Sequence[Sequences], sections: Sequence[Section]) -> Layout:
    """The layout of recordings' intervals, which are those of the sections, one after the other.

    Recordings of the same sensor and size share pixels.
    """
    sensors: dict[tuple, int] = {}
    keys, last_keys = [], []
    for recording, iv in zip(recordings, intervals, strict=True):
        size = (recording.sensor, recording.events.width, recording.events.height)
        base = sensors.setdefault(size, len(sensors)) << FLAT_BITS
        keys.append(base + iv.pixel)
        last_keys.append(base + iv.last_pixel)
    pixel_keys, index = np.unique(np.concatenate([*keys, *last_keys]), return_inverse=True)
    counts, last_counts = [len(iv) for iv in intervals], [len(iv.last_s) for iv in intervals]
    pixel, last_pixel = np.split(index, [sum(counts)])
    sign = np.concatenate([iv.sign for iv in intervals])
    which = np.arange(len(intervals))
    arrays = {
        "pixel_keys": pixel_keys,
        "sign": sign,
        "previous_sign": np.concatenate([iv.previous_sign for iv in intervals]),
        "time_s": np.concatenate([iv.time_s for iv in intervals]),
        "tick_s": np.repeat([iv.tick_s for iv in intervals], counts),
        "pixel": pixel,
        "recording": np.repeat(which, counts),
        "group": 2 * pixel + (sign > 0),
        "last_pixel": last_pixel,
        "last_time_s": np.repeat([iv.end_s for iv in intervals], last_counts),
        "last_sign": np.concatenate([iv.last_sign for iv in intervals]),
        "last_recording": np.repeat(which, last_counts),
        "event_ends": np.cumsum([len(s.intervals) for s in sections])[:-1],
        "end_ends": np.cumsum([len(s.intervals.last_s) for s in sections])[:-1],
    }
    return Layout(recordings=len(intervals), **{name: read_only(array) for name, array in arrays.items()})


def flat_index(pixel_keys: np.ndarray) -> np.ndarray:
    """(pixels,) flat index of pixels within their sensor, from `Layout.pixel_keys`."""
    return pixel_keys & ((1 << FLAT_BITS) - 1)


def read_only(array: np.ndarray) -> np.ndarray:
    """A contiguous copy that cannot be written to."""
    copy = np.array(array, order="C")
    copy.flags.writeable = False
    return copy
