"""Procedural scenes: textured objects that hide each other, a highlight, dark and bright parts; rendered from anywhere.

A scene is drawn from a seed.  Its radiance is in units of white; the background has one known value.  The highlights
and the darkest textures are more than a hundredfold apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from pixelid.nerf.data import raycast
from pixelid.nerf.data.camera import Camera, sub_pixel_directions
from pixelid.nerf.data.trajectory import Trajectory
from pixelid.parallel import map_threads, ranges, thread_count

BACKGROUND = 0.4
FIELD_OF_VIEW = 0.6911  # rad, as of the published synthetic scenes
DISTANCE = 4.0  # of the cameras from the centre
EXTENT = 1.3  # the objects are inside this radius
ELEVATIONS = (0.0, 0.9)  # rad, of random views


@dataclass(frozen=True)
class Scene:
    """Objects as rows of numbers (see `raycast.FIELDS`), a lamp and a background.

    items: (n, FIELDS);  light: (4,) unit direction towards the lamp and the ambient share;  background: radiance
    """

    items: np.ndarray
    light: np.ndarray
    background: float = BACKGROUND

    def render(self, camera: Camera, position, rotation, supersample: int = 3) -> np.ndarray:
        """Images (n, height, width), radiance averaged over `supersample`² rays per pixel.

        position: (n, 3), rotation: (n, 3, 3), camera to world (x right, y down, z forward).
        """
        position, rotation = np.atleast_2d(position), np.asarray(rotation).reshape(-1, 3, 3)
        directions = sub_pixel_directions(camera, supersample)
        out = np.empty((len(position), camera.height * camera.width))
        items = raycast.prepared(self.items)

        def part(some: slice) -> None:
            raycast.render(
                position[some], rotation[some], directions, supersample**2, items, self.light, self.background,
                out[some],
            )  # fmt: skip

        map_threads(part, ranges(len(position), 4 * thread_count()))  # in quarters: views differ in cost
        return out.reshape(len(position), camera.height, camera.width)


def procedural(seed: int) -> Scene:
    """A scene drawn from a seed: a slab to stand on, then spheres and boxes, none inside another."""
    rng = np.random.default_rng(seed)
    items = [_slab(rng)]
    placed: list[tuple[np.ndarray, float]] = []
    objects = 7
    while len(placed) < objects:
        size = rng.uniform(0.26, 0.46)
        centre = np.array([*rng.uniform(-0.85, 0.85, 2), rng.uniform(-0.5, 0.65)])
        apart = all(np.linalg.norm(centre - other) > 0.8 * (size + radius) for other, radius in placed)
        if np.linalg.norm(centre) + size < EXTENT and apart:
            items.append(_object(rng, centre, size, len(placed)))
            placed.append((centre, size))
        elif rng.random() < 0.002:  # no room left: start again with this seed's next numbers
            items, placed = items[:1], []
    towards = np.array([rng.uniform(-0.6, 0.6), rng.uniform(-0.6, 0.6), 1.0])
    return Scene(np.array(items), np.array([*(towards / np.linalg.norm(towards)), 0.35]))


def _slab(rng) -> list[float]:
    return [
        raycast.BOX, 0.0, 0.0, -0.85, 0.85, 0.85, 0.08, rng.uniform(0, np.pi), 0.05, 0.55, raycast.CHECKER, 9.0,
        rng.uniform(0, 6), 0.0, 0.0, 1.0,
    ]  # fmt: skip


def _object(rng, centre, size, number: int) -> list[float]:
    sphere = number % 3 != 2
    half = [size] * 3 if sphere else list(size * rng.uniform(0.55, 0.8, 3))
    dark, bright = 0.012 * np.exp(rng.uniform(0, 1.2)), 0.9 * np.exp(rng.uniform(-1.3, 0))
    texture = float(rng.permutation(3)[0])
    shiny = 1.0 if sphere and number % 2 == 0 else 0.0
    return [
        raycast.SPHERE if sphere else raycast.BOX, *centre, *half, rng.uniform(0, np.pi), dark, bright, texture,
        rng.uniform(9.0, 15.0), rng.uniform(0, 6), rng.uniform(-0.7, 0.7), 1.2 * shiny, 30.0,
    ]  # fmt: skip


def looking_at_centre(position) -> np.ndarray:
    """(n, 3, 3) rotations of cameras at positions (n, 3) that look at the origin, world z up in the image."""
    z = -np.atleast_2d(position)
    z = z / np.linalg.norm(z, axis=1, keepdims=True)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x = x / np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], axis=2)


def on_sphere(azimuth, elevation, distance: float = DISTANCE) -> np.ndarray:
    """(n, 3) positions at angles (n,) rad."""
    azimuth, elevation = np.broadcast_arrays(azimuth, elevation)
    return distance * np.column_stack(
        [np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)]
    )


def spiral(duration_s: float, revolutions: float, low: float = -0.1, high: float = 1.0) -> Trajectory:
    """A camera that circles the scene at constant speed while its elevation changes.

    Args:
        duration_s: of the flight.
        revolutions: about the scene's axis.
        low: elevation at the beginning, in rad.
        high: elevation at the end, in rad.

    Returns:
        The flight.
    """
    per_turn = 720  # poses of a spiral
    n = round(revolutions * per_turn) + 1
    share = np.linspace(0.0, 1.0, n)
    position = on_sphere(2 * np.pi * revolutions * share, low + (high - low) * share)
    quaternions = Rotation.from_matrix(looking_at_centre(position)).as_quat()
    return Trajectory(share * duration_s, position, quaternions)


def random_views(n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions (n, 3) and rotations (n, 3, 3) of cameras all around, evenly in azimuth from a random start."""
    rng = np.random.default_rng(seed)
    azimuth = 2 * np.pi * (np.arange(n) + rng.random()) / n
    position = on_sphere(azimuth, rng.uniform(*ELEVATIONS, n))
    return position, looking_at_centre(position)
