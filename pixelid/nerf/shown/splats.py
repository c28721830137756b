"""A field as Gaussian splats, one for each vertex that is neither clear nor hidden inside.

A vertex stands for a cell of side h (along each axis, where space is contracted; its shear is left out), in a box that
is no cube the geometric mean of its sides, with opacity
a = 1 − exp(−σ h).  A round Gaussian of peak a and standard deviation
s covers a · 2π s² of area; a layer of them, one per h², is as opaque as the cell for s = h / √(2π).

Where radiance depends on the direction, so does a splat's colour, by the same harmonics: the colours seen along the
nodes of a product quadrature (Gauss–Legendre × equal angles, exact here) are projected onto them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch

from pixelid.errors import InputError
from pixelid.nerf.field.harmonics import harmonics
from pixelid.nerf.field.radiance import EMPTY, Field
from pixelid.nerf.shown.solid import vertex_values

HIDDEN = 0.95  # opacity of all six neighbours beyond which nobody sees a vertex
NODES = 6, 12  # of the quadrature over the sphere: heights, angles; exact for products up to degree 11


class Splats(NamedTuple):
    """The splats of a scene.

    centre: (n, 3);  log_radiance: (n, C);  coefficients: (n, C, K) of its harmonics;  opacity: (n,);  deviation: (n, 3)
    along the axes
    """

    centre: np.ndarray
    log_radiance: np.ndarray
    coefficients: np.ndarray
    opacity: np.ndarray
    deviation: np.ndarray

    def colours(self, tone: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """Colours by direction.

        Args:
            tone: radiance (n, C) → colours (n, 3).

        Returns:
            (n, 3, 1 + K): the mean over the sphere, then the coefficients of the harmonics.
        """
        number = self.coefficients.shape[2]
        if number == 0:
            return tone(np.exp(self.log_radiance))[..., None]
        directions, weights = _sphere(*NODES)
        basis = harmonics(torch.from_numpy(directions), number).numpy()
        colours = np.zeros((len(self.centre), 3, 1 + number))
        for at, weight in zip(basis, weights, strict=True):
            seen = tone(np.exp(self.log_radiance + self.coefficients @ at))
            colours += weight * seen[..., None] * np.concatenate([[1.0], at])
        return colours


def splats_of(field: Field) -> Splats:
    """The splats of a field.

    Raises:
        InputError: the field is clear everywhere.
    """
    density, log_radiance = vertex_values(field)
    side = float(np.prod(np.diagonal(field.cells(np.full((1, 3), 0.5 * (field.vertices - 1)))[0])) ** (1 / 3))
    opacity = -np.expm1(-side * np.exp(np.minimum(density, 12.0)))
    opaque = np.pad(opacity > HIDDEN, 1)
    hidden = np.ones(density.shape, bool)
    for axis in range(3):
        for shift in (-1, 1):
            hidden &= np.roll(opaque, shift, axis)[1:-1, 1:-1, 1:-1]
    index = np.argwhere((opacity > EMPTY) & ~hidden)
    if len(index) == 0:
        raise InputError("the scene has no splats: everything in it is clear")
    at, rows = tuple(index.T), field.bricks.rows_of(torch.from_numpy(index)).to(field.grid.device)
    coefficients = field.coefficients.detach()[rows]
    sides = np.diagonal(field.cells(index), axis1=1, axis2=2)
    most_opacity = 0.999  # its logit is what viewers read
    return Splats(
        field.places(index), log_radiance[at], coefficients.cpu().numpy(),
        np.minimum(opacity[at], most_opacity), sides / math.sqrt(2 * math.pi),
    )  # fmt: skip


def _sphere(heights: int, angles: int) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3) nodes and (n,) weights, of sum 1, of a quadrature over the unit sphere."""
    z, weight = np.polynomial.legendre.leggauss(heights)
    angle = 2 * math.pi * (np.arange(angles) + 0.5) / angles
    z, angle = np.repeat(z, angles), np.tile(angle, heights)
    across = np.sqrt(1 - z * z)
    return np.column_stack([across * np.cos(angle), across * np.sin(angle), z]), np.repeat(weight, angles) / (
        2 * angles
    )
