"""The pixel in continuous time: the equations of `equations.py` as a right-hand side for any ODE solver.

`right_hand_side` leaves out the stages that are absent, so that nothing infinitely stiff is handed over, and uses
only + − × ÷ on the components: the same function serves floats, complex numbers, CasADi symbols and torch tensors.

The input enters as u = ln L and L, both: the photoreceptor's coefficients follow the light at every instant, which
is what the discrete engines approach as their steps shrink.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from pixelid.dynamics.equations import (
    PRESENT_BELOW,
    derivative_low_pass,
    derivatives_photoreceptor,
    photoreceptor_rates,
)
from pixelid.dynamics.trajectory import STAGES, Dynamics


def photoreceptor_kind(dynamics: Dynamics) -> str:
    """How many poles the dynamics have there: "unlimited", "one_pole" or "second_order"."""
    if dynamics.beta < PRESENT_BELOW:
        return "second_order"
    return "one_pole" if dynamics.gamma > 0 else "unlimited"


def present_states(dynamics: Dynamics) -> tuple[str, ...]:
    """The names, in signal order, of the states that the dynamics have; absent stages left out."""
    present = {
        "photoreceptor_slope": photoreceptor_kind(dynamics) == "second_order",
        "photoreceptor": photoreceptor_kind(dynamics) != "unlimited",
        "source_follower": dynamics.follower < PRESENT_BELOW,
        "extra_pole": dynamics.extra_pole < PRESENT_BELOW,
        "lower_cutoff": dynamics.lower_cutoff > 0,
        "differencing": dynamics.differencing < PRESENT_BELOW,
    }
    return tuple(name for name in STAGES if present[name])


def right_hand_side(dynamics: Dynamics, values: Sequence[Any] | None = None) -> tuple[int, Callable]:
    """(order, f) with f(state, u, radiance) → derivatives, both tuples of `order` components.

    The components are those of `present_states(dynamics)`, in rad/s and log-radiance units.  `values`, in the
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
