"""Temporary names for `inspection.hot_pixels`, until the gap calls it by its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pixelid.inspection.hot_pixels import find_hot_pixels_in_silence
from pixelid.inspection.timestamps import TimestampSignature
from pixelid.recordings.recording import Recording


@dataclass(frozen=True)
class Hot:
    """pixels: (k,) flat indices of the hot ones;  print: what the result says of them"""

    pixels: np.ndarray
    print: TimestampSignature


def hot_pixels(recordings: Sequence[Recording]) -> Hot | None:
    """`find_hot_pixels_in_silence` under its former name."""
    hot = find_hot_pixels_in_silence(recordings)
    return None if hot is None else Hot(hot.pixels, hot.signature)
