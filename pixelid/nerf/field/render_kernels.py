"""The volume renderer, compiled: march, interpolate, composite; and its gradient.

A field holds log density and log radiances at the vertices of a box (`bricks`), trilinear in between, exponential
after; log radiance may also depend on the ray's direction (`harmonics`).  Kernels read the densities in one array, and
the log radiance of a colour with its harmonics side by side in another: two thirds of the time of a march.
With step h, density σ_i, radiance c_i, transmittance T_i = exp(−h Σ_{j<i} σ_j) and background b,

    L = Σ_i (T_i − T_{i+1}) c_i + T_n b
    ∂L/∂c_i = T_i − T_{i+1}        ∂L/∂σ_i = h (T_{i+1} c_i − R_i),   R_i what the ray still collects after sample i

so a walk along the samples with L known gives all gradients.  Clear space is left in strides as wide as it is clear
all around, clear samples elsewhere are passed over; a ray ends where T falls below `OPAQUE`.  For the gradient a ray
keeps which samples were neither, with their h σ and c: 12 bytes each, some twenty per ray.  Source: Max, IEEE TVCG 1995
(compositing).

An unbounded field (`contraction`) is marched by steps that grow outside the inner box, h dt/dτ, and is less dense there
by n²: of what the grid holds as g, h e^g (dt/dτ)/n² is in the place of h σ.

A sample at o + t d moves with origin and direction as o does and as t times d; that t itself moves with the face of
the box where the march begins is left out, since the offset of the first sample is random.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from pixelid.nerf.field import contraction, harmonics
from pixelid.nerf.field.bricks import ROWS, SIDE, corners, row

OPAQUE = 1e-3
CLEAR = 1e-3  # opacity of a step below which a sample is passed over
BLOCK = SIDE  # cells per side of an occupancy block
HIGHEST = 12.0  # of log density and log radiance
FARTHEST = 1e6  # steps from the camera: beyond, single-precision origins miss cells, in the end a march stands still


@njit(inline="always", error_model="numpy")
def _span(o, d, low, high, nearest):
    """(near, far) of the box along a ray, from the distance `nearest` on."""
    near, far = nearest, 1e30
    for j in range(3):
        direction = d[j]
        if abs(direction) < 1e-9:
            direction = 1e-9
        a, b = (low[j] - o[j]) / direction, (high[j] - o[j]) / direction
        near, far = max(near, min(a, b)), min(far, max(a, b))
    return near, far


@njit(inline="always", error_model="numpy")
def _shares(x, y, z):
    """(8,) shares of a cell's corners in its trilinear value at (x, y, z), 0 … 1 each; z changes fastest."""
    one = np.float32(1.0)
    a, b, c, d = (one - x) * (one - y), (one - x) * y, x * (one - y), x * y
    e = one - z
    return a * e, a * z, b * e, b * z, c * e, c * z, d * e, d * z


@njit(inline="always", error_model="numpy")
def _interpolated(values, at, number, k, shares):
    """Trilinear value of the k-th of `number` values per row; at: (8,) rows of the corners."""
    return (
        shares[0] * values[np.uintp(at[0] * number + k)] + shares[1] * values[np.uintp(at[1] * number + k)]
        + shares[2] * values[np.uintp(at[2] * number + k)] + shares[3] * values[np.uintp(at[3] * number + k)]
        + shares[4] * values[np.uintp(at[4] * number + k)] + shares[5] * values[np.uintp(at[5] * number + k)]
        + shares[6] * values[np.uintp(at[6] * number + k)] + shares[7] * values[np.uintp(at[7] * number + k)]
    )  # fmt: skip


@njit(inline="always", error_model="numpy")
def _spread(values, at, shares, amount):
    """The transpose for one value per row: add a cell's shares of `amount`."""
    for k in range(8):
        values[np.uintp(at[k])] += shares[k] * amount


@njit(inline="always", error_model="numpy")
def _add_slopes(values, at, number, k, x, y, z, by_value, out):
    """Add to out (3,) by_value times the gradient, in cells, of the trilinear value of `_interpolated`."""
    one = np.float32(1.0)
    for j in range(8):
        wx, wy, wz = x if j & 4 else one - x, y if j & 2 else one - y, z if j & 1 else one - z
        value = by_value * values[np.uintp(at[j] * number + k)]
        out[0] += (value if j & 4 else -value) * wy * wz
        out[1] += (value if j & 2 else -value) * wx * wz
        out[2] += (value if j & 1 else -value) * wx * wy


