"""The step that looks for effects beside shot noise, in the likelihood that knows it.

To the likelihood of the rounds shot noise is threshold noise, under which a pole or a floor goes unseen; and replicates
of a model that lacks one may look as the measurement does, another pole in its place.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from scipy.stats import norm

from pixelid.fit.maximise import Maximum
from pixelid.gap.attribute.attribute import Attribution, Candidate, attribute, may_be_named
from pixelid.gap.attribute.candidates import impossible, missing
from pixelid.gap.attribute.pixels import candidates_of
from pixelid.gap.attribute.significance import negligible
from pixelid.gap.imputation.impute import JITTER
from pixelid.gap.options import Context
from pixelid.gap.phases import Phase
from pixelid.gap.rounds import attribution_entry
from pixelid.gap.shot_noise.beside import beyond_sessions_without, settled_under_noise
from pixelid.gap.shot_noise.shot_noise import ShotNoise, find_shot_noise
from pixelid.gap.state import State
from pixelid.gap.steps.name_effect import MAX_ROUNDS, with_refused
from pixelid.gap.steps.name_in_noise import grown_without_noise

# Chance of one effect's excess, from which replicates are made with it, too, whatever it gains.  A choice.
PROMISING_P = 0.01
NO_EXCESS = "sessions simulated without it gain as much by it"
NOT_WITH_NOISE = "with it in the model shot noise explains less"


def name_beside_shot_noise(state: State, context: Context) -> State:
    """The state with one effect more beside shot noise, to be asked again; where there is none, the next step's.

    Not at imputed times: what drawing them leaves, sessions simulated without a readout do not show.
    """
    noise = state.shot_noise
    if noise is None or state.imputed or len(state.steps) >= MAX_ROUNDS:
        return state.then(Phase.DISCOUNT)
    context.report("beside shot noise", 0.72)
    hypothesis, options = state.hypothesis, context.options
    evidence, fit = settled_under_noise(hypothesis.evidence, hypothesis.model, context.cache)
    skip = {*options.leave_out, *state.given_up, JITTER}
    effects = [e for e in missing(fit.model) if e not in skip]
    attribution = attribute(
        candidates_of(evidence, fit.model, None, context.cache, context.work), effects, options,
        lambda what: context.report(f"beside shot noise: {what}", 0.72),
    )  # fmt: skip
    entry = attribution_entry(len(state.rounds), fit, hypothesis.seen, attribution, impossible(fit.model))
    state = replace(state, rounds=(*state.rounds, entry))
    able = [c for c in attribution.candidates if may_be_named(c, options)]
    asked = _to_be_asked(able, len(effects), state, context)
    nearest: State | None = None
    for one in asked:
        alone = one.p < options.alpha_each
        more = _with(one, attribution, noise, state, context)
        if more is not None and not alone:
            more = _borne_out(more, one, noise, len(effects), context)
        if more is not None and (nearest is None or _left(more) < _left(nearest)):
            nearest = more
    if nearest is not None:
        return nearest.then(Phase.BESIDE_SHOT_NOISE)
    if asked:
        state = with_refused(state, asked[0], NOT_WITH_NOISE if asked[0].p < options.alpha_each else NO_EXCESS)
    return state.then(Phase.DISCOUNT)


def _left(state: State) -> float:
    """Nats by which replicates are off from the measurement."""
    return math.inf if state.shot_noise is None else state.shot_noise.left


def _borne_out(more: State, winner: Candidate[Maximum], noise: ShotNoise, tried: int, context: Context) -> State | None:
    """The state with an effect whose excess alone is not enough, where replicates with it come nearer; None where they
    do not: both chances as one (Stouffer 1949), a drop of the distance in units of its error.

    more: with the effect;  noise: without it;  tried: number of effects
    """
    assert more.shot_noise is not None
    criteria = context.options.criteria
    nearer = (noise.left - more.shot_noise.left) / criteria.min_shot_noise_gain_nats
    both = (float(norm.isf(winner.p / tried)) + nearer) / math.sqrt(2.0)
    p = min(1.0, tried * float(norm.sf(both)))
    if p >= context.options.alpha_each:
        return None
    step = more.steps[-1]
    return replace(more, steps=(*more.steps[:-1], replace(step, winner=replace(step.winner, p=p))))


def _to_be_asked(
    able: Sequence[Candidate[Maximum]], tried: int, state: State, context: Context
) -> list[Candidate[Maximum]]:
    """Candidates with which replicates are to be made, p: the chance of what each gains beside its gain in sessions
    without it.

    The one of least chance, where that promises anything, and the one that gains most: an effect that does to events
    what the noise does gains as much without it, however strong it is, and only replicates tell.
    """
    if not able:
        return []
    hypothesis, options = state.hypothesis, context.options
    judged = beyond_sessions_without(
        hypothesis.evidence, hypothesis.model, able, tried, options, context.cache, context.work
    )
    least, most = min(judged, key=lambda c: (c.p, -c.gain)), max(judged, key=lambda c: c.gain)
    promising = least.p < PROMISING_P * tried
    asked = [least] if promising else []
    if most.gain > options.criteria.min_shot_noise_gain_nats and not (promising and most is least):
        asked.append(most)
    return asked


def _with(
    winner: Candidate[Maximum], attribution: Attribution[Maximum], noise: ShotNoise, state: State, context: Context
) -> State | None:
    """The state with an effect named and shot noise found anew beside it; None where that explains less then."""
    before = replace(state, hypothesis=replace(state.hypothesis, corrected=None))
    more = grown_without_noise(before, winner, attribution, context)
    if more is None:
        return None  # times drawn anew with it leave nothing for it
    step = more.steps[-1]
    if len(more.steps) > len(state.steps):  # else it took the place of an earlier one, and follows what that did
        step = replace(step, before=state.hypothesis, noise_before=noise)
    hypothesis = more.hypothesis
    found = find_shot_noise(
        hypothesis.evidence, hypothesis.fit, hypothesis.seen, context.options, context.cache, context.work
    )
    if found is None or negligible(winner.effect, found.corrected.model, context.options.criteria):
        return None
    if found.corrected.seen.p < context.options.alpha_each and found.left > noise.left:
        return None
    hypothesis = replace(hypothesis, seen=found.corrected.seen, corrected=found.corrected)
    return replace(more, steps=(*more.steps[:-1], step), hypothesis=hypothesis, shot_noise=found)
