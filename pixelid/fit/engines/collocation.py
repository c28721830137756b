"""The continuous form in CasADi: three-point Radau collocation, differentiated exactly.

Order 5 and stiffly accurate (Hairer & Wanner, Solving ODEs II, section IV.5):

    x(t + h c_i) = x + h Σ_j a_ij f(x_j, u(t + h c_j)),   i = 1 … 3;   x(t + h) is the last stage.

f is linear in x, so the stages are one linear solve and the step is an explicit expression.
"""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np

from pixelid.fit.engines.casadi_operations import CasadiOperations
from pixelid.fit.engines.continuous import ContinuousObjective, discrete_form, log_posterior
from pixelid.fit.engines.frozen import freeze
from pixelid.fit.objective import Objective

ROOT = np.sqrt(6.0)
NODES = np.array([(4.0 - ROOT) / 10.0, (4.0 + ROOT) / 10.0, 1.0])
RADAU = np.array(
    [
        [(88.0 - 7.0 * ROOT) / 360.0, (296.0 - 169.0 * ROOT) / 1800.0, (-2.0 + 3.0 * ROOT) / 225.0],
        [(296.0 + 169.0 * ROOT) / 1800.0, (88.0 + 7.0 * ROOT) / 360.0, (-2.0 - 3.0 * ROOT) / 225.0],
        [(16.0 - ROOT) / 36.0, (16.0 + ROOT) / 36.0, 1.0 / 9.0],
    ]
)
# Collocation steps are at most this long in units of the photoreceptor's 1/ωn.  Halving it moves the log-likelihood of
# the tests' recordings by less than 1e-3 nats.
LONGEST_STEP = 1.0


@cache
def radau_step(parts: int) -> ca.Function:
    """(x (4,), drive, slope, τ, L at the start, p (5,)) → x after τ, in `parts` equal collocation steps.

    x = (v, y, s, d), the levels relative to the input at the start;  p = (α, β, γ, follower, differencing).
    """
    x, drive, slope, tau = ca.SX.sym("x", 4), ca.SX.sym("drive"), ca.SX.sym("slope"), ca.SX.sym("tau")
    light, p = ca.SX.sym("L"), ca.SX.sym("p", 5)
    h = tau / parts
    state = x
    for part in range(parts):
        times = [(part + float(node)) * h for node in NODES]
        lights = [light * ca.exp(slope * t) for t in times]
        v, y, s, d = (state[i] for i in range(4))
        # photoreceptor: eliminate the slopes' dependence on y, y_i = y + h Σ a_ij v_j, then solve for v_i
        A, B = ca.SX.zeros(3, 3), ca.SX.zeros(3, 1)
        for i in range(3):
            B[i] = v
            for j in range(3):
                a, b2 = p[0] * lights[j], p[1] + p[2] * lights[j]
                w = h * RADAU[i, j]
                B[i] += w * a * (drive * times[j] - y)
                A[i, j] += w * b2 + (1.0 if i == j else 0.0)
                for k in range(3):
                    A[i, k] += w * a * h * RADAU[j, k]
        slopes = _solve3(A, B)
        levels = [y + h * sum(RADAU[i, j] * slopes[j] for j in range(3)) for i in range(3)]
        following = _low_pass(s, levels, p[3] * h)
        differenced = _low_pass(d, following, p[4] * h)
        state = ca.vertcat(slopes[2], levels[2], following[2], differenced[2])
    return ca.Function("radau", [x, drive, slope, tau, light, p], [state])


def _low_pass(start, drive, wh):
    """Stage values of x' = w (drive − x)."""
    A, B = ca.SX.zeros(3, 3), ca.SX.zeros(3, 1)
    for i in range(3):
        B[i] = start
        for j in range(3):
            B[i] += wh * RADAU[i, j] * drive[j]
            A[i, j] = wh * RADAU[i, j] + (1.0 if i == j else 0.0)
    x = _solve3(A, B)
    return [x[i] for i in range(3)]


def _solve3(A, b):
    """Solution of three equations by cofactors (well conditioned here: the identity plus a stable generator)."""
    return ca.mtimes(ca.inv_minor(A), b)


def collocation_objective(objective: Objective, x: np.ndarray, parts: int | None = None) -> ContinuousObjective:
    """The continuous form of an objective by collocation.

    Args:
        objective: the discrete form.
        x: (p,) where the search will be; decides about the number of collocation steps.
        parts: collocation steps per stimulus step; None: as many as `LONGEST_STEP` asks for.

    Raises:
        InputError: see `continuous.discrete_form`.
    """
    discrete = discrete_form(objective, x)
    if parts is None:
        parts = needed_parts(freeze(discrete, x))
    step = radau_step(parts)
    op = CasadiOperations()

    def flow(state, drive, slope, tau, radiance, dynamics):
        n = tau.shape[0]
        p = ca.vertcat(dynamics.alpha, dynamics.beta, dynamics.gamma, dynamics.follower, dynamics.differencing)
        moved = step.map(n)(ca.horzcat(*state).T, drive.T, slope.T, tau.T, radiance.T, ca.repmat(p, 1, n))
        return tuple(moved[i, :].T for i in range(4))

    def expressed(x):
        at = ca.MX.sym("x", len(x))
        return at, log_posterior(op, discrete, freeze(discrete, x), at, flow)

    def value(x):
        at, value = expressed(x)
        return float(ca.Function("value", [at], [value])(x))

    def value_and_gradient(x):
        at, value = expressed(x)
        found, gradient = ca.Function("local", [at], [value, ca.gradient(value, at)])(x)
        return float(found), np.array(gradient).ravel()

    return ContinuousObjective(discrete, value, value_and_gradient)


def needed_parts(frozen) -> int:
    """How many collocation steps a stimulus step needs, for the longest one in which the light moves."""
    most = 0.0
    for recording in frozen.recordings:
        radiance = recording.radiance + frozen.circuit.dark
        ramps = np.diff(radiance) != 0
        if ramps.any():
            rate = np.sqrt(frozen.circuit.alpha * np.maximum(radiance[1:], radiance[:-1]))
            most = max(most, float((np.diff(recording.t) * rate)[ramps].max()))
    least_parts, most_parts = 2, 32
    return int(np.clip(np.ceil(most / LONGEST_STEP), least_parts, most_parts))
