"""The continuous form of the likelihood: the photoreceptor's coefficients follow the light at every instant.

The discrete form freezes the photoreceptor at one radiance per step of the stimulus; the pixel does not.  In the
continuous form an engine integrates dx/dt = f(x, u(t)) itself, u = ln L a straight line within a step, and the rest of
the likelihood is the same expression (`expression.py`).

f is linear in the state, so the steps of a stimulus need not wait for each other: each is integrated from the four
unit states and from rest under its own ramp, all steps at once, which gives x[k+1] = A[k] x[k] + c[k]; a recurrence
joins them.  Releases and events start from the sample before them.  One trajectory serves all pixels.  Where the light
stands still the coefficients do, too, and the closed form is exact; only the steps in which it moves are integrated.

An integrator is a function `flow(state, drive, slope, tau, radiance, dynamics)` of an engine's vectors (n,), one
entry per independent problem: the state (v, y, s, d) after `tau` seconds under ln L = ln radiance + slope t, the
levels y, s, d relative to the input at the start and the input drive · t (the slope, or 0 for free motion).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from pixelid.dynamics.equations import PRESENT_BELOW
from pixelid.dynamics.of_circuit import dynamics_of
from pixelid.dynamics.trajectory import Dynamics
from pixelid.errors import InputError
from pixelid.fit.engines import expression
from pixelid.fit.engines.engine import parameter_values, with_priors
from pixelid.fit.engines.frozen import Frozen, freeze
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.objective import Local, Objective

Flow = Callable[[tuple, Any, Any, Any, Any, Dynamics], tuple]


class ContinuousObjective(Objective):
    """The continuous form of an event-time log posterior.

    Value and gradient are an engine's; the information matrix and the Hessian are the discrete form's, whose
    optimum is a fraction of a standard error away: a metric for the steps and for standard errors, to which the
    difference of the forms is of second order.

    Args:
        discrete: the discrete form.
        value: x (p,) → log posterior.
        value_and_gradient: x (p,) → (log posterior, gradient (p,)).
    """

    def __init__(
        self,
        discrete: EventTimesObjective,
        value: Callable[[np.ndarray], float],
        value_and_gradient: Callable[[np.ndarray], tuple[float, np.ndarray]],
    ) -> None:
        self.discrete, self.coordinates, self.likelihood = discrete, discrete.coordinates, discrete.likelihood
        self._value, self._value_and_gradient = value, value_and_gradient

    def value(self, x: np.ndarray) -> float:
        return self._value(x)

    def gradient(self, x: np.ndarray) -> np.ndarray:
        return self._value_and_gradient(x)[1]

    def local(self, x: np.ndarray) -> Local:
        value, gradient = self._value_and_gradient(x)
        return Local(value, gradient, self.discrete.local(x).information)

    def hessian(self, x: np.ndarray, here: Local | None = None) -> np.ndarray:
        """The discrete form's."""
        return self.discrete.hessian(x)


def discrete_form(objective: Objective, x: np.ndarray) -> EventTimesObjective:
    """The objective, checked to have a continuous form at x.

    Raises:
        InputError: pooled counts, or a circuit without all four states or with effects that expressions lack.
    """
    if not isinstance(objective, EventTimesObjective):
        raise InputError("form: the continuous form is for event times, these recordings are pooled")
    present = dynamics_of(objective.coordinates.circuit(x))
    if max(present.follower, present.differencing, present.beta) > PRESENT_BELOW:
        raise InputError(
            "form: the continuous form needs a second-order photoreceptor, source_follower_pole and differencing_pole"
        )
    if present.floor != 0.0:
        raise InputError("form: the continuous form does not know bandwidth_floor")
    freeze(objective, x)
    return objective


def log_posterior(op: Any, objective: EventTimesObjective, frozen: Frozen, x: Any, flow: Flow) -> Any:
    """The log posterior of the continuous form at an engine's vector x (p,)."""
    coordinates = objective.coordinates
    values = parameter_values(coordinates, x, op.exp)
    circuit = coordinates.model.circuit(values)
    midpoint = frozen.circuit.linearisation == "midpoint"

    def changes_of(recording, circuit, real, clock):
        def states_of(light, dynamics):
            return _states(op, recording, light, dynamics, flow)

        return expression.changes(op, recording, circuit, real, midpoint, clock, states_of)

    value = expression.log_likelihood(op, frozen, circuit, changes_of)
    return with_priors(value, coordinates, x, op.log)


def _states(op, recording, light, dynamics, flow):
    """(states at the samples, at(step index, time into it) → (states, slope)), see `expression.changes`."""
    steps = len(recording.t) - 1
    moving = np.diff(recording.radiance) != 0
    exact = op.constant((~moving).astype(float)) > 0.5
    index = np.arange(steps)
    radiance = op.take(light.radiance, index)
    tau = light.tau * op.constant(moving.astype(float))
    zero = 0.0 * light.tau

    def one_step(state, drive):
        closed = expression.step(op, state, drive, light.tau, light.linearised, dynamics)
        flown = flow(state, drive, light.slope, tau, radiance, dynamics)
        return [op.where(exact, a, b) for a, b in zip(closed, flown, strict=True)]

    columns = [one_step(tuple(1.0 + zero if i == j else zero for i in range(4)), zero) for j in range(4)]
    driven = one_step((zero, zero, zero, zero), light.slope)
    A = [[columns[j][i] if j <= max(i, 1) else 0.0 for j in range(4)] for i in range(4)]
    samples = op.recur(A, [driven[0], *(driven[i] - light.rise for i in (1, 2, 3))])

    def at(index, tau):
        slope, linearised = light.at(op, index)
        ramp = np.append(moving, False)[np.minimum(index, steps)]
        start = tuple(op.take(column, index) for column in samples)
        closed = expression.step(op, start, slope, tau, linearised, dynamics)
        moved = op.constant(ramp.astype(float))
        flown = flow(start, slope, slope, tau * moved, op.take(light.radiance, index), dynamics)
        return tuple(op.where(moved > 0.5, b, a) for a, b in zip(closed, flown, strict=True)), slope

    return samples, at
