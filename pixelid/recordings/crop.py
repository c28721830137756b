"""Recordings cut to a part of the sensor, of the time, or of the pixels."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pixelid.errors import InputError
from pixelid.recordings.recording import Recording
from pixelid.stimuli.pixel_lights import pixel_lights


def crop(
    recording: Recording,
    *,
    roi: tuple[int, int, int, int] | None = None,
    time_s: tuple[float, float] | None = None,
    pixels: int | None = None,
    without: np.ndarray | None = None,
    seed: int = 0,
) -> Recording:
    """The events inside a region, a span of time, and as many pixels as asked.

    Args:
        roi: (x0, y0, x1, y1), columns x0 ≤ x < x1 and rows y0 ≤ y < y1; addresses stay as they are.
        time_s: (from, to), seconds on the recording's clock; the light before `from` stays, the pixel remembers it.
        pixels: how many of the pixels that have events, chosen at random by `seed`.
        without: flat pixel indices to leave out, hot ones say.

    Returns:
        The recording with fewer events, everything else as before; of light of each pixel's own that of the pixels
        left, in groups that share one.

    Raises:
        InputError: for a region outside the sensor, an empty span, and when no event is left of some.
    """
    events = recording.events
    keep = np.ones(len(events), bool)
    if roi is not None:
        x0, y0, x1, y1 = roi
        if not (0 <= x0 < x1 <= events.width and 0 <= y0 < y1 <= events.height):
            size = f"{events.width} x {events.height}"
            raise InputError(
                f"--roi: expected x0,y0,x1,y1 within the sensor of {size} pixels, found {x0},{y0},{x1},{y1}"
            )
        keep &= (events.x >= x0) & (events.x < x1) & (events.y >= y0) & (events.y < y1)
    stimulus = recording.stimulus
    if time_s is not None:
        begin, end = time_s
        if not begin < end or not max(abs(begin), abs(end)) < 9.2e9:  # seconds that fit 64 bits in ns
            raise InputError(f"--time: expected from:to in seconds with from < to, found {begin:g}:{end:g}")
        keep &= (events.t >= round(begin * 1e9)) & (events.t < round(end * 1e9))
        if stimulus is not None:
            stimulus = stimulus.until(end)
    if without is not None and len(without):
        keep &= ~np.isin(events.pixel, without)
    if pixels is not None:
        if pixels < 1:
            raise InputError(f"--pixels: expected a positive number, found {pixels}")
        present = np.unique(events.pixel[keep])
        chosen = np.random.default_rng(seed).permutation(present)[:pixels]
        keep &= np.isin(events.pixel, chosen)
    if len(events) and not keep.any():
        raise InputError(f"{recording.name}: no event is left of {len(events)} (--roi, --time, --pixels)")
    events = events.select(keep)
    if stimulus is not None and (roi or pixels) and stimulus.size == (events.width, events.height):
        grouped = pixel_lights(stimulus, events.pixel)
        stimulus = stimulus if grouped is None else grouped.restricted(np.unique(events.pixel))
    return replace(recording, events=events, stimulus=stimulus)


@dataclass(frozen=True)
class Crop:
    """A cut that several recordings get, as the options --roi, --time, --pixels and --without-hot-pixels say it."""

    roi: tuple[int, int, int, int] | None = None
    time_s: tuple[float, float] | None = None
    pixels: int | None = None
    without_hot_pixels: bool = False

    def applied(self, recording: Recording, seed: int = 0) -> Recording:
        """The part of the recording that is asked for; `seed` chooses the pixels.

        Raises:
            InputError: as `crop`.
        """
        if self == Crop():
            return recording
        hot = None
        if self.without_hot_pixels:
            from pixelid.inspection.hot_pixels import find_hot_pixels

            hot = np.array([p.y * recording.events.width + p.x for p in find_hot_pixels(recording.events)], np.int64)
        return crop(recording, roi=self.roi, time_s=self.time_s, pixels=self.pixels, without=hot, seed=seed)
