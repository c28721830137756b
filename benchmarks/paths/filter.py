"""The pixel's response to samples of light, with gradients, beside matrix exponentials in torch."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache

import numpy as np
import torch

from paths.counting import EXPONENTIALS, step_back_flops, step_flops
from paths.sizes import Sizes
from paths.timing import Counts, Other, Target, Task, compared
from pixelid.dynamics.of_circuit import dynamics_of
from pixelid.model.shipped import find_model
from pixelid.nerf.pixel.scan import respond
from pixelid.nerf.pixel.scan_kernels import STATES

KINDS = {"forward": (False, False), "gradient by light": (True, False), "all gradients": (True, True)}
TARGETS = {"float32": 30.0, "float64": 40.0}
PARAMETERS = [0, 1, 2, 3, 6]  # α, β, γ, ω1, ωd of `Dynamics`
# Share of the largest entry by which both may differ.  The plain way works in the type of the light (ours always in
# float64): in float32 squaring the exponentials of stiff steps costs it some digits.
AGREEMENT = {"float32": 1e-4, "float64": 1e-11}


def tasks(sizes: Sizes) -> Iterator[Task]:
    """Forward, gradient by light, all gradients; float32 and float64."""
    for precision in ("float32", "float64"):
        for kind in KINDS:
            yield Task("filter", f"filter, {kind}, {precision}", lambda k=kind, p=precision: measured(k, p, sizes))


@lru_cache(maxsize=4)
def problem(shape: tuple[int, int]) -> tuple[torch.Tensor, torch.Tensor, np.ndarray, np.ndarray]:
    """(u (S · N), dynamics (8,), t, first): N runs of S samples, light that wanders, steps of 0.3 ms on average."""
    samples, runs = shape
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.exponential(3e-4, (runs, samples)) + 1e-6, axis=1)
    u = np.log(100.0) + 0.3 * rng.standard_normal((runs, samples)).cumsum(axis=1)
    dynamics = torch.tensor(dynamics_of(find_model("dvs128").circuit()).uniform(), dtype=torch.float64)
    return torch.tensor(u.ravel()), dynamics, t.ravel(), np.arange(runs + 1) * samples


def plain(u: torch.Tensor, dynamics: torch.Tensor, t: np.ndarray, first: np.ndarray):
    """(reset level, amplifier output) by one exponential of the augmented system per step, in the type of u.

    d/dτ (v/ω, y, s, d, u, r) is linear with u' = r; all exponentials in one batch, then the steps in turn.  v is taken
    in units of ω = 1/1 ms and time in ms, so that float32 does not overflow.
    """
    runs, ms = len(first) - 1, 1e3
    light, tau = u.reshape(runs, -1), torch.as_tensor(ms * np.diff(t.reshape(runs, -1))).to(u.dtype)
    alpha, beta, gamma, w1, _, _, wd, _ = (value.to(u.dtype) for value in dynamics)
    radiance = torch.exp(0.5 * (light[:, 1:] + light[:, :-1]))
    a, b2, zero = alpha / ms**2 * radiance, (beta + gamma * radiance) / ms, torch.zeros_like(radiance)
    w1, wd, one = w1 / ms + zero, wd / ms + zero, torch.ones_like(radiance)
    rows = [
        (-b2, -a, zero, zero, a, zero),
        (one, zero, zero, zero, zero, zero),
        (zero, w1, -w1, zero, zero, zero),
        (zero, zero, wd, -wd, zero, zero),
        (zero, zero, zero, zero, zero, one),
        (zero, zero, zero, zero, zero, zero),
    ]
    system = torch.stack([torch.stack(line, dim=-1) for line in rows], dim=-2)
    step = torch.linalg.matrix_exp(system * tau[..., None, None])[..., :4, :]
    slope = (light[:, 1:] - light[:, :-1]) / tau
    state = torch.stack([zero[:, 0], light[:, 0], light[:, 0], light[:, 0]], dim=-1)
    levels, outputs = [state[:, 2]], [state[:, 3]]
    for k in range(light.shape[1] - 1):
        full = torch.cat([state, light[:, k, None], slope[:, k, None]], dim=-1)
        state = (step[:, k] @ full[..., None])[..., 0]
        levels.append(state[:, 2])
        outputs.append(state[:, 3])
    return torch.stack(levels, dim=1).reshape(-1), torch.stack(outputs, dim=1).reshape(-1)


def ours(u: torch.Tensor, dynamics: torch.Tensor, t: np.ndarray, first: np.ndarray):
    """The package's, which works in float64."""
    level, output = respond(u.double(), dynamics, t, first, engine="compiled")
    return level.to(u.dtype), output.to(u.dtype)


def once(way: Callable, kind: str, dtype: torch.dtype, shape: tuple[int, int]) -> list[torch.Tensor]:
    """Both outputs, and the gradients of a weighted sum of them by what the kind says."""
    u, dynamics, t, first = problem(shape)
    by_light, by_parameters = KINDS[kind]
    u, dynamics = u.to(dtype).detach().clone().requires_grad_(by_light), dynamics.clone().requires_grad_(by_parameters)
    level, output = way(u, dynamics, t, first)
    results = [level.detach(), output.detach()]
    if u.requires_grad:
        weights = torch.cos(torch.arange(len(u), dtype=dtype))
        ((weights * level).sum() + (weights.flip(0) * output).sum()).backward()
    if u.grad is not None:
        results.append(u.grad)
    if dynamics.grad is not None:
        results.append((dynamics * dynamics.grad)[PARAMETERS].detach())  # by logs
    return results


def apart(kind: str, dtype: torch.dtype, shape: tuple[int, int]) -> float:
    """The largest difference of any output or gradient between the two, over the largest entry."""
    pairs = zip(once(ours, kind, dtype, shape), once(plain, kind, dtype, shape), strict=True)
    return max(float((a.double() - b.double()).abs().max() / a.double().abs().max()) for a, b in pairs)


def measured(kind: str, precision: str, sizes: Sizes) -> dict:
    dtype, shape = getattr(torch, precision), sizes.filter_shape
    difference = apart(kind, dtype, shape)
    assert difference < AGREEMENT[precision], f"filter, {kind}, {precision}: the two differ by {difference:.1e}"
    backward = kind != "forward"
    counts = Counts(  # time, light and six states forwards; these, two gradients by outputs and one by light backwards
        bytes=8.0 * (2 + STATES) + backward * 8.0 * (2 + STATES + 3),
        flops=step_flops() + backward * step_back_flops(),
        exponentials=(EXPONENTIALS + 1) * (1 + backward),
    )
    other = Other("matrix exponentials", f"torch {torch.__version__}", lambda: once(plain, kind, dtype, shape))
    return compared(
        lambda: once(ours, kind, dtype, shape),
        other,
        sizes.runs,
        size=f"{shape[0]} × {shape[1]} samples",
        item="sample",
        items=shape[0] * shape[1],
        target=Target("ratio", TARGETS[precision]) if kind == "all gradients" else None,
        counts=counts,
        words="steps of a run follow one another: exponentials and divisions in a chain, not memory",
        extra={"difference": difference},
    )
