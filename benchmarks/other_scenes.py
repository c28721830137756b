"""Scenes of another make than `pixelid.nerf.data.scenes`: thin legs, flat surfaces of one colour, shadows, things
that hang in the air, before white, grey and dark.

Solids are met analytically, lit by a sky and one lamp that casts shadows (Lambert), with Phong's highlight.  Nothing is
shared with the scenes that weights were chosen on, the camera and the simulated pixel aside.  `far_away` puts one of
those before something far behind it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from pixelid.nerf.data import raycast
from pixelid.nerf.data.camera import Camera, sub_pixel_directions
from pixelid.nerf.data.scenes import EXTENT, Scene, on_sphere, procedural

ELLIPSOID, BOX, CYLINDER = 0.0, 1.0, 2.0
FLAT, CHECKER, STRIPES = 0.0, 1.0, 2.0
AMBIENT, DIRECT, TOWARDS = 0.5, 0.6, (0.47, 0.28, 0.84)  # light of the sky, of the lamp, and where it is
SHARP = 25.0  # exponent of the highlight
NONE, BARELY = -1.0, 1e-6


def solid(kind, centre, half, angle=0.0, albedo=0.5, other=0.1, texture=FLAT, waves=0.0, shine=0.0) -> list[float]:
    """A row: kind, centre, half sizes, turn about z, two albedos, texture, its waves per length, highlight, radius²."""
    radius2 = max(half) ** 2 if kind == ELLIPSOID else sum(h * h for h in half)
    return [kind, *centre, *half, angle, albedo, other, texture, waves, shine, 1.0001 * radius2]


LEGS = [solid(CYLINDER, (x, y, -0.45), (0.06, 0.06, 0.4), albedo=0.2)
        for x, y in ((-0.68, -0.18), (0.52, -0.62), (0.68, 0.18), (-0.52, 0.62))]  # fmt: skip
TABLE = [
    solid(BOX, (0.0, 0.0, 0.0), (0.85, 0.6, 0.05), 0.3, 0.55),
    *LEGS,
    solid(ELLIPSOID, (0.35, 0.0, 0.28), (0.23, 0.23, 0.23), albedo=0.7, shine=0.6),
    solid(BOX, (-0.3, 0.15, 0.2), (0.17, 0.12, 0.15), 0.8, 0.8, 0.06, CHECKER, 9.0),
    solid(CYLINDER, (0.0, -0.33, 0.2), (0.12, 0.12, 0.15), 0.0, 0.05, 0.6, STRIPES, 25.0),
]
YARD = [
    solid(CYLINDER, (0.0, 0.0, -0.62), (1.15, 1.15, 0.04), albedo=0.4),
    solid(BOX, (-0.45, -0.2, -0.2), (0.25, 0.25, 0.38), 0.5, 0.3),
    solid(ELLIPSOID, (0.4, 0.35, -0.22), (0.36, 0.36, 0.36), 0.0, 0.1, 0.5, CHECKER, 7.0, 0.7),
    solid(CYLINDER, (0.45, -0.45, -0.28), (0.2, 0.2, 0.3), 0.0, 0.6, 0.05, STRIPES, 22.0),
    solid(ELLIPSOID, (-0.3, 0.6, -0.38), (0.2, 0.2, 0.2), albedo=0.03),
]

RODS = [solid(BOX, (x, y, z), half, angle, albedo)
        for x, y, z, half, angle, albedo in (
            (0.0, 0.0, 0.75, (0.9, 0.04, 0.04), 0.4, 0.15), (0.75, 0.32, 0.35, (0.035, 0.035, 0.4), 0.0, 0.15),
            (-0.72, -0.3, 0.45, (0.035, 0.035, 0.3), 0.0, 0.9),
            (-0.2, 0.5, -0.1, (0.6, 0.035, 0.035), -0.9, 0.6))]  # fmt: skip
MOBILE = [
    *RODS,
    solid(ELLIPSOID, (0.75, 0.32, -0.2), (0.22, 0.22, 0.22), albedo=0.08),
    solid(BOX, (-0.72, -0.3, 0.0), (0.2, 0.04, 0.2), 1.1, 0.9),
    solid(ELLIPSOID, (0.0, -0.2, -0.55), (0.45, 0.45, 0.12), albedo=0.25),
    solid(CYLINDER, (0.1, -0.55, 0.15), (0.16, 0.16, 0.2), 0.0, 0.7, 0.05, CHECKER, 11.0),
    solid(ELLIPSOID, (-0.35, 0.65, -0.35), (0.15, 0.15, 0.25), albedo=0.75, shine=0.5),
]


@dataclass(frozen=True)
class Solids:
    """Rows of `solid` (n, 14) before a background."""

    rows: np.ndarray
    background: float

    def render(self, camera: Camera, position, rotation, supersample: int = 3) -> np.ndarray:
        """Images (n, height, width) of cameras at position (n, 3), rotation (n, 3, 3)."""
        position, rotation = np.atleast_2d(position), np.asarray(rotation).reshape(-1, 3, 3)
        out = np.empty((len(position), camera.height * camera.width))
        inside = sub_pixel_directions(camera, supersample)
        _film(position, rotation, inside, supersample**2, self.rows, np.array(TOWARDS), self.background, out)
        return out.reshape(len(position), camera.height, camera.width)


FAR, FAR_BALLS = 20.0, 40  # inner radii to the middle of what is far, and how many there are of it


def far_away(seed: int) -> Scene:
    """The usual scene, and textured balls around it and below, `FAR` times as far away as its objects reach."""
    near, rng = procedural(seed), np.random.default_rng(seed + 100)
    rows = np.tile(near.items[1], (FAR_BALLS, 1))
    azimuth = 6 * np.pi * (np.arange(FAR_BALLS) + rng.random(FAR_BALLS)) / FAR_BALLS
    rows[:, 0] = raycast.SPHERE
    rows[:, 1:4] = on_sphere(azimuth, rng.uniform(-1.1, 0.3, FAR_BALLS), FAR * EXTENT)
    rows[:, 4:7] = FAR * EXTENT * rng.uniform(0.1, 0.2, (FAR_BALLS, 1))
    rows[:, 8] = 0.03 * np.exp(rng.uniform(0, 1, FAR_BALLS))
    rows[:, 9] = 0.9 * np.exp(rng.uniform(-1, 0, FAR_BALLS))
    rows[:, 10] = np.arange(FAR_BALLS) % 3
    rows[:, 11] = 0.4 * rng.uniform(9, 15, FAR_BALLS) / rows[:, 4]
    rows[:, 14] = 0.0
    return Scene(np.vstack([near.items, rows]), near.light)


SCENES = {
    "table": Solids(np.array(TABLE), 1.0),
    "yard": Solids(np.array(YARD), 0.25),
    "mobile": Solids(np.array(MOBILE), 0.5),
}


@njit
def _ellipsoid(half, o, d):
    """(distance, normal) of the nearer side."""
    a, b = o / half, d / half
    along, across = (b * b).sum(), (a * b).sum()
    inside = across * across - along * ((a * a).sum() - 1.0)
    t = (-across - math.sqrt(inside)) / along if inside > 0 else NONE
    return t, (a + t * b) / half


@njit
def _box(half, o, d):
    """(distance, normal) of the nearer side."""
    near, far, axis = -1e30, 1e30, 0
    for j in range(3):
        along = d[j] if abs(d[j]) > 1e-12 else 1e-12
        first, last = (-half[j] - o[j]) / along, (half[j] - o[j]) / along
        first, last = min(first, last), max(first, last)
        if first > near:
            near, axis = first, j
        far = min(far, last)
    normal = np.zeros(3)
    normal[axis] = -1.0 if d[axis] > 0 else 1.0
    return (near if near < far else NONE), normal


@njit
def _cylinder(half, o, d):
    """(distance, normal) of the nearer side, mantle or cap; its axis is z."""
    normal, t = np.zeros(3), NONE
    along, across = d[0] ** 2 + d[1] ** 2, o[0] * d[0] + o[1] * d[1]
    inside = across * across - along * (o[0] ** 2 + o[1] ** 2 - half[0] ** 2)
    if inside > 0 and along > 1e-12:
        mantle = (-across - math.sqrt(inside)) / along
        if abs(o[2] + mantle * d[2]) < half[2]:
            t = mantle
            normal[0], normal[1] = o[0] + t * d[0], o[1] + t * d[1]
    if t <= BARELY and abs(d[2]) > 1e-9:
        up = -1.0 if d[2] > 0 else 1.0
        cap = (up * half[2] - o[2]) / d[2]
        if (o[0] + cap * d[0]) ** 2 + (o[1] + cap * d[1]) ** 2 < half[0] ** 2:
            t, normal[2] = cap, up
    return t, normal


@njit
def _nearest(rows, o, d):
    """(row, distance, unit normal) of what a ray meets first; row −1 for nothing."""
    which, nearest, facing = -1, 1e30, d
    for i in range(len(rows)):
        row = rows[i]
        x, y, z = row[1] - o[0], row[2] - o[1], row[3] - o[2]
        if x * x + y * y + z * z - (x * d[0] + y * d[1] + z * d[2]) ** 2 > row[13]:
            continue
        c, s = math.cos(row[7]), math.sin(row[7])
        there = np.array([-c * x - s * y, s * x - c * y, -z])
        along = np.array([c * d[0] + s * d[1], -s * d[0] + c * d[1], d[2]])
        if row[0] == ELLIPSOID:
            t, normal = _ellipsoid(row[4:7], there, along)
        elif row[0] == BOX:
            t, normal = _box(row[4:7], there, along)
        else:
            t, normal = _cylinder(row[4:7], there, along)
        if BARELY < t < nearest:
            which, nearest = i, t
            normal = normal / math.sqrt((normal * normal).sum())
            facing = np.array([c * normal[0] - s * normal[1], s * normal[0] + c * normal[1], normal[2]])
    return which, nearest, facing


@njit
def _radiance(rows, towards, background, o, d):
    """Of a ray."""
    which, t, normal = _nearest(rows, o, d)
    if which < 0:
        return background
    row, at = rows[which], o + t * d
    albedo = row[8]
    if row[10] == CHECKER:
        cells = math.floor(row[11] * at[0]) + math.floor(row[11] * at[1]) + math.floor(row[11] * at[2])
        albedo = row[8] if int(cells) % 2 == 0 else row[9]
    elif row[10] == STRIPES:
        albedo = row[8] + (row[9] - row[8]) * (0.5 + 0.5 * math.sin(row[11] * (at[0] + 0.7 * at[2])))
    lit = max((normal * towards).sum(), 0.0)
    if lit > 0 and _nearest(rows, at + 1e-3 * normal, towards)[0] >= 0:
        lit = 0.0
    mirrored = ((d - 2.0 * (d * normal).sum() * normal) * towards).sum()
    shine = row[12] * mirrored**SHARP if lit > 0 and mirrored > 0 else 0.0
    return albedo * (AMBIENT * (0.7 + 0.3 * normal[2]) + DIRECT * lit) + shine


@njit(nogil=True)
def _film(origins, rotations, inside, each, rows, towards, background, out):
    d = np.empty(3)
    for k in range(len(origins)):
        turn = rotations[k]
        for i in range(out.shape[1]):
            total = 0.0
            for j in range(each):
                x, y, z = inside[i * each + j]
                for m in range(3):
                    d[m] = turn[m, 0] * x + turn[m, 1] * y + turn[m, 2] * z
                total += _radiance(rows, towards, background, origins[k], d)
            out[k, i] = total / each
