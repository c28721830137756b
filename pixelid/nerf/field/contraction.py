"""The map between an unbounded space and a grid: what is far shares a shell about the inner box.

With p = (x − middle)/(half sides) and n = max |p|, the inner box being n ≤ 1 (Barron et al., Mip-NeRF 360, CVPR 2022,
eq. 10, with the largest coordinate in place of the Euclidean norm, since the inner box and the grid are boxes),

    c = p                      inside
    c = (2 − 1/n) p/n          outside: all of space lies in |c| < 2, which the grid covers

so that half of the cells along a side are the inner box's, and a cell at n is n² times as long outwards, and about n/2
times as wide.  Density is counted per length that outwards steps have in the grid, σ(x) = e^g(x)/n² of what the grid
holds as g: a cell is then as opaque with the same g wherever it lies, and so is what begins, ends and passes for clear.

A ray is marched by a length τ of which a step of the march is one cell.  Within the inner box, from t_in to t_out,
τ is the distance; before and behind it disparity is uniform in τ (ibid., section 3),

    t = t_out + g v/(1 − v/V)    v = τ − (t_out − t_in) < V        dt/dτ = g/(1 − v/V)²
    t = t_in  − g u/(1 − u/V)    u = −τ                            dt/dτ = g/(1 − u/V)²

A ray that misses the inner box has t_in = t_out where it comes closest to its middle; with n there (1 for a ray that
hits it), g = n²/(2n − 1) is how wide a cell is there, and V g = 2 R n, R the half side, lets steps grow half as fast as
cells do outwards, since a ray that leaves next to a corner passes by cells first.  No step is longer than 2.5 cells.

This module alone knows the map: scalars for the compiled renderer, arrays for tensors and for what shows a scene.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from numba import njit

SIDE = 2.0  # of the grid, in sides of the inner box
# Cells from the end of the grid at which rays end and the places of its outermost vertices are, which else were nowhere
SHORT = 0.5
# Per side, at least: of fewer, half a cell from the end of the grid is within the inner box, and nothing is beyond
LEAST_VERTICES = 3


def contracted(point: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """(c (n, 3), n (n,) at least 1) of points p (n, 3), differentiable."""
    norm = point.abs().amax(dim=1).clamp(min=1.0)
    return point * ((2.0 - 1.0 / norm) / norm)[:, None], norm


def expanded(c: np.ndarray, vertices: int) -> tuple[np.ndarray, np.ndarray]:
    """(p (n, 3), n (n,)) of places c (n, 3) in a grid of so many vertices per side: the inverse of `contracted`."""
    most = np.abs(c).max(axis=1)
    norm = 1.0 / (2.0 - np.clip(most, 1.0, 2.0 - SHORT * 2.0 * SIDE / (vertices - 1)))
    return c * (np.where(most > 1.0, norm / np.maximum(most, 1.0), 1.0))[:, None], norm


def expansion(c: np.ndarray, vertices: int) -> np.ndarray:
    """(n, 3, 3) ∂p/∂c at places c (n, 3): with m = max |c|, p = c/(m (2 − m)) outside."""
    p, norm = expanded(c, vertices)
    rows, axis = np.arange(len(c)), np.abs(c).argmax(axis=1)
    slopes = np.eye(3) * (norm**2 / (2.0 * norm - 1.0))[:, None, None]
    along = 2.0 * norm * (norm - 1.0) / (2.0 * norm - 1.0) * np.sign(c[rows, axis])
    slopes[rows, :, axis] += along[:, None] * p
    return slopes


@njit(inline="always", error_model="numpy")
def shrink(x, y, z):
    """(factor s with c = s p, n) of one point p."""
    norm = max(abs(x), abs(y), abs(z), 1.0)
    return (2.0 - 1.0 / norm) / norm, norm


@njit(inline="always", error_model="numpy")
def pull_back(x, y, z, slopes, by_log_norm):
    """Turn the gradient by c of one point p, in slopes (3,), into that by p; by_log_norm: the gradient by ln n."""
    factor, norm = shrink(x, y, z)
    if norm > 1.0:
        along = (2.0 / norm - 2.0) / (norm * norm) * (slopes[0] * x + slopes[1] * y + slopes[2] * z)
        along += by_log_norm / norm
        slopes[0] *= factor
        slopes[1] *= factor
        slopes[2] *= factor
        j, largest = (0, x) if abs(x) == norm else ((1, y) if abs(y) == norm else (2, z))
        slopes[j] += math.copysign(1.0, largest) * along


@njit(inline="always", error_model="numpy")
def way(o, d, low, high, near, far, nearest, step):
    """(τ at the distance `nearest`, τ at the end, t_in, t_out − t_in, g, V) of a ray.

    near, far: where the inner box is along it;  step: of the march, half of which before the end of space rays end
    """
    half, norm = 0.5 * max(high[0] - low[0], high[1] - low[1], high[2] - low[2]), 1.0
    if near >= far:
        along, square = 0.0, 0.0
        for j in range(3):
            size = 0.5 * (high[j] - low[j])
            e = d[j] / size
            along -= (o[j] - 0.5 * (low[j] + high[j])) / size * e
            square += e * e
        near = max(along / square, nearest)
        far = near
        for j in range(3):
            norm = max(norm, abs(o[j] + near * d[j] - 0.5 * (low[j] + high[j])) / (0.5 * (high[j] - low[j])))
    wide = norm * norm / (2.0 * norm - 1.0)
    reach = 2.0 * half * norm / wide
    before = (near - nearest) / wide
    return -before / (1.0 + before / reach), far - near + reach - SHORT * step, near, far - near, wide, reach


@njit(inline="always", error_model="numpy")
def distance(tau, entry, length, wide, reach):
    """(t, dt/dτ) along a ray of `way`."""
    if tau < 0.0:
        rest = 1.0 + tau / reach
        return entry + wide * tau / rest, wide / (rest * rest)
    if tau <= length:
        return entry + tau, 1.0
    beyond = tau - length
    rest = 1.0 - beyond / reach
    return entry + length + wide * beyond / rest, wide / (rest * rest)


def ways(o, d, low, high, near, far, nearest: float, step: float):
    """`way` of rays (n, 3), all tensors (n,)."""
    size, middle = 0.5 * (high - low), 0.5 * (low + high)
    e = d / size
    missed = near >= far
    closest = (-((o - middle) / size * e).sum(dim=1) / (e * e).sum(dim=1)).clamp(min=nearest)
    near = torch.where(missed, closest, near)
    far = torch.where(missed, near, far)
    there = ((o + near[:, None] * d - middle) / size).abs().amax(dim=1).clamp(min=1.0)
    norm = torch.where(missed, there, torch.ones_like(near))
    wide = norm * norm / (2.0 * norm - 1.0)
    reach = 2.0 * float(size.max()) * norm / wide
    before = (near - nearest) / wide
    return -before / (1.0 + before / reach), far - near + reach - SHORT * step, near, far - near, wide, reach


def distances(tau: torch.Tensor, entry: torch.Tensor, length: torch.Tensor, wide: torch.Tensor, reach: torch.Tensor):
    """`distance` of many."""
    before, beyond = tau.clamp(max=0.0), (tau - length).clamp(min=0.0)
    rest, left = 1.0 + before / reach, 1.0 - beyond / reach
    t = entry + wide * (before / rest + beyond / left) + tau.clamp(min=0.0).minimum(length)
    outside = (before < 0) | (beyond > 0)
    return t, torch.where(outside, wide, torch.ones_like(wide)) / (rest * left) ** 2
