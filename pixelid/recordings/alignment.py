"""Bring the light and the events onto one clock: by a trigger, by the first event, or by the events themselves.

A camera and whatever drives or measures the light count time from zeros of their own, and their clocks differ by some
parts in a million.  What is sought is where the light's time zero lies on the camera's clock (the offset) and how many
of the camera's seconds one second of the light takes (1 + rate error).  What the events say by themselves is in
`alignment_from_events.py`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, replace

import numpy as np

from pixelid.errors import InputError, did_you_mean
from pixelid.recordings.alignment_filter import RATE_BOUND
from pixelid.recordings.alignment_from_events import alignment_from_events
from pixelid.recordings.clocks import CRYSTAL, ONE_CLOCK, Alignment, ClockPrior
from pixelid.recordings.events import Events
from pixelid.recordings.kept import ATTRIBUTE, kept_of
from pixelid.recordings.parts import WHOLE_EVENTS, Either, LongRecording, Totals, as_long, joined, like
from pixelid.recordings.recording import Recording
from pixelid.recordings.triggers import Triggers
from pixelid.statistics import Z95
from pixelid.stimuli.pixel_lights import Light, pixel_lights
from pixelid.stimuli.stimulus import Stimulus

METHODS = ("trigger", "first-event", "auto")
GIVEN_SD_S = 1e-3  # of an offset stated without its error: read off a clock by hand


def find_alignment(recording: Recording, light: Light, how: str, *, one_clock: bool = False) -> Alignment:
    """The alignment by one of `METHODS`, or by a number: the light's time zero in seconds of the camera's clock.

    Args:
        recording: events, and triggers for "trigger".
        light: full-field or of each pixel's own.
        how: "trigger": the first rising edge is the light's time zero where that lies within it, as an oscilloscope's
            does, else its first sample; "trigger@zero" and "trigger@start" state which.  "trigger:N" of input N.  Where
            more edges follow, a second one at the light's last sample gives the clocks' rate.
            "first-event": the first event is the light's first change.  "auto": by the events themselves.
            Seconds: "12.345" with a standard deviation of 1 ms, or "12.345±0.002" (also "+-").
        one_clock: the light and the camera are on one clock.

    Returns:
        The alignment; `aligned` applies it.

    Raises:
        InputError: for an unknown method, no triggers, no events, and events that do not identify it: no correlation
            with the light, or two offsets as good as each other.
    """
    alignment = _find(recording, light, how)
    if one_clock and alignment.prior is not None:
        prior = replace(alignment.prior, rate_mean=0.0, rate_sd=ONE_CLOCK)
        later, half = alignment.rate_error * prior.at_s, Z95 * ONE_CLOCK
        interval = alignment.offset_interval_95
        alignment = replace(
            alignment, prior=prior, offset_s=alignment.offset_s + later, rate_error=0.0, rate_interval_95=(-half, half),
            offset_interval_95=None if interval is None else (interval[0] + later, interval[1] + later),
        )  # fmt: skip
    return replace(alignment, start_s=alignment.offset_s + (1.0 + alignment.rate_error) * light.start_s)


def _find(recording: Recording, light: Light, how: str) -> Alignment:
    if _is_trigger(how):
        return _trigger_alignment(recording, light, how)
    if how not in METHODS:
        return _given(how, light)
    if len(recording.events) == 0:
        raise InputError(f"{recording.name}: --align {how}: the file holds no events")
    if how == "first-event":
        return Alignment(float(recording.events.t[0] * 1e-9 - _first_change_s(light)), "first-event")
    return alignment_from_events(recording, light)


def _is_trigger(how: str) -> bool:
    method, _, first = how.partition("@")
    return method.partition(":")[0] == "trigger" and first in ("", "zero", "start")


def _given(how: str, light: Light) -> Alignment:
    """Seconds, perhaps with their standard deviation."""
    value, _, error = how.replace("+-", "±").partition("±")
    try:
        seconds, sd = float(value), float(error) if error.strip() else GIVEN_SD_S
    except ValueError:
        seconds, sd = np.nan, np.nan
    if not (np.isfinite(seconds) and np.isfinite(sd) and sd > 0.0):
        raise InputError(
            f"--align: expected {', '.join(METHODS)} or seconds, as 12.345 or 12.345±0.001, found {how!r}"
            f"{did_you_mean(how, METHODS)}"
        )
    return known_alignment(seconds, "given", 0.0, sd, light)


def known_alignment(
    offset_s: float,
    method: str,
    at_s: float,
    delay_sd_s: float,
    light: Light,
    rate: float = 0.0,
    rate_sd: float = CRYSTAL,
) -> Alignment:
    """An alignment that is known as well as stated; its prior knows the clocks' rate as well as crystals keep it.

    Args:
        offset_s: at the light's time zero.
        method: of `Alignment`.
        at_s: the light's moment at which the delay is known to `delay_sd_s`.
        light: that is aligned.
        rate, rate_sd: of the clock rate error.
    """
    half, start_half = (Z95 * float(np.hypot(delay_sd_s, (moment - at_s) * rate_sd)) for moment in (0.0, light.start_s))
    prior = ClockPrior(at_s, light.duration_s, delay_sd_s, 0.0, CRYSTAL)
    rates = rate - Z95 * rate_sd, rate + Z95 * rate_sd
    interval, start_s = (offset_s - half, offset_s + half), offset_s + (1.0 + rate) * light.start_s
    return Alignment(offset_s, method, interval, rate, rates, prior, start_s, start_half)


def aligned(recording: Either, light: Light, alignment: Alignment) -> Either:
    """The recording with time zero at the light's first sample, the light on the camera's clock with it.

    Events move by whole nanoseconds, so that their ticks stay; what lies outside the light is left out, and counted in
    a reading before.  Raises InputError when nothing lies inside.
    """
    long = as_long(recording)
    zero_ns, first, last = _span_ns(long.head, light, alignment)
    inside, totals = 0, Totals()
    for part in long.read():
        t = part.events.t
        begin, end = np.searchsorted(t, first), np.searchsorted(t, last, side="right")
        inside += int(end - begin)
        totals.add(part)
    if totals.events and not inside:
        spans = (first, last), (totals.ends[0], totals.ends[-1])
        light_s, events_s = (f"{begin * 1e-9:.10g}..{end * 1e-9:.10g} s" for begin, end in spans)
        raise InputError(
            f"{long.name}: no event lies within the light, at {light_s} of the camera's clock; events are at "
            f"{events_s} (--align)"
        )

    def moved(events: Events, since: int) -> Events:
        kept = events.select(np.s_[np.searchsorted(events.t, since) : np.searchsorted(events.t, last, side="right")])
        return replace(kept, t=kept.t - zero_ns)

    head = _with_light(long.head, light, alignment, totals.events - inside)
    if head.exposures is not None:
        head = replace(head, exposures=moved(head.exposures, zero_ns))

    def parts() -> Iterator[Recording]:
        for part in long.read():
            edges = None if part.triggers is None else part.triggers.shifted(-zero_ns)
            yield replace(head, events=moved(part.events, first), triggers=edges)

    return like(recording, LongRecording(head, parts))


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


def _with_light(recording: Recording, light: Light, alignment: Alignment, outside: int) -> Recording:
    """The recording with the light on its new clock, and with how that was found."""
    zero_ns, _, _ = _span_ns(recording, light, alignment)
    rate, offset_s = 1.0 + alignment.rate_error, alignment.offset_s - zero_ns * 1e-9
    written = {**alignment.as_dict(), "zero_ns": zero_ns, "events_outside": outside}
    if alignment.prior is not None:
        at_s = offset_s + rate * alignment.prior.at_s
        written["prior"] = asdict(replace(alignment.prior, at_s=at_s, span_s=rate * alignment.prior.span_s))
    attributes = {**recording.attributes, "alignment": written}
    if ATTRIBUTE in attributes:
        attributes[ATTRIBUTE] = asdict(kept_of(recording).shifted(zero_ns * 1e-9))
    return replace(recording, stimulus=light.shifted(offset_s, rate), attributes=attributes)


def trigger_edges(recording: Recording, light: Light, how: str = "trigger") -> tuple[np.ndarray, np.ndarray, float]:
    """(camera's times of one or two edges, the light's moments they mark, standard deviation of a stamp), in seconds.

    An edge is known to its stamp: uniform over a tick.  Of several edges that may be the light's last sample nobody
    knows which, so none is.

    Args:
        how: "trigger" as of `find_alignment`.

    Raises:
        InputError: no edges, several inputs and none stated.
    """
    method, _, first = how.partition("@")
    if recording.triggers is None or not len(recording.triggers):
        raise InputError(f"{recording.name}: --align trigger: the file holds no trigger edges")
    edges = _edges_s(recording, recording.triggers, method.partition(":")[2])
    begin = light.start_s
    if first == "zero" or (first == "" and light.start_s < 0.0 <= light.end_s):
        begin = 0.0
    duration = light.end_s - begin
    edge_s = 1e-6  # cameras stamp trigger edges in microseconds, whatever unit a file has them in
    stamp = max(edge_s, recording.events.tick_ns * 1e-9) / float(np.sqrt(12.0))
    near = edges[np.abs(edges - edges[0] - duration) <= RATE_BOUND * duration]
    if len(near) > 1 and isinstance(light, Stimulus) and len(edges) == len(light.t):  # an edge per sample
        near = near[near == edges[-1]]
    if len(near) == 1 and near[0] > edges[0]:
        return np.array([edges[0], near[0]]), np.array([begin, light.end_s]), stamp
    return edges[:1], np.array([begin]), stamp


def _trigger_alignment(recording: Recording, light: Light, how: str) -> Alignment:
    edges, moments, stamp = trigger_edges(recording, light, how)
    begin, rate, rate_sd = float(moments[0]), 0.0, CRYSTAL
    if len(edges) == 2:
        between = float(np.diff(moments)[0])
        rate, rate_sd = float(np.diff(edges)[0]) / between - 1.0, float(np.sqrt(2.0)) * stamp / between
    assert recording.triggers is not None
    note = "" if recording.triggers.rises_at(edges[0]) else "no edge rises; falling ones are taken"
    offset = float(edges[0]) - (1.0 + rate) * begin
    return replace(known_alignment(offset, "trigger", begin, stamp, light, rate, rate_sd), note=note)


def _edges_s(recording: Recording, triggers: Triggers, channel: str) -> np.ndarray:
    """Seconds of the edges at one input: the one asked for ("" where there is only one)."""
    inputs = sorted({*triggers.channel.tolist()})
    wanted = [number for number in inputs if channel in ("", str(number))]
    if len(wanted) != 1:
        present = ", ".join(map(str, inputs))
        asked = f"expected one of them, found {channel!r}" if channel else f"say which, --align trigger:{inputs[0]}"
        raise InputError(f"{recording.name}: --align trigger: edges at the inputs {present}; {asked}")
    return triggers.edges_s(wanted[0])


def _first_change_s(light: Light) -> float:
    """Where the light first leaves its first value, in any pixel: the last sample that still has it."""
    grouped = pixel_lights(light)
    if grouped is not None:
        changing = [one for one in grouped.lights if (one.radiance != one.radiance[0]).any()]
        return min(map(_first_change_s, changing), default=light.start_s)
    assert isinstance(light, Stimulus)
    moved = np.flatnonzero(light.radiance != light.radiance[0])
    return float(light.t[max(int(moved[0]) - 1, 0)]) if len(moved) else light.start_s
