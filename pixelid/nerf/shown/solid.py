"""What a field looks like as geometry: log density and colour at the vertices, depth along rays, a mesh."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch

from pixelid.errors import InputError
from pixelid.nerf.data.views import Views
from pixelid.nerf.field.harmonics import harmonics
from pixelid.nerf.field.radiance import Field
from pixelid.nerf.field.render import read_off
from pixelid.nerf.shown.evaluate import render_views

SEEN = 0.5  # opacity of a ray below which it has no depth


class Mesh(NamedTuple):
    """vertices: (n, 3) in the scene;  normals: (n, 3) unit, outwards;  radiance: (n, C) as
    seen head-on;  faces: (m, 3) indices."""

    vertices: np.ndarray
    normals: np.ndarray
    radiance: np.ndarray
    faces: np.ndarray


def vertex_values(field: Field) -> tuple[np.ndarray, np.ndarray]:
    """(log density (n, n, n), log radiance (n, n, n, C)) at the vertices of a field."""
    grid = field.bricks.spread_out(field.grid.detach().cpu().numpy())
    return grid[..., 0], grid[..., 1:]


def depth_of(field: Field, views: Views) -> np.ndarray:
    """Distances from the cameras to what they see, NaN where rays pass through.

    The renderer's own sum with the distance in place of the radiance: Σ (T_i − T_{i+1}) t_i over the opacity.  It is
    rendered as a share of the farthest, since the renderer caps radiance (`render_kernels.HIGHEST`).

    Args:
        field: the scene.
        views: where from; their images are not looked at.

    Returns:
        (n, H, W) in the scene's unit.
    """
    density, positions = field.grid.detach().cpu().numpy()[:, 0], field.positions()
    out = []
    for k in range(len(views)):
        squared = ((positions - views.position[k]) ** 2).sum(axis=1)
        farthest = max(float(squared.max()), np.finfo(float).tiny)
        shares = 0.5 * np.log(np.maximum(squared / farthest, 1e-12))
        distances = _like(field, np.stack([density, shares], axis=-1))
        clear = _like(field, np.stack([density, np.full_like(density, -30.0)], axis=-1))
        one = views.some([k])
        passed = render_views(clear, one, np.zeros(1))[0, ..., 0]  # transmittance: the background is 1
        total = render_views(distances, one, np.zeros(1))[0, ..., 0] - passed
        opacity = 1.0 - passed
        out.append(np.where(opacity > SEEN, math.sqrt(farthest) * total / np.maximum(opacity, SEEN), np.nan))
    return np.array(out)


def mesh_of(field: Field) -> Mesh:
    """The surface where one cell lets half of the light through, by marching cubes.

    Args:
        field: the scene.

    Returns:
        The mesh; it is closed, and coloured by the radiance of the field there.

    Raises:
        InputError: nothing in the field is that dense.
    """
    from scipy.ndimage import map_coordinates
    from skimage.measure import marching_cubes

    density, log_radiance = vertex_values(field)
    surface = 0.5  # opacity of one cell at which a surface is drawn
    level = math.log(-math.log1p(-surface) / field.step)
    if not density.max() > level:
        raise InputError("the scene has no surface: nothing in it is opaque")
    padded = np.pad(density, 1, constant_values=min(float(density.min()), level - 1))
    # "ascent": density is high inside, so that normals and the faces' sense point outwards
    vertices, faces, normals, _ = marching_cubes(padded, level, gradient_direction="ascent")
    # a gradient per cell: of places, by the inverse of what they change by per cell
    normals = np.linalg.solve(np.swapaxes(field.cells(vertices - 1), 1, 2), normals[..., None])[..., 0]
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(np.float32).tiny)
    at = np.clip(vertices - 1, 0, np.array(density.shape) - 1)
    points = at / (np.array(density.shape) - 1)
    coefficients = read_off(field.coefficients.flatten(1), points, field.bricks).cpu().numpy()
    coefficients = coefficients.reshape(len(at), *field.coefficients.shape[1:])
    head_on = harmonics(torch.from_numpy(-normals), coefficients.shape[-1]).numpy()
    radiance = np.empty((len(at), log_radiance.shape[-1]))
    for c in range(radiance.shape[1]):
        radiance[:, c] = map_coordinates(log_radiance[..., c], at.T, order=1)
        for k in range(coefficients.shape[-1]):
            radiance[:, c] += coefficients[:, c, k] * head_on[:, k]
    return Mesh(field.places(vertices - 1), normals, np.exp(radiance), faces)


def _like(field: Field, grid: np.ndarray) -> Field:
    """A field of one colour with another grid (rows, 2), before a background of 1."""
    other = Field(field.low, field.high, 2, 1, [1.0], near=field.near, unbounded=field.unbounded)
    other.hold(field.bricks, torch.from_numpy(np.ascontiguousarray(grid, np.float32)))
    other.occupied = field.occupied
    return other