@njit(inline="always", error_model="numpy")
def _steps_in_clear(x, y, z, ix, iy, iz, rate_x, rate_y, rate_z, away):
    """Steps from (x, y, z) in cell (ix, iy, iz) to the first sample at which a block that is not clear may begin.

    rates: steps per cell;  away: blocks to the nearest such block along the axis that is farthest from it, 1 at least
    """
    a = ((ix // BLOCK + (away if rate_x > 0 else 1 - away)) * BLOCK - x) * rate_x
    b = ((iy // BLOCK + (away if rate_y > 0 else 1 - away)) * BLOCK - y) * rate_y
    c = ((iz // BLOCK + (away if rate_z > 0 else 1 - away)) * BLOCK - z) * rate_z
    return max(int(min(a, b, c)) + 1, 1)


@njit(inline="always", error_model="numpy")
def _per_cell(q, step):
    """Steps of the march per cell along an axis, q: cells per unit of length."""
    return 1.0 / (step * (q if abs(q) > 1e-9 else 1e-9))


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "afn", "reassoc"})
def forward(
    origins, directions, channels, offsets, densities, looks, vertices, index, filled, away, low, high, unbounded,
    nearest, step, background, radiance, opacity, first, samples, depths, colours,
):  # fmt: skip
    """Fill radiance (n,) and opacity (n,) of rays; (samples, depths, colours), where rays met something.

    origins, directions: (n, 3) float32;  channels: (n,) colour of each ray;  offsets: (n,) of the first sample in
    steps;  densities: (rows,) float32, logs;  looks: (rows, C, 1 + K) float32, log radiance and its harmonics, K may be
    0;  vertices: per side;  index: of `Bricks`;  filled, away: of `filled_cells`;  low, high: (3,) the box, the inner
    one where the field is unbounded;  unbounded: True or None, which is left out of the compiled walk;  nearest:
    distance before which nothing is seen;  background: (C,) radiance
    behind it
    first: (n + 1,) where the samples of each ray begin, or (0,) when nobody asks for them;  samples, depths, colours:
    room for number of the step (int32), optical depth and radiance of samples that are not clear; larger arrays are
    returned where it does not suffice
    """
    floor, basis, cells = np.float32(math.log(CLEAR / step)), np.ones(looks.shape[2], np.float32), vertices - 1
    sx, sy, sz = cells / (high[0] - low[0]), cells / (high[1] - low[1]), cells / (high[2] - low[2])
    kept, keeping = 0, len(first) > 0
    for i in range(len(origins)):
        o, d, c = origins[i], directions[i], channels[i]
        harmonics.fill(d, basis[1:])
        near, far = _span(o, d, low, high, nearest)
        T, L = np.float32(1.0), np.float32(0.0)
        if keeping:
            first[i] = kept
        px, py, pz = (o[0] - low[0]) * sx, (o[1] - low[1]) * sy, (o[2] - low[2]) * sz
        qx, qy, qz = d[0] * sx, d[1] * sy, d[2] * sz
        way, hit = (0.0, 0.0, 1.0, 1.0), near < far < FARTHEST * step
        if unbounded is not None:
            near, far, entry, length, wide, reach = contraction.way(o, d, low, high, near, far, nearest, step)
            way, hit = (entry, length, wide, reach), entry < FARTHEST * step
            (px, qx), (py, qy), (pz, qz) = _inner(o, d, low, high)
        if hit:
            while keeping and kept + (far - near) / step + 2 > len(samples):
                samples, depths, colours = _longer(samples), _longer(depths), _longer(colours)
            T, L, kept = _march(
                px, py, pz, qx, qy, qz, near + offsets[i] * step, far, unbounded, way, step, c, basis, densities,
                looks, cells, index, filled, away, floor, keeping, samples, depths, colours, kept,
            )  # fmt: skip
        radiance[i] = L + T * background[c]
        opacity[i] = 1.0 - T
    if keeping:
        first[len(origins)] = kept
    return samples, depths, colours


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "afn", "reassoc"})
def _march(
    px, py, pz, qx, qy, qz, start, far, unbounded, way, step, c, basis, densities, looks, cells, index, filled, away,
    floor, keeping, samples, depths, colours, kept,
):  # fmt: skip
    """(transmittance, radiance, kept) at the end of one ray.

    p + t q: along the ray, in cells; of an unbounded field in half sides of the inner box, where alone blocks are left
    in one stride;  way: (entry, length, wide, reach) of `contraction.way`
    """
    flat, each, number, last = looks.reshape(-1), looks.shape[2], looks.shape[1] * looks.shape[2], cells - 1
    scale, (entry, length, wide, reach) = cells / (2.0 * contraction.SIDE), way
    stride = scale if unbounded is not None else 1.0
    rate_x, rate_y, rate_z = _per_cell(qx * stride, step), _per_cell(qy * stride, step), _per_cell(qz * stride, step)
    k, tau, growth, norm = 0, start, 1.0, 1.0
    T, L = np.float32(1.0), np.float32(0.0)
    while tau < far:
        x, y, z = px + tau * qx, py + tau * qy, pz + tau * qz
        if unbounded is not None:
            t, growth = contraction.distance(tau, entry, length, wide, reach)
            x, y, z = px + t * qx, py + t * qy, pz + t * qz
            shrunk, norm = contraction.shrink(x, y, z)
            x, y, z = _in_grid(x, shrunk, scale), _in_grid(y, shrunk, scale), _in_grid(z, shrunk, scale)
        ix, iy, iz = min(max(int(x), 0), last), min(max(int(y), 0), last), min(max(int(z), 0), last)
        if filled[np.uintp(row(index, ix, iy, iz))]:
            at, shares = corners(index, ix, iy, iz), _shares(np.float32(x - ix), np.float32(y - iy), np.float32(z - iz))
            density = _interpolated(densities, at, 1, 0, shares)
            if density > floor:
                value = harmonics.seen(flat, at, number, c * each, shares, basis)
                passed = np.float32(step) * math.exp(min(density, np.float32(HIGHEST)))
                if unbounded is not None:
                    passed = np.float32(growth / (norm * norm) * step * math.exp(min(density, np.float32(HIGHEST))))
                colour = math.exp(min(value, np.float32(HIGHEST)))
                if keeping:
                    samples[kept], depths[kept], colours[kept] = k, passed, colour
                    kept += 1
                T_next = T * math.exp(-passed)
                L += (T - T_next) * colour
                T = T_next
                if T < OPAQUE:
                    break
            k += 1
        else:
            blocks, steps = away[np.uintp(ix // BLOCK), np.uintp(iy // BLOCK), np.uintp(iz // BLOCK)], 1
            if blocks > 0 and (unbounded is None or 0.0 <= tau < length):
                steps = _steps_in_clear(x, y, z, ix, iy, iz, rate_x, rate_y, rate_z, blocks)
                if unbounded is not None:
                    steps = min(steps, int((length - tau) / step) + 1)
            k += steps
        tau = start + k * step
    return T, L, kept


@njit(inline="always", error_model="numpy")
def _inner(o, d, low, high):
    """(origin, direction) along each axis, in half sides of the inner box, from its middle."""
    a, b, c = 0.5 * (high[0] - low[0]), 0.5 * (high[1] - low[1]), 0.5 * (high[2] - low[2])
    x, y, z = (o[0] - low[0]) / a - 1.0, (o[1] - low[1]) / b - 1.0, (o[2] - low[2]) / c - 1.0
    return (x, d[0] / a), (y, d[1] / b), (z, d[2] / c)


@njit(inline="always", error_model="numpy")
def _in_grid(p, shrunk, scale):
    """Cells from the low end of the grid of a coordinate of `_inner`; scale: cells per half side."""
    return (p * shrunk + contraction.SIDE) * scale


@njit(inline="always", error_model="numpy")
def _longer(column):
    """The same numbers (n,), with room for as many again."""
    longer = np.empty(2 * len(column) + 1024, column.dtype)
    longer[: len(column)] = column
    return longer


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "afn", "reassoc"})
def backward(
    origins, directions, channels, offsets, densities, looks, vertices, index, low, high, unbounded, nearest, step,
    background, radiance, first, samples, depths, colours, by_radiance, by_densities, by_looks, by_background,
    by_origins, by_directions,
):  # fmt: skip
    """Add the gradient of Σ by_radiance · radiance, from the samples that `forward` kept.

    unbounded: True or None;  by_densities, by_looks, by_background: (…) as densities, looks, background;  by_origins,
    by_directions: (n, 3), or None when nobody asks.  What is None is left out of the compiled walk.
    """
    slopes, turning = np.empty(3, np.float32), np.empty(3, np.float32)
    cells, last, brightest = vertices - 1, vertices - 2, math.exp(np.float32(HIGHEST - 1e-5))
    flat, each, number = looks.reshape(-1), looks.shape[2], looks.shape[1] * looks.shape[2]
    by_flat, basis, here = by_looks.reshape(-1), np.ones(each, np.float32), np.empty(each, np.float32)
    sx, sy, sz = cells / (high[0] - low[0]), cells / (high[1] - low[1]), cells / (high[2] - low[2])
    scale, most = cells / (2.0 * contraction.SIDE), np.float32(step) * brightest
    if unbounded is not None:  # per half side of the inner box
        sx, sy, sz = 2.0 / (high[0] - low[0]), 2.0 / (high[1] - low[1]), 2.0 / (high[2] - low[2])
    for i in range(len(origins)):
        g = by_radiance[i]
        if g == 0.0:
            continue
        o, d, c = origins[i], directions[i], channels[i]
        harmonics.fill(d, basis[1:])
        near, far = _span(o, d, low, high, nearest)
        T, left = np.float32(1.0), radiance[i]
        px, py, pz = (o[0] - low[0]) * sx, (o[1] - low[1]) * sy, (o[2] - low[2]) * sz
        qx, qy, qz = d[0] * sx, d[1] * sy, d[2] * sz
        start = near
        if unbounded is not None:
            start, _, entry, length, wide, reach = contraction.way(o, d, low, high, near, far, nearest, step)
            (px, qx), (py, qy), (pz, qz) = _inner(o, d, low, high)
        start += offsets[i] * step
        for m in range(first[i], first[i + 1]):
            t, passed, colour = start + samples[m] * step, depths[m], colours[m]
            x, y, z, densest = px + t * qx, py + t * qy, pz + t * qz, most
            if unbounded is not None:
                t, stretch = contraction.distance(t, entry, length, wide, reach)
                ux, uy, uz = px + t * qx, py + t * qy, pz + t * qz
                shrunk, norm = contraction.shrink(ux, uy, uz)
                x, y, z = _in_grid(ux, shrunk, scale), _in_grid(uy, shrunk, scale), _in_grid(uz, shrunk, scale)
                densest = np.float32(most * stretch / (norm * norm))
            ix, iy, iz = min(max(int(x), 0), last), min(max(int(y), 0), last), min(max(int(z), 0), last)
            fx, fy, fz = np.float32(x - ix), np.float32(y - iy), np.float32(z - iz)
            at, shares = corners(index, ix, iy, iz), _shares(fx, fy, fz)
            T_next = T * math.exp(-passed)
            by_value = g * (T - T_next) * colour
            left -= (T - T_next) * colour
            by_density = g * (T_next * colour - left) * passed
            by_log_norm = -2.0 * by_density
            if passed >= densest:
                by_density = np.float32(0.0)
            if colour >= brightest:
                by_value = np.float32(0.0)
            _spread(by_densities, at, shares, by_density)
            harmonics.spread(by_flat, at, number, c * each, shares, basis, by_value)
            if by_origins is not None:
                slopes[:], turning[:] = 0.0, 0.0
                _add_slopes(densities, at, 1, 0, fx, fy, fz, by_density, slopes)
                for k in range(each):
                    _add_slopes(flat, at, number, c * each + k, fx, fy, fz, by_value * basis[k], slopes)
                    here[k] = by_value * _interpolated(flat, at, number, c * each + k, shares)
                harmonics.turned(d, here[1:], turning)
                if unbounded is not None:  # per half side of the inner box
                    slopes *= np.float32(scale)
                    contraction.pull_back(ux, uy, uz, slopes, by_log_norm)
                for j in range(3):
                    slope = slopes[j] * (sx if j == 0 else (sy if j == 1 else sz))
                    by_origins[i, j] += slope
                    by_directions[i, j] += t * slope + turning[j]
            T = T_next
        by_background[c] += g * T
    by_densities[:ROWS] = 0.0
    by_looks[:ROWS] = 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def filled_cells(densities, vertices, index, step, occupied, filled, away):
    """Mark cells in which a sample may be other than clear, and how far from them every block of cells is.

    No trilinear value is above that of all corners, so nothing that a march would meet is left out.

    occupied: (b, b, b) uint8, blocks that may hold any;  filled: (rows,) uint8, by the low corner of the cell;  away:
    (b, b, b) int16, blocks from here to the nearest with a filled cell along the axis that is farthest from it, 0 there
    """
    floor, last = np.float32(math.log(CLEAR / step)), vertices - 1
    filled[:] = 0
    away[:] = len(away)
    for a in range(occupied.shape[0]):
        for b in range(occupied.shape[1]):
            for c in range(occupied.shape[2]):
                if not (occupied[a, b, c] and index[a, b, c]):
                    continue
                for i in range(a * BLOCK, min((a + 1) * BLOCK, last)):
                    for j in range(b * BLOCK, min((b + 1) * BLOCK, last)):
                        for k in range(c * BLOCK, min((c + 1) * BLOCK, last)):
                            at = corners(index, i, j, k)
                            most = max(densities[at[0]], densities[at[1]], densities[at[2]], densities[at[3]])
                            other = max(densities[at[4]], densities[at[5]], densities[at[6]], densities[at[7]])
                            if max(most, other) > floor:
                                filled[at[0]], away[a, b, c] = 1, 0
    for way in (1, -1):
        _passed_on(away, way)


@njit(inline="always", error_model="numpy")
def _passed_on(away, way):
    """Let blocks (b, b, b), first to last (way 1) or last to first (-1), be one farther than a neighbour at most.

    Of the half of its 26 neighbours that were walked over before, nine lie in the last plane, three in the last row.
    Source: Rosenfeld and Pfaltz, Pattern Recognition 1, 33, 1968: two such walks find all distances.
    """
    n = len(away)
    rows, least = np.empty((n, n), np.int16), np.empty(n, np.int16)
    for a in range(0 if way > 0 else n - 1, n if way > 0 else -1, way):
        inside = 0 <= a - way < n
        for b in range(n if inside else 0):
            _least_of_three(away[a - way, b], rows[b])
        for b in range(0 if way > 0 else n - 1, n if way > 0 else -1, way):
            here = away[a, b]
            for near in range(max(b - 1, 0), min(b + 2, n) if inside else 0):
                for c in range(n):
                    here[c] = min(here[c], rows[near, c] + 1)
            if 0 <= b - way < n:
                _least_of_three(away[a, b - way], least)
                for c in range(n):
                    here[c] = min(here[c], least[c] + 1)
            for c in range(way if way > 0 else n - 2, n if way > 0 else -1, way):
                here[c] = min(here[c], here[c - way] + 1)


@njit(inline="always", error_model="numpy")
def _least_of_three(values, out):
    """Fill out (n,) with the least of each of values (n,) and its two neighbours."""
    n = len(values)
    out[0], out[n - 1] = min(values[0], values[min(1, n - 1)]), min(values[n - 1], values[max(n - 2, 0)])
    for c in range(1, n - 1):
        out[c] = min(min(values[c - 1], values[c + 1]), values[c])


@njit(cache=True, nogil=True, error_model="numpy")
def occupancy(grid, vertices, index, log_floor, occupied):
    """Mark the blocks any of whose vertices (shared faces included) has log density above `log_floor`."""
    blocks = len(occupied)
    occupied[:] = 0
    for a in range(blocks):
        for b in range(blocks):
            for c in range(blocks):
                if index[a, b, c] == 0:
                    continue
                dense = False
                for i in range(a * BLOCK, min((a + 1) * BLOCK + 1, vertices)):
                    for j in range(b * BLOCK, min((b + 1) * BLOCK + 1, vertices)):
                        for k in range(c * BLOCK, min((c + 1) * BLOCK + 1, vertices)):
                            dense = dense or grid[row(index, i, j, k), 0] > log_floor
                occupied[a, b, c] = 1 if dense else 0
