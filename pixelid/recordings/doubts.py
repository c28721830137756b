"""What speaks against a recording before a fit: one polarity or one time only, ON where light falls, another unit.

Each is one line that names it; none stops a command.
"""

from __future__ import annotations

import numpy as np

from pixelid.recordings.events import Events
from pixelid.recordings.recording import Recording
from pixelid.stimuli.stimulus import Stimulus

MIN_EVENTS = 20  # of one polarity, by chance 2 in 10⁶
# As of an ATIS' own measurements (`sensor_light`): of events without any relation to the light, 1 in 2000 recordings
# has so few of 100 that agree.
MIN_TELLING, MAX_SHARE_AGREEING = 100, 1 / 3
SETTLED_S = 5e-3  # light that has run one way for so long is what a pixel sees, whatever its bandwidth above 30 Hz
STEPS, MOST_LOOKED_AT = 5, 100_000
LEAST_COVERED = 0.01  # of a light that changes, by the events
# Events per time and per pixel, of times so far apart: no readout waits as long while all pixels fire.
MANY_PER_TIME, COARSE_NS = 20, 900_000
MAX_OUTSIDE = 0.01  # of events, that a latency carries past the light's end


def polarity_doubt(events: int, on: float | None) -> str:
    """Of the share of ON events; empty where there is none."""
    if on is None or events < MIN_EVENTS or 0.0 < on < 1.0:
        return ""
    kind, other = ("ON", "OFF") if on == 1.0 else ("OFF", "ON")
    return f"only {kind} events: nothing is known of the {other} threshold; is the polarity column right?"


def doubts_of_events(events: Events) -> list[str]:
    """What speaks against events by themselves."""
    share = float(events.p.mean()) if len(events) else None
    found = [polarity_doubt(len(events), share), _times_doubt(events)]
    return [line for line in found if line]


def doubts(recording: Recording) -> list[str]:
    """What speaks against the events of a recording, and against its light's being theirs."""
    events, light = recording.events, recording.stimulus
    found = doubts_of_events(events)
    if isinstance(light, Stimulus) and light.full_field and len(events) >= MIN_TELLING:
        found += [_inverted(recording, light), _too_short(recording, light), _not_under(recording, light)]
    return [line for line in found if line]


def _times_doubt(events: Events) -> str:
    """Of events that share few times, which show nothing of a pixel's answer."""
    if len(events) < MIN_EVENTS:
        return ""
    if events.t[0] == events.t[-1]:
        return f"all events have one time, {int(events.t[0])} ns: is the column of the times right?"
    steps = np.diff(events.t)
    steps = steps[steps > 0]
    times, pixels = 1 + len(steps), len(np.unique(events.pixel))
    if steps.min() < COARSE_NS or max(times, pixels) * MANY_PER_TIME > len(events):
        return ""
    return f"{len(events)} events of {pixels} pixels at {times} times only: are the times cut to whole ms or s?"


def _inverted(recording: Recording, light: Stimulus) -> str:
    """ON events where the light has fallen for a while, OFF events where it has risen."""
    some = slice(None, None, 1 + len(recording.events) // MOST_LOOKED_AT)
    t, on = recording.events.t[some] * 1e-9, recording.events.p[some] == 1
    past = t[:, None] - np.linspace(SETTLED_S, 0.0, STEPS + 1)
    radiance = np.interp(past, light.t, light.radiance)
    steps = np.diff(radiance, axis=1)
    rising, falling = (steps > 0).all(axis=1), (steps < 0).all(axis=1)
    telling = rising | falling
    count = int(np.count_nonzero(telling))
    agree = int(np.count_nonzero((on == rising) & telling))
    if count < MIN_TELLING or agree >= MAX_SHARE_AGREEING * count:
        return ""
    return (
        f"ON events where the light falls: {count - agree} of {count} events disagree with it; --polarity swapped, or "
        "another light?"
    )


def _not_under(recording: Recording, light: Stimulus) -> str:
    """Events outside the light's time."""
    t = recording.events.t
    first, last = np.searchsorted(t, [light.start_s * 1e9, light.end_s * 1e9])
    outside = int(first) + (len(t) - int(last) if light.interpolation != "previous" else 0)
    if outside <= MAX_OUTSIDE * len(t):
        return ""
    return f"{outside} of {len(t)} events lie outside the light: is its time zero theirs (convert --align)?"


def _too_short(recording: Recording, light: Stimulus) -> str:
    """Events in a sliver of a light that changes all along."""
    span, whole = recording.events.duration_s, light.end_s - light.start_s
    if not 0 < span < LEAST_COVERED * whole or np.ptp(light.radiance) == 0:
        return ""
    return f"events cover {100 * span / whole:.2g} % of the light: is the unit of their times right (--time-unit)?"
