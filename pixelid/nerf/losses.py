"""What training minimises, from the pixel's response at the samples of a batch of chains.

    change_k = yd(t_k) − ys(s_k) − (yd(s_k) − ys(s_k)) exp(−ωd (t_k − s_k))         DESIGN §1: reset at the start s_k
    ℓ_diff   = Huber((change_k − p C_p)/C̄)                                         Low & Lee, arXiv 2409.17988
    ℓ_tv     = |ys(b) − ys(a)|/C̄ over a random sub-interval (a, b)                 the same
    ℓ_chain  = Huber of the running sum of (change_k − p C_p)/C̄ along a chain, minus its mean over the chain

Single differences barely feel an error that is spread over many events; the centred running sum does.  Light that
changes within a dead time is in no term.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F

from pixelid.nerf.intervals import Chains


class Weights(NamedTuple):
    """λ of the terms."""

    diff: float = 1.0
    tv: float = 0.1
    chain: float = 0.1


def changes(level: torch.Tensor, output: torch.Tensor, chains: Chains, cutoff: torch.Tensor | None) -> torch.Tensor:
    """(runs, CHAIN) change of the amplifier over every interval.

    level, output: (n,) of `scan.respond`;  cutoff: ωd, None for an amplifier without a pole
    """
    begin, end = (torch.as_tensor(a, device=level.device) for a in (chains.begin, chains.end))
    if cutoff is None:
        return level[end] - level[begin]
    length = torch.as_tensor(chains.t[chains.end] - chains.t[chains.begin], device=level.device)
    return output[end] - level[begin] - (output[begin] - level[begin]) * torch.exp(-cutoff * length)


def terms(
    change: torch.Tensor, level: torch.Tensor, chains: Chains, on_threshold: torch.Tensor, off_threshold: torch.Tensor
) -> dict[str, torch.Tensor]:
    """The means of ℓ_diff, ℓ_tv and ℓ_chain over the batch."""
    device = level.device
    weight, on = torch.as_tensor(chains.weight, device=device), torch.as_tensor(chains.on, device=device)
    mean = 0.5 * (on_threshold + off_threshold)
    rest = (change - torch.where(on, on_threshold, -off_threshold)) / mean
    number = weight.sum().clamp(min=1.0)
    diff = (F.huber_loss(rest, torch.zeros_like(rest), reduction="none") * weight).sum() / number
    sub, share = torch.as_tensor(chains.sub, device=device), torch.as_tensor(chains.share, device=device)
    after = torch.clamp(sub + 1, max=len(level) - 1)
    at = level[sub] + share * (level[after] - level[sub])
    tv = ((at[..., 1] - at[..., 0]).abs() / mean * weight).sum() / number
    running = torch.cumsum(rest * weight, dim=1)
    centre = (running * weight).sum(dim=1, keepdim=True) / weight.sum(dim=1, keepdim=True).clamp(min=1.0)
    apart = (running - centre) * weight
    chain = F.huber_loss(apart, torch.zeros_like(apart), reduction="sum") / number
    return {"diff": diff, "tv": tv, "chain": chain}


def total(found: dict[str, torch.Tensor], weights: Weights) -> torch.Tensor:
    """The weighted sum."""
    return weights.diff * found["diff"] + weights.tv * found["tv"] + weights.chain * found["chain"]


def residual_rms(change: np.ndarray, chains: Chains, on_threshold: float, off_threshold: float) -> float:
    """Root mean square of (change − p C_p) in units of the mean threshold."""
    rest = change - np.where(chains.on, on_threshold, -off_threshold)
    weight = chains.weight
    return float(np.sqrt((rest**2 * weight).sum() / weight.sum()) / (0.5 * (on_threshold + off_threshold)))
