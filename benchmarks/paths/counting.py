"""The work of a step of the fourth-order chain, counted in the source of its formulas, which have neither loops nor
branches."""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Callable

from pixelid.dynamics import equations
from pixelid.nerf.pixel import scan_adjoint

# + − × ÷ where the photoreceptor's poles are real, of functions that have branches
FACTORS = 15  # `kernels.photoreceptor_factors`
BY_FACTORS = 42  # `scan_adjoint._by_factors`
EXPONENTIALS = 5  # of a step: √ and two exp in `photoreceptor_factors`, exp(−ω1 τ), exp(−ωd τ)
RESPONSES = (equations.responses, equations.low_pass_response, equations.low_pass_response)


def flops(function: Callable) -> int:
    """+ − × ÷ written in a function's source, those of functions it calls left out."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    return sum(isinstance(node, ast.BinOp | ast.AugAssign) for node in ast.walk(tree))


def step_flops() -> int:
    """Of a step forwards: rates at its light, factors, `step_two_poles`."""
    parts = (
        equations.photoreceptor_rates,
        equations.step_two_poles,
        *RESPONSES,
        equations.modes_of,
        equations.state_of,
    )
    return sum(map(flops, parts)) + FACTORS


def step_back_flops() -> int:
    """Of a step of the gradient."""
    parts = (scan_adjoint.step_back.py_func, *RESPONSES, equations.modes_of)
    return sum(map(flops, parts)) + FACTORS + BY_FACTORS
