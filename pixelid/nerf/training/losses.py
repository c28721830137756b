"""What training minimises, from the pixel's response at the samples of a batch of chains.

    change_k = yd(t_k) − ys(s_k) − (yd(s_k) − ys(s_k)) exp(−ωd (t_k − s_k))   of an interval: reset at its start s_k
               ys(t_k) − ys(s_k)                                              of a burst or part of an interval
               and to both C_on ∫ (leak + parasitic L) dt from s_k to t_k     what the amplifier drifts by itself
    rest_k   = (change_k − rise_k C_on + fall_k C_off)/C̄                      rise 1 or fall 1 for an interval
    ℓ_diff   = Huber(rest_k/√(1 + v_k)), v_k the variance of rise and fall    Low & Lee, arXiv 2409.17988, for v = 0
    ℓ_tv     = |ys(b) − ys(a)|/C̄ over a random part (a, b), bursts left out   the same
    ℓ_chain  = Huber of the running sum of rest_k along a chain minus its mean, over √(1 + Σ v/6)

C̄ grows with what training makes of all thresholds: light and thresholds that are larger together make the same events,
and no term may gain by smaller ones.  What single pixels' thresholds depart by is held in it, for a larger one would
lessen its pixel's losses.

Single differences barely feel an error that is spread over many events; the centred running sum does.  ℓ_tv is about
the light alone: what leaks is no change of it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F

from pixelid.nerf.events.intervals import Chains

# Thresholds: changes of less are none.  Two looks past everything differ by rounding alone, whose sign is no direction.
STILL = 0.02


class Weights(NamedTuple):
    """λ of the terms."""

    diff: float = 1.0
    tv: float = 0.1
    chain: float = 0.5


def changes(
    level: torch.Tensor, output: torch.Tensor, chains: Chains, cutoff: torch.Tensor | None,
    later: torch.Tensor | None = None, drift: torch.Tensor | None = None,
) -> torch.Tensor:  # fmt: skip
    """(runs, CHAIN) change over every stretch: of the amplifier since its reset, of the level over merged events.

    level, output: (n,) of `scan.respond`;  cutoff: ωd, one or (runs, 1), None for an amplifier without a pole;  later:
    s by which the resets are later than the chains say, to first order;  drift: (n,) of `amplifier_drift`
    """
    begin, end, reset = (torch.as_tensor(a, device=level.device) for a in (chains.begin, chains.end, chains.reset))
    length = torch.as_tensor(chains.t[chains.end] - chains.t[chains.begin], device=level.device)
    since = level[end] - level[begin]
    if cutoff is not None:
        amplified = output[end] - level[begin] - (output[begin] - level[begin]) * torch.exp(-cutoff * length)
        since = torch.where(reset, amplified, since)
    if later is not None:
        after = torch.as_tensor(np.minimum(chains.begin + 1, chains.end), device=level.device)
        step = torch.as_tensor(chains.t, device=level.device)
        slope = (level[after] - level[begin]) / (step[after] - step[begin]).clamp(min=1e-9)
        since = since - torch.where(reset, slope * later, torch.zeros_like(slope))
    if drift is not None:
        since = since + drift[end] - drift[begin]
    return since


def amplifier_drift(
    u: torch.Tensor,
    t: np.ndarray,
    on_threshold: torch.Tensor,
    leak_hz: torch.Tensor | float,
    leak_hz_per_radiance: torch.Tensor | float,
) -> torch.Tensor:
    """(n,) what leak and parasitic photocurrent have added up to at samples of log radiance u (n,), in ln L.

    Differences within a run count (runs follow each other).  The light is taken as linear between samples.
    t: (n,) s, sorted within each run;  on_threshold: the unit that a leak is quoted in [ln L]
    """
    rate = on_threshold * (leak_hz + leak_hz_per_radiance * torch.exp(u))
    steps = torch.as_tensor(np.diff(t), device=u.device) * 0.5 * (rate[1:] + rate[:-1])
    return torch.cat([steps.new_zeros(1), torch.cumsum(steps, dim=0)])


def terms(
    change: torch.Tensor, level: torch.Tensor, chains: Chains, on_threshold: torch.Tensor, off_threshold: torch.Tensor,
    growth: torch.Tensor | float = 1.0,
) -> dict[str, torch.Tensor]:  # fmt: skip
    """The means of ℓ_diff, ℓ_tv and ℓ_chain over the batch; thresholds: one or (runs, 1);  growth: `Pixel.growth`."""
    device = level.device
    weight, rise, fall, variance, burst = (
        torch.as_tensor(a, device=device)
        for a in (chains.weight, chains.rise, chains.fall, chains.variance, chains.burst)
    )
    mean = 0.5 * (on_threshold + off_threshold)
    mean = mean.detach() * growth / torch.as_tensor(growth).detach()
    rest = (change - rise * on_threshold + fall * off_threshold) / mean
    number = weight.sum().clamp(min=1.0)
    diff = (huber(rest / torch.sqrt(1.0 + variance)) * weight).sum() / number
    at = level[torch.as_tensor(chains.sub, device=device)]
    quiet = weight * ~burst
    asked = quiet * torch.as_tensor(chains.sub[..., 0] != chains.sub[..., 1], device=device)
    tv = ((at[..., 1] - at[..., 0]).abs() / mean * asked).sum() / asked.sum().clamp(min=1.0) * quiet.sum() / number
    running = torch.cumsum(rest * weight, dim=1)
    centre = (running * weight).sum(dim=1, keepdim=True) / weight.sum(dim=1, keepdim=True).clamp(min=1.0)
    spread = (variance * weight).sum(dim=1, keepdim=True) / 6  # of a centred random walk
    chain = (huber((running - centre) / torch.sqrt(1.0 + spread)) * weight).sum() / number
    return {"diff": diff, "tv": tv, "chain": chain}


def quiet_change(light: torch.Tensor, on_threshold: torch.Tensor, off_threshold: torch.Tensor) -> torch.Tensor:
    """Mean ℓ_quiet of log radiance (n, 2) at pairs of times in which nothing fired (see `quiet`)."""
    moved = (light[:, 1] - light[:, 0]) / (0.5 * (on_threshold + off_threshold))
    return F.smooth_l1_loss(moved, torch.zeros_like(moved), beta=STILL)


def huber(x: torch.Tensor) -> torch.Tensor:
    """Huber's loss of each: x²/2 below 1, |x| − ½ beyond."""
    return F.huber_loss(x, torch.zeros_like(x), reduction="none")


