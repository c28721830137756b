"""A field as Gaussian splats, one for each vertex that is neither clear nor hidden inside.

A vertex stands for a cell of side h with opacity a = 1 − exp(−σ h).  A round Gaussian of peak a and standard deviation
s covers a · 2π s² of area; a layer of them, one per h², is as opaque as the cell for s = h / √(2π).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pixelid.errors import InputError
from pixelid.nerf.field import EMPTY, Field
from pixelid.nerf.shown.solid import vertex_values

HIDDEN = 0.95  # opacity of all six neighbours beyond which nobody sees a vertex
MOST_OPACITY = 0.999  # its logit is what viewers read


class Splats(NamedTuple):
    """centre: (n, 3);  radiance: (n, C);  opacity: (n,);  deviation: (3,) along the axes, the same for all."""

    centre: np.ndarray
    radiance: np.ndarray
    opacity: np.ndarray
    deviation: np.ndarray


def splats_of(field: Field) -> Splats:
    """The splats of a field.

    Raises:
        InputError: the field is clear everywhere.
    """
    density, log_radiance = vertex_values(field)
    spacing = (field.high - field.low) / (np.array(density.shape) - 1)
    opacity = -np.expm1(-field.step * np.exp(np.minimum(density, 12.0)))
    opaque = np.pad(opacity > HIDDEN, 1)
    hidden = np.ones(density.shape, bool)
    for axis in range(3):
        for shift in (-1, 1):
            hidden &= np.roll(opaque, shift, axis)[1:-1, 1:-1, 1:-1]
    index = np.argwhere((opacity > EMPTY) & ~hidden)
    if len(index) == 0:
        raise InputError("the scene has no splats: everything in it is clear")
    at = tuple(index.T)
    return Splats(
        field.low + index * spacing, np.exp(log_radiance[at]), np.minimum(opacity[at], MOST_OPACITY),
        spacing / math.sqrt(2 * math.pi),
    )  # fmt: skip
