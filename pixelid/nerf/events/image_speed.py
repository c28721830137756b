"""How fast the image moves at a pixel and a time: what an event's burst, and a pixel's rays, are measured by.

The image of a camera does not move at one speed: a camera changes its own, what is close passes faster than what is
far, and a turn moves all alike.  Before anything is known of the scene a pixel sees something on its ray within the
ball (of a box that is no cube: the ellipsoid) inside the box, where it is as likely as elsewhere; a ray that misses the
ball sees what is nearest to it.  Each of `DEPTHS` such points is projected into the camera a little before and a little
after, and the root mean square over them is the speed.

An edge of a field is about two cells wide, so what a cell is in pixels there is measured as well: of a camera that
only shifts, close things are as much faster as their cells are larger, and the time is the same at any depth.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from pixelid.nerf.data.camera import Camera
from pixelid.nerf.data.trajectory import Trajectory, interval_at, pose_at, rotate
from pixelid.parallel import map_threads, ranges, thread_count

# Midpoints of thirds of the chord, in half chords from its middle: the speed goes with one over the depth, and more of
# them change its mean by less than a hundredth where the camera is outside the ball.
DEPTHS = (-2 / 3, 0.0, 2 / 3)
CLOSEST = 0.05  # of the box's half side: nothing is closer to the camera


def crossing_times(
    trajectory: Trajectory, camera: Camera, low, high, t, pixel, *, cell: float = 0.0, within: float, most: float,
    near: float = 0.0,
) -> np.ndarray:  # fmt: skip
    """Seconds in which the image moves by one pixel, or by one cell where that is more, at pixels and times.

    Args:
        trajectory: of the camera.
        camera: the sensor.
        low, high: (3,) corners of the box.
        t: (N,) s.
        pixel: (N,) row-major index.
        cell: side of the field's cells, in the unit of the poses; 0 for pixels alone.
        within: s over which the movement is taken: poses have noise, and rates that jump at every one of them.
        most: s, where the image hardly moves.
        near: distance from the camera before which nothing is.

    Returns:
        (N,) float32.
    """
    rows, columns = np.divmod(np.arange(camera.width * camera.height), camera.width)
    inside = camera.directions(np.column_stack([columns, rows]))
    middle, half = 0.5 * (np.asarray(low) + high), 0.5 * (np.asarray(high, float) - low)
    closest, focal = max(near, CLOSEST * float(half.max())), float(camera.intrinsics[0, 0])
    out = np.empty(len(t), np.float32)

    def part(some: slice) -> None:
        _fill(
            t[some], pixel[some], inside, trajectory.t, trajectory.position, trajectory.orientation, middle, half,
            focal, cell, 0.5 * within, closest, np.array(DEPTHS), most, out[some],
        )  # fmt: skip

    map_threads(part, ranges(len(t), thread_count()))
    return out


@njit(inline="always", error_model="numpy")
def _seen(x, y, z, pose, focal):
    """(place in the image [pixels], depth) of a point from a pose."""
    ox, oy, oz, qx, qy, qz, qw = pose
    a, b, c = rotate(-qx, -qy, -qz, qw, x - ox, y - oy, z - oz)
    return focal * a / c, focal * b / c, c


@njit(cache=True, nogil=True, error_model="numpy")
def _fill(
    times, pixel, inside, t, position, orientation, middle, half, focal, cell, step, closest, depths, most, out
):  # fmt: skip
    """Fill out (N,) of `crossing_times`."""
    k = 0
    for i in range(len(times)):
        k = interval_at(times[i], t, k)
        here = pose_at(times[i], k, t, position, orientation)
        before, after = max(times[i] - step, t[0]), min(times[i] + step, t[-1])
        earlier = pose_at(before, interval_at(before, t, k), t, position, orientation)
        later = pose_at(after, interval_at(after, t, k), t, position, orientation)
        d = inside[pixel[i]]
        dx, dy, dz = rotate(here[3], here[4], here[5], here[6], d[0], d[1], d[2])
        # in half sides of the box, where the ball has radius 1
        ax, ay, az = (here[0] - middle[0]) / half[0], (here[1] - middle[1]) / half[1], (here[2] - middle[2]) / half[2]
        bx, by, bz = dx / half[0], dy / half[1], dz / half[2]
        square = bx * bx + by * by + bz * bz
        nearest = -(ax * bx + ay * by + az * bz) / square
        mx, my, mz = ax + nearest * bx, ay + nearest * by, az + nearest * bz
        chord = math.sqrt(max(1.0 - (mx * mx + my * my + mz * mz), 0.0) / square)
        total, number = 0.0, 0
        for depth in depths:
            s = max(nearest + depth * chord, closest)
            x, y, z = here[0] + s * dx, here[1] + s * dy, here[2] + s * dz
            u, v, ahead = _seen(x, y, z, earlier, focal)
            p, q, beyond = _seen(x, y, z, later, focal)
            if ahead > 0.0 and beyond > 0.0 and after > before:
                wide = max(focal * cell / (s * d[2]), 1.0)
                total += ((p - u) ** 2 + (q - v) ** 2) / (wide * (after - before)) ** 2
                number += 1
        out[i] = min(math.sqrt(number / total), most) if total > 0.0 else most
