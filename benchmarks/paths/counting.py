"""The work of the formulas, counted by sending a number through them that counts its operations."""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Callable

from pixelid.dynamics import equations
from pixelid.dynamics.equations import photoreceptor_rates
from pixelid.dynamics.trajectory import Dynamics
from pixelid.nerf import scan_adjoint


class Counter:
    """+ − × ÷ of all numbers made from one another, each as one flop."""

    def __init__(self, tally: list[int]) -> None:
        self.tally = tally

    def _counted(self, *_: object) -> Counter:
        self.tally[0] += 1
        return Counter(self.tally)

    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = __truediv__ = __rtruediv__ = _counted


FACTORS = 15  # + − × ÷ of `kernels.photoreceptor_factors` where poles are real; its √ and two exp are counted apart
BY_FACTORS = 42  # of `scan_adjoint._by_factors` there
EXPONENTIALS = 5  # of a step: √ and two exp there, exp(−ω1 τ), exp(−ωd τ)


def step_flops() -> int:
    """+ − × ÷ of one step of the fourth-order chain: rates at the step's light, factors, `step_two_poles`."""
    tally = [0]
    a_number = [Counter(tally) for _ in range(16)]
    v, y, s, d, u0, r, tau, a, b2, w1, wd, f1, f2, g, k1, kd = a_number
    equations.step_two_poles((v, y, s, d), u0, r, tau, a, b2, w1, wd, (f1, f2, g), k1, kd)
    dynamics = Dynamics(alpha=a, beta=b2, gamma=g, follower=w1, extra_pole=w1, lower_cutoff=w1, differencing=wd,
                        floor=v)  # fmt: skip
    photoreceptor_rates(dynamics, u0)
    return tally[0] + FACTORS


def source_flops(function: Callable) -> int:
    """+ − × ÷ written in a function's source: right where it has neither loops nor branches."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    return sum(isinstance(node, ast.BinOp | ast.AugAssign) for node in ast.walk(tree))


def step_back_flops() -> int:
    """+ − × ÷ of one step of the gradient of the fourth-order chain."""
    parts = (equations.responses, equations.low_pass_response, equations.low_pass_response, equations.modes_of)
    return source_flops(scan_adjoint.step_back.py_func) + sum(map(source_flops, parts)) + FACTORS + BY_FACTORS
