"""The pixel's output as a weighted sum of its past inputs, y = Σ w[i] u[i].

The scan x ← A x + B u[k] + B̃ u[k+1], read backwards.  With c the row that takes the output from the last state,

    w[k+1] += c·B̃_k,    w[k] += c·B_k,    c ← c·A_k        for k = S−2 … 0.

The weights depend on the light only through the photoreceptor's linearisation.  What is left of c at the first
sample acts on the state there: for a pixel in steady state at the first sample it gives that sample the remaining
weight c·x_steady, x_steady the state under u = 1.  Then Σ w = 1 and the sum equals `integrate`.

An independent statement of what the scans and the reconstruction's response compute, accurate to the smallest weight,
at some 30 µs per weight.
Source: Low & Lee, arXiv 2409.17988, supplement (the normalised weights over a truncated past).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from oracles import first_order_hold as hold
from pixelid.dynamics.continuous import photoreceptor_kind, present_states
from pixelid.dynamics.kernels import linearised_at
from pixelid.dynamics.trajectory import STAGES, Dynamics


def output_weights(
    dt_s, radiance, dynamics: Dynamics, *, output="differencing", linearisation="newer", past="normalised"
) -> np.ndarray:
    """Weights (S, N) of the log radiance (S, N) in the output at the last sample, for N pixels at once.

    dt_s: (S−1, N) seconds between samples, ≥ 0 (0: a jump);  radiance: (S, N), > 0, any one unit;
    output: a stage but the lower cutoff, never reset;  linearisation: at the "newer" sample of each step (as in the
    paper) or at its "midpoint" (second order in the step).

    past: what stands for the light before the first sample.
        "normalised"  nothing; the weights are rescaled to sum to one (the paper).
        "steady"      the first sample's light for ever, which takes the remaining weight.  Equals `integrate`.
        "dropped"     zero log radiance: the bare weights, which sum to less than one.

    Tiny weights are as accurate, relatively, as large ones while the poles are real (see `first_order_hold`).
    Behind a lower cutoff the differencing output forgets its DC level: its weights sum to zero, not one.
    """
    radiance = np.ascontiguousarray(radiance, dtype=np.float64)
    dt_s = np.ascontiguousarray(dt_s, dtype=np.float64)
    names, row, steady, direct = _read_out(dynamics, output)
    weights = np.zeros(radiance.shape)
    remaining = np.repeat(row[None, :], radiance.shape[1], axis=0)
    weights[-1] = direct
    poles = ("unlimited", "one_pole", "second_order").index(photoreceptor_kind(dynamics))
    photoreceptor = (dynamics.alpha, dynamics.beta, dynamics.gamma)
    rate = hold.rates(dynamics, 1.0, names)
    if names:
        _backward(
            dt_s, radiance, photoreceptor, poles, rate, hold.high_pass_index(names), linearisation == "midpoint",
            remaining, weights,
        )  # fmt: skip
    if past == "steady":
        weights[0] += remaining @ steady
    elif past == "normalised":
        weights /= weights.sum(axis=0)
    return weights


def _read_out(dynamics, output):
    """(states up to the output, row (n,) that reads it, steady state (n,) under u = 1, weight of u itself)."""
    names = [name for name in present_states(dynamics) if STAGES.index(name) <= STAGES.index(output)]
    row = np.zeros(len(names))
    direct = 0.0
    level = [i for i, name in enumerate(names) if name in ("photoreceptor", "source_follower", "extra_pole")]
    if "differencing" in names:
        row[names.index("differencing")] = 1.0
    elif level:
        row[level[-1]] = 1.0
    else:
        direct = 1.0
    if "lower_cutoff" in names and "differencing" not in names:
        row[names.index("lower_cutoff")] = -1.0
    zero = ("photoreceptor_slope", "differencing") if "lower_cutoff" in names else ("photoreceptor_slope",)
    steady = np.array([0.0 if name in zero else 1.0 for name in names])
    return tuple(names), row, steady, direct


@njit(cache=True, nogil=True)
def _backward(dt, radiance, photoreceptor, poles, rate, high_pass, midpoint, remaining, weights):
    """Adds to `weights` (S, N); `remaining` (N, n) enters as the read-out row and leaves as c at the first sample."""
    alpha, beta, gamma = photoreceptor
    n = len(rate)
    A, B, B_next = np.empty((n, n)), np.empty(n), np.empty(n)
    for pixel in range(weights.shape[1]):
        c = remaining[pixel]
        for k in range(len(dt) - 1, -1, -1):
            light = linearised_at(radiance[k, pixel], radiance[k + 1, pixel], midpoint)
            if poles == 2:
                rate[0], rate[1] = beta + gamma * light, alpha * light
            elif poles == 1:
                rate[0] = gamma * light
            hold.fill(rate, poles == 2, high_pass, dt[k, pixel], A, B, B_next)
            weights[k + 1, pixel] += c @ B_next
            weights[k, pixel] += c @ B
            c[:] = c @ A
