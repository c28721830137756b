"""Ray casting of textured spheres and boxes, compiled: what the procedural scenes look like from anywhere."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

SPHERE, BOX = 0.0, 1.0
CHECKER, STRIPES, WAVES = 0.0, 1.0, 2.0
FIELDS = 16  # kind, centre (3), half sizes (3), yaw, dark, bright, texture, frequency, phase, tilt, specular, exponent


def prepared(items) -> np.ndarray:
    """(n, FIELDS + 3) the objects (n, FIELDS) with what every ray needs of them."""
    items = np.asarray(items, dtype=np.float64)
    bound = np.where(items[:, 0] == SPHERE, items[:, 4] ** 2, (items[:, 4:7] ** 2).sum(axis=1))
    return np.column_stack([items, np.cos(items[:, 7]), np.sin(items[:, 7]), bound * 1.0001])


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def _hit_sphere(ox, oy, oz, dx, dy, dz, r):
    """Distance along the ray to a sphere about the origin, −1 without one."""
    b = ox * dx + oy * dy + oz * dz
    disc = b * b - (ox * ox + oy * oy + oz * oz - r * r)
    if disc <= 0.0:
        return -1.0
    return -b - math.sqrt(disc)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=False)
def _hit_box(ox, oy, oz, dx, dy, dz, hx, hy, hz):
    """(distance, axis of the face) along the ray to a box about the origin, (−1, 0) without one."""
    near, far, axis = -1e30, 1e30, 0
    for j in range(3):
        o, d, h = (ox, dx, hx) if j == 0 else ((oy, dy, hy) if j == 1 else (oz, dz, hz))
        if abs(d) < 1e-12:
            if abs(o) > h:
                return -1.0, 0
            continue
        a, b = (-h - o) / d, (h - o) / d
        if a > b:
            a, b = b, a
        if a > near:
            near, axis = a, j
        far = min(far, b)
    if near >= far or near <= 0.0:
        return -1.0, 0
    return near, axis


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def _albedo(item, x, y, z):
    """The texture at a point in the object's frame, between its dark and bright value, in log steps."""
    f, phase, tilt = item[11], item[12], item[13]
    a = f * (x * math.cos(tilt) + z * math.sin(tilt)) + phase
    b = f * (y * math.cos(tilt) + x * math.sin(tilt)) - phase
    c = f * (z * math.cos(tilt) - y * math.sin(tilt)) + 0.5 * phase
    if item[10] == CHECKER:
        s = 1.0 if math.sin(a) * math.sin(b) * math.sin(c) > 0.0 else 0.0
    elif item[10] == STRIPES:
        s = 1.0 if math.sin(a + 0.6 * c) > 0.0 else 0.0
    else:
        s = 0.5 + 0.25 * (math.sin(a + 1.3 * math.sin(b)) + math.sin(c + math.sin(0.7 * a)))
    return item[8] * (item[9] / item[8]) ** s


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def radiance(ox, oy, oz, dx, dy, dz, items, light, background):
    """Radiance along one ray.

    items: of `prepared`;  light: (4,) direction towards it and ambient share;  background: where nothing is hit
    """
    best, which, normal_x, normal_y, normal_z, px, py, pz = 1e30, -1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(len(items)):
        item = items[i]
        tx, ty, tz = ox - item[1], oy - item[2], oz - item[3]
        along = tx * dx + ty * dy + tz * dz
        if tx * tx + ty * ty + tz * tz - along * along > item[18] or -along - math.sqrt(item[18]) > best:
            continue
        c, s = item[16], item[17]
        lx, ly = c * tx + s * ty, -s * tx + c * ty
        ex, ey = c * dx + s * dy, -s * dx + c * dy
        if item[0] == SPHERE:
            t, axis = _hit_sphere(lx, ly, tz, ex, ey, dz, item[4]), -1
        else:
            t, axis = _hit_box(lx, ly, tz, ex, ey, dz, item[4], item[5], item[6])
        if 0.0 < t < best:
            best, which = t, i
            px, py, pz = lx + t * ex, ly + t * ey, tz + t * dz
            if axis < 0:
                nx, ny, nz = px / item[4], py / item[4], pz / item[4]
            else:
                nx = math.copysign(1.0, px) if axis == 0 else 0.0
                ny = math.copysign(1.0, py) if axis == 1 else 0.0
                nz = math.copysign(1.0, pz) if axis == 2 else 0.0
            normal_x, normal_y, normal_z = c * nx - s * ny, s * nx + c * ny, nz
    if which < 0:
        return background
    item = items[which]
    cosine = max(normal_x * light[0] + normal_y * light[1] + normal_z * light[2], 0.0)
    value = _albedo(item, px, py, pz) * (light[3] + (1.0 - light[3]) * cosine)
    if item[14] > 0.0:  # Blinn's half vector
        hx, hy, hz = light[0] - dx, light[1] - dy, light[2] - dz
        h = math.sqrt(hx * hx + hy * hy + hz * hz)
        shine = max((normal_x * hx + normal_y * hy + normal_z * hz) / h, 0.0)
        value += item[14] * shine ** item[15]
    return value


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def render(origins, rotations, directions, samples, items, light, background, out):
    """Fill out (frames, pixels) with the mean radiance of each pixel.

    origins: (frames, 3);  rotations: (frames, 3, 3);  directions: (pixels · samples, 3), a pixel's samples together
    """
    for k in range(len(origins)):
        R = rotations[k]
        for i in range(out.shape[1]):
            total = 0.0
            for j in range(samples):
                d = directions[i * samples + j]
                total += radiance(
                    origins[k, 0], origins[k, 1], origins[k, 2],
                    R[0, 0] * d[0] + R[0, 1] * d[1] + R[0, 2] * d[2],
                    R[1, 0] * d[0] + R[1, 1] * d[1] + R[1, 2] * d[2],
                    R[2, 0] * d[0] + R[2, 1] * d[1] + R[2, 2] * d[2],
                    items, light, background,
                )  # fmt: skip
            out[k, i] = total / samples
