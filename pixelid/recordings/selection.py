"""Recordings cut down to some of their pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pixelid.recordings.recording import Recording


def only(recordings: Sequence[Recording], pixels: np.ndarray) -> list[Recording]:
    """The recordings with the events of these flat pixel indices only."""
    return [replace(r, events=r.events.select(np.isin(r.events.pixel, pixels))) for r in recordings]


def few(recordings: Sequence[Recording], events: int, rng: np.random.Generator) -> list[Recording]:
    """The recordings with as many pixels, at least two, as hold about so many events; chosen at random."""
    pixels = np.unique(np.concatenate([np.unique(r.events.pixel) for r in recordings]))
    if sum(len(r.events) for r in recordings) <= events or len(pixels) <= 2:
        return list(recordings)
    counts = np.zeros(len(pixels))
    for r in recordings:
        counts += np.bincount(np.searchsorted(pixels, r.events.pixel), minlength=len(pixels))
    order = rng.permutation(len(pixels))
    enough = max(int(np.searchsorted(np.cumsum(counts[order]), events)) + 1, 2)
    return only(recordings, pixels[order[:enough]])
