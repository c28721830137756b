"""The step that names effects in the likelihood which knows shot noise, and then asks simulation once.

The filter (`likelihood/shot_noise.py`) says how much of what events scatter by is shot noise, beside whatever the model
has.  Under that noise the library is tried as ever, an effect counting by what it gains beyond its gain in sessions
that lack it.  When nothing more is named, replicates of the model with the noise check it.
"""

from __future__ import annotations

from dataclasses import replace

from pixelid.fit.maximise import Maximum
from pixelid.fit.shot_noise import EFFECT, NOISE
from pixelid.gap.attribute.attribute import Attribution, Candidate, attribute, may_be_named
from pixelid.gap.attribute.candidates import impossible, missing
from pixelid.gap.attribute.coarse_jitter import is_fine_jitter
from pixelid.gap.attribute.pixels import candidates_of
from pixelid.gap.imputation.impute import JITTER
from pixelid.gap.options import Context
from pixelid.gap.rounds import attribution_entry
from pixelid.gap.shot_noise.beside import beyond_sessions_without, settled_under_noise
from pixelid.gap.shot_noise.shares import Guess
from pixelid.gap.state import State
from pixelid.gap.steps.name_effect import MAX_ROUNDS, grown_by, with_accepted
from pixelid.likelihood.event_times import EventTimes
from pixelid.likelihood.shot_noise import share_out


def named_in_noise(state: State, context: Context) -> State | None:
    """The state with all effects named that show under the noise which the filter finds; None where it finds none."""
    first = state
    while len(state.steps) < MAX_ROUNDS:
        hypothesis, options = state.hypothesis, context.options
        if NOISE not in hypothesis.fit.coordinates.names:
            return None
        found = share_out(hypothesis.evidence.training, hypothesis.fit.model.circuit(), options.seed, free_jitter=True)
        if found is None or found.gain < options.criteria.min_shot_noise_gain_nats:
            return state if state is not first else None
        grown = _one_more(state, Guess.first(hypothesis.fit, found), context)
        if grown is None:
            return state
        state = grown
    return state


def _one_more(state: State, guess: Guess, context: Context) -> State | None:
    """The state with one effect more, under the noise of a guess; None where none is to be named."""
    hypothesis, options = state.hypothesis, context.options
    report = f"round {state.turn + 1}, in noise"
    context.report(report, 0.1)
    evidence, fit = settled_under_noise(hypothesis.evidence, guess.model, context.cache)
    skip = {*options.leave_out, *state.given_up, *([JITTER] if state.hides_jitter else [])}
    effects = [e for e in missing(fit.model) if e not in skip]
    candidates = candidates_of(evidence, fit.model, None, context.cache, context.work)
    attribution = attribute(candidates, effects, options, lambda what: context.report(f"{report}: {what}", 0.15))
    told = attribution_entry(state.turn, fit, hypothesis.seen, attribution, impossible(fit.model))
    state = replace(state, rounds=(*state.rounds, told), turn=state.turn + 1)
    able = [c for c in attribution.candidates if _may_be_named(c, hypothesis.evidence.training, context)]
    if not able:
        return None
    judged = beyond_sessions_without(
        hypothesis.evidence, guess.model, able, len(effects), options, context.cache, context.work
    )
    winner = min(judged, key=lambda c: (c.p, -c.gain))
    if winner.p >= options.alpha_each:
        return None
    return grown_without_noise(state, winner, attribution, context)


def _may_be_named(candidate: Candidate[Maximum], events: EventTimes, context: Context) -> bool:
    """Whether it may be named, and the density of single events is enough for it."""
    enough = candidate.effect != JITTER or is_fine_jitter(candidate, events)
    return enough and may_be_named(candidate, context.options)


def grown_without_noise(
    state: State, winner: Candidate[Maximum], attribution: Attribution[Maximum], context: Context
) -> State | None:
    """The state with an effect that was found under noise, which is the thresholds' again; None where nothing is left
    for the effect then."""
    bare = replace(winner, end=replace(winner.end, model=winner.end.model.without_effect(EFFECT)))
    attribution = replace(attribution, winner=bare, runners_up=())
    evidence = state.hypothesis.evidence.weighed(state.hypothesis.fit.model.circuit())
    more = grown_by(with_accepted(state, bare, attribution, True), bare, evidence, context)
    return more if more.steps and more.steps[-1].effect == winner.effect else None
