"""How sure a gain is: its chance under no effect, and its lead over pixels that no fit has seen."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from pixelid import stages
from pixelid.gap.attribute.candidates import INVERSE, MAINS_HZ
from pixelid.gap.criteria import Criteria
from pixelid.model.model import Model

ON_BOUNDARY = 0.5  # share of the χ² in the mixture, the rest being 0 (Self & Liang 1987, JASA 82, 605, case 5)


def chance_of_gain(effect: str, gain_nats: float, tried: int) -> float:
    """Bonferroni-adjusted chance of an effect's gain where it is absent and `tried` effects are.

    No effect is a strength of zero, on the boundary: twice the gain is 0 or χ² with equal chance.  A strength of either
    sign has no boundary there, nor have amplitude and phase of mains flicker, which is tried at each mains frequency.
    """
    free = [p for p in stages.effect(effect).parameters if p.free]
    degrees = len(free)
    share = ON_BOUNDARY if free[0].transform == "log" else 1.0
    if effect == "mains_flicker":
        share = float(len(MAINS_HZ))
    return min(1.0, share * tried * float(chi2.sf(2.0 * max(gain_nats, 0.0), degrees)))


def leads(differences: np.ndarray, criteria: Criteria) -> bool:
    """Whether paired differences over units (pixels, stretches) are positive in sum, beyond their standard error."""
    n = len(differences)
    error = differences.std(ddof=1) * np.sqrt(n) if n > 1 else 0.0
    return bool(differences.sum() > criteria.min_lead_standard_errors * error)


def negligible(effect: str, fitted: Model, criteria: Criteria) -> bool:
    """Whether a fitted effect is far weaker than it ever is in a camera."""
    parameter = next(p for p in stages.effect(effect).parameters if p.free)
    relative = abs(fitted.values[parameter.name]) / parameter.value
    if effect in INVERSE:
        relative = 1.0 / relative
    flickers = effect == "mains_flicker"
    return relative < (criteria.min_relative_strength_flicker if flickers else criteria.min_relative_strength)
