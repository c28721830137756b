"""What no effect of the library explains, described: the cell of the grammar that explains most on unseen pixels.

Scores choose a few cells, the event-time likelihood fits them, and pixels that no fit has seen judge between them, a
penalty of ½ ln n for each parameter (Schwarz 1978, Annals of Statistics 6, 461; n events there) set against the gain.
A description must be significant among all the shapes tried, and gain as much as the flexible term, which follows
whatever localises the remainder.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy.stats import chi2

from pixelid.fit.cache import FitCache, map_fits
from pixelid.fit.maximise import Maximum, maximise, maximise_with_restarts
from pixelid.gap.attribute.alternative import flexible_alternative
from pixelid.gap.attribute.significance import leads, price
from pixelid.gap.describe.cells import beginnings, covariates
from pixelid.gap.describe.screen import Screened, screened
from pixelid.gap.detect.diagnostics import diagnose
from pixelid.gap.detect.pixels import PixelEvidence, per_pixel
from pixelid.gap.options import Context, Options
from pixelid.gap.state import Hypothesis
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import Model
from pixelid.stages.described import Described

# Work that is saved: each leader costs a fit.
MAX_LEADERS = 6
MAX_OF_A_COVARIATE = 2  # forms of one quantity by one covariate among them
MAX_DESCRIPTIONS = 2  # a camera that needs more needs a model
FIT_STEPS, WITHOUT_STEPS = 30, 15
# Of a step, whose edge no fit moves: it is looked for as far as the next one that was screened, then between two of
# these.
EDGES_TRIED, EDGE_SPANS = 25, (0.25, 0.02)
NEARLY = 1e-3  # zero, as a share of a dead time: where a fit can move either way


@dataclass(frozen=True)
class Candidate:
    """A description fitted.

    Attributes:
        own: Its cell.
        end: The model with it, on the fit pixels.
        gain: Nats there.
        p: Chance of that gain, adjusted for all shapes tried.
        held_out: (select pixels,) nats gained.
        judged: (select pixels,) log-likelihood.
        penalty: Nats for its parameters.
    """

    own: Described
    end: Maximum
    gain: float
    p: float
    held_out: np.ndarray
    judged: np.ndarray
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
        judged: (select pixels,) log-likelihood of the model, fitted to the fit pixels.
        penalty: Nats for each parameter.
    """

    found: tuple[Candidate, ...]
    hypothesis: Hypothesis
    tried: tuple[dict, ...]
    judged: np.ndarray
    penalty: float

    @property
    def price(self) -> float:
        """Nats for the parameters of the descriptions."""
        return sum(one.penalty for one in self.found)


class Rival(Protocol):
    """What an effect gains on the fit pixels, and on those that no fit saw."""

    @property
    def gain(self) -> float: ...

    @property
    def heldout_gain(self) -> float: ...


def describe(
    hypothesis: Hypothesis, context: Context, elsewhere: Callable[[Hypothesis], Model | None] = lambda _: None
) -> Descriptions:
    """The descriptions of what a hypothesis leaves, none, one or two.

    What one description does not explain as much of as the flexible term, two may: such a first one is kept if a second
    one beside it brings both together to more than the term.

    Args:
        hypothesis: Whose model something is left of.
        context: Of the search.
        elsewhere: Where descriptions are fitted from as well as from a hypothesis; None where that is to be trusted.
    """
    options = context.options
    ended, at = None, hypothesis
    found: list[Candidate] = []
    tried: list[dict] = []
    wanted = worth = 0.0
    for turn in range(MAX_DESCRIPTIONS):
        context.report(f"description {turn + 1}", 0.7 + 0.02 * turn)
        evidence = at.evidence.weighed(at.fit.model.circuit())
        looked_at = _candidates(evidence, _promises(evidence, at.fit, context), elsewhere(at), context)
        if ended is None:
            ended = Descriptions((), hypothesis, (), looked_at.judged, looked_at.penalty)
        term = flexible_alternative(evidence, at.fit, at.seen)
        flexible = 0.0 if term is None else float(term.held_out.sum())
        best = max(looked_at.candidates, key=lambda c: c.worth, default=None)
        wanted = wanted or flexible
        worth += 0.0 if best is None else best.worth
        tried.append({
            "flexible_heldout_gain_nats": flexible, "candidates": [c.as_dict() for c in looked_at.candidates],
            "screened": looked_at.promising, "described": None,
        })  # fmt: skip
        enough = worth > wanted * options.criteria.min_description_share
        if best is None or not _holds(best, options) or not (enough or turn + 1 < MAX_DESCRIPTIONS):
            break
        found.append(best)
        at = _with(at, evidence, best, context)
        if enough:
            for one, told in zip(found[len(ended.found) :], tried[len(ended.found) :], strict=True):
                told["described"] = one.own.name
            tried[-1]["remaining_p"] = at.seen.p
            ended = replace(ended, found=tuple(found), hypothesis=at, judged=best.judged)
            wanted = worth = 0.0
            if at.seen.p >= options.alpha_each:
                break
    assert ended is not None
    return replace(ended, tried=tuple(tried))


