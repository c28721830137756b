"""The rival that every candidate has: a term without a name, free to follow whatever localises the remainder.

A neighbour of an unknown effect gains much on held-out pixels, too.  What gives it away: a nameless term gains more,
and beside it the neighbour has little left to explain.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from pixelid import stages
from pixelid.gap.attribute import Candidate, Pools, secure
from pixelid.gap.candidates import missing
from pixelid.gap.climb import Climbed, climbed, per_pixel
from pixelid.gap.covariates import factors
from pixelid.gap.flexible import Flexible, flexible
from pixelid.gap.residuals import residuals
from pixelid.gap.workbench import Look, Workbench, relative_noise
from pixelid.likelihood.event_times import EventTimes

REMAINS = 0.5  # of its gain an effect must keep beside a nameless term that gains more than it does
OVERWHELMED = 4.0  # times its held-out gain: a nameless term that gains so much more ends the search


@dataclass(frozen=True)
class Standing:
    """firm: the candidate is wanted beside the nameless term, or that gains less;  hopeless: it is not, and the term
    gains so much more that whatever else is missing, this is a neighbour at best."""

    firm: bool
    hopeless: bool = False


def nameless(bench: Workbench, current: Climbed, seen: Look) -> Flexible | None:
    """The nameless term on what the fit pixels leave, judged on the select pixels."""
    held = bench.pools.select
    fit = bench.pools.fit
    parts = []
    for likelihood in (fit, held):
        here = residuals(likelihood, current.model.circuit())
        parts.append((likelihood, here, factors(likelihood, current.model.circuit(), here, like=seen.factors)))
    return flexible(parts[0], parts[1])


def standing(bench: Workbench, current: Climbed, seen: Look, winner: Candidate, alpha: float) -> Standing:
    """Whether the winner is still wanted when a nameless term may take its place.

    Asked only where the nameless term gains more on held-out pixels than the winner: then the term's shifts become
    part of the thresholds, the model is fitted with and without the effect, and the effect must keep enough gain.
    """
    term = nameless(bench, current, seen)
    if term is None or float(term.held_out.sum()) < winner.heldout_gain:
        return Standing(True)
    sigma = relative_noise(current.model)
    pools = Pools(
        *(
            _shifted(part, current, seen, term, sigma)
            for part in (bench.pools.scout, bench.pools.fit, bench.pools.select)
        )
    )
    without = climbed(pools.fit, current.model, tolerance=0.05, max_steps=25)
    beside = climbed(pools.fit, winner.end.model, tolerance=0.05, max_steps=25)
    gain = beside.value - without.value
    degrees = sum(p.free for p in stages.effect(winner.effect).parameters)
    p = len(missing(current.model)) * 0.5 * float(chi2.sf(2.0 * max(gain, 0.0), degrees))
    held = per_pixel(pools.select, beside.model) - per_pixel(pools.select, without.model)
    if p < alpha and secure(held) and gain > REMAINS * winner.gain:
        return Standing(True)
    return Standing(False, float(term.held_out.sum()) > OVERWHELMED * winner.heldout_gain)


def _shifted(likelihood: EventTimes, current: Climbed, seen: Look, term: Flexible, sigma: float) -> EventTimes:
    """The same events with the nameless term's shifts as part of their thresholds."""
    here = residuals(likelihood, current.model.circuit())
    factor = next(
        f for f in factors(likelihood, current.model.circuit(), here, like=seen.factors) if f.labels == term.labels
    )
    moved = EventTimes(likelihood.recordings)
    moved.threshold_factor = np.exp(sigma * term.shift[factor.cell])
    return moved
