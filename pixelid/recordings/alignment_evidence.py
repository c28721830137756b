"""How much better events follow the light at one offset than at another, in nats.

The loss of residuals is a quasi log-likelihood whose unit is estimated from the residuals themselves.  With ψ = loss',
δ the change of ψ from the one hypothesis to the other, and blocks of time b of all pixels together (they see one light,
and so share what a filter does not describe),

    Φ = Σ_b (Σ_{k in b} ψ_k δ_k)² / Σ_k ψ'_k δ_k²

is the variance of the score along the difference, per unit of curvature (Chandler & Bate 2007, Biometrika 94, 167); of
a ladder of blocks the largest counts.  D = Σ (loss of the other − loss − form)/Φ is then a log-likelihood ratio, `form`
being what a filter of the wrong form costs.  Φ is known from as few blocks as carry the difference,
ν = (Σ_b J_b)²/Σ_b J_b² of curvature J_b, so that D becomes ν/2 ln(1 + 2D/ν), the ratio with the scale profiled out (of
normal residuals, Student's t with ν degrees of freedom).

How large the difference is in any block plays no part, so a light whose information lies in a few edges identifies its
offset; a light that repeats itself leaves D below zero.
"""

from __future__ import annotations

import numpy as np

from pixelid.recordings.alignment_filter import SOFT, soft_loss

LADDER = (24, 96, 384)  # blocks of the recording's length: from a few milliseconds to what outlasts any filter
ENOUGH_NATS = 10.0  # a rival is one of some 1000 separate offsets: 5 % in all


def evidence_nats(time_s: np.ndarray, mine: np.ndarray, other: np.ndarray) -> float:
    """Quasi log-likelihood ratio of one hypothesis over another.

    Args:
        time_s: (n,) times of the changes.
        mine, other: (n,) residuals of the same changes under either.

    Returns:
        Nats; negative where the other explains them better.
    """
    if len(time_s) < 2 or np.ptp(time_s) == 0.0:
        return 0.0
    form_loss = 0.5 * 0.1**2  # a filter's form is within a tenth of a threshold; of periods in a row, 0.004 at most
    difference = float((soft_loss(other) - soft_loss(mine) - form_loss).sum())
    psi, curvature = _score(mine), (1.0 + (mine / SOFT) ** 2) ** -1.5
    along = _score(other) - psi
    information = curvature * along**2
    total = float(information.sum())
    if total <= 0.0:
        return 0.0
    unit, effective = float((psi * along) @ (psi * along)) / total, 1.0
    for blocks in LADDER:
        block = np.minimum((blocks * (time_s - time_s.min()) / np.ptp(time_s)).astype(int), blocks - 1)
        scores, shares = (np.bincount(block, values, blocks) for values in (psi * along, information))
        unit = max(unit, float(scores @ scores) / total)
        effective = total**2 / float(shares @ shares)  # of the finest
    scaled = abs(difference) / max(unit, 1e-6)
    return float(np.sign(difference) * 0.5 * effective * np.log1p(2.0 * scaled / effective))


def _score(residuals: np.ndarray) -> np.ndarray:
    return residuals / np.sqrt(1.0 + (residuals / SOFT) ** 2)
