"""The alternative that every candidate has: a flexible term that follows whatever localises the remainder.

A neighbour of an effect that the library lacks gains much on held-out pixels, too.  What gives it away: a flexible term
gains more, and beside it the neighbour has little left to explain.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pixelid.fit.cache import FitCache
from pixelid.fit.maximise import Maximum, maximise
from pixelid.gap.attribute.attribute import Candidate
from pixelid.gap.attribute.candidates import missing
from pixelid.gap.attribute.flexible import Flexible, fit_flexible
from pixelid.gap.attribute.significance import chance_of_gain, leads, own_values
from pixelid.gap.detect.covariates import sort_events
from pixelid.gap.detect.diagnostics import Diagnostics
from pixelid.gap.detect.pixels import PixelEvidence, per_pixel, relative_noise
from pixelid.gap.detect.residuals import residuals
from pixelid.gap.options import Options
from pixelid.likelihood.event_times import EventTimes


@dataclass(frozen=True)
class Standing:
    """How a candidate does beside the flexible alternative.

    Attributes:
        firm: It is wanted beside the alternative, or gains more than that does.
        hopeless: It is not, and the alternative gains so much more that this is a neighbour of the truth at best.
    """

    firm: bool
    hopeless: bool = False


def flexible_alternative(evidence: PixelEvidence, fit: Maximum, seen: Diagnostics) -> Flexible | None:
    """The flexible term on what the fit pixels leave, judged on the select pixels."""
    circuit, parts = fit.model.circuit(), []
    for likelihood in (evidence.fitting, evidence.judging):
        here = residuals(likelihood, circuit)
        parts.append((likelihood, here, sort_events(likelihood, circuit, here, like=seen.factors)))
    return fit_flexible(parts[0], parts[1])


def stands(
    evidence: PixelEvidence,
    fit: Maximum,
    seen: Diagnostics,
    winner: Candidate[Maximum],
    options: Options,
    cache: FitCache | None = None,
) -> Standing:
    """Whether the winner is still wanted when a flexible term may take its place.

    Asked only where the term gains more on held-out pixels than the winner: then its shifts become part of the
    thresholds, the model is fitted with and without the effect, and the effect must keep enough gain.
    """
    criteria = options.criteria
    term = flexible_alternative(evidence, fit, seen)
    if term is None or float(term.held_out.sum()) < winner.heldout_gain:
        return Standing(True)
    fitting, judging = (_shifted(part, fit, seen, term) for part in (evidence.fitting, evidence.judging))
    without = maximise(fitting, fit.model, tolerance=0.05, max_steps=25, cache=cache)
    beside = maximise(fitting, winner.end.model, tolerance=0.05, max_steps=25, cache=cache)
    gain = beside.value - without.value
    own = own_values(winner.end.model, winner.effect)
    p = chance_of_gain(winner.effect, gain, len(missing(fit.model)), own)
    held = per_pixel(judging, beside.model) - per_pixel(judging, without.model)
    kept = gain > criteria.min_share_beside_alternative * winner.gain
    if p < options.alpha_each and leads(held, criteria) and kept:
        return Standing(True)
    overwhelmed = float(term.held_out.sum()) > criteria.max_alternative_gain_ratio * winner.heldout_gain
    return Standing(False, overwhelmed)


def _shifted(likelihood: EventTimes, fit: Maximum, seen: Diagnostics, term: Flexible) -> EventTimes:
    """The same events with the flexible term's shifts as part of their thresholds."""
    circuit = fit.model.circuit()
    here = residuals(likelihood, circuit)
    factor = next(f for f in sort_events(likelihood, circuit, here, like=seen.factors) if f.labels == term.labels)
    return likelihood.with_threshold_factor(np.exp(relative_noise(fit.model) * term.shift[factor.cell]))
