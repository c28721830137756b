"""Where the camera was: at constant rates or along cubic splines between pose samples, and the rays of its pixels.

Camera axes as in computer vision: x right, y down, z forward.  Pixel centres are at integer coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from pixelid.parallel import map_threads, ranges

FINER = 16  # poses per pose of a splined trajectory: a straight line between them leaves 1/256 of what it left before


@dataclass(frozen=True)
class Trajectory:
    """Camera-to-world poses, constant rate in between and held outside.

    t: (K,) s, increasing;  position: (K, 3);  orientation: (K, 4) unit quaternions x, y, z, w;  zero_ns: what time zero
    is called in the file
    """

    t: np.ndarray
    position: np.ndarray
    orientation: np.ndarray
    zero_ns: int = 0

    def splined(self, finer: int = FINER) -> Trajectory:
        """The trajectory with cubic splines through its poses instead of constant rates, as more poses.

        Positions by cubic splines (not-a-knot ends), orientations by rotation vectors whose angular velocity and
        acceleration are continuous (SciPy's `RotationSpline`).

        Args:
            finer: poses in the place of one.

        Returns:
            The same poses, and `finer` − 1 between any two.
        """
        known = np.arange(len(self.t))
        t = np.interp(np.arange((len(self.t) - 1) * finer + 1) / finer, known, self.t)
        position = CubicSpline(self.t, self.position)(t)
        orientation = RotationSpline(self.t, Rotation.from_quat(self.orientation))(t).as_quat()
        return replace(self, t=t, position=position, orientation=orientation)

    def at(self, times) -> tuple[np.ndarray, np.ndarray]:
        """Positions (n, 3) and rotation matrices (n, 3, 3) at `times` (n,) s."""
        times = np.ascontiguousarray(np.atleast_1d(times), dtype=np.float64)
        position, rotation = np.empty((len(times), 3)), np.empty((len(times), 3, 3))
        _poses(times, self.t, self.position, self.orientation, position, rotation)
        return position, rotation

    def rays(self, times, directions, threads: int = 1) -> tuple[np.ndarray, np.ndarray]:
        """World origins and unit directions (n, 3) float32 of camera-frame unit directions (n, 3) at times (n,) s."""
        times, directions = np.ascontiguousarray(times, dtype=np.float64), np.ascontiguousarray(directions)
        origins, out = np.empty((len(times), 3), np.float32), np.empty((len(times), 3), np.float32)

        def part(some: slice) -> None:
            _rays(
                times[some], directions[some], self.t, self.position, self.orientation, origins[some], out[some]
            )  # fmt: skip

        worth_threads = 1 << 14  # rays, some 1.5 ms of one thread: starting others takes 0.4
        number = threads if len(times) >= worth_threads else 1
        map_threads(part, ranges(len(times), number), threads=number)
        return origins, out


@njit(inline="always")
def interval_at(time, t, k):
    """The interval of poses at a time; k: one that may be it, as times of a run follow each other closely."""
    if t[k] <= time < t[k + 1]:
        return k
    return min(max(np.searchsorted(t, time, side="right") - 1, 0), len(t) - 2)


@njit(cache=True, nogil=True)
def pose_at(time, k, t, position, orientation):
    """(px, py, pz, qx, qy, qz, qw) at one time, in the interval k of poses."""
    f = min(max((time - t[k]) / (t[k + 1] - t[k]), 0.0), 1.0)
    dot = 0.0
    for j in range(4):
        dot += orientation[k, j] * orientation[k + 1, j]
    sign = 1.0 if dot >= 0.0 else -1.0
    short = 1.0 - min(abs(dot), 1.0)
    if short < 1e-3:  # series of sin(f x)/sin x, x the angle between the quaternions, to 1e-11
        x2 = 2.0 * short * (1.0 + short / 6.0 * (1.0 + 4.0 * short / 15.0))
        rest = (1.0 - f) * (1.0 - f) * x2
        sine, rest, gone = 1.0 - x2 / 6.0 * (1.0 - x2 / 20.0), 1.0 - rest / 6.0 * (1.0 - rest / 20.0), f * f * x2
        w0, w1 = (1.0 - f) * rest / sine, sign * f * (1.0 - gone / 6.0 * (1.0 - gone / 20.0)) / sine
    else:
        angle = np.arccos(1.0 - short)
        w0, w1 = np.sin((1.0 - f) * angle) / np.sin(angle), sign * np.sin(f * angle) / np.sin(angle)
    q0 = w0 * orientation[k, 0] + w1 * orientation[k + 1, 0]
    q1 = w0 * orientation[k, 1] + w1 * orientation[k + 1, 1]
    q2 = w0 * orientation[k, 2] + w1 * orientation[k + 1, 2]
    q3 = w0 * orientation[k, 3] + w1 * orientation[k + 1, 3]
    n = 1.0 / np.sqrt(q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)
    return (
        position[k, 0] + f * (position[k + 1, 0] - position[k, 0]),
        position[k, 1] + f * (position[k + 1, 1] - position[k, 1]),
        position[k, 2] + f * (position[k + 1, 2] - position[k, 2]),
        q0 * n, q1 * n, q2 * n, q3 * n,
    )  # fmt: skip


@njit(cache=True, nogil=True)
def rotate(x, y, z, w, a, b, c):
    """Vector (a, b, c) rotated by the unit quaternion (x, y, z, w)."""
    u, v, s = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return a + w * u + y * s - z * v, b + w * v + z * u - x * s, c + w * s + x * v - y * u


@njit(cache=True, nogil=True)
def _poses(times, t, position, orientation, out_position, out_rotation):
    k = 0
    for i in range(len(times)):
        k = interval_at(times[i], t, k)
        p0, p1, p2, x, y, z, w = pose_at(times[i], k, t, position, orientation)
        out_position[i, 0], out_position[i, 1], out_position[i, 2] = p0, p1, p2
        for j in range(3):
            e0, e1, e2 = 1.0 * (j == 0), 1.0 * (j == 1), 1.0 * (j == 2)
            r0, r1, r2 = rotate(x, y, z, w, e0, e1, e2)
            out_rotation[i, 0, j], out_rotation[i, 1, j], out_rotation[i, 2, j] = r0, r1, r2


@njit(cache=True, nogil=True)
def _rays(times, directions, t, position, orientation, origins, out):
    k = 0
    for i in range(len(times)):
        k = interval_at(times[i], t, k)
        p0, p1, p2, x, y, z, w = pose_at(times[i], k, t, position, orientation)
        d0, d1, d2 = rotate(x, y, z, w, directions[i, 0], directions[i, 1], directions[i, 2])
        origins[i, 0], origins[i, 1], origins[i, 2] = p0, p1, p2
        out[i, 0], out[i, 1], out[i, 2] = d0, d1, d2
