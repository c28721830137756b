"""Frames as an H.264 video that browsers and slides play."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from itertools import chain
from pathlib import Path

import numpy as np

SMALLEST = 256  # pixels a side, below which frames are shown enlarged by a whole factor
LARGEST = 4096  # pixels a side that they are not enlarged beyond: the codec ends at four times that, players before


def can_write() -> bool:
    """Whether PyAV is installed."""
    from importlib.util import find_spec

    return find_spec("av") is not None


def write_video(path: Path, frames: Iterable[np.ndarray], rate: int) -> None:
    """Write an mp4.

    Args:
        path: of the file.
        frames: (H, W, 3) 8-bit each, at least one; they are taken one by one.
        rate: frames per second.
    """
    import av  # type: ignore[import-not-found]

    frames = iter(frames)
    first = next(frames)
    sides = first.shape[:2]
    factor = max(1, min(-(-SMALLEST // min(sides)), LARGEST // max(sides)))
    odd = [(0, side * factor % 2) for side in sides]  # the codec halves the colours' sides: the last row twice, then
    height, width = (side * factor + more for side, (_, more) in zip(sides, odd, strict=True))
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=Fraction(rate), options={"crf": "18"})
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        for frame in chain([first], frames):
            large = np.pad(np.repeat(np.repeat(frame, factor, axis=0), factor, axis=1), (*odd, (0, 0)), mode="edge")
            for packet in stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(large), format="rgb24")):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)
