"""The continuous-time model fitted by direct multiple shooting with collocation steps (CasADi, IPOPT).

The discrete model freezes the photoreceptor's coefficients over each step; the pixel does not.  Here the light inside
a step is the same log-linear ramp, but the coefficients follow it: dx/dt = f(x, u(t)) of `dynamics/continuous.py`,
integrated by three-point Radau collocation (order 5, stiffly accurate; Hairer & Wanner, Solving ODEs II, §IV.5).

    x(t + h c_i) = x + h Σ_j a_ij f(x_j, u(t + h c_j)),   i = 1 … 3;   x(t + h) is the last stage.

f is linear in x, so the stages of one step are one linear solve and the step is an explicit expression.  Direct
multiple shooting cuts a recording into segments whose initial states are unknowns, tied by continuity constraints;
the likelihood is the same expression as everywhere (`expression.log_likelihood`).  For modest problems: thousands of
samples, not millions.
"""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import casadi as ca
import numpy as np

from pixelid.dynamics.equations import PRESENT_BELOW
from pixelid.dynamics.of_circuit import dynamics_of
from pixelid.errors import InputError
from pixelid.fit.engines.casadi_operations import CasadiOperations
from pixelid.fit.engines.engine import held_by_bounds, parameter_values, promised, scales
from pixelid.fit.engines.expression import changes, log_likelihood
from pixelid.fit.engines.frozen import freeze
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.newton import Optimum
from pixelid.fit.objective import Local

ROOT = np.sqrt(6.0)
NODES = np.array([(4.0 - ROOT) / 10.0, (4.0 + ROOT) / 10.0, 1.0])
RADAU = np.array(
    [
        [(88.0 - 7.0 * ROOT) / 360.0, (296.0 - 169.0 * ROOT) / 1800.0, (-2.0 + 3.0 * ROOT) / 225.0],
        [(296.0 + 169.0 * ROOT) / 1800.0, (88.0 + 7.0 * ROOT) / 360.0, (-2.0 - 3.0 * ROOT) / 225.0],
        [(16.0 - ROOT) / 36.0, (16.0 + ROOT) / 36.0, 1.0 / 9.0],
    ]
)
SEGMENTS = 8


@cache
def radau_step(parts: int) -> ca.Function:
    """(x (4,), u slope, τ, L at the step's start, p (5,)) → x after τ, in `parts` equal collocation steps.

    x = (v, y, s, d), the levels relative to u at the step's start;  p = (α, β, γ, follower, differencing).
    """
    x, r, tau = ca.SX.sym("x", 4), ca.SX.sym("r"), ca.SX.sym("tau")
    light, p = ca.SX.sym("L"), ca.SX.sym("p", 5)
    h = tau / parts
    state = x
    for part in range(parts):
        times = [(part + float(node)) * h for node in NODES]
        lights = [light * ca.exp(r * t) for t in times]
        v, y, s, d = (state[i] for i in range(4))
        # photoreceptor: eliminate the slopes' dependence on y, y_i = y + h Σ a_ij v_j, then solve for v_i
        A, B = ca.SX.zeros(3, 3), ca.SX.zeros(3, 1)
        for i in range(3):
            B[i] = v
            for j in range(3):
                a, b2 = p[0] * lights[j], p[1] + p[2] * lights[j]
                w = h * RADAU[i, j]
                B[i] += w * a * (r * times[j] - y)
                A[i, j] += w * b2 + (1.0 if i == j else 0.0)
                for k in range(3):
                    A[i, k] += w * a * h * RADAU[j, k]
        slopes = _solve3(A, B)
        levels = [y + h * sum(RADAU[i, j] * slopes[j] for j in range(3)) for i in range(3)]
        following = _low_pass(s, levels, p[3] * h)
        differenced = _low_pass(d, following, p[4] * h)
        state = ca.vertcat(slopes[2], levels[2], following[2], differenced[2])
    return ca.Function("radau", [x, r, tau, light, p], [state])


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


