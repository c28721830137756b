"""The event-time likelihood of recordings: what the measured times say, each previous event given.

The formulas are those of `density.py`; here recordings become intervals, and circuits their changes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property

import numpy as np

from pixelid.errors import InputError
from pixelid.likelihood.changes import ChangeEvaluator
from pixelid.likelihood.clocks import Clock, clock_in
from pixelid.likelihood.density import Terms, density
from pixelid.likelihood.extremes import Extremes
from pixelid.likelihood.layout import Layout, Shift, StackedChanges, flat_index, layout_of, read_only
from pixelid.likelihood.light_between_samples import unknown_light
from pixelid.likelihood.sections import sections_of
from pixelid.likelihood.stamps import Bend, Carried, Placed, carried_over
from pixelid.parallel import map_threads
from pixelid.recordings.bench import gains_of_pixels
from pixelid.recordings.events import COARSE_UNIT_SHARE, SHORT_QUANTILE
from pixelid.recordings.recording import Recording
from pixelid.stages.circuit import Circuit
from pixelid.stages.comparator import memory_factor
from pixelid.stimuli.stimulus import Stimulus

BRIGHTER = 1e-3  # of ln light, to find how levels go with a pixel's gain: to first order, 0.1 % of a gain of 3 %
UNEVEN = 0.03  # ln light, about what a field differs by: where the changes of a parabola are taken
NUDGE_S = 1e-7  # of the release, to find how a level depends on it: 1e-3 of a dead time, 1e7 times a float's rounding
MOST_REMEMBERED = 4_000_000  # samples of light in sections whose trajectories are remembered: 0.3 GB
SAME = (1e-3, 1e-2, 5e-2)  # of an interval: equal to a stamp's jitter; stamps of a foreign clock may be blurred more
PLACINGS = 8  # at most, of events where they most likely happened
FULL_STEPS = 3  # of them; then half steps, for an event that goes to and fro
LARGE = 60_000  # samples and events, a few milliseconds of work, from which handing it to other threads pays


class EventTimes:
    """The event-time likelihood of one or more recordings of the same pixels.

    Recordings of the same sensor and size share pixels, and so pixel thresholds.

    Args:
        recordings: With a stimulus each, full-field or of each pixel's own.

    Attributes:
        layout: Which pixel and recording each of the n intervals belongs to.
        clock_share: (n,) how often timestamp noise counts, 1 until `weighed`.
        threshold_factor: (n,) what each event's threshold is multiplied by in addition to all that the circuit says,
            or None.
        carried: What levels share with those of the events before, by the noise of stamps, or None.
        placed: Where events most likely happened, or None: where their stamps are.
        shift: What noise has added to the changes at events, or None.
        by_gain: What the gains of pixels add to changes where that is held, else None.
        unknown_light: What is not known of light that sensors measured themselves, None where there is none.

    Raises:
        InputError: For pooled recordings, a missing stimulus, or fewer than two events in any pixel.
    """

    def __init__(self, recordings: Sequence[Recording]) -> None:
        self.recordings = tuple(recordings)
        for recording in self.recordings:
            if recording.pooled:
                raise InputError(f"{recording.name}: pooled events have no pixels; use the pooled-rate likelihood")
        divided = [sections_of(recording) for recording in self.recordings]
        self.intervals = tuple(intervals for intervals, _ in divided)
        sections = [section for _, some in divided for section in some]
        self._recording_of_section = tuple(i for i, (_, some) in enumerate(divided) for _ in some)
        samples = sum(section.samples for section in sections)
        remember = len(sections) == len(self.recordings) or samples <= MOST_REMEMBERED
        self.evaluators = tuple(ChangeEvaluator(section, remember) for section in sections)
        if sum(map(len, self.intervals)) == 0:
            raise InputError("no pixel has two events: there is no interval to explain")
        self.layout = layout_of(self.recordings, self.intervals, sections)
        self.unknown_light = unknown_light(self.recordings, [some for _, some in divided])
        if self.unknown_light is not None:
            self.layout = self.unknown_light.added(self.layout)
        self._uneven = _uneven(self.recordings, self.intervals)
        # the same sections once more, so that trajectories under brighter light have a memory of their own
        self._brighter = () if self._uneven is None else tuple(ChangeEvaluator(s, remember) for s in sections)
        self.clock_share = read_only(np.ones(self.events))
        self.threshold_factor: np.ndarray | None = None
        self.shift: Shift | None = None
        self.carried: Carried | None = None
        self.placed: Placed | None = None
        self.by_gain: np.ndarray | None = None
        self._large = samples + self.events > LARGE

    @property
    def events(self) -> int:
        """n, the number of intervals with an event at their end."""
        return self.layout.events

    @property
    def pixels(self) -> int:
        """Number of distinct pixels with events."""
        return self.layout.pixels

    @property
    def pixel_keys(self) -> np.ndarray:
        """(pixels,) sensor and flat index of each pixel, sorted."""
        return self.layout.pixel_keys

    @property
    def flat_pixels(self) -> np.ndarray:
        """(pixels,) flat index of each pixel within its sensor."""
        return flat_index(self.pixel_keys)

    @property
    def sign(self) -> np.ndarray:
        """(n,) +1 ON, −1 OFF."""
        return self.layout.sign

    @property
    def time_s(self) -> np.ndarray:
        """(n,) times of the events."""
        return self.layout.time_s

    @property
    def pixel(self) -> np.ndarray:
        """(n,) whose event it is, an index into `pixel_keys`."""
        return self.layout.pixel

    @property
    def group(self) -> np.ndarray:
        """(n,) 2 · pixel + ON: the groups that share a threshold."""
        return self.layout.group

    @property
    def recording_of_event(self) -> np.ndarray:
        """(n,) index of its recording."""
        return self.layout.recording

    @property
    def is_uneven(self) -> bool:
        """Whether pixels see more or less than the light says."""
        return self._uneven is not None

    @cached_property
    def has_coarse_stamps(self) -> bool:
        """Whether stamps are as wide as `COARSE_UNIT_SHARE` of the shortest intervals: their rounding shows."""
        widest = float(self.layout.tick_s.max(initial=0.0))
        return widest > 0.0 and widest >= COARSE_UNIT_SHARE * self.shortest_intervals_s(SHORT_QUANTILE)

    def shortest_intervals_s(self, quantile: float) -> float:
        """A low quantile of the times between two events of a pixel: dead time can hardly be longer."""
        return float(np.quantile(np.concatenate([iv.time_s - iv.previous_s for iv in self.intervals]), quantile))

    def commonest_intervals_s(self) -> list[float]:
        """Times between two events of a pixel that recur most, counted in windows of each of `SAME`.

        There a silence may end: what comes at its end comes after the same time.
        """
        waits = np.sort(np.concatenate([iv.time_s - iv.previous_s for iv in self.intervals]))
        waits = waits[waits > 0]
        tick = float(self.layout.tick_s.max())
        found: list[float] = []
        for share in SAME:
            last = np.searchsorted(waits, waits * (1.0 + share) + 2.0 * tick, side="right")
            k = int(np.argmax(last - np.arange(len(waits)))) if len(waits) else 0
            middle = float(np.median(waits[k : last[k]])) if len(waits) else 0.0
            if middle > 0 and all(abs(middle / other - 1.0) > SAME[0] for other in found):
                found.append(middle)
        return found

    def changes(self, circuit: Circuit, here: StackedChanges | None = None) -> StackedChanges:
        """The changes of all recordings under a circuit.

        Args:
            circuit: Of real numbers.
            here: The changes under a circuit close by, for a derivative, which does not see that extremes move.
        """
        if circuit.light_spread:
            raise InputError("light_spread: of pooled recordings only; pixels with addresses have light of their own")
        vector = np.empty(self.layout.size)
        where = [True] * len(self.evaluators) if here is None else here.extremes
        circuits, clocks = self._circuits(circuit)
        parts = list(zip(circuits, self.evaluators, where, self.layout.per_section(vector), clocks, strict=True))
        located = self._filled(parts)
        self._add_gains(vector, circuits, clocks, located)
        changes = self.layout.stacked(vector, tuple(located))
        if self.unknown_light is not None:
            self.unknown_light.apply(changes, self.sign)
        if self.shift is not None:
            self.shift.apply(changes, self.sign)
        if self.threshold_factor is not None:
            for row in changes.events.of_level:
                row /= self.threshold_factor
        if self.placed is not None:
            self.placed.apply(changes)
        if self.carried is not None:
            self.carried.apply(changes)
        return changes

    def changes_of_one(self, circuit: Circuit, here: StackedChanges, recording: int) -> StackedChanges:
        """`here`, but for one recording under another circuit; its extremes where they were."""
        vector = here.vector.copy()
        circuits, clocks = self._circuits(circuit)
        mine = [k for k, of in enumerate(self._recording_of_section) if of == recording]
        self._filled([
            (circuits[k], self.evaluators[k], here.extremes[k], self.layout.of_section(vector, k), clocks[k])
            for k in mine
        ])  # fmt: skip
        for k in mine if self.is_uneven else ():
            by_gain = self._gain_of(k, vector, circuits[k], clocks[k], here.extremes[k])
            for row, by in zip(self.layout.of_section(vector, k), by_gain, strict=True):
                row += by
        changes = self.layout.stacked(vector)
        if self.unknown_light is not None:
            self.unknown_light.apply(changes, self.sign, self.layout.recording == recording)
        if self.shift is not None:
            self.shift.apply(changes, self.sign, self.layout.recording == recording)
        if self.threshold_factor is not None:
            mine = self.layout.recording == recording
            for row in changes.events.of_level:
                row[mine] /= self.threshold_factor[mine]
        if self.placed is not None:
            self.placed.apply(changes, self.layout.recording == recording)
        if self.carried is not None:
            self.carried.apply(changes, self.layout.recording == recording)
        return changes

    def _add_gains(
        self,
        vector: np.ndarray,
        circuits: Sequence[Circuit],
        clocks: Sequence[Clock | None],
        extremes: Sequence[Extremes],
    ) -> None:
        """Move changes by what their pixels see more or less than the light says."""
        if self._uneven is None:
            return
        if self.by_gain is not None:
            vector += self.by_gain
            return
        parts = zip(range(len(circuits)), circuits, clocks, extremes, strict=True)
        gains = map_threads(
            lambda part: self._gain_of(part[0], vector, *part[1:]), list(parts), threads=None if self._large else 1
        )
        for section, gain in zip(self.layout.per_section(vector), gains, strict=True):
            for row, by in zip(section, gain, strict=True):
                row += by

    def _gain_of(
        self, k: int, vector: np.ndarray, circuit: Circuit, clock: Clock | None, extremes: Extremes
    ) -> tuple[np.ndarray, ...]:
        """What gains of pixels add to the rows of section k, to first order: as held, or under a circuit."""
        assert self._uneven is not None
        if self.by_gain is not None:
            return self.layout.of_section(self.by_gain, k)
        mine = self.layout.of_section(vector, k)
        there = mine[0].copy(), mine[1].copy()
        brighter = circuit.with_(light_gain=circuit.light_gain * (1.0 + BRIGHTER))
        self._brighter[k].fill(brighter, extremes, *there, clock=clock, unknown=self.layout.unknown)
        events, ends = self._uneven
        by = []
        for row, moved, gain in zip(
            mine, there, (events[self.layout.events_of(k)], ends[self.layout.ends_of(k)]), strict=True
        ):
            with np.errstate(over="ignore", invalid="ignore"):
                slope = (moved - row) / BRIGHTER
            by.append(gain * np.nan_to_num(slope, copy=False, posinf=0.0, neginf=0.0))
        return tuple(by)

    def _circuits(self, circuit: Circuit) -> tuple[list[Circuit], list[Clock | None]]:
        """Of every section: the circuit as it was in its recording, and the clock."""
        in_each = [circuit.in_recording(recording.name) for recording in self.recordings]
        clocks = [clock_in(recording, circuit) for recording in self.recordings]
        which = self._recording_of_section
        return [in_each[k] for k in which], [clocks[k] for k in which]

    def _filled(self, parts: Sequence[tuple]) -> list[Extremes]:
        """Fill the rows of sections (circuit, evaluator, extremes or True, rows, clock); where their extremes are."""

        unknown = self.layout.unknown

        def fill(part) -> Extremes:
            circuit, evaluator, at, rows, clock = part
            return evaluator.fill(circuit, at, *rows, clock, unknown)

        return list(map_threads(fill, parts, threads=None if self._large else 1))

    def times_on_light(self, circuit: Circuit) -> tuple[np.ndarray, np.ndarray]:
        """(n,) each: when the event before, and the event, left their pixel, in seconds of the light."""
        previous, time = [], []
        for recording, intervals in zip(self.recordings, self.intervals, strict=True):
            clock, delay = clock_in(recording, circuit), circuit.in_recording(recording.name).delay
            for out, stamps in ((previous, intervals.previous_s), (time, intervals.time_s)):
                out.append((stamps if clock is None else clock.on_light(stamps)) - delay)
        return np.concatenate(previous), np.concatenate(time)

    def terms(self, circuit: Circuit, changes: StackedChanges | None = None) -> Terms:
        """The likelihood's pieces under a circuit; `changes` is `changes(circuit)` when it is known already."""
        terms = density(self.layout, circuit, changes or self.changes(circuit), self.clock_share)
        if self.carried is not None:
            terms.event.term[:] += self.carried.gain * ~terms.background
        return terms

    def released_later(self, circuit: Circuit, here: Terms) -> Terms:
        """The pieces if every pixel were let go `NUDGE_S` later;  here: `terms(circuit)`."""
        later = circuit.with_(refractory=circuit.refractory + NUDGE_S)
        return self.terms(later, self.changes(later, here.changes))

    def log_likelihood(self, circuit: Circuit) -> float:
        """The log-likelihood."""
        return self.terms(circuit).total

    def weighed(self, circuit: Circuit) -> EventTimes:
        """The same likelihood with timestamp noise counted twice: at the event, and at the reset before it.

        The time of the reset is as uncertain as that of the event, and what the event before says of it is taken from
        the level (`stamps.py`).  All that is held as it is under this circuit, and gains of pixels are, too.
        """
        return self.with_single_stamps().with_gains_held(circuit).with_stamps_at(circuit)

    def with_stamps_at(self, circuit: Circuit, bend: Bend | None = None) -> EventTimes:
        """The same likelihood with the noise of stamps held as under a circuit, events placed from where they are.

        bend: if it is known
        """
        other = self.with_stamps(None, np.ones(self.events), self.placed)
        for turn in range(PLACINGS):
            here = other.terms(circuit)
            carried, _, moved = other._carried_over(circuit, here)
            if carried is None:
                break
            placed = carried.placed(here, moved, here.event.clock, other.placed, 1.0 if turn < FULL_STEPS else 0.5)
            rests = placed.rests_at(other.placed, here)
            other = other.with_stamps(None, other.clock_share, placed)
            if rests:
                break
        carried, share = other.shared_by_stamps(circuit, other.terms(circuit), bend=bend)
        return other.with_stamps(carried, share, None if carried is None else other.placed)

    def shared_by_stamps(
        self,
        circuit: Circuit,
        here: Terms,
        added: np.ndarray | None = None,
        levels: np.ndarray | None = None,
        bend: Bend | None = None,
    ) -> tuple[Carried | None, np.ndarray]:
        """What levels share by the noise of stamps, as of `stamps.carried_over`;  here: `terms(circuit)`.

        added: (n,) variance of levels in addition to those of thresholds and stamps
        levels: (n,) about what is expected of them, the events before given; None: as stamps alone have it
        bend: of levels, by times; None: to be found
        """
        carried, share, moved = self._carried_over(circuit, here, added)
        if carried is None:
            return None, share
        if levels is not None:
            carried = replace(carried, level=levels)
        stamp = here.event.clock
        bend = bend or self._bend(circuit, here, float(np.sqrt(stamp.max())))
        return carried.with_bend(here, moved, stamp, bend, self.placed), share

    def _carried_over(
        self, circuit: Circuit, here: Terms, added: np.ndarray | None = None
    ) -> tuple[Carried | None, np.ndarray, np.ndarray]:
        """`stamps.carried_over`, and (n,) how levels move with the release;  here: `terms(circuit)`."""
        growth = 1.0 + circuit.threshold_drift * self.time_s
        scale = self.sign / (growth * memory_factor(circuit.polarity_memory, self.layout.alike))
        previous_s = np.concatenate([intervals.previous_s for intervals in self.intervals])
        moved = self.moved_by_release(circuit, here)
        return *carried_over(here, moved, here.event.clock, scale, previous_s, added), moved

    def with_single_stamps(self) -> EventTimes:
        """The same likelihood with timestamp noise counted at the event alone, where stamps are."""
        return self.with_stamps(None, np.ones(self.events), None)

    def with_stamps(self, carried: Carried | None, clock_share: np.ndarray, placed: Placed | None) -> EventTimes:
        """The same likelihood with the noise of stamps held in another way; arguments are the attributes."""
        other = copy(self)
        other.carried, other.clock_share, other.placed = carried, read_only(clock_share), placed
        if placed is not self.placed:
            shifts = np.zeros((2, self.events)) if placed is None else (placed.earlier, placed.reset_earlier)
            columns = [self.layout.events_of(k) for k in range(len(self.evaluators))]
            other.evaluators = tuple(
                e.placed(*(row[of] for row in shifts)) for e, of in zip(self.evaluators, columns, strict=True)
            )
        return other

    def _where_placed(self, circuit: Circuit, here: Terms) -> tuple[EventTimes, Terms]:
        """The same likelihood with levels where events are placed, not carried on to their stamps, and its pieces."""
        if self.placed is None:
            return self, here
        plain = self.with_stamps(self.carried, self.clock_share, self.placed.not_carried_on())
        return plain, plain.terms(circuit)

    def moved_by_release(self, circuit: Circuit, here: Terms) -> np.ndarray:
        """(n,) by how much levels rise, per second by which pixels are let go later, where events are placed;
        here: `terms(circuit)`."""
        plain, here = self._where_placed(circuit, here)
        there = plain.released_later(circuit, here)
        known = (here.z != 0.0) & (there.z != 0.0)  # a level of 0: the circuit cannot have fired
        return np.where(known, there.z - here.z, 0.0) / NUDGE_S

    def _bend(self, circuit: Circuit, here: Terms, within_s: float) -> Bend:
        """Second derivatives of levels by the times of events and resets, from levels so many seconds further and back,
        where events are placed;  here: `terms(circuit)`."""
        plain, here = self._where_placed(circuit, here)

        def at(other: Circuit) -> Terms:
            return plain.terms(other, plain.changes(other, here.changes))

        released = [at(circuit.with_(refractory=circuit.refractory + by)) for by in (within_s, -within_s)]
        all_later = [at(circuit.later_by(-by)) for by in (within_s, -within_s)]
        known = np.logical_and.reduce([terms.z != 0.0 for terms in (here, *released, *all_later)])
        reset = (released[0].z - 2.0 * here.z + released[1].z) / within_s**2
        both = (released[0].event.rate - released[1].event.rate) / (2.0 * within_s)
        event = (all_later[0].event.rate - all_later[1].event.rate) / (2.0 * within_s) - both
        return Bend(*(np.where(known, derivative, 0.0) for derivative in (event, reset, both)))

    def with_gains_held(self, circuit: Circuit) -> EventTimes:
        """The same likelihood with what the gains of pixels add to changes as it is under a circuit, to second order.

        Under circuits close by it hardly differs, and takes half of the time of each evaluation.
        """
        other = copy(self)
        other.by_gain = self._by_gains(circuit) if self.is_uneven else None
        return other

    def _by_gains(self, circuit: Circuit) -> np.ndarray:
        """What the gains of pixels add to the changes: of the parabola through those in light e^±`UNEVEN` as bright."""
        assert self._uneven is not None
        middle, extremes = self._in_even_field(circuit, self.evaluators, [True] * len(self.evaluators))
        up, down = (self._in_even_field(circuit, self._brighter, extremes, math.exp(by))[0] for by in (UNEVEN, -UNEVEN))
        gains = np.empty_like(middle)
        for k, rows in enumerate(self.layout.per_section(gains)):
            own = self._uneven[0][self.layout.events_of(k)], self._uneven[1][self.layout.ends_of(k)]
            for row, gain in zip(rows, own, strict=True):
                row[:] = gain / UNEVEN
        with np.errstate(over="ignore", invalid="ignore"):
            added = 0.5 * gains * (up - down + gains * (up - 2.0 * middle + down))
        return np.nan_to_num(added, copy=False, posinf=0.0, neginf=0.0)

    def _in_even_field(
        self, circuit: Circuit, evaluators: Sequence[ChangeEvaluator], where: Sequence, brighter: float = 1.0
    ) -> tuple[np.ndarray, list[Extremes]]:
        """(all changes where every pixel sees the light that is stated, times a factor; where their extremes are).

        where: of every section its extremes, or True where they are to be found
        """
        vector = np.empty(self.layout.size)
        circuits, clocks = self._circuits(circuit)
        lit = [own.with_(light_gain=own.light_gain * brighter) for own in circuits]
        parts = list(zip(lit, evaluators, where, self.layout.per_section(vector), clocks, strict=True))
        return vector, self._filled(parts)

    def with_lights(self, lights: Sequence[Sequence[Stimulus]]) -> EventTimes:
        """The same likelihood under other lights, those of each section, sampled at the same times."""
        other = copy(self)
        other.evaluators = tuple(e.with_lights(some) for e, some in zip(self.evaluators, lights, strict=True))
        other._brighter = tuple(
            e.with_lights(some) for e, some in zip(self._brighter, lights, strict=bool(self._brighter))
        )
        return other

    def with_shift(self, shift: Shift, layout: Layout) -> EventTimes:
        """The same likelihood with what noise has added to changes, and a layout that knows its variances."""
        other = copy(self)
        other.shift, other.layout = shift, layout
        return other

    def with_threshold_factor(self, factor: np.ndarray | None) -> EventTimes:
        """The same likelihood with each event's threshold multiplied by `factor` (n,); None: by nothing."""
        other = copy(self)
        other.threshold_factor = None if factor is None else read_only(factor)
        return other


def _uneven(recordings: Sequence[Recording], intervals: Sequence) -> tuple[np.ndarray, np.ndarray] | None:
    """(n,) of the intervals and (m,) of the unfinished ones: ln of their pixel's gain; None where the field is even."""
    events = [gains_of_pixels(r, iv.pixel) for r, iv in zip(recordings, intervals, strict=True)]
    ends = [gains_of_pixels(r, iv.last_pixel) for r, iv in zip(recordings, intervals, strict=True)]
    uneven = any(gain.any() for gain in (*events, *ends))
    return (np.concatenate(events), np.concatenate(ends)) if uneven else None
