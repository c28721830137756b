"""How sure a gain is: its chance under no effect, and its lead over pixels that no fit has seen."""

from __future__ import annotations

import math

import numpy as np
from scipy.stats import chi2

from pixelid import stages
from pixelid.gap.criteria import Criteria
from pixelid.model.model import Model

SMALLEST = 1e-290  # chance that double precision holds: of some 660 nats and more it does not
WAYS = 2  # values shared by all recordings, or of each one's own


def chance_of_gain(effect: str, gain_nats: float, tried: int, own: int = 0) -> float:
    """Bonferroni-adjusted chance of an effect's gain where it is absent and `tried` effects are.

    No effect is a strength of zero, on the boundary: twice the gain is 0 or χ² with equal chance.  A strength of either
    sign has no boundary there, nor have amplitude and phase of a flicker.  Values that are held while the others are
    fitted (a frequency of the mains, a slope of the line) are tried one by one.

    own: values that recordings have each for themselves, in place of shared ones (`own_values`): then the effect was
    tried both ways, and this was the better one
    """
    return math.exp(log_chance_of_gain(effect, gain_nats, tried, own))


def log_chance_of_gain(effect: str, gain_nats: float, tried: int, own: int = 0) -> float:
    """The logarithm of `chance_of_gain`, which tells chances apart that are too small for a number."""
    share, degrees = _null(effect, tried, own)
    return min(0.0, math.log(share) + _log_chi2_sf(max(gain_nats, 0.0), degrees))


def gain_of_chance(effect: str, chance: float, tried: int) -> float:
    """Nats whose `chance_of_gain` that is."""
    share, degrees = _null(effect, tried, 0)
    return 0.5 * float(chi2.isf(min(chance / share, 1.0), degrees))


def _log_chi2_sf(half: float, degrees: int) -> float:
    """ln P(χ² > 2 half); where that is no number, by Γ(a, x) ~ x^(a−1) e^−x Σ (a−1)…(a−k) x^−k (DLMF 8.11.2)."""
    chance = float(chi2.sf(2.0 * half, degrees))
    if chance > SMALLEST:
        return math.log(chance)
    a = 0.5 * degrees
    terms = 8  # of the series for smaller ones, each less than a tenth of that before at 100 degrees of freedom
    total = 1.0 + sum(math.prod((a - j) / half for j in range(1, k + 1)) for k in range(1, terms))
    return (a - 1.0) * math.log(half) - half - math.lgamma(a) + math.log(total)


def _null(effect: str, tried: int, own: int) -> tuple[float, int]:
    """(share of the χ² times how often it had its chance, its degrees of freedom)."""
    new = stages.effect(effect)
    free = [p for p in new.parameters if p.free]
    degrees = len(free) + (own - len(new.starts_anew) if own else 0)
    on_boundary = 0.5  # share of the χ² in the mixture, the rest being 0 (Self & Liang 1987, JASA 82, 605, case 5)
    share = on_boundary if new.on_boundary else 1.0
    held = [values for name, values in new.tried_with.items() if name not in {p.name for p in free}]
    share *= math.prod(map(len, held))  # tried at each of them
    share *= WAYS if own else 1
    return share * tried, degrees


def price(values: int, events: int) -> float:
    """Nats that values fitted to events must gain to be worth it (Schwarz 1978, Annals of Statistics 6, 461)."""
    return 0.5 * values * math.log(max(events, 2))


def own_values(model: Model, effect: str) -> int:
    """How many values of an effect the recordings have each for themselves."""
    anew = stages.effect(effect).starts_anew
    return sum(name.split("[", 1)[0] in anew for name in model.nuisances)


def leads(differences: np.ndarray, criteria: Criteria) -> bool:
    """Whether paired differences over units (pixels, stretches) are positive in sum, beyond their standard error."""
    n = len(differences)
    error = differences.std(ddof=1) * np.sqrt(n) if n > 1 else 0.0
    return bool(differences.sum() > criteria.min_lead_standard_errors * error)


def negligible(effect: str, fitted: Model, criteria: Criteria) -> bool:
    """Whether a fitted effect is far weaker than it ever is in a camera."""
    parameter = next(p for p in fitted.library(effect) if p.free)
    relative = abs(fitted.values[parameter.name]) / parameter.value
    declared = stages.effect(effect)
    if declared.weakens:
        relative = 1.0 / relative
    periodic = declared.periodic
    return relative < (criteria.min_relative_strength_flicker if periodic else criteria.min_relative_strength)
