"""The continuous form in NumPy: SciPy's Dormand–Prince 8(5,3) over all stimulus steps at once, central differences.

No derivative code at all: the slow reference that the differentiated engines are compared with.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from scipy.integrate import solve_ivp
from scipy.special import ndtr

from pixelid.dynamics.continuous import right_hand_side
from pixelid.fit.engines.continuous import ContinuousObjective, discrete_form, log_posterior
from pixelid.fit.engines.engine import scales
from pixelid.fit.engines.frozen import freeze
from pixelid.fit.objective import Objective
from pixelid.parallel import map_threads


class NumpyOperations:
    """`expression.Operations` on float64 arrays (n,)."""

    exp, log, sqrt, sin, cos, abs = (staticmethod(f) for f in (np.exp, np.log, np.sqrt, np.sin, np.cos, np.abs))
    where, total, join = staticmethod(np.where), staticmethod(np.sum), staticmethod(np.concatenate)
    normal_cdf = staticmethod(ndtr)

    @staticmethod
    def constant(values):
        return np.asarray(values, dtype=float)

    @staticmethod
    def take(x, index):
        return x[index]

    @staticmethod
    def spread(x, at, size):
        out = np.zeros(size)
        out[at] = x
        return out

    @staticmethod
    def sum_by(index, x, size):
        return np.bincount(index, x, size)

    @staticmethod
    def cumulate(x):
        return np.concatenate([[0.0], np.cumsum(x)])

    @staticmethod
    def recur(A, c):
        n = len(c[0])
        states = np.zeros((n + 1, 4))
        _recur(np.array([[np.broadcast_to(a, n) for a in row] for row in A]), np.array(c), states)
        return list(states.T)


@njit(cache=True)
def _recur(A, c, states):
    for k in range(c.shape[1]):
        for i in range(4):
            total = c[i, k]
            for j in range(4):
                total += A[i, j, k] * states[k, j]
            states[k + 1, i] = total


def solve_ivp_objective(objective: Objective, x: np.ndarray) -> ContinuousObjective:
    """The continuous form of an objective by SciPy.

    Args:
        objective: the discrete form.
        x: (p,) where the search will be; sets the steps of the differences.

    Raises:
        InputError: see `continuous.discrete_form`.
    """
    discrete = discrete_form(objective, x)
    op: Any = NumpyOperations()
    # Central difference in standard errors: the error of the gradient, of third order, is below 1e-3 per standard
    # error, and what solver tolerances make of the two values 1e-4.
    step_sd = 0.1
    steps = step_sd * scales(discrete.local(x), discrete.coordinates.longest_moves())

    def value_at(point):
        x, frozen = point
        return float(log_posterior(op, discrete, frozen, x, _flow))

    def chosen(x):  # the discrete choices belong to the point: which step a release falls into may change
        return x, freeze(discrete, x)

    def value(x):
        return value_at(chosen(x))

    def value_and_gradient(x):
        moved = [x + sign * row for sign in (1.0, -1.0) for row in np.diag(steps)]
        here, *around = map_threads(value_at, [chosen(point) for point in (x, *moved)])
        up, down = np.reshape(around, (2, len(x)))
        return here, (up - down) / (2.0 * steps)

    return ContinuousObjective(discrete, value, value_and_gradient)


def _flow(state, drive, slope, tau, radiance, dynamics):
    """(v, y, s, d) (n,) after tau, each problem in its own time t = σ tau, σ from 0 to 1; v is carried as v · tau."""
    _, derivatives = right_hand_side(dynamics)
    n = len(tau)
    unit = np.where(tau > 0, tau, 1.0)

    def rate(sigma, flat):
        t = sigma * tau
        w, y, s, d = flat.reshape(4, n)
        dv, dy, ds, dd = derivatives((w / unit, y, s, d), drive * t, radiance * np.exp(slope * t))
        return np.concatenate([unit * tau * dv, tau * dy, tau * ds, tau * dd])

    v, y, s, d = state
    start = np.concatenate([v * unit, y, s, d])
    rtol, atol = 1e-9, 1e-11
    end = solve_ivp(rate, (0.0, 1.0), start, method="DOP853", rtol=rtol, atol=atol, t_eval=[1.0]).y[:, -1]
    w, y, s, d = end.reshape(4, n)
    return w / unit, y, s, d
