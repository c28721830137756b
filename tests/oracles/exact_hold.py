"""The first-order hold at any number of digits, by mpmath alone: the exponential of the augmented matrix."""

from __future__ import annotations

import math

import mpmath as mp

from oracles.first_order_hold import rates
from pixelid.dynamics.continuous import present_states


def system(names, rate):
    """Matrix of d/dt (x, u, du) = M (x, u, du), the equations of docs/model.md, "The pixel", written a second time."""
    n = len(names)
    m = mp.zeros(n + 2)
    drive, high_pass = n, None
    for i, name in enumerate(names):
        if name == "photoreceptor_slope":
            m[0, 0], m[0, 1], m[0, n] = -rate[0], -rate[1], rate[1]
        elif name == "photoreceptor" and i == 1:
            m[1, 0] = 1
            drive = 1
        else:
            m[i, i], m[i, drive] = -rate[i], rate[i]
            if name == "lower_cutoff":
                high_pass = i
            elif name == "differencing" and high_pass is not None:
                m[i, high_pass] = -rate[i]
            else:
                drive = i
    return m


def exact_hold(dynamics, radiance, dt, digits=50):
    """(A, B, B̃) as mpmath values, and the same of their derivative by ln dt (the scale of an oscillation)."""
    names = present_states(dynamics)
    n = len(names)
    rate = [mp.mpf(float(value)) for value in rates(dynamics, radiance, names)]
    doublings = int(math.log2(float(max(rate)) * dt + 1)) + 8
    with mp.workdps(digits + int(0.7 * doublings) + 30):
        m = system(names, rate) * mp.mpf(dt)
        m[n, n + 1] = 1  # u grows by du over the step
        small = m / mp.mpf(2) ** doublings
        total, term, k = mp.eye(n + 2), mp.eye(n + 2), 0
        while mp.mnorm(term) > mp.eps:
            k += 1
            term = term * small / k
            total += term
        for _ in range(doublings):
            total = total * total
        return split(total, n), split(m * total, n)


def split(e, n):
    return e[:n, :n], [e[i, n] - e[i, n + 1] for i in range(n)], [e[i, n + 1] for i in range(n)]
