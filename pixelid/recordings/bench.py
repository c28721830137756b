"""How exact the statements about a recording's light are: what a laboratory's trace leaves open.

A simulated recording's light is exact.  One that was measured, and brought onto the camera's clock by `pixelid check`
or `calibrate`, says so in its attribute `bench`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace

import numpy as np

from pixelid.documents import is_number
from pixelid.errors import InputError
from pixelid.recordings.recording import Recording

ATTRIBUTE = "bench"
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


def on_bench(recording: Recording, bench: Bench) -> Recording:
    """The recording, which says how exact its light is."""
    return replace(recording, attributes={**recording.attributes, ATTRIBUTE: asdict(bench)})
