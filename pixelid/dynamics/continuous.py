"""The pixel in continuous time: the equations of `equations.py` as a right-hand side for any ODE solver.

`right_hand_side` leaves out the stages that are absent, so that nothing infinitely stiff is handed over, and uses
only + − × ÷ on the components: the same function serves floats, complex numbers, CasADi symbols and torch
tensors.  Around it, one thin adapter per solver library; CasADi and torch are imported where they are used.

The input enters as u = ln L and L, both: the photoreceptor's coefficients follow the light at every instant, which
is what the discrete engines approach as their steps shrink.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from pixelid.dynamics.equations import derivative_low_pass, derivatives_photoreceptor, photoreceptor_rates
from pixelid.dynamics.hold import photoreceptor_kind, present_states
from pixelid.dynamics.trajectory import Dynamics


def right_hand_side(dynamics: Dynamics, values: Sequence[Any] | None = None) -> tuple[int, Callable]:
    """(order, f) with f(state, u, radiance) → derivatives, both tuples of `order` components.

    The components are those of `hold.present_states(dynamics)`, in rad/s and log-radiance units.  `values`, in the
    order of the fields of `Dynamics`, replaces the numbers (by symbols, tensors); `dynamics` alone decides which
    stages are there.
    """
    names = present_states(dynamics)
    second = photoreceptor_kind(dynamics) == "second_order"
    p = Dynamics(*(dynamics if values is None else values))
    cutoffs = {"source_follower": p.follower, "extra_pole": p.extra_pole, "differencing": p.differencing}

    def derivatives(state, u, radiance):
        x = dict(zip(names, state, strict=True))
        dx = {}
        signal = u
        if second:
            a, b2 = photoreceptor_rates(p, radiance)
            v, signal = x["photoreceptor_slope"], x["photoreceptor"]
            dx["photoreceptor_slope"], dx["photoreceptor"] = derivatives_photoreceptor(v, signal, u, a, b2)
        elif "photoreceptor" in x:
            signal = x["photoreceptor"]
            dx["photoreceptor"] = derivative_low_pass(signal, u, p.gamma * (radiance + p.floor))
        for name in ("source_follower", "extra_pole", "lower_cutoff", "differencing"):
            if name == "lower_cutoff" and name in x:
                dx[name] = derivative_low_pass(x[name], signal, p.lower_cutoff)
                signal = signal - x[name]
            elif name in x:
                dx[name] = derivative_low_pass(x[name], signal, cutoffs[name])
                signal = x[name]
        return tuple(dx[name] for name in names)

    return len(names), derivatives


def steady_state(dynamics: Dynamics, u: float) -> np.ndarray:
    """(order,) state under constant log radiance u: every output at u, slopes and high-passed outputs at zero."""
    names = present_states(dynamics)
    zero = {"photoreceptor_slope"} | ({"differencing"} if "lower_cutoff" in names else set())
    return np.array([0.0 if name in zero else u for name in names])


def scipy_function(dynamics: Dynamics, log_radiance: Callable) -> Callable:
    """f(t, x) for `scipy.integrate.solve_ivp`: x (order,) or (order, k); log_radiance(t) → u for float t."""
    _, derivatives = right_hand_side(dynamics)

    def function(t, x):
        u = log_radiance(t)
        return np.stack(derivatives(tuple(x), u, np.exp(u)))

    return function


def casadi_function(dynamics: Dynamics) -> Any:
    """`casadi.Function` (x (order,), u, p (8,)) → dx/dt (order,), differentiable in everything.

    p are the fields of `Dynamics` in their order; those of absent stages have no influence.
    """
    import casadi as ca

    x, u, p = ca.SX.sym("x", len(present_states(dynamics))), ca.SX.sym("u"), ca.SX.sym("p", len(dynamics))
    _, derivatives = right_hand_side(dynamics, ca.vertsplit(p))
    dx = ca.vertcat(*derivatives(tuple(ca.vertsplit(x)), u, ca.exp(u)))
    return ca.Function("pixel", [x, u, p], [dx], ["x", "u", "p"], ["dx"])


def torch_module(dynamics: Dynamics, log_radiance: Callable) -> Any:
    """`torch.nn.Module` f(t, x) → dx/dt for `torchdiffeq.odeint`: x (…, order), log_radiance(t) → u (…) tensor.

    `module.values` (8,) float64, the fields of `Dynamics`, is a parameter to differentiate or fit; entries of
    absent stages get no gradient.  Explicit solvers need steps below about 3 / the fastest cutoff.
    """
    import torch

    class Pixel(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.values = torch.nn.Parameter(torch.tensor(list(dynamics), dtype=torch.float64))

        def forward(self, t, x):
            _, derivatives = right_hand_side(dynamics, tuple(self.values))
            u = log_radiance(t)
            return torch.stack(derivatives(x.unbind(-1), u, torch.exp(u)), dim=-1)

    return Pixel()
