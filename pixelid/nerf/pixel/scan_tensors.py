"""The scan of `scan_kernels` in torch operations: all samples of all runs at once, any device.

A step is an affine map of the state, x[k] = A[k] x[k−1] + c[k], whose columns are what the closed form makes of unit
vectors.  Maps of neighbours are composed, then those of pairs, of fours, …: a run of n samples takes log₂ n rounds.
Source: Hillis & Steele, CACM 29, 1170, 1986 (parallel prefix).

Absent stages sit at cutoffs so high that their exponentials vanish; the closed form is then the identity in floating
point, as in `dynamics.equations`.  Cutoffs that coincide, which the compiled scan treats apart, are moved `APART`.
"""

from __future__ import annotations

import numpy as np
import torch

from pixelid.dynamics import equations

# Relative distance that cutoffs keep: equal ones have no closed form.  Where three coincide, slopes by them are within
# 1e-3; at 1e-4 rounding puts them off by 0.003, and at 1e-3 having been moved does
APART = 3e-4


def respond(u: torch.Tensor, dynamics: torch.Tensor, t: np.ndarray, first: np.ndarray, midpoint: bool):
    """As `scan.respond`; dynamics: (runs, 8)."""
    device = u.device
    length = np.diff(first)
    most = int(length.max()) if len(length) else 0
    # (runs, most) indices; short runs repeat their last sample, a step of no length
    place = np.minimum(np.arange(most), length[:, None] - 1) + first[:-1, None]
    index = torch.as_tensor(place, device=device)
    light, when = u[index], torch.as_tensor(t, device=device)[index]
    lower = bool(dynamics[:1, 5].sum() > 0)
    extra = bool((dynamics[:, 4] < equations.PRESENT_BELOW).any())
    short = not (lower or extra)
    zero, begin = torch.zeros_like(light[:, 0]), light[:, 0]
    rest = (begin,) if short else (begin, begin if lower else zero, zero if lower else begin)
    start = torch.stack((zero, begin, begin, *rest), dim=-1)
    states = _chained(*_steps(light, when, dynamics, start, midpoint, lower=lower, short=short))
    level = states[..., 3] - states[..., 4] if lower else states[..., 2 if short else 3]
    run = np.repeat(np.arange(len(length)), length)
    flat = torch.as_tensor(run * most + np.arange(len(u)) - first[:-1][run], device=device)
    return level.reshape(-1)[flat], states[..., -1].reshape(-1)[flat]


def _steps(
    light: torch.Tensor, when: torch.Tensor, dynamics: torch.Tensor, start: torch.Tensor, midpoint: bool, *,
    lower: bool, short: bool,
) -> tuple[torch.Tensor, torch.Tensor]:  # fmt: skip
    """(A (runs, most, S, S), c (runs, most, S)) of the steps that end at every sample; at the first, 0 and the start.

    start: (runs, S);  short: four states instead of six (`equations.step_two_poles`)
    """
    alpha, beta, gamma, w1, w2, _, wd, floor = dynamics.T[..., None]
    w2 = torch.where(_near(w2, w1), w2 * (1.0 + 2.0 * APART), w2)
    wd = torch.where(_near(wd, w1) | _near(wd, w2), wd * (1.0 - 2.0 * APART), wd)
    wh = dynamics[:1, 5:6] if lower else 0.0
    gap = when[:, 1:] - when[:, :-1]
    moved = gap > 0
    tau = torch.where(moved, gap, torch.ones_like(gap) * 1e-6)
    before, after = light[:, :-1], light[:, 1:]
    L = torch.exp(0.5 * (before + after) if midpoint else after) + floor
    a, b2 = alpha * L, beta + gamma * L
    pr, k1, kd = equations.selected_factors(torch, a, b2, tau), torch.exp(-w1 * tau), torch.exp(-wd * tau)

    # the states to step from, one behind the other: unit vectors in the dark, then nothing in the light
    number = 4 if short else 6
    unit = torch.eye(number, dtype=light.dtype, device=light.device)
    lit = torch.cat([unit.new_zeros(number), unit.new_ones(1)])[:, None, None]
    state = tuple(torch.cat([unit, unit.new_zeros(1, number)]).T[..., None, None])
    u0, r = lit * before, lit * ((after - before) / tau)
    if short:
        following = equations.step_two_poles(state, u0, r, tau, a, b2, w1, wd, pr, k1, kd)
    else:
        k2, kh = torch.exp(-w2 * tau), torch.exp(-wh * tau)
        following = equations.step_full_chain(state, u0, r, tau, a, b2, w1, w2, wh, wd, pr, k1, k2, kh, kd)
    stepped = torch.stack(torch.broadcast_tensors(*following))  # (S, S + 1, runs, most − 1)
    maps, inputs = stepped[:, :-1].permute(2, 3, 0, 1), stepped[:, -1].permute(1, 2, 0)
    maps, inputs = torch.where(moved[..., None, None], maps, unit), torch.where(moved[..., None], inputs, 0.0)
    nothing = torch.zeros_like(unit).expand(len(start), 1, number, number)
    return torch.cat([nothing, maps], dim=1), torch.cat([start[:, None], inputs], dim=1)


def _near(cutoff: torch.Tensor, other: torch.Tensor) -> torch.Tensor:
    return (cutoff - other).abs() < APART * other


def _chained(maps: torch.Tensor, inputs: torch.Tensor) -> torch.Tensor:
    """(runs, n, S) states x[k] = A[k] x[k−1] + c[k];  maps: (runs, n, S, S), A[0] = 0;  inputs: (runs, n, S)."""
    reach = 1
    while reach < inputs.shape[1]:
        later = maps[:, reach:]
        inputs = torch.cat(
            [inputs[:, :reach], inputs[:, reach:] + (later @ inputs[:, :-reach, :, None])[..., 0]], dim=1
        )
        maps = torch.cat([maps[:, :reach], later @ maps[:, :-reach]], dim=1)
        reach *= 2
    return inputs
