"""The scan of `scan_kernels` in torch operations: all runs side by side, one step after another, any device.

Absent stages sit at cutoffs so high that their exponentials vanish; the closed form is then the identity in floating
point, as in `dynamics.equations`.  Coinciding poles, which the compiled scan treats apart, lose digits here.
"""

from __future__ import annotations

import numpy as np
import torch

from pixelid.dynamics import equations


def respond(u: torch.Tensor, dynamics: torch.Tensor, t: np.ndarray, first: np.ndarray, midpoint: bool):
    """As `scan.respond`; dynamics: (runs, 8)."""
    device = u.device
    length = np.diff(first)
    most = int(length.max()) if len(length) else 0
    # (runs, most) indices; short runs repeat their last sample, a step of no length
    place = np.minimum(np.arange(most), length[:, None] - 1) + first[:-1, None]
    index = torch.as_tensor(place, device=device)
    light, when = u[index], torch.as_tensor(t, device=device)[index]
    alpha, beta, gamma, w1, w2, _, wd, floor = dynamics.T
    wh = dynamics[:1, 5].sum()
    start = light[:, 0]
    zero = torch.zeros_like(start)
    lower, extra = bool(wh > 0), bool((w2 < equations.PRESENT_BELOW).any())
    state = (zero, start, start, start, start if lower else zero, zero if lower else start)
    levels, outputs = [], []
    for k in range(most):
        if k:
            gap = when[:, k] - when[:, k - 1]
            moved = gap > 0
            tau = torch.where(moved, gap, torch.ones_like(gap) * 1e-6)
            log_light = 0.5 * (light[:, k] + light[:, k - 1]) if midpoint else light[:, k]
            L = torch.exp(log_light) + floor
            a, b2 = alpha * L, beta + gamma * L
            pr, r = equations.selected_factors(torch, a, b2, tau), (light[:, k] - light[:, k - 1]) / tau
            k1, kd = torch.exp(-w1 * tau), torch.exp(-wd * tau)
            v, y, s, _, z, d = state
            if lower or extra:
                after = equations.step_full_chain(
                    state, light[:, k - 1], r, tau, a, b2, w1, w2, wh if lower else 0.0, wd, pr, k1,
                    torch.exp(-w2 * tau), torch.exp(-wh * tau), kd,
                )  # fmt: skip
            else:
                v, y, s, d = equations.step_two_poles((v, y, s, d), light[:, k - 1], r, tau, a, b2, w1, wd, pr, k1, kd)
                after = (v, y, s, s, z, d)
            state = tuple(torch.where(moved, new, old) for new, old in zip(after, state, strict=True))
        levels.append(state[3] - state[4] if lower else state[3])
        outputs.append(state[5])
    run = np.repeat(np.arange(len(length)), length)
    flat = torch.as_tensor(run * most + np.arange(len(u)) - first[:-1][run], device=device)
    return torch.stack(levels, dim=1).reshape(-1)[flat], torch.stack(outputs, dim=1).reshape(-1)[flat]
