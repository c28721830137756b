"""Recordings cut to a part of the sensor, of the time, or of the pixels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace

import numpy as np

from pixelid.errors import InputError
from pixelid.recordings.columns import INT64_MAX
from pixelid.recordings.events import Events
from pixelid.recordings.kept import ATTRIBUTE, Kept, kept_of
from pixelid.recordings.parts import Either, LongRecording, Totals, as_long, like
from pixelid.recordings.recording import Recording
from pixelid.stimuli.pixel_lights import pixel_lights


def _nanoseconds(time_s: tuple[float, float] | None, since_ns: int) -> tuple[int, int] | None:
    """A span of seconds since `since_ns` on the recording's clock; None: all of it.

    Raises:
        InputError: an empty span, or one beyond 64 bits.
    """
    if time_s is None:
        return None
    begin, end = time_s
    if not begin < end or not max(abs(begin), abs(end)) < 9.2e9:  # seconds that fit 64 bits in ns
        raise InputError(f"--time: expected from:to in seconds with from < to, found {begin:g}:{end:g}")
    return since_ns + round(begin * 1e9), min(since_ns + round(end * 1e9), INT64_MAX)


def _inside(events: Events, roi, span: tuple[int, int] | None, without: np.ndarray | None) -> np.ndarray:
    """(n,) whether an event lies in the region and the span (ns), and not on one of the pixels `without`.

    Raises:
        InputError: a region outside the sensor.
    """
    keep = np.ones(len(events), bool)
    if roi is not None:
        x0, y0, x1, y1 = roi
        if not (0 <= x0 < x1 <= events.width and 0 <= y0 < y1 <= events.height):
            size = f"{events.width} x {events.height}"
            raise InputError(
                f"--roi: expected x0,y0,x1,y1 within the sensor of {size} pixels, found {x0},{y0},{x1},{y1}"
            )
        keep &= (events.x >= x0) & (events.x < x1) & (events.y >= y0) & (events.y < y1)
    if span is not None:
        keep &= (events.t >= span[0]) & (events.t < span[1])
    if without is not None and len(without):
        keep &= ~np.isin(events.pixel, without)
    return keep


def _kept(recording: Recording, roi, span: tuple[int, int] | None, without: np.ndarray) -> Kept:
    """What a cut leaves of the region and the time of a recording, which may have been cut before.

    Raises:
        InputError: nothing of the region or of the time.
    """
    before, events = kept_of(recording), recording.events
    hot = np.unique(without)
    x0, y0, x1, y1 = roi or before.roi
    x, y = hot % events.width, hot // events.width
    hot = hot[(x >= x0) & (x < x1) & (y >= y0) & (y < y1)]
    kept = before.cut(roi, None if span is None else (span[0] * 1e-9, span[1] * 1e-9), len(hot))
    if not (kept.roi[0] < kept.roi[2] and kept.roi[1] < kept.roi[3]):
        old = ",".join(map(str, before.roi))
        raise InputError(f"{recording.name}: --roi: expected part of {old}, which was kept before, found none of it")
    if kept.time_s is not None and not kept.time_s[0] < kept.time_s[1]:
        old = "{:g}:{:g}".format(*before.time_s) if before.time_s else ""
        raise InputError(f"{recording.name}: --time: expected part of {old}, which was kept before, found none of it")
    return kept


def _chosen(present: np.ndarray, pixels: int, seed: int, size: int) -> np.ndarray:
    """As many of the pixels that are `present` as asked, at random: the first in an order of all `size` of the sensor.

    So recordings of one camera keep the same pixels, but for those that some of them lack.
    """
    if pixels < 1:
        raise InputError(f"--pixels: expected a positive number, found {pixels}")
    place = np.random.default_rng(seed).permutation(size)[present]
    return present[np.argsort(place)[:pixels]]


def _nothing_left(name: str, totals: Totals) -> InputError:
    span = f"{totals.ends[0] * 1e-9:.3f} to {totals.ends[-1] * 1e-9:.3f} s on its clock"
    return InputError(
        f"{name}: no event is left of {totals.events}, from {span} (--roi, --time, --pixels); --time +0:+0.5 counts "
        "from the first event"
    )


@dataclass(frozen=True)
class Crop:
    """The events inside a region, a span of time, and as many pixels as asked; one cut for several recordings.

    Attributes:
        roi: (x0, y0, x1, y1), columns x0 ≤ x < x1 and rows y0 ≤ y < y1; addresses stay as they are.
        time_s: (from, to), seconds on the recording's clock; the light before `from` stays, the pixel remembers it.
        pixels: how many of the pixels that have events, chosen at random.
        without_hot_pixels: leave them out.
        from_first: count `time_s` from each recording's first event on.
    """

    roi: tuple[int, int, int, int] | None = None
    time_s: tuple[float, float] | None = None
    pixels: int | None = None
    without_hot_pixels: bool = False
    from_first: bool = False

    def with_(self, other: Crop) -> Crop:
        """This cut, with what another says in place of what this one says of the same."""
        span = (self.time_s, self.from_first) if other.time_s is None else (other.time_s, other.from_first)
        return Crop(
            other.roi or self.roi, span[0], other.pixels or self.pixels,
            self.without_hot_pixels or other.without_hot_pixels, span[1],
        )  # fmt: skip

    def applied(self, recording: Either, seed: int = 0) -> Either:
        """The part of a recording that is asked for; `seed` chooses the pixels.

        One that does not lie in memory is read as often as this takes, and again with what is returned.

        Returns:
            The recording with fewer events, and with a note of what was kept (`Kept`), everything else as before; of
            light of each pixel's own that of the pixels left, in groups that share one.

        Raises:
            InputError: for a region outside the sensor, an empty span, and when no event is left of some.
        """
        if self == Crop():
            return recording
        long = as_long(recording)
        hot = _hot_pixels(long) if self.without_hot_pixels else np.empty(0, np.int64)
        return like(recording, _cropped(long, self, hot, seed))


def _hot_pixels(long: LongRecording) -> np.ndarray:
    """(k,) flat indices."""
    from pixelid.inspection.hot_pixels import hot_of_counts

    width, height = long.head.events.width, long.head.events.height
    counts, totals = np.zeros(width * height, np.int64), Totals()
    for part in long.read():
        counts += np.bincount(part.events.pixel, minlength=len(counts))
        totals.add(part)
    hot = hot_of_counts(counts.reshape(height, width), totals.duration_s)
    return np.array([p.y * width + p.x for p in hot], np.int64)


def _cropped(long: LongRecording, crop: Crop, hot: np.ndarray, seed: int) -> LongRecording:
    """What a cut leaves, without the flat pixel indices `hot`; pixels are counted in a reading before."""
    head, since, roi = long.head, 0, crop.roi
    if crop.from_first:
        since = next((int(part.events.t[0]) for part in long.read() if len(part.events)), 0)
    span = _nanoseconds(crop.time_s, since)
    _inside(head.events, roi, span, None)  # refuses what cannot be
    size = head.events.width * head.events.height
    light, kept = head.stimulus, _kept(head, roi, span, hot)
    if light is not None and span is not None:  # what was before the span stays, the pixel remembers it
        light = light.until(span[1] * 1e-9)
    own = light is not None and light.size == (head.events.width, head.events.height)
    chosen: np.ndarray | None = None
    if crop.pixels is not None or (roi is not None and own):
        seen, totals = np.zeros(size, bool), Totals()
        for part in _before_end(long.read(), span):
            totals.add(part)
            seen[part.events.pixel[_inside(part.events, roi, span, hot)]] = True
        if totals.events and not seen.any():
            raise _nothing_left(long.name, totals)
        chosen = seen
        if crop.pixels is not None:
            chosen = np.zeros(size, bool)
            chosen[_chosen(np.flatnonzero(seen), crop.pixels, seed, size)] = True
            kept = replace(kept, pixels=int(chosen.sum()))
        left = np.flatnonzero(chosen)
        if light is not None and own and (grouped := pixel_lights(light, left)) is not None:
            light = grouped.restricted(left)
    if kept.pixels is not None and crop.pixels is None:  # of pixels that were chosen, all have events at some time
        fired = [np.unique(part.events.pixel[_inside(part.events, roi, None, hot)]) for part in long.read()]
        kept = replace(kept, pixels=len(np.unique(np.concatenate(fired))) if fired else 0)
    noted = {**head.attributes, ATTRIBUTE: asdict(kept)}

    def cropped() -> Iterator[Recording]:
        totals, left = Totals(), 0
        for part in _before_end(long.read(), span):
            keep = _inside(part.events, roi, span, hot)
            if chosen is not None:
                keep &= chosen[part.events.pixel]
            totals.add(part)
            left += int(np.count_nonzero(keep))
            yield replace(part, events=part.events.select(keep), stimulus=light, attributes=noted)
        if totals.events and not left:
            raise _nothing_left(long.name, totals)

    return LongRecording(replace(head, stimulus=light, attributes=noted), cropped)


def _before_end(parts: Iterator[Recording], span: tuple[int, int] | None) -> Iterator[Recording]:
    """The parts up to the end of the span (ns); those behind are not read."""
    for part in parts:
        yield part
        if span is not None and len(part.events) and part.events.t[-1] >= span[1]:
            return