class MultipleShooting:
    """The continuous model's likelihood of an event-time objective as one constrained problem.

    parts: collocation steps per stimulus sample;  segments: per recording
    """

    def __init__(self, objective: EventTimesObjective, parts: int = 2, segments: int = SEGMENTS) -> None:
        self.objective, self.parts, self.segments = objective, parts, segments

    def expressions(self, x: np.ndarray):
        """(coordinates, states at the segments' starts, log posterior, continuity defects) at discrete choices of x.

        Raises InputError for effects the symbolic form lacks, and a source follower or amplifier without a pole.
        """
        coordinates = self.objective.coordinates
        frozen = freeze(self.objective, x)
        present = dynamics_of(frozen.circuit)
        if max(present.follower, present.differencing, present.beta) > PRESENT_BELOW:
            raise InputError("the continuous fit needs a second-order photoreceptor, a follower and an amplifier pole")
        if present.floor != 0:
            raise InputError("bandwidth_floor: not in the continuous fit; use the discrete form")
        at = ca.MX.sym("x", len(coordinates))
        circuit = coordinates.model.circuit(parameter_values(coordinates, at, ca.exp))
        nodes: list[ca.MX] = []
        defects: list[ca.MX] = []

        def changes_of(recording):
            return changes(
                CasadiOperations(), recording, circuit, frozen.circuit, True,
                lambda light, dynamics: self._integrated(light, dynamics, nodes, defects),
            )  # fmt: skip

        value = log_likelihood(CasadiOperations(), frozen, circuit, changes_of)
        for i, p in enumerate(coordinates.parameters):
            if p.prior is not None:
                value = value - 0.5 * ((at[i] - p.prior.mean) / p.prior.sd) ** 2
        return at, ca.vertcat(*nodes), value, ca.vertcat(*defects), frozen

    def _integrated(self, light, dynamics, nodes, defects):
        step = radau_step(self.parts)
        p = ca.vertcat(*(dynamics.alpha, dynamics.beta, dynamics.gamma, dynamics.follower, dynamics.differencing))
        n = light.tau.shape[0]
        one = ca.Function(
            "one", [x := ca.SX.sym("x", 4), c := ca.SX.sym("c", 4), q := ca.SX.sym("q", 5)],
            [step(x, c[0], c[1], c[2], q) - ca.vertcat(0, c[3], c[3], c[3])],
        )  # fmt: skip
        rows = ca.horzcat(light.slope, light.tau, light.radiance[:n], light.rise).T
        edges = np.linspace(0, n, min(self.segments, max(n // 8, 1)) + 1).astype(int)
        state, pieces = ca.MX.zeros(4, 1), [ca.MX.zeros(4, 1)]
        for first, last in pairwise(edges):
            if first > 0:
                node = ca.MX.sym("node", 4)
                nodes.append(node)
                defects.append(node - state)
                state = node
            states = one.mapaccum(int(last - first))(state, rows[:, first:last], ca.repmat(p, 1, int(last - first)))
            pieces.append(states)
            state = states[:, -1]
        samples = ca.horzcat(*pieces).T
        columns = [samples[:, i] for i in range(4)]

        def at(index, tau):
            op = CasadiOperations()
            r, _ = light.at(op, index)
            m = len(index)
            x = ca.horzcat(*(op.take(column, index) for column in columns)).T
            moved = step.map(m)(x, r.T, tau.T, op.take(light.radiance, index).T, ca.repmat(p, 1, m))
            return tuple(moved[i, :].T for i in range(4)), r

        return columns, at

    def value(self, x: np.ndarray) -> float:
        """The continuous model's log posterior at x (single shooting through all segments)."""
        at, nodes, value, defects, _ = self.expressions(x)
        f = ca.Function("f", [at, nodes], [value, defects])
        return float(f(x, self._nodes_at(f, x, nodes.shape[0]))[0])

    @staticmethod
    def _nodes_at(f: ca.Function, x: np.ndarray, size: int) -> np.ndarray:
        """Node states without defects: each pass carries continuity one segment further."""
        nodes = np.zeros(size)
        for _ in range(size // 4 + 1):
            defects = np.array(f(x, nodes)[1]).ravel()
            nodes = nodes - defects
            if np.abs(defects).max(initial=0.0) < 1e-13:
                break
        return nodes

    def maximise(self, start: np.ndarray, *, tolerance: float = 1e-6, solves: int = 5) -> Optimum:
        """IPOPT over coordinates and node states; discrete choices refreshed between solves.

        First derivatives are exact; curvature is built up by limited-memory updates (the exact Hessian of a mapped
        accumulation over collocation steps costs more than it saves).
        """
        lower, upper = self.objective.coordinates.bounds()
        longest = self.objective.coordinates.longest_moves()
        x = np.clip(np.asarray(start, dtype=float), lower, upper)
        local = self.objective.local(x)
        scale, steps, moved = scales(local, longest), 0, np.inf
        for _ in range(solves):
            at, nodes, value, defects, _ = self.expressions(x)
            f = ca.Function("f", [at, nodes], [value, defects])
            q = ca.MX.sym("q", len(x))
            g = ca.MX.sym("g", nodes.shape[0])
            objective_at, defects_at = f(x + scale * q, g)
            options = {
                "print_time": False, "error_on_fail": False, "show_eval_warnings": False,
                "ipopt": {"hessian_approximation": "limited-memory", "limited_memory_max_history": 30,
                          "print_level": 0, "sb": "yes", "mu_init": 1e-8, "bound_push": 1e-8, "bound_frac": 1e-8,
                          "nlp_scaling_method": "none", "tol": float(np.sqrt(tolerance)), "max_iter": 60},
            }  # fmt: skip
            problem = {"x": ca.vertcat(q, g), "f": -objective_at, "g": defects_at}
            solver = ca.nlpsol("shooting", "ipopt", problem, options)
            begin = np.concatenate([np.zeros(len(x)), self._nodes_at(f, x, nodes.shape[0])])
            free = np.full(nodes.shape[0], np.inf)
            low = np.concatenate([(np.maximum(lower, x - longest) - x) / scale, -free])
            high = np.concatenate([(np.minimum(upper, x + longest) - x) / scale, free])
            found = solver(x0=begin, lbx=low, ubx=high, lbg=0.0, ubg=0.0)
            steps += int(solver.stats()["iter_count"])
            move = np.array(found["x"]).ravel()[: len(x)]
            x, moved = x + scale * move, float(np.abs(move).max())
            if moved < 1e-2:
                break
        held = (x <= lower) | (x >= upper)
        return Optimum(x, self.objective.local(x), moved < 1e-2, held, steps)


def continuous_log_posterior(objective: EventTimesObjective, x: np.ndarray, parts: int = 2) -> float:
    """The log posterior of the continuous-time model at x; compare `objective.value(x)`, the discrete model's."""
    return MultipleShooting(objective, parts, segments=1).value(x)


def continuous_optimum(
    objective: EventTimesObjective, start: np.ndarray, parts: int = 2, tolerance: float = 1e-6, max_steps: int = 20
) -> Optimum:
    """The continuous-time model's optimum by single shooting: its exact gradient, the discrete model's information.

    The two models differ little, so that information is a good metric: a few steps from the discrete optimum.
    Bounds clip the steps.
    """
    lower, upper = objective.coordinates.bounds()
    x = np.clip(np.asarray(start, dtype=float), lower, upper)
    shooting = MultipleShooting(objective, parts, segments=1)

    def at(x):
        point, _, value, _, _ = shooting.expressions(x)
        value, gradient = ca.Function("f", [point], [value, ca.gradient(value, point)])(x)
        return Local(float(value), np.array(gradient).ravel(), objective.local(x).information)

    local = at(x)
    for step in range(max_steps):
        held = held_by_bounds(x, local, lower, upper)
        if promised(local, held) < tolerance:
            return Optimum(x, local, True, held, step)
        free = ~held
        move = np.zeros(len(x))
        move[free] = np.linalg.solve(local.information[np.ix_(free, free)], local.gradient[free])
        for _ in range(6):
            trial = np.clip(x + move, lower, upper)
            there = at(trial)
            if there.value > local.value:
                break
            move *= 0.5
        else:
            break
        x, local = trial, there
    held = held_by_bounds(x, local, lower, upper)
    return Optimum(x, local, promised(local, held) < tolerance, held, max_steps)
