"""How exact the statements about a recording's light are: what a laboratory's trace leaves open.

A simulated recording's light is exact.  One that was measured, and brought onto the camera's clock by `pixelid check`
or `calibrate`, says so in its attribute `bench`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace

import numpy as np

from pixelid.documents import interpreting, is_number
from pixelid.errors import InputError
from pixelid.recordings.recording import Recording

ATTRIBUTE = "bench"
FIELD = "pixel_gain"  # attribute: how the field differs from pixel to pixel
LEVEL_SD = 0.03  # of ln light: filters, distances and meters keep their level to about 3 %


@dataclass(frozen=True)
class Bench:
    """Standard deviations of what is stated about a recording's light; 0 where it is exact.

    level_sd: of the logarithm of its level;  offset_sd: of its zero, in the light's unit
    """

    level_sd: float = 0.0
    offset_sd: float = 0.0


def bench_of(recording: Recording) -> Bench:
    """How exact a recording's light is.

    Raises:
        InputError: Impossible numbers in its attribute.
    """
    stated = recording.attributes.get(ATTRIBUTE)
    if not isinstance(stated, Mapping):
        return Bench()
    where = f"{recording.source or recording.name}: {ATTRIBUTE}"
    numbers = {}
    for name in ("level_sd", "offset_sd"):
        value = stated.get(name, 0.0)
        if not is_number(value) or not 0.0 <= value < np.inf:
            raise InputError(f"{where}.{name}: expected a number of at least 0, found {str(value)[:40]!r}")
        numbers[name] = float(value)
    return Bench(**numbers)


def pixel_gains(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """(k,) flat indices of pixels, and (k,) the logarithm of what each sees over what the light says; none: empty.

    Raises:
        InputError: No lists of as many numbers in its attribute.
    """
    stated = recording.attributes.get(FIELD)
    if not isinstance(stated, Mapping):
        return np.empty(0, np.int64), np.empty(0)
    with interpreting(f"{recording.source or recording.name}: {FIELD}", "lists pixel and ln_gain of as many numbers"):
        pixels, gains = np.asarray(stated["pixel"], np.int64), np.asarray(stated["ln_gain"], float)
        if pixels.ndim != 1 or pixels.shape != gains.shape or not np.isfinite(gains).all():
            raise ValueError(f"shapes {pixels.shape} and {gains.shape}")
    return pixels, gains


def with_pixel_gains(recording: Recording, pixels: np.ndarray, gains: np.ndarray) -> Recording:
    """The recording whose pixels see so much more or less than its light says; (k,) indices and logarithms."""
    stated = {"pixel": [int(k) for k in pixels], "ln_gain": [float(g) for g in gains]}
    return replace(recording, attributes={**recording.attributes, FIELD: stated})


def without_pixel_gains(recording: Recording) -> Recording:
    """The recording as if its field were even."""
    return replace(recording, attributes={k: v for k, v in recording.attributes.items() if k != FIELD})


def gains_of_pixels(recording: Recording, pixels: np.ndarray) -> np.ndarray:
    """(n,) the logarithm of the gain of each flat pixel index (n,); 0 where none is known."""
    known, gains = pixel_gains(recording)
    if not len(known):
        return np.zeros(len(pixels))
    order = np.argsort(known)
    place = np.clip(np.searchsorted(known[order], pixels), 0, len(known) - 1)
    return np.where(known[order][place] == pixels, gains[order][place], 0.0)


def on_bench(recording: Recording, bench: Bench) -> Recording:
    """The recording, which says how exact its light is."""
    return replace(recording, attributes={**recording.attributes, ATTRIBUTE: asdict(bench)})