def variance_left(
    change: torch.Tensor, chains: Chains, on_threshold: torch.Tensor, off_threshold: torch.Tensor
) -> float:
    """The variance [thresholds²] of Gaussian changes that would show as much of a threshold as ℓ_diff does.

    E ψ²/E ψ' of Huber's estimate, ψ its slope: what a prior weighs against.  Early in training, when the scene explains
    little, it is above 1 and thresholds of single pixels wait; then it falls with what is left.
    """
    device = change.device
    weight, rise, fall, variance = (
        torch.as_tensor(a, device=device) for a in (chains.weight, chains.rise, chains.fall, chains.variance)
    )
    with torch.no_grad():
        mean = 0.5 * (on_threshold + off_threshold)
        rest = (change - rise * on_threshold + fall * off_threshold) / (mean * torch.sqrt(1.0 + variance))
        square = (rest.clamp(-1, 1) ** 2 * weight).sum()
        curvature = ((rest.abs() < 1) * weight).sum()
        return float(square / curvature.clamp(min=1.0))


def total(parts: dict[str, torch.Tensor], weights: Weights) -> torch.Tensor:
    """The weighted sum."""
    return weights.diff * parts["diff"] + weights.tv * parts["tv"] + weights.chain * parts["chain"]


def unexplained(change: np.ndarray, chains: Chains, on_threshold, off_threshold) -> float:
    """Root mean square of what events say beyond `change`, as a share of what they say (single events: a threshold).

    Stretches weigh as in ℓ_diff: one that says hundreds of thresholds, give or take as many, decides nothing.
    """
    said = chains.rise * on_threshold - chains.fall * off_threshold
    weight = chains.weight / (1.0 + chains.variance)
    return float(np.sqrt(((change - said) ** 2 * weight).sum() / (said**2 * weight).sum()))
