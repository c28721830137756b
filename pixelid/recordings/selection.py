"""Recordings cut down to some of their pixels, and sensors of a number of pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import isqrt

import numpy as np

from pixelid.errors import InputError
from pixelid.recordings.recording import Recording
from pixelid.stimuli.stimulus import WITHOUT_SCALE

LONGEST_SIDE_PIXELS = 65536  # addresses are 16 bits wide


def nearly_square(pixels: int) -> tuple[int, int]:
    """(width, height) with width · height = pixels, as square as that allows.

    Raises InputError for less than one pixel and for a side beyond `LONGEST_SIDE_PIXELS`.

    >>> nearly_square(12)
    (4, 3)
    """
    if pixels < 1:
        raise InputError(f"--pixels: expected at least 1, found {pixels}")
    if pixels > LONGEST_SIDE_PIXELS**2:
        raise InputError(f"--pixels: expected at most {LONGEST_SIDE_PIXELS**2}, found {pixels}")
    height = next(side for side in range(isqrt(pixels), 0, -1) if pixels % side == 0)
    if pixels // height > LONGEST_SIDE_PIXELS:
        raise InputError(
            f"--pixels {pixels}: no sensor of that many pixels has sides up to {LONGEST_SIDE_PIXELS}; "
            "try a round number"
        )
    return pixels // height, height


def named_apart(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings with a number behind every name that an earlier one has: names distinguish them in results."""
    taken: set[str] = set()
    named = []
    for r in recordings:
        name, number = r.name, 1
        while name in taken:
            number += 1
            name = f"{r.name} ({number})"
        taken.add(name)
        named.append(r if name == r.name else replace(r, label=name))
    return named


def unit_of_light(recordings: Sequence[Recording]) -> str | None:
    """The unit of the recordings' light; None where it is known up to a factor only, or not at all.

    Raises:
        InputError: lights in more than one unit, whose radiances no circuit can share.
    """
    units = {r.stimulus.unit for r in recordings if r.stimulus is not None} - {*WITHOUT_SCALE}
    if len(units) > 1:
        raise InputError(f"expected recordings whose light is in one unit, found {', '.join(sorted(units))}")
    return next(iter(units), None)


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
