"""Frames of a DAVIS in AEDAT4 files, as light of each pixel's own.

The active pixels of a DAVIS integrate the same photodiode's current over a global exposure (Brandli et al., JSSC
2014), so a frame is linear in the light: grey level over exposure time, put at the middle of the exposure.  The gain of
a pixel is not known; it changes no difference of log radiance.  What a pixel shows in the dark is not known either, and
does change them: `dark`, the grey level of no light, is subtracted.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from pixelid.errors import InputError
from pixelid.recordings.recording import Recording
from pixelid.recordings.sensor_light import ATTRIBUTE, FRAMES
from pixelid.stimuli.pixel_lights import UNKNOWN, PixelLights
from pixelid.stimuli.stimulus import Stimulus

NOTHING = 0.5  # stands for grey level 0, since light is positive
FULL = {"L": 255, "L16": 65535}  # grey level that clips, by the format of the frames


def frames(path: Path) -> Iterator[dict[str, np.ndarray]]:
    """What the reading process does: `levels` (n, height, width), `exposures_us` (n, 2) begin and end, `full` (1,).

    Raises:
        InputError: the file cannot be decoded or has fewer than two grey frames with an exposure.
    """
    from faery.extension import aedat

    from pixelid.recordings.decoded import checked_packets

    def packets():
        with aedat.Decoder(path) as decoder:
            for _, packet in decoder:
                if hasattr(packet, "exposure_end_t"):
                    yield packet

    levels: list[np.ndarray] = []
    edges: list[tuple[int, int]] = []
    full = 255
    most_values = 250_000_000  # of all frames in memory, 1 GB
    for frame in checked_packets(packets, path):
        begin, end, pixels = int(frame.exposure_start_t), int(frame.exposure_end_t), frame.pixels
        if end <= begin or pixels.ndim != 2 or (edges and (begin <= edges[-1][0] or pixels.shape != levels[0].shape)):
            continue
        if (len(levels) + 1) * pixels.size > most_values:
            raise InputError(f"{path}: frames: more than fit {most_values:.0e} grey levels; record fewer")
        full = full if edges else FULL.get(str(frame.format), 255)
        levels.append(np.array(pixels))
        edges.append((begin, end))
    if len(levels) < 2:
        raise InputError(f"{path}: --stimulus frames: expected two grey frames or more, found {len(levels)}")
    yield {"levels": np.stack(levels), "exposures_us": np.array(edges), "full": np.array([full])}


def with_frames(recording: Recording, dark: float = 0.0) -> Recording:
    """The recording from its first frame to its last, with its frames as light; time zero is the first frame's middle.

    Pixels that clip in any frame, or are not above the grey level `dark` in all of them, are left out.

    Raises:
        InputError: a file that is not AEDAT4, has no frames, or no pixel whose light they show.
    """
    from pixelid.recordings.isolated import arrays_isolated

    path = recording.source
    if path is None or path.suffix.lower() != ".aedat4":
        raise InputError(f"{recording.name}: --stimulus frames: expected an AEDAT4 file with frames")
    (shown,) = arrays_isolated("frames", path, single=True)
    levels, edges, events = shown["levels"], shown["exposures_us"], recording.events
    if levels.shape[1:] != (events.height, events.width):
        raise InputError(f"{path}: frames: expected {events.width} x {events.height} pixels, as of the events")
    levels = np.maximum(levels.reshape(len(levels), -1), NOTHING).astype(np.float32)
    lowest, highest = levels.min(axis=0), levels.max(axis=0)
    least_above_dark = 1.0  # grey level above `dark` that tells a light: rounding is 0.3 of a level
    lit = np.flatnonzero((lowest - dark >= least_above_dark) & (highest < shown["full"]))
    if not len(lit):
        raise InputError(f"{path}: frames: every pixel clips or is as dark as {dark:g} in some frame")
    seconds = 1e-6 * (edges[:, 1] - edges[:, 0])
    lights = (levels[:, lit] - dark) / seconds[:, None]
    of_pixel = np.full(levels.shape[1], UNKNOWN, np.int32)
    of_pixel[lit] = np.arange(len(lit))
    middle, zero_ns = 0.5e-6 * (edges.sum(axis=1) - edges[0].sum()), 500 * int(edges[0].sum())
    since = events.t - zero_ns
    inside = (since >= 0) & (since <= middle[-1] * 1e9) & (of_pixel[events.pixel] != UNKNOWN)
    kept = events.select(inside)
    grouped = PixelLights.of_groups(
        [Stimulus(middle, np.ascontiguousarray(column, np.float64)) for column in lights.T],
        of_pixel.reshape(events.height, events.width),
    )
    attributes = {**recording.attributes, ATTRIBUTE: FRAMES, "dark_grey_level": dark, "zero_ns": zero_ns}
    return replace(
        recording, events=replace(kept, t=since[inside]), stimulus=grouped, triggers=None, attributes=attributes
    )