def describes_better(
    evidence: PixelEvidence, fit: Maximum, rival: Rival, elsewhere: Model | None, context: Context
) -> bool:
    """Whether a description explains more than an effect does, on pixels that no fit saw.

    Args:
        evidence: Of a hypothesis, weighed.
        fit: Its model.
        rival: The effect, fitted beside it.
        elsewhere: Where descriptions are fitted from as well.
        context: Of the search.
    """
    promises = _promises(evidence, fit, context)
    # Of a rival's gain, that a score must promise for descriptions to be fitted: behind true jitters of 0.3 to 4
    # times the typical one scores promised 0.05 to 0.17 of what the jitter gained.
    worth_a_fit = 0.5
    if max((one.gain for one in promises.screened), default=0.0) < worth_a_fit * rival.gain:
        return False
    candidates = _candidates(evidence, promises, elsewhere, context).candidates
    best = max(candidates, key=lambda c: c.worth, default=None)
    return best is not None and _holds(best, context.options) and best.worth > rival.heldout_gain


@dataclass(frozen=True)
class _Looked:
    """Descriptions looked at beside a model.

    Attributes:
        candidates: Fitted to the fit pixels, best on unseen pixels first.
        promising: Cell → nats that its score promises.
        judged, penalty: As of `Descriptions`, of the model without any of them.
    """

    candidates: list[Candidate]
    promising: dict[str, float]
    judged: np.ndarray
    penalty: float


def _candidates(evidence: PixelEvidence, promises: _Promises, elsewhere: Model | None, context: Context) -> _Looked:
    """The leading ones of descriptions that were screened, fitted."""
    base, looked_at, penalty = promises.base, promises.screened, promises.penalty
    leaders = _leaders(looked_at, penalty)
    promising: dict[str, float] = {}
    for one in looked_at:
        promising.setdefault(one.own.name, one.gain)
    fitted = _Fit(base, elsewhere, evidence.fitting, evidence.judging, promises.seen, len(looked_at), penalty)
    candidates = map_fits(context.work, fitted, leaders, context.cache)
    candidates.sort(key=lambda c: -c.worth)
    promising = dict(list(promising.items())[: 2 * MAX_LEADERS])
    return _Looked(candidates, promising, per_pixel(evidence.judging, base.model), penalty)


@dataclass(frozen=True)
class _Promises:
    """What descriptions promise beside a model.

    Attributes:
        base: The model on the fit pixels.
        screened: Every description there, by what its score promises.
        penalty: Nats for each parameter.
        seen: As of `covariates`.
    """

    base: Maximum
    screened: list[Screened]
    penalty: float
    seen: dict[str, np.ndarray]


