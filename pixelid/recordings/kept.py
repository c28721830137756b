"""What a cut has kept of a recording: the pixels and the seconds in which silence means that nothing fired.

A recording that was cut keeps the size of its sensor and the light from before the cut; what lies outside was not seen.
`crop` notes it in `Recording.attributes["crop"]`; a recording without the note counts whole.
"""

from __future__ import annotations

from dataclasses import dataclass

from pixelid.documents import interpreting
from pixelid.errors import InputError
from pixelid.recordings.recording import Recording

ATTRIBUTE = "crop"


@dataclass(frozen=True)
class Kept:
    """The part of a recording that is left; as a dictionary, the attribute (docs/formats.md).

    Attributes:
        roi: (x0, y0, x1, y1), columns x0 ≤ x < x1 and rows y0 ≤ y < y1.
        hot_pixels: left out of it.
        pixels: left of it, where they were chosen; None: all but the hot ones.
        time_s: (from, to), seconds on the recording's clock; None: all of it.
    """

    roi: tuple[int, int, int, int]
    hot_pixels: int = 0
    pixels: int | None = None
    time_s: tuple[float, float] | None = None

    @property
    def count(self) -> int:
        """How many pixels are left."""
        if self.pixels is not None:
            return self.pixels
        return max(_area(self.roi) - self.hot_pixels, 0)

    def cut(self, roi: tuple[int, int, int, int] | None, time_s: tuple[float, float] | None, hot_pixels: int) -> Kept:
        """What another cut leaves of this one: where both are, without so many more hot pixels.

        Of the hot pixels left out before, a smaller region has its share: which they were is not noted.
        """
        now, span, before = self.roi, self.time_s, self.hot_pixels
        if roi is not None:
            (a, b, c, d), (x0, y0, x1, y1) = self.roi, roi
            now = max(a, x0), max(b, y0), min(c, x1), min(d, y1)
            before = round(before * _area(now) / max(_area(self.roi), 1))
        if time_s is not None:
            span = time_s if span is None else (max(span[0], time_s[0]), min(span[1], time_s[1]))
        return Kept(now, before + hot_pixels, self.pixels, span)

    def shifted(self, seconds: float) -> Kept:
        """The same on a clock whose time zero lies so many seconds later."""
        span = None if self.time_s is None else (self.time_s[0] - seconds, self.time_s[1] - seconds)
        return Kept(self.roi, self.hot_pixels, self.pixels, span)


def kept_of(recording: Recording) -> Kept:
    """What a recording's attribute says; all of the sensor and of the time where it has none.

    Raises:
        InputError: a damaged attribute.
    """
    whole = (0, 0, recording.events.width, recording.events.height)
    told = recording.attributes.get(ATTRIBUTE)
    if told is None:
        return Kept(whole)
    where = f"{recording.source or recording.name}: attribute {ATTRIBUTE}"
    with interpreting(where, "a region, pixels and a span of time"):
        x0, y0, x1, y1 = (int(edge) for edge in told["roi"])
        hot = int(told["hot_pixels"])
        chosen = None if told["pixels"] is None else int(told["pixels"])
        begin, end = (None, None) if told["time_s"] is None else map(float, told["time_s"])
    if not (0 <= x0 < x1 <= whole[2] and 0 <= y0 < y1 <= whole[3]):
        raise InputError(
            f"{where}: roi: expected a region of {whole[2]} x {whole[3]} pixels, found {x0},{y0},{x1},{y1}"
        )
    if hot < 0 or not 0 <= (0 if chosen is None else chosen) <= _area((x0, y0, x1, y1)):
        raise InputError(
            f"{where}: pixels: expected a number of those of the region, found {chosen}, {hot} of them hot"
        )
    if begin is None or end is None:
        return Kept((x0, y0, x1, y1), hot, chosen)
    if not begin < end:
        raise InputError(f"{where}: time_s: expected from < to, found {begin:g}, {end:g}")
    return Kept((x0, y0, x1, y1), hot, chosen, (begin, end))


def seconds_looked_at(recording: Recording) -> tuple[float, float]:
    """(begin, end) on the recording's clock: from the light's or the events' first to their last, within a cut.

    Raises:
        InputError: a damaged attribute.
    """
    t, light, span = recording.events.t, recording.stimulus, kept_of(recording).time_s
    edges = [float(edge) * 1e-9 for edge in (*t[:1], *t[-1:])]
    edges += [] if light is None else [light.start_s, light.end_s]
    begin, end = min(edges, default=0.0), max(edges, default=0.0)
    return (begin, end) if span is None else (max(begin, span[0]), min(end, span[1]))


def _area(roi: tuple[int, int, int, int]) -> int:
    return max(roi[2] - roi[0], 0) * max(roi[3] - roi[1], 0)
