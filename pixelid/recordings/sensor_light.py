"""The light as the sensor itself measured it: exposure measurements of an ATIS, as light of each pixel's own.

An ATIS pixel measures, after each of its changes, the time T that its photocurrent takes to move a fixed charge Q
(Posch, Matolin & Wohlgenannt, JSSC 2011).  The mean photocurrent over that window is Q/T: one sample of the light, in
units of Q per second, put at the window's middle.  Between samples log radiance is taken as a straight line, before the
first and after the last it is held.  A measurement that the next one breaks off has no end, and is left out.

What that cannot say: the light between two samples.  It changed by about one threshold there, at a moment that only the
event shows.  A likelihood integrates that out (`likelihood/light_between_samples.py`); fast poles and the dead time are
not to be read from such a fit (`CAVEAT`).

Files differ in which polarity is ON.  Here the measurements show: light rises between the measurements before and after
an ON event.  Where it falls for most, polarities are exchanged, and the recording says so (`EXCHANGED`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pixelid.errors import InputError
from pixelid.recordings.events import Events
from pixelid.recordings.recording import Recording
from pixelid.stimuli.pixel_lights import UNKNOWN, PixelLights
from pixelid.stimuli.stimulus import Stimulus

ATTRIBUTE, MEASURED, FRAMES = "light", "exposure measurements", "frames"
# Changes of light with the sign of the events between: 98 % in a public recording, once its polarities are right.
# Below a third of at least 100 they are exchanged: of files without any relation, 1 in 2000 has so few.
MAX_SHARE_AGREEING, MIN_TELLING = 1 / 3, 100
EXCHANGED = "ON and OFF exchanged: the light measured after most ON events is less than before them"
CAVEAT = (
    "the light is the sensor's own, a sample per exposure: its course between two samples is integrated out as a "
    "random path, threshold noise holds that of the exposures, and the intervals of thresholds and delay hold what the "
    "level differs by between short and long intervals; each pixel's unknown gain of the light shifts nothing"
)
DARK = (
    "the frames' grey level without light is not fitted: what it is off by scales thresholds, in dim pixels more than "
    "in bright ones"
)


def with_measured_light(recording: Recording) -> Recording:
    """The recording with its own exposure measurements as light, without the pixels that have fewer than two.

    Raises:
        InputError: the file holds no exposure measurements, or too few of them.
    """
    if recording.exposures is None or len(recording.exposures) == 0:
        raise InputError(
            f"{recording.name}: --stimulus sensor: expected exposure measurements (of an ATIS) in the file, found none"
        )
    pixel, middle_s, radiance = measurements(recording.exposures)
    events = recording.events
    agree, telling = _signs(events, pixel, middle_s, radiance)
    exchanged = telling >= MIN_TELLING and agree < MAX_SHARE_AGREEING * telling
    if exchanged:
        events = replace(events, p=1 - events.p)
    last_ns = max(int(t[-1]) for t in (events.t, recording.exposures.t) if len(t))
    span = 0.0, last_ns * 1e-9
    edges = np.flatnonzero(np.diff(pixel)) + 1
    of_pixel = np.full(events.width * events.height, UNKNOWN, np.int32)
    lights: list[Stimulus] = []
    min_measurements = 2  # of a pixel: one tells no change
    for part in np.split(np.arange(len(pixel)), edges):
        t, light = middle_s[part], radiance[part]
        inside = (np.diff(t, prepend=span[0]) > 0) & (t < span[1])
        t, light = t[inside], light[inside]
        if len(t) < min_measurements:
            continue
        of_pixel[pixel[part[0]]] = len(lights)
        t, light = np.concatenate([span[:1], t, span[1:]]), np.concatenate([light[:1], light, light[-1:]])
        lights.append(Stimulus(t, light))
    if not lights:
        raise InputError(f"{recording.name}: --stimulus sensor: no pixel has {min_measurements} exposure measurements")
    grouped = PixelLights.of_groups(lights, of_pixel.reshape(events.height, events.width))
    kept = events.select(of_pixel[events.pixel] != UNKNOWN)
    attributes = {**recording.attributes, ATTRIBUTE: MEASURED, **({"polarity": EXCHANGED} if exchanged else {})}
    return replace(recording, events=kept, stimulus=grouped, attributes=attributes)


def _signs(events: Events, pixel: np.ndarray, middle_s: np.ndarray, radiance: np.ndarray) -> tuple[int, int]:
    """(changes of light with the sign of their events, all that show): between two measurements of a pixel.

    Only events of one polarity between them show.  Arguments as `measurements` returns them.
    """
    order = np.lexsort((events.t, events.pixel))
    span = 1.0 + max(float(events.t.max(initial=0)) * 1e-9, float(middle_s.max(initial=0.0)))
    place = np.searchsorted(events.pixel[order] * span + events.t[order] * 1e-9, pixel * span + middle_s)
    on = np.concatenate([[0], np.cumsum(events.p[order] == 1)])[place]
    rises, every = np.diff(on), np.diff(place)
    telling = (pixel[1:] == pixel[:-1]) & (every > 0) & ((rises == 0) | (rises == every))
    brighter = np.diff(radiance) > 0
    return int((brighter == (rises > 0))[telling].sum()), int(telling.sum())


def measurements(exposures: Events) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(pixel, time s, light 1/s) (m,) of every finished measurement, by pixel and time; the shortest are left out.

    Args:
        exposures: Begin (p = 0) and end (p = 1) of each.
    """
    order = np.lexsort((exposures.p, exposures.t, exposures.pixel))
    pixel, t, p = exposures.pixel[order].astype(np.int64), exposures.t[order], exposures.p[order]
    begins = np.flatnonzero((p[:-1] == 0) & (p[1:] == 1) & (pixel[1:] == pixel[:-1]) & (t[1:] > t[:-1]))
    min_ticks = 10  # of an exposure: a shorter one is rounded by more than 3 % (1/√12 tick)
    begins = begins[t[begins + 1] - t[begins] >= min_ticks * exposures.tick_ns]
    begin, end = t[begins], t[begins + 1]
    return pixel[begins], 0.5e-9 * (begin + end), 1e9 / (end - begin)


def is_measured(recording: Recording) -> bool:
    """Whether the sensor measured the light itself, at samples between which its course is not known."""
    return recording.attributes.get(ATTRIBUTE) in (MEASURED, FRAMES)


def light_caveats(recordings: Sequence[Recording]) -> list[str]:
    """What to say of fits to light that the sensor measured itself."""
    said = [CAVEAT] if any(map(is_measured, recordings)) else []
    return [*said, DARK] if any(r.attributes.get(ATTRIBUTE) == FRAMES for r in recordings) else said
