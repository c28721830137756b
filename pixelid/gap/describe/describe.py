"""What no effect of the library explains, described: the cell of the grammar that explains most on unseen pixels.

Scores choose a few cells, the event-time likelihood fits them, and pixels that no fit has seen judge between them, a
penalty of ½ ln n for each parameter (Schwarz 1978, Annals of Statistics 6, 461; n events there) set against the gain.
A description must be significant among all the shapes tried, and gain as much as the flexible term, which follows
whatever localises the remainder.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from pixelid.fit.cache import FitCache, map_fits
from pixelid.fit.maximise import Maximum, maximise
from pixelid.gap.attribute.alternative import flexible_alternative
from pixelid.gap.attribute.significance import leads
from pixelid.gap.describe.cells import beginnings
from pixelid.gap.describe.screen import Screened, screened
from pixelid.gap.detect.diagnostics import diagnose
from pixelid.gap.detect.pixels import PixelEvidence, per_pixel
from pixelid.gap.options import Context
from pixelid.gap.state import Hypothesis
from pixelid.likelihood.event_times import EventTimes
from pixelid.stages.described import Described

# Work that is saved: each leader costs a fit.
MAX_LEADERS = 6
MAX_OF_A_COVARIATE = 2  # forms of one quantity by one covariate among them
MAX_DESCRIPTIONS = 2  # a camera that needs more needs a model
FIT_STEPS, WITHOUT_STEPS = 30, 15


@dataclass(frozen=True)
class Candidate:
    """A description fitted.

    Attributes:
        own: Its cell.
        end: The model with it, on the fit pixels.
        gain: Nats there.
        p: Chance of that gain, adjusted for all shapes tried.
        held_out: (select pixels,) nats gained.
        penalty: Nats for its parameters.
    """

    own: Described
    end: Maximum
    gain: float
    p: float
    held_out: np.ndarray
    penalty: float

    @property
    def heldout_gain(self) -> float:
        """Nats gained on the select pixels."""
        return float(self.held_out.sum())

    @property
    def worth(self) -> float:
        """The same less the penalty."""
        return self.heldout_gain - self.penalty

    def as_dict(self) -> dict:
        """What the details of the result say of it."""
        return {
            "name": self.own.name, "gain_nats": self.gain, "p_value": self.p, "heldout_gain_nats": self.heldout_gain,
            "penalty_nats": self.penalty,
        }  # fmt: skip


@dataclass(frozen=True)
class Descriptions:
    """Where the search for descriptions ended.

    Attributes:
        found: Descriptions accepted, in order.
        hypothesis: The model with them, and what it leaves.
        tried: What each round tried, for the details of the result.
    """

    found: tuple[Candidate, ...]
    hypothesis: Hypothesis
    tried: tuple[dict, ...]


def describe(hypothesis: Hypothesis, context: Context) -> Descriptions:
    """The descriptions of what a hypothesis leaves, none, one or two."""
    found, tried = [], []
    for turn in range(MAX_DESCRIPTIONS):
        context.report(f"description {turn + 1}", 0.7 + 0.02 * turn)
        evidence = hypothesis.evidence.weighed(hypothesis.fit.model.circuit())
        candidates, promising = _candidates(evidence, hypothesis.fit, context)
        term = flexible_alternative(evidence, hypothesis.fit, hypothesis.seen)
        flexible = 0.0 if term is None else float(term.held_out.sum())
        best = max(candidates, key=lambda c: c.worth, default=None)
        accepted = best if best is not None and _earns_its_place(best, flexible, context) else None
        tried.append({
            "flexible_heldout_gain_nats": flexible, "candidates": [c.as_dict() for c in candidates],
            "screened": promising, "described": None if accepted is None else accepted.own.name,
        })  # fmt: skip
        if accepted is None:
            break
        found.append(accepted)
        hypothesis = _with(hypothesis, evidence, accepted, context)
        tried[-1]["remaining_p"] = hypothesis.seen.p
        if hypothesis.seen.p >= context.options.alpha_each:
            break
    return Descriptions(tuple(found), hypothesis, tuple(tried))


def _candidates(evidence: PixelEvidence, fit: Maximum, context: Context) -> tuple[list[Candidate], dict[str, float]]:
    """(descriptions fitted to the fit pixels, best on unseen pixels first;  cell → nats that its score promises)."""
    cache = context.cache
    base = maximise(evidence.fitting, fit.model, tolerance=0.05, max_steps=25, cache=cache)
    looked_at = screened(evidence.fitting, base, beginnings(evidence.fitting, base.model))
    penalty = 0.5 * math.log(max(evidence.judging.events, 2))
    leaders = _leaders(looked_at, penalty)
    promising: dict[str, float] = {}
    for one in looked_at:
        promising.setdefault(one.own.name, one.gain)
    fitted = _Fit(base, evidence.fitting, evidence.judging, len(looked_at), penalty)
    candidates = map_fits(context.work, fitted, leaders, cache)
    candidates.sort(key=lambda c: -c.worth)
    return candidates, dict(list(promising.items())[: 2 * MAX_LEADERS])


def _parameters(own: Described) -> int:
    """How many were chosen by the data: an edge was, though no fit moves it."""
    return sum(not p.name.endswith(".reference") for p in own.parameters)


def _leaders(looked_at: list[Screened], penalty: float) -> list[Screened]:
    """The cells worth a fit, in their best shape each, a few forms of every quantity and covariate."""
    by_cell: dict[str, Screened] = {}
    for one in looked_at:
        if one.gain > penalty * _parameters(one.own):
            by_cell.setdefault(one.own.name, one)
    ranked = sorted(by_cell.values(), key=lambda one: penalty * _parameters(one.own) - one.gain)
    seen: Counter = Counter()
    leaders = []
    for one in ranked:
        pair = one.own.quantity, one.own.covariate
        seen[pair] += 1
        if seen[pair] <= MAX_OF_A_COVARIATE:
            leaders.append(one)
    return leaders[:MAX_LEADERS]


@dataclass(frozen=True)
class _Fit:
    """A description fitted.

    Attributes:
        base: The model without any.
        fitting, judging: Likelihoods of the fit pixels and of the select pixels.
        tried: Number of shapes looked at.
        penalty: Nats for each parameter.
    """

    base: Maximum
    fitting: EventTimes
    judging: EventTimes
    tried: int
    penalty: float

    def __call__(self, one: Screened, cache: FitCache | None) -> Candidate:
        end = maximise(self.fitting, one.start, tolerance=0.02, max_steps=FIT_STEPS, cache=cache)
        less = end.model.without_effect(one.own.name)
        again = maximise(self.fitting, less, tolerance=0.1, max_steps=WITHOUT_STEPS, cache=cache)
        # the model without it may owe its lower place to its other parameters
        worse = again if again.value > self.base.value else self.base
        gain = end.value - worse.value
        parameters = _parameters(one.own)
        p = min(1.0, self.tried * float(chi2.sf(2.0 * max(gain, 0.0), parameters)))
        held_out = per_pixel(self.judging, end.model) - per_pixel(self.judging, worse.model)
        return Candidate(one.own, end, gain, p, held_out, self.penalty * parameters)


def _earns_its_place(candidate: Candidate, flexible: float, context: Context) -> bool:
    criteria = context.options.criteria
    significant = candidate.p < context.options.alpha_each and leads(candidate.held_out, criteria)
    return significant and candidate.worth > max(flexible * criteria.min_description_share, 0.0)


def _with(hypothesis: Hypothesis, evidence: PixelEvidence, accepted: Candidate, context: Context) -> Hypothesis:
    """The hypothesis with a description in its model, fitted to the training pixels."""
    options = context.options
    fit = maximise(evidence.training, accepted.end.model, tolerance=0.01, max_steps=40, cache=context.cache)
    seen = diagnose(evidence.training, fit, options.criteria, options.seed, background_fraction=hypothesis.seen.allowed)
    return replace(hypothesis, evidence=evidence, fit=fit, seen=seen)
