"""How much an effect has to show before a search names it, four times in five."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pixelid.gap.attribute.significance import gain_of_chance
from pixelid.gap.criteria import Criteria

POWER_SD = 0.84  # standard deviations above what is required, for a power of 80 %


def nats_needed(effect: str, alpha_each: float, tried: int, pixels: Mapping[str, Any], criteria: Criteria) -> float:
    """Nats on the training pixels that an effect has to be worth for a search to name it with a power of 80 %.

    A gain of S nats expected is a χ² of non-centrality λ = 2 S, of which √λ has about unit variance.  To be named the
    gain has to be significant on the pixels that fit, among `tried` effects, and to exceed so many of its standard
    errors on the pixels that select, where it is λ/2 ± √λ.

    Args:
        effect: Its name.
        alpha_each: Chance that naming may err by.
        tried: Number of effects tried.
        pixels: How many "fit" and "select"; both together train, and with too few pixels all do either.
        criteria: Of the search.
    """
    fit, select = int(pixels["fit"]), int(pixels["select"])
    train = fit + select if pixels.get("apart", True) else max(fit, select)
    significant = np.sqrt(2.0 * gain_of_chance(effect, alpha_each, tried)) + POWER_SD
    leading = 2.0 * (criteria.min_lead_standard_errors + POWER_SD)
    return 0.5 * train * max(significant**2 / max(fit, 1), leading**2 / max(select, 1))
