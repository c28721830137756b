"""The continuous-time pixel by torchdiffeq, one trajectory after the other: reference trajectories and events.

For short recordings: explicit solvers take steps of about 3 / the fastest cutoff.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torchdiffeq import odeint, odeint_adjoint, odeint_event

from pixelid.dynamics.continuous import present_states, right_hand_side
from pixelid.dynamics.of_circuit import dynamics_of
from pixelid.dynamics.trajectory import Dynamics
from pixelid.errors import InputError
from pixelid.stages.circuit import Circuit

Light = Callable[[torch.Tensor], torch.Tensor]


def steady_state(dynamics: Dynamics, u: float) -> np.ndarray:
    """(order,) state under constant log radiance u: every output at u, slopes and high-passed outputs at zero."""
    names = present_states(dynamics)
    zero = {"photoreceptor_slope"} | ({"differencing"} if "lower_cutoff" in names else set())
    return np.array([0.0 if name in zero else u for name in names])


def torch_module(dynamics: Dynamics, log_radiance: Callable) -> Any:
    """`torch.nn.Module` f(t, x) → dx/dt for `torchdiffeq.odeint`: x (…, order), log_radiance(t) → u (…) tensor.

    `module.values` (8,) float64, the fields of `Dynamics`, is a parameter to differentiate or fit; entries of
    absent stages get no gradient.  Explicit solvers need steps below about 3 / the fastest cutoff.
    """

    class Pixel(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.values = torch.nn.Parameter(torch.tensor(list(dynamics), dtype=torch.float64))

        def forward(self, t, x):
            _, derivatives = right_hand_side(dynamics, tuple(self.values))
            u = log_radiance(t)
            return torch.stack(derivatives(x.unbind(-1), u, torch.exp(u)), dim=-1)

    return Pixel()


def log_linear(t: np.ndarray, radiance: np.ndarray) -> Light:
    """u(t) of samples (n,) whose log radiance is linear in between; held outside."""
    at, u = torch.as_tensor(t, dtype=torch.float64), torch.log(torch.as_tensor(radiance, dtype=torch.float64))

    def log_radiance(when):
        k = torch.clamp(torch.searchsorted(at, when.detach()), 1, len(at) - 1)
        share = torch.clamp((when - at[k - 1]) / (at[k] - at[k - 1]), 0.0, 1.0)
        return u[k - 1] + share * (u[k] - u[k - 1])

    return log_radiance


def trajectory(
    dynamics: Dynamics, log_radiance: Light, t, *, adjoint: bool = False, rtol: float = 1e-9, atol: float = 1e-10
) -> tuple[torch.nn.Module, torch.Tensor]:
    """(module, states (n, order)) at times t (n,), from the steady state at t[0]; see `torch_module`.

    `module.values.grad` receives derivatives: through the solver's operations, or by the adjoint equations, which need
    memory for one state only.
    """
    module = torch_module(dynamics, log_radiance)
    times = torch.as_tensor(t, dtype=torch.float64)
    start = torch.as_tensor(steady_state(dynamics, float(log_radiance(times[0]))), dtype=torch.float64)
    solve = odeint_adjoint if adjoint else odeint
    states = solve(module, start, times, rtol=rtol, atol=atol, method="dopri5")
    assert isinstance(states, torch.Tensor)
    return module, states


def events(
    circuit: Circuit, log_radiance: Light, start_s: float, end_s: float, *, rtol: float = 1e-9, most: int = 10_000
) -> tuple[np.ndarray, np.ndarray]:
    """(times (n,), signs (n,)) of an ideal pixel: no noise, first reference at `start_s` in steady state.

    Each crossing of change(t) = C_on or −C_off is solved for by `odeint_event`; the solver restarts from the state at
    release, a dead time later.  Raises InputError without an amplifier or with effects beyond dead time.
    """
    dynamics = dynamics_of(circuit)
    names = present_states(dynamics)
    if names[-1] != "differencing" or "lower_cutoff" in names or circuit.leak_hz or circuit.leak_hz_per_radiance:
        raise InputError("the reference events need an amplifier pole, and neither leak nor lower cutoff")
    module = torch_module(dynamics, log_radiance)
    wd, follower = dynamics.differencing, names.index("differencing") - 1
    now = torch.tensor(start_s, dtype=torch.float64)
    state = torch.as_tensor(steady_state(dynamics, float(log_radiance(now))), dtype=torch.float64)
    times, signs = [], []
    options = {"rtol": rtol, "atol": 1e-11, "method": "dopri5"}
    with torch.no_grad():
        while len(times) < most:
            level = state[follower]
            offset, released = state[-1] - level, now

            def margin(t, x, level=level, offset=offset, released=released):
                """Distance to the nearer threshold; past the end it is 0, so that the search stops."""
                change = x[-1] - level - offset * torch.exp(-wd * (t - released))
                nearer = torch.minimum(circuit.on_threshold - change, circuit.off_threshold + change)
                return torch.minimum(nearer, end_s - t)

            when, path = odeint_event(module, state, now, event_fn=margin, odeint_interface=odeint, **options)
            if float(when) >= end_s - 1e-9:
                break
            change = path[-1][-1] - level - offset * torch.exp(-wd * (when - released))
            times.append(float(when))
            signs.append(1.0 if float(change) > 0 else -1.0)
            now, state = when, path[-1]
            if circuit.refractory > 0:
                release = when + circuit.refractory
                if float(release) >= end_s:
                    break
                state = odeint(module, state, torch.stack([when, release]), **options)[-1]
                now = release
    return np.array(times), np.array(signs)
