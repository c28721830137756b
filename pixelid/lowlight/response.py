"""Frequency and step response of a chain of poles with unit gain at DC, for small changes of ln L.

    H(jω) = Π p / (jω + p)         step: y(t) = Π p · tⁿ · exp[0, −p₁t, …, −pₙt]

the latter a divided difference, exact wherever poles meet and where they are complex.

−3 dB frequency: the highest frequency at which |H| = 1/√2 (a resonance may cross it more than once).
Step time: when y first reaches 1 − 1/e = 63.2 %, the time constant of a single pole.

Divided differences of the exponential, to full relative accuracy wherever the nodes lie:

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

import math

import numpy as np
from numba import njit
from scipy.optimize import brentq

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


LEVEL = 1.0 - math.exp(-1.0)


def gain(poles: np.ndarray, frequency_hz) -> np.ndarray:
    """(…) complex H at frequencies (…) Hz of the chain with poles (n,) rad/s."""
    s = 2j * np.pi * np.asarray(frequency_hz, dtype=float)
    return np.prod(poles / (s[..., None] + poles), axis=-1)


def bandwidth_hz(poles: np.ndarray) -> float:
    """The −3 dB frequency [Hz] of the chain with poles (n,) rad/s."""
    slowest = np.abs(poles).min()
    p = poles / slowest
    # with y = 1/ω²: |jω + p|² / |p|² = 1 + 1/(y |p|²) for a real pole; multiplied by yⁿ, a polynomial in y whose
    # wanted root is of order 1 and whose other roots are smaller
    product = np.array([1.0])
    for real in p[np.abs(p.imag) == 0]:
        product = np.polymul(product, [1.0, 1.0 / real.real**2])
    for upper in p[p.imag > 0]:
        square = abs(upper) ** 2
        product = np.polymul(product, [1.0, 2 * (upper.real**2 - upper.imag**2) / square**2, 1.0 / square**2])
    product[0] -= 2.0
    roots = np.roots(product)
    y = min(root.real for root in roots if abs(root.imag) < 1e-6 * abs(root) and root.real > 0)
    log_w = -0.5 * math.log(y)
    for _ in range(3):  # Newton on ln|H|² + ln 2 over ln ω
        w = math.exp(log_w)
        size = np.abs(1j * w + p) ** 2
        value = np.log(np.abs(p) ** 2 / size).sum() + math.log(2.0)
        log_w += value / (2.0 * w * (w + p.imag) / size).sum()
    return float(slowest * math.exp(log_w) / (2 * np.pi))


def step_response(poles: np.ndarray, t) -> np.ndarray:
    """(m,) response at times t (m,) seconds to a unit step of ln L at t = 0."""
    t = np.asarray(t, dtype=float)
    order = len(poles)
    out = np.zeros(len(t))
    for i, time in enumerate(t):
        if time > 0:
            value = exp_divided_difference(np.append(0.0, -poles * time)) * np.prod(poles * time)
            out[i] = value.real
    return out if order else np.ones(len(t))


def step_time_s(poles: np.ndarray) -> float:
    """Seconds until the step response first reaches `LEVEL`."""

    def short(time: float) -> float:
        return float(step_response(poles, [time])[0]) - LEVEL

    part = (float((1.0 / poles).real.sum()) + 1.0 / float(np.abs(poles).min())) / 24
    end = part
    while short(end) < 0:
        end += part
    return float(brentq(short, end - part, end, xtol=1e-12 * end))  # type: ignore[arg-type]
