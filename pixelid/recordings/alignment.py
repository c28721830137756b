"""Bring the light and the events onto one clock: by a trigger, by the first event, or by the events themselves.

A camera and whatever drives or measures the light count time from zeros of their own, and their clocks differ by some
parts in a million.  What is sought is where the light's time zero lies on the camera's clock (the offset) and how many
of the camera's seconds one second of the light takes (1 + rate error).  What the events say by themselves is in
`alignment_from_events.py`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from pixelid.errors import InputError, did_you_mean
from pixelid.recordings.alignment_from_events import RATE_BOUND, alignment_from_events
from pixelid.recordings.clocks import CRYSTAL, Alignment, ClockPrior
from pixelid.recordings.kept import ATTRIBUTE, kept_of
from pixelid.recordings.parts import WHOLE_EVENTS, LongRecording, joined
from pixelid.recordings.recording import Recording
from pixelid.recordings.triggers import Triggers
from pixelid.statistics import Z95
from pixelid.stimuli.pixel_lights import Light, pixel_lights
from pixelid.stimuli.stimulus import Stimulus

METHODS = ("trigger", "first-event", "auto")
EDGE_S = 1e-6  # cameras stamp trigger edges in microseconds, whatever unit a file has them in


def find_alignment(recording: Recording, light: Light, how: str) -> Alignment:
    """The alignment by one of `METHODS`, or by a number: the light's time zero in seconds of the camera's clock.

    Args:
        recording: events, and triggers for "trigger": the first rising edge is the light's first sample; where more
            follow, a second edge at the light's last sample gives the clocks' rate; "trigger:N" of input N.
        light: full-field or of each pixel's own.
        how: "trigger", "first-event" (the first event is the light's first change), "auto", or seconds.

    Returns:
        The alignment; `aligned` applies it.

    Raises:
        InputError: for an unknown method, no triggers, no events, and events that do not tell: no correlation with the
            light, or two offsets as good as each other.
    """
    found = _found(recording, light, how)
    return replace(found, start_s=found.offset_s + (1.0 + found.rate_error) * light.start_s)


def _found(recording: Recording, light: Light, how: str) -> Alignment:
    how, _, channel = how.partition(":") if how.startswith("trigger:") else (how, "", "")
    if how not in METHODS:
        try:
            seconds = float(how)
        except ValueError:
            seconds = np.nan
        if not np.isfinite(seconds):
            raise InputError(
                f"--align: expected {', '.join(METHODS)} or seconds, found {how!r}{did_you_mean(how, METHODS)}"
            )
        return Alignment(seconds, "given")
    if how == "trigger":
        if recording.triggers is None or not len(recording.triggers):
            raise InputError(f"{recording.name}: --align trigger: the file holds no trigger edges")
        edges = _edges_s(recording, recording.triggers, channel)
        note = "" if recording.triggers.rises_at(edges[0]) else "no edge rises; falling ones are taken"
        return replace(_from_triggers(edges, light, recording.events.tick_ns), note=note)
    if len(recording.events) == 0:
        raise InputError(f"{recording.name}: --align {how}: the file holds no events")
    if how == "first-event":
        return Alignment(float(recording.events.t[0] * 1e-9 - _first_change_s(light)), "first-event")
    return alignment_from_events(recording, light)


def aligned(recording: Recording, light: Light, alignment: Alignment) -> Recording:
    """The recording with time zero at the light's first sample, the light on the camera's clock beside it.

    Events move by whole nanoseconds, so that their ticks stay; what lies outside the light is left out.
    Raises InputError when nothing lies inside.
    """
    zero_ns, first, last = _span_ns(recording, light, alignment)
    events = recording.events
    inside = (events.t >= first) & (events.t <= last)
    if len(events) and not inside.any():
        raise _nothing_inside(recording.name, (first, last), (int(events.t[0]), int(events.t[-1])))
    kept = events.select(inside)
    return replace(
        _beside(recording, light, alignment, int((~inside).sum())),
        events=replace(kept, t=kept.t - zero_ns),
        triggers=None if recording.triggers is None else recording.triggers.shifted(-zero_ns),
        exposures=None if recording.exposures is None else _moved(recording.exposures, zero_ns, last),
    )


def aligned_parts(long: LongRecording, light: Light, alignment: Alignment) -> LongRecording:
    """The same of a recording that does not lie in memory; events outside the light are counted in a reading before."""
    zero_ns, first, last = _span_ns(long.head, light, alignment)
    inside = outside = 0
    ends: list[int] = []
    for part in long.read():
        t = part.events.t
        begin, end = np.searchsorted(t, first), np.searchsorted(t, last, side="right")
        inside, outside = inside + int(end - begin), outside + len(t) - int(end - begin)
        ends = [*ends[:1], *t[:1].tolist(), *t[-1:].tolist()]
    if ends and not inside:
        raise _nothing_inside(long.name, (first, last), (ends[0], ends[-1]))
    head = _beside(long.head, light, alignment, outside)

    def parts() -> Iterator[Recording]:
        for part in long.read():
            kept = part.events.select(np.s_[np.searchsorted(part.events.t, first) :])
            kept = kept.select(np.s_[: np.searchsorted(kept.t, last, side="right")])
            edges = None if part.triggers is None else part.triggers.shifted(-zero_ns)
            yield replace(head, events=replace(kept, t=kept.t - zero_ns), triggers=edges)

    return LongRecording(head, parts)


def sample_to_align(long: LongRecording, seed: int = 0) -> Recording:
    """Enough of a long recording to align it: all trigger edges, the events of some pixels, the time of the first."""
    counts = np.zeros(long.head.events.width * long.head.events.height, np.int64)
    edges, first = [], None
    for part in long.read():
        counts += np.bincount(part.events.pixel, minlength=len(counts))
        edges.append(part.triggers)
        first = int(part.events.t[0]) if first is None and len(part.events) else first
    order = np.random.default_rng(seed).permutation(np.flatnonzero(counts))
    few = order[: max(int(np.searchsorted(np.cumsum(counts[order]), WHOLE_EVENTS)), 1)]
    chosen = np.zeros(len(counts), bool)
    chosen[few] = True
    sample = joined(
        long.head, (replace(part, events=part.events.select(chosen[part.events.pixel])) for part in long.read())
    )
    earliest = sample.events.t.copy()
    earliest[:1] = first  # a moment early for one event of its pixel
    return replace(sample, events=replace(sample.events, t=earliest), triggers=Triggers.joined(edges))


def _span_ns(recording: Recording, light: Light, alignment: Alignment) -> tuple[int, int, int]:
    """The camera's time that becomes zero, and the first and last time within the light."""
    rate = 1.0 + alignment.rate_error
    start_s = alignment.offset_s + rate * light.start_s
    tick = max(recording.events.tick_ns, 1)
    zero_ns = round(start_s * 1e9 / tick) * tick
    first, last = (round(1e9 * (alignment.offset_s + rate * edge)) for edge in (light.start_s, light.end_s))
    return zero_ns, max(first, zero_ns), last


def _beside(recording: Recording, light: Light, alignment: Alignment, outside: int) -> Recording:
    """The recording with the light on its new clock, and with how that was found."""
    zero_ns, _, _ = _span_ns(recording, light, alignment)
    rate, offset_s = 1.0 + alignment.rate_error, alignment.offset_s - zero_ns * 1e-9
    told = {**alignment.as_dict(), "zero_ns": zero_ns, "events_outside": outside}
    if alignment.prior is not None:
        at_s = offset_s + rate * alignment.prior.at_s
        told["prior"] = replace(alignment.prior, at_s=at_s, span_s=rate * alignment.prior.span_s).as_dict()
    attributes = {**recording.attributes, "alignment": told}
    if ATTRIBUTE in attributes:
        attributes[ATTRIBUTE] = kept_of(recording).shifted(zero_ns * 1e-9).as_dict()
    return replace(recording, stimulus=light.shifted(offset_s, rate), attributes=attributes)


def _nothing_inside(name: str, light_ns: tuple[int, int], events_ns: tuple[int, int]) -> InputError:
    light, events = (f"{first * 1e-9:.10g}..{last * 1e-9:.10g} s" for first, last in (light_ns, events_ns))
    return InputError(
        f"{name}: no event lies within the light, at {light} of the camera's clock; events are at {events} (--align)"
    )


def _moved(events, zero_ns: int, last_ns: int):
    kept = events.select((events.t >= zero_ns) & (events.t <= last_ns))
    return replace(kept, t=kept.t - zero_ns)


def _edges_s(recording: Recording, triggers: Triggers, channel: str) -> np.ndarray:
    """Seconds of the edges at one input: the one asked for ("" where there is only one)."""
    inputs = sorted({*triggers.channel.tolist()})
    wanted = [number for number in inputs if channel in ("", str(number))]
    if len(wanted) != 1:
        found = ", ".join(map(str, inputs))
        asked = f"expected one of them, found {channel!r}" if channel else f"say which, --align trigger:{inputs[0]}"
        raise InputError(f"{recording.name}: --align trigger: edges at the inputs {found}; {asked}")
    return triggers.edges_s(wanted[0])


def _from_triggers(edges: np.ndarray, light: Light, tick_ns: int) -> Alignment:
    """First edge at the light's first sample; the one edge within RATE_BOUND of its last gives the rate.

    An edge is known to its stamp: uniform over a tick.  Without a second one, and where several may be it, the rate is
    as uncertain as clocks are.
    """
    duration, begin = light.duration_s, light.start_s
    stamp = max(EDGE_S, tick_ns * 1e-9) / np.sqrt(12.0)
    near = edges[np.abs(edges - edges[0] - duration) <= RATE_BOUND * duration]
    if len(near) > 1 and isinstance(light, Stimulus) and len(edges) == len(light.t):  # an edge per sample
        near = near[near == edges[-1]]
    if len(near) == 1:  # of several nobody knows which
        last = float(near[0])
        rate = (last - float(edges[0])) / duration - 1.0
        rate_sd = np.sqrt(2.0) * stamp / duration
        prior = ClockPrior(begin + 0.5 * duration, duration, stamp / np.sqrt(2.0), rate, rate_sd)
    else:
        rate, prior = 0.0, ClockPrior(begin, duration, stamp, 0.0, CRYSTAL)
    assert prior.delay_sd_s is not None
    offset = float(edges[0]) - (1.0 + rate) * begin
    half = Z95 * float(np.hypot(prior.delay_sd_s, prior.at_s * prior.rate_sd))  # at the light's time zero
    return Alignment(
        offset,
        "trigger",
        (offset - half, offset + half),
        rate,
        (rate - Z95 * prior.rate_sd, rate + Z95 * prior.rate_sd),
        prior,
        start_half_s=Z95 * float(np.hypot(prior.delay_sd_s, (begin - prior.at_s) * prior.rate_sd)),
    )


def _first_change_s(light: Light) -> float:
    """Where the light first leaves its first value, in any pixel: the last sample that still has it."""
    grouped = pixel_lights(light)
    if grouped is not None:
        changing = [one for one in grouped.lights if (one.radiance != one.radiance[0]).any()]
        return min(map(_first_change_s, changing), default=light.start_s)
    assert isinstance(light, Stimulus)
    moved = np.flatnonzero(light.radiance != light.radiance[0])
    return float(light.t[max(int(moved[0]) - 1, 0)]) if len(moved) else light.start_s