def _promises(evidence: PixelEvidence, fit: Maximum, context: Context) -> _Promises:
    """What descriptions promise beside a fitted model."""
    base = maximise(evidence.fitting, fit.model, tolerance=0.05, max_steps=25, cache=context.cache)
    seen = covariates(evidence.fitting)
    looked_at = screened(evidence.fitting, base, beginnings(seen, base.model))
    return _Promises(base, looked_at, price(1, evidence.judging.events), seen)


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
        elsewhere: Where fits start from as well.
        fitting, judging: Likelihoods of the fit pixels and of the select pixels.
        seen: Covariate → its values at the events that are fitted.
        tried: Number of shapes looked at.
        penalty: Nats for each parameter.
    """

    base: Maximum
    elsewhere: Model | None
    fitting: EventTimes
    judging: EventTimes
    seen: dict[str, np.ndarray]
    tried: int
    penalty: float

    def __call__(self, one: Screened, cache: FitCache | None) -> Candidate:
        def best(model: Model, than: Maximum | None) -> Maximum:
            end = maximise(self.fitting, model, tolerance=0.02, max_steps=FIT_STEPS, cache=cache)
            return end if than is None or end.value > than.value else than

        end = best(one.start, None)
        if self.elsewhere is not None:
            end = best(self.elsewhere.with_effect(one.own.name, one.own.own(end.model.values)), end)
        at_zero = _with_dead_time_at_zero(one.own, end.model)
        end = end if at_zero is None else best(at_zero, end)
        if one.own.form == "step":
            for span in EDGE_SPANS:
                moved = self._with_better_edge(one.own, end, span)
                end = end if moved is None else best(moved, end)
        less = end.model.without_effect(one.own.name)
        again = maximise(self.fitting, less, tolerance=0.1, max_steps=WITHOUT_STEPS, cache=cache)
        # the model without it may owe its lower place to its other parameters
        worse = again if again.value > self.base.value else self.base
        gain = end.value - worse.value
        parameters = _parameters(one.own)
        p = min(1.0, self.tried * float(chi2.sf(2.0 * max(gain, 0.0), parameters)))
        if one.own.form == "relaxation" and one.own.own(end.model.values)["scale"] > np.max(
            self.seen[one.own.covariate]
        ):
            p = 1.0  # no event saw it fade: it is a constant, and gains what a constant does
        judged = per_pixel(self.judging, end.model)
        held_out = judged - per_pixel(self.judging, worse.model)
        return Candidate(one.own, end, gain, p, held_out, judged, self.penalty * parameters)

    def _with_better_edge(self, own: Described, end: Maximum, span: float) -> Model | None:
        """The model with the edge of a step where it explains most, all else as it is; None for where it is.

        span: how far it may move, as a share of the events
        """
        values, name = np.sort(self.seen[own.covariate]), f"{own.name}.edge"
        share = np.searchsorted(values, end.model.values[name]) / len(values)
        edges = np.unique(np.quantile(values, np.clip(share + span * np.linspace(-1.0, 1.0, EDGES_TRIED), 0.0, 1.0)))
        models = [end.model.set({name: float(edge)}) for edge in edges]
        explained = [self.fitting.log_likelihood(model.circuit()) for model in models]
        best = int(np.argmax(explained))
        return models[best] if explained[best] > end.value else None


def _with_dead_time_at_zero(own: Described, model: Model) -> Model | None:
    """The model with a dead time of (nearly) zero after the polarity where a description has it below, the other as it
    is; None where no dead time is.

    Below zero all are the same, so that a fit which gets there does not come back.
    """
    if (own.quantity, own.covariate) != ("dead_time", "previous_polarity") or "refractory_s" not in model.values:
        return None
    name = f"{own.name}.strength"
    dead, strength = model.values["refractory_s"], model.values[name]
    if abs(strength) <= dead:
        return None
    half = 0.5 * (dead + abs(strength))
    return model.set({"refractory_s": (1.0 + NEARLY) * half, name: math.copysign((1.0 - NEARLY) * half, strength)})


def _holds(candidate: Candidate, options: Options) -> bool:
    """Whether a description's gain is significant, and worth its parameters on the select pixels."""
    return candidate.p < options.alpha_each and leads(candidate.held_out, options.criteria) and candidate.worth > 0.0


def _with(hypothesis: Hypothesis, evidence: PixelEvidence, accepted: Candidate, context: Context) -> Hypothesis:
    """The hypothesis with a description in its model, fitted to the training pixels."""
    options = context.options
    start = hypothesis.start.with_effect(accepted.own.name, accepted.own.own(accepted.end.model.values))
    fit = maximise_with_restarts(
        evidence.training, accepted.end.model, start, tolerance=0.01, max_steps=40, cache=context.cache
    )
    seen = diagnose(evidence.training, fit, options.criteria, options.seed, background_fraction=hypothesis.seen.allowed)
    return replace(hypothesis, evidence=evidence, fit=fit, seen=seen, start=start)
