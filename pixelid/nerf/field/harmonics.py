"""Real spherical harmonics: how a colour depends on the direction it is seen from.

    ln L(x, d) = c(x) + Σ_k h_k(x) Y_k(d),   d the unit direction of the ray

Y_k are the harmonics of degree 1 (x, y, z) and 2 (xy, yz, zx, 3z² − 1, x² − y²), each of mean square 1 over the
sphere; degree 0 is c.  Source: Ramamoorthi and Hanrahan, SIGGRAPH 2001, with another scale.  Radiance stays positive,
since it is the logarithm that they describe.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from numba import njit

_FIRST, _MIXED, _POLAR = math.sqrt(3.0), math.sqrt(15.0), 0.5 * math.sqrt(5.0)


def number_of(degree: int) -> int:
    """How many harmonics there are up to a degree, in addition to the constant."""
    return (degree + 1) ** 2 - 1


@njit(inline="always", error_model="numpy")
def fill(d, out):
    """Fill out (K,) float32 with the harmonics at a direction d (3,); K: 0, 3 or 8."""
    if len(out) >= 3:
        for j in range(3):
            out[j] = _FIRST * d[j]
    if len(out) >= 8:
        x, y, z = d[0], d[1], d[2]
        out[3], out[4], out[5] = _MIXED * x * y, _MIXED * y * z, _MIXED * z * x
        out[6], out[7] = _POLAR * (3.0 * z * z - 1.0), 0.5 * _MIXED * (x * x - y * y)


def harmonics(directions: torch.Tensor, number: int) -> torch.Tensor:
    """(n, number) at unit directions (n, 3)."""
    x, y, z = directions.unbind(dim=1)
    every = (
        _FIRST * x, _FIRST * y, _FIRST * z, _MIXED * x * y, _MIXED * y * z, _MIXED * z * x, _POLAR * (3 * z * z - 1),
        0.5 * _MIXED * (x * x - y * y),
    )  # fmt: skip
    return torch.stack(every, dim=1)[:, :number]


@njit(inline="always", error_model="numpy")
def turned(d, coefficient, out):
    """Add to out (3,) the gradient of Σ_k coefficient_k Y_k by the direction d (3,); coefficient: (K,)."""
    number = len(coefficient)
    if number >= 3:
        for j in range(3):
            out[j] += _FIRST * coefficient[j]
    if number >= 8:
        x, y, z = d[0], d[1], d[2]
        out[0] += _MIXED * (y * coefficient[3] + z * coefficient[5] + x * coefficient[7])
        out[1] += _MIXED * (x * coefficient[3] + z * coefficient[4] - y * coefficient[7])
        out[2] += _MIXED * (y * coefficient[4] + x * coefficient[5]) + 6.0 * _POLAR * z * coefficient[6]


@njit(inline="always", error_model="numpy")
def _at_corner(flat, i, basis):
    """Σ_k basis_k times value k at one vertex, the first at i; degree 1, the usual one, without a loop."""
    if len(basis) == 4:
        return (
            flat[np.uintp(i)] + basis[1] * flat[np.uintp(i + 1)] + basis[2] * flat[np.uintp(i + 2)]
            + basis[3] * flat[np.uintp(i + 3)]
        )  # fmt: skip
    dot = np.float32(0.0)
    for k in range(len(basis)):
        dot += basis[k] * flat[np.uintp(i + k)]
    return dot


@njit(inline="always", error_model="numpy")
def seen(flat, at, number, first, shares, basis):
    """Σ_k basis_k times the trilinear value of the constant (k = 0, basis 1) and the harmonics.

    at: (8,) rows of a cell's corners, z fastest, of `number` values each;  first: of them that counts;  shares: (8,)
    """
    return (
        shares[0] * _at_corner(flat, at[0] * number + first, basis)
        + shares[1] * _at_corner(flat, at[1] * number + first, basis)
        + shares[2] * _at_corner(flat, at[2] * number + first, basis)
        + shares[3] * _at_corner(flat, at[3] * number + first, basis)
        + shares[4] * _at_corner(flat, at[4] * number + first, basis)
        + shares[5] * _at_corner(flat, at[5] * number + first, basis)
        + shares[6] * _at_corner(flat, at[6] * number + first, basis)
        + shares[7] * _at_corner(flat, at[7] * number + first, basis)
    )


@njit(inline="always", error_model="numpy")
def spread(flat, at, number, first, shares, basis, by_value):
    """The transpose: add a cell's shares of the gradient by `seen`.  A loop, which here is five times faster."""
    for corner in range(8):
        w = shares[corner] * by_value
        i = at[corner] * number + first
        if len(basis) == 4:
            flat[np.uintp(i)] += w
            flat[np.uintp(i + 1)] += w * basis[1]
            flat[np.uintp(i + 2)] += w * basis[2]
            flat[np.uintp(i + 3)] += w * basis[3]
        else:
            for k in range(len(basis)):
                flat[np.uintp(i + k)] += w * basis[k]
