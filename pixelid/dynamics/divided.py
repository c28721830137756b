"""Divided differences of the exponential, to full relative accuracy wherever the nodes lie.

    exp[z1, …, zn] = ∫ exp(t1 z1 + … + tn zn) over the simplex      (Hermite-Genocchi)

is the value at time one of the inverse Laplace transform of 1/((s − z1) … (s − zn)): the impulse response of a
chain of first-order stages, whether or not their poles coincide.

Two formulas cover all nodes, after McCurdy, Ng & Parlett, Mathematics of Computation 43, 1984:

*Recursion.*  f[S] = (f[S∖i] − f[S∖j]) / (z_j − z_i) with i, j the farthest pair.  For real nodes the subtraction
    amplifies rounding by 1 + 2 f[S∖max] / (|z_j − z_i| f[S]) ≲ 1 + 2 (n − 2)/|z_j − z_i|, so it is used where
    the spread exceeds `SPREAD`.
*Series.*  Below that, about a centre c:  f[c + d] = e^c Σ_k h_k(d) / (k + n − 1)!, with h_k the complete
    homogeneous symmetric polynomial of the displacements.  With c at the smallest real part every term is
    positive for real nodes, and nothing cancels; complex nodes are centred between their imaginary parts.
"""

from __future__ import annotations

import numpy as np
from numba import njit

SPREAD = 8.0
MAX_NODES = 10
_TERMS = 80  # more than any spread up to SPREAD needs


def exp_divided_difference(nodes) -> complex:
    """exp[z1, …, zn] of nodes (n,), 1 ≤ n ≤ `MAX_NODES`, real or complex, in any order and arbitrarily close.

    Relative error below 1e-13 for real nodes.  Complex nodes make the value an oscillation in the nodes'
    scale; near its zeros the error is 1e-13 of the value's envelope.

    Raises ValueError for an empty list or too many nodes.
    """
    nodes = np.ascontiguousarray(nodes, dtype=np.complex128)
    if nodes.ndim != 1 or not 1 <= len(nodes) <= MAX_NODES:
        raise ValueError(f"expected 1 to {MAX_NODES} nodes in one dimension, found shape {nodes.shape}")
    return complex(difference(nodes))


@njit(cache=True)
def _series(z, mask):
    """The series over the nodes z whose bits are set in `mask`."""
    d = np.empty(len(z), dtype=np.complex128)
    n = 0
    low, bottom, top = np.inf, np.inf, -np.inf
    for i in range(len(z)):
        if mask >> i & 1:
            d[n] = z[i]
            n += 1
            low = min(low, z[i].real)
            bottom = min(bottom, z[i].imag)
            top = max(top, z[i].imag)
    centre = complex(low, 0.5 * (bottom + top))
    h = np.ones(n, dtype=np.complex128)  # h[i] = h_k(d_0 … d_i) = h_k(d_0 … d_{i−1}) + d_i h_{k−1}(d_0 … d_i)
    scale = 1.0  # 1 / (k + n − 1)!
    for k in range(2, n):
        scale /= k
    total = complex(scale, 0.0)
    radius = 0.0
    for i in range(n):
        d[i] -= centre
        radius = max(radius, abs(d[i]))
    bound = scale  # of the term of degree k: radius^k / (k! (n − 1)!)
    for k in range(1, _TERMS):
        bound *= radius / k
        if bound < 1e-18 * abs(total) and k > radius:
            break
        scale /= k + n - 1
        h[0] *= d[0]
        for i in range(1, n):
            h[i] = h[i - 1] + d[i] * h[i]
        total += h[n - 1] * scale
    return np.exp(centre) * total


@njit(cache=True)
def difference(z):
    """exp[z1, …, zn] of the complex128 array z (n,), compiled; see `exp_divided_difference`.

    Subsets are bit masks.  Downward, every subset that the recursion needs is marked with its farthest pair;
    upward, each is computed once from the two smaller ones.
    """
    size = 1 << len(z)
    first = np.full(size, -1)  # −1: not needed; otherwise the farthest pair, equal where the series serves
    second = np.empty(size, dtype=np.int64)
    first[size - 1] = 0
    for mask in range(size - 1, 0, -1):
        if first[mask] < 0:
            continue
        first[mask] = second[mask] = 0
        spread = SPREAD
        for i in range(len(z)):
            for j in range(i):
                if mask >> i & 1 and mask >> j & 1 and abs(z[i] - z[j]) > spread:
                    first[mask], second[mask] = i, j
                    spread = abs(z[i] - z[j])
        if spread > SPREAD:
            first[mask & ~(1 << first[mask])] = 0
            first[mask & ~(1 << second[mask])] = 0
    f = np.empty(size, dtype=np.complex128)
    for mask in range(1, size):
        i, j = first[mask], second[mask]
        if i < 0:
            continue
        if i == j:
            f[mask] = _series(z, mask)
        else:
            f[mask] = (f[mask & ~(1 << i)] - f[mask & ~(1 << j)]) / (z[j] - z[i])
    return f[size - 1]
