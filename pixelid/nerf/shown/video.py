"""Frames as an H.264 video that browsers and slides play."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np

SMALLEST = 256  # pixels a side, below which frames are shown enlarged by a whole factor


def can_write() -> bool:
    """Whether PyAV is installed."""
    from importlib.util import find_spec

    return find_spec("av") is not None


def write_video(path: Path, frames: Sequence[np.ndarray], rate: int) -> None:
    """Write an mp4.

    Args:
        path: of the file.
        frames: (H, W, 3) 8-bit each.
        rate: frames per second.
    """
    import av  # type: ignore[import-not-found]

    factor = max(1, -(-SMALLEST // min(frames[0].shape[:2])))
    height, width = (2 * (side * factor // 2) for side in frames[0].shape[:2])  # the codec halves the colours' sides
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=Fraction(rate), options={"crf": "18"})
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        for frame in frames:
            large = np.repeat(np.repeat(frame, factor, axis=0), factor, axis=1)[:height, :width]
            for packet in stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(large), format="rgb24")):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)
