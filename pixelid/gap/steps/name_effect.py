"""The step that names an effect: attribute what is left, and accept the leading effect where it stands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from pixelid import stages
from pixelid.fit.maximise import Maximum, maximise, maximise_with_restarts
from pixelid.gap.attribute.alternative import stands
from pixelid.gap.attribute.attribute import Attribution, Candidate, attribute, may_be_named
from pixelid.gap.attribute.candidates import (
    SLEW,
    canonical,
    holds_together,
    impossible,
    missing,
    remove_effect,
)
from pixelid.gap.attribute.coarse_jitter import coarse_jitter, is_fine_jitter
from pixelid.gap.attribute.pixels import candidates_of, slewing_both_ways
from pixelid.gap.attribute.significance import leads
from pixelid.gap.describe.describe import describes_better
from pixelid.gap.detect.diagnostics import diagnose
from pixelid.gap.detect.pixels import (
    DEAD_TIME,
    NOISE,
    PixelEvidence,
    at_rest,
    is_noisy,
    reconsider_field,
    reconsider_stimuli,
    relative_noise,
)
from pixelid.gap.detect.words import where
from pixelid.gap.imputation.exact import LOST, loses_where_times_are_exact
from pixelid.gap.imputation.impute import (
    JITTER,
    impute_behind_jitter,
    impute_changed,
    impute_with_effect,
)
from pixelid.gap.options import Context
from pixelid.gap.phases import Phase
from pixelid.gap.rounds import Rounds, amended, attribution_entry, withdrawn
from pixelid.gap.shot_noise.shot_noise import looks_like_shot_noise, noise_explains_more
from pixelid.gap.state import Hypothesis, NamedStep, State
from pixelid.gap.steps.impute_hypothesis import Setting, at_imputed_times
from pixelid.model.model import Model

NOTHING_LEFT_FOR_IT = "at times drawn with it in the model nothing is left for it"
ONLY_WHERE_DRAWN = "nothing is lost where the readout was idle and times are known, or no more than drawing leaves"
DESCRIBED_BETTER = "a description explains more on pixels that no fit has seen"
NOISE_EXPLAINS_MORE = "shot noise beside it would explain more than it does, which drawn times cannot bear out"
UNLIKE_JITTER = "what it would take of the times does not look like one"
MAX_ROUNDS = 4  # a camera that lacks more effects than this lacks a model


def name_effect(state: State, context: Context) -> State:
    """One round: the state with one effect more, or as it is where none can be named."""
    state = _named_one_more(state, context)
    return state if state.phase is Phase.NAME else _without_unlike_jitter(state, context)


def name_what_settles(state: State, context: Context) -> State | None:
    """The state with an effect that, tried from the fitted values alone, leaves nothing to explain; None without one.

    Asked only where a round would begin with more than that: shot noise, or effects tried from the shipped values as
    well.  Nothing else may explain the events as well.
    """
    before, options = state.hypothesis, context.options
    noisy = not state.steps and looks_like_shot_noise(before.seen, options.criteria)
    if state.imputed or not (noisy or restart(state, context) is not None):
        return None
    evidence = before.evidence.weighed(before.fit.model.circuit())
    attribution = _attribute(state, evidence, None, context)
    winner = attribution.winner
    if winner is None or attribution.runners_up:
        return None
    if winner.effect == JITTER and not is_fine_jitter(winner, evidence.training):
        return None
    if not stands(evidence, before.fit, before.seen, winner, options, context.cache).firm:
        return None
    named = with_accepted(_after_round(state, attribution, context), winner, attribution, True)
    grown = grown_by(named, winner, evidence, context)
    left = grown.remainder(options.alpha_each) or restart(grown, context) is not None
    return None if left else grown.then(_next(grown))


def _after_round(state: State, attribution: Attribution[Maximum], context: Context) -> State:
    """The state with one more round on record."""
    fit, seen = state.hypothesis.fit, state.hypothesis.seen
    rounds = (*state.rounds, attribution_entry(state.turn, fit, seen, attribution, impossible(fit.model)))
    state = state.then(Phase.SHOT_NOISE, rounds=rounds, turn=state.turn + 1)
    if state.turn > 1:
        return state
    return state.with_global_p(c.p for c in attribution.candidates if leads(c.held_out, context.options.criteria))


def _named_one_more(state: State, context: Context) -> State:
    hypothesis = state.hypothesis
    # one likelihood for the model and all that is tried beside it
    evidence = hypothesis.evidence.weighed(hypothesis.fit.model.circuit())
    attribution = _attribute(state, evidence, restart(state, context), context)
    state = _after_round(state, attribution, context)
    winner = attribution.winner
    if winner is None and state.imputed and [c.effect for c in attribution.candidates[:1]] == [LOST]:
        # drawing misplaces some events, and what explains these best is no more than that
        return _without_lost(state)
    if winner is None or winner.effect == JITTER:
        slewing = _slewing_through_new_poles(state, 0.0 if winner is None else winner.gain, context)
        if slewing is not None:
            return slewing.then(_next(slewing))
    if winner is None:
        return _with_jitter_instead(state, state, attribution, context)
    if winner.effect == JITTER and not state.imputed:  # for which any scatter passes
        elsewhere = restart(state, context)
        if describes_better(evidence, hypothesis.fit, winner, elsewhere, context):
            return with_refused(state, winner, DESCRIBED_BETTER)
    standing = stands(evidence, hypothesis.fit, hypothesis.seen, winner, context.options, context.cache)
    if standing.hopeless:
        refused = with_refused(state, winner, "a flexible alternative explains more, and leaves it little to explain")
        return _with_jitter_instead(refused, state, attribution, context)
    if state.imputed and noise_explains_more(evidence, winner.end.model, winner.gain, context.options):
        return with_refused(state, winner, NOISE_EXPLAINS_MORE)
    if winner.effect == LOST and _is_misplaced(state, winner.end.model, hypothesis.fit.model, context):
        return _without_lost(with_refused(state, winner, ONLY_WHERE_DRAWN))
    accepted = with_accepted(state, winner, attribution, standing.firm)
    if winner.effect == JITTER and not is_fine_jitter(winner, evidence.training):
        coarse = _behind_coarse_jitter(state, attribution, context) if is_astray(state, context) else None
        if coarse is not None:
            return coarse
        grown = _behind_jitter(accepted, winner, context)
        if _is_unlike(grown, context) and not state.jitter_given_up:
            other = _another_first(replace(state, jitter_given_up=True), attribution, context)
            grown = grown if other is None else other
    else:
        grown = _with_jitter_instead(grown_by(accepted, winner, evidence, context), state, attribution, context)
    return grown.then(_next(grown))


def _without_lost(state: State) -> State:
    """The state with lost events tried no more, and the next round."""
    return replace(state, given_up=state.given_up | {LOST}).then(_next(state))


def _next(state: State) -> Phase:
    return Phase.NAME if state.turn < MAX_ROUNDS else Phase.SHOT_NOISE


def _attribute(
    state: State, evidence: PixelEvidence, elsewhere: Model | None, context: Context
) -> Attribution[Maximum]:
    """elsewhere: where effects are tried from as well as from the fitted values"""
    options, hypothesis = context.options, state.hypothesis
    model = hypothesis.fit.model
    skip = {*options.leave_out, *state.given_up, *([JITTER] if state.hides_jitter else [])}
    share = 0.1 + 0.6 * state.turn / MAX_ROUNDS
    candidates = candidates_of(evidence, model, elsewhere, context.cache, context.work, state.on_paths)
    return attribute(
        candidates, [e for e in missing(model) if e not in skip], options,
        lambda what: context.report(f"round {state.turn + 1}: {what}", share),
    )  # fmt: skip


def restart(state: State, context: Context) -> Model | None:
    """Where effects are tried from as well as from the fitted values; None where those are to be trusted.

    Threshold noise covers for what is missing, and once it is large nothing is surprising enough to find what that was:
    there the effects are tried from the shipped noise.
    """
    hypothesis = state.hypothesis
    if state.on_paths:
        return None  # paths lie near the model they are of
    if is_noisy(hypothesis.fit.model, state.model):
        return hypothesis.start.set({NOISE: state.model.values[NOISE]})
    options = context.options
    astray = hypothesis.seen.has_excess_background(options.criteria.max_unexplained_fraction, options.alpha_each)
    return hypothesis.start if astray or not hypothesis.fit.converged else None


def with_refused(state: State, winner: Candidate[Maximum], why: str) -> State:
    return replace(state, rounds=amended(state.rounds, -1, refused=f"{winner.effect}: {why}"))


def with_accepted(state: State, winner: Candidate[Maximum], attribution: Attribution[Maximum], firm: bool) -> State:
    """The state with the winner among its steps, the hypothesis as it was."""
    hypothesis = state.hypothesis
    seen, noise = hypothesis.seen, relative_noise(hypothesis.fit.model)
    place = where(seen.maps, hypothesis.evidence.training, seen.residual.background, noise)
    step = NamedStep(winner, attribution, place, firm, hypothesis)
    return replace(state, steps=(*state.steps, step), rounds=amended(state.rounds, -1, named=winner.effect))


def grown_by(state: State, winner: Candidate[Maximum], evidence: PixelEvidence, context: Context) -> State:
    """The state with the winner in its model, and without what the winner leaves nothing to explain."""
    hypothesis, cache, options = state.hypothesis, context.cache, context.options
    start = replace(hypothesis.start.with_effect(winner.effect), nuisances=winner.end.model.nuisances)
    model = canonical(winner.end.model, state.model)

    def fitted(seen: PixelEvidence, origin: Model) -> Maximum:
        return maximise_with_restarts(seen.training, origin, start, tolerance=0.01, max_steps=40, cache=cache)

    evidence, fit = at_rest(evidence, fitted(evidence, model), fitted)
    if winner.effect == SLEW:  # few pixels may not reach the limit of one side
        fit = slewing_both_ways(evidence.training, fit, partial(fitted, evidence))
    state, fit, start = _pruned(state, winner, evidence, fit, start, context)
    if state.imputation is not None and state.imputed:
        imputation, model = impute_with_effect(state.imputation, fit.model, options, cache)
        lost = state.lost + imputation.lost[len(state.imputation.lost) :]
        return at_times_anew(replace(state, imputation=imputation, lost=lost), model, start, context)
    weights = fit.model.circuit()
    field, evidence, fit = reconsider_field(evidence, hypothesis.recordings, state.model, fit, options.seed, cache)
    if field is not None:
        hypothesis = replace(hypothesis, recordings=tuple(field.on(hypothesis.recordings)))
        state = replace(state, recordings=tuple(field.on(state.recordings)))
    evidence, fit = reconsider_stimuli(evidence, hypothesis.recordings, state.model, fit, weights, options.seed, cache)
    allowed = None if state.undone else options.criteria.max_unexplained_fraction
    seen = diagnose(evidence.training, fit, options.criteria, options.seed, background_fraction=allowed)
    grown = Hypothesis(hypothesis.recordings, evidence, fit, seen, start, None, hypothesis.jitter, hypothesis.scatter)
    return replace(state, hypothesis=grown)


def _pruned(
    state: State, winner: Candidate[Maximum], evidence: PixelEvidence, fit: Maximum, start: Model, context: Context
) -> tuple[State, Maximum, Model]:
    """(state, fit, start) without earlier effects that gain nothing any more."""
    why = f"{winner.effect} explains it"
    steps, rounds, fit, start = without_unneeded(
        state.steps, state.rounds, evidence, fit, start, state.model, why, context, newest=1
    )
    return replace(state, steps=steps, rounds=rounds), fit, start


def without_unneeded(
    steps: Sequence[NamedStep],
    rounds: Rounds,
    evidence: PixelEvidence,
    fit: Maximum,
    start: Model,
    base: Model,
    why: str,
    context: Context,
    newest: int = 0,
) -> tuple[tuple[NamedStep, ...], Rounds, Maximum, Model]:
    """(steps, rounds, fit, start) without the effects that gain nothing any more, the latest asked first.

    Args:
        steps, rounds: Of the search.
        evidence: Behind the fit.
        fit: On its training pixels, of a model with the effects.
        start: As `Hypothesis.start`.
        base: As shipped.
        why: What the rounds say of those taken back.
        context: Of the search.
        newest: How many of the last steps are not asked.
    """
    kept = list(steps)
    for k in reversed(range(len(kept) - newest)):
        effect = kept[k].effect
        if not fit.model.has(effect):
            continue
        without = remove_effect(fit.model, effect, base)
        if not holds_together(without):
            continue  # a later effect needs this one
        less = maximise(evidence.training, without, tolerance=0.05, max_steps=25, cache=context.cache)
        if fit.value - less.value < context.options.criteria.min_lead_nats:
            fit, start = less, remove_effect(start, effect, base)
            rounds = withdrawn(rounds, effect, why)
            kept = _taken_back(kept, k)
    return tuple(kept), rounds, fit, start


def _taken_back(steps: Sequence[NamedStep], k: int) -> list[NamedStep]:
    """The steps without one, which the next one then follows in the place of."""
    gone = steps[k]
    after = [replace(one, before=gone.before, noise_before=gone.noise_before) for one in steps[k + 1 : k + 2]]
    return [*steps[:k], *after, *steps[k + 2 :]]


def _behind_jitter(state: State, winner: Candidate[Maximum], context: Context) -> State:
    """The state at the times behind a jitter."""
    hypothesis = state.hypothesis
    imputation, model = impute_behind_jitter(
        hypothesis.recordings, winner.end.model, hypothesis.start, hypothesis.evidence.between, context.options.seed,
        lambda what: context.report(what, 0.5), context.cache,
    )  # fmt: skip
    return at_times_anew(replace(state, imputation=imputation), model, hypothesis.start, context)


def _is_unlike(state: State, context: Context) -> bool:
    """Whether what has been taken of the times for a jitter does not look like one, or leaves thresholds that scatter
    more than those of such pixels do: then it is not what was missing."""
    if state.hypothesis.jitter is not None and is_noisy(state.hypothesis.fit.model, state.model):
        return True
    return state.imputation is not None and state.imputation.is_uneven(context.options)


def _without_unlike_jitter(state: State, context: Context) -> State:
    """The state before a jitter that, beside everything named since, does not look like one."""
    at = next((i for i, step in enumerate(state.steps) if step.effect == JITTER), None)
    if at is None or not _is_unlike(state, context):
        return state
    rounds = state.rounds
    for step in state.steps[at:]:
        rounds = withdrawn(rounds, step.effect, UNLIKE_JITTER)
    before = state.steps[at].before
    return replace(state, hypothesis=before, imputation=None, steps=state.steps[:at], rounds=rounds)


def _another_first(state: State, attribution: Attribution[Maximum], context: Context) -> State | None:
    """The state with the effect named that explains most but a jitter; None where nothing else does.

    Times drawn from a model that lacks something may hide it, and what it does take the place of a jitter's.  A pole
    that others wait for goes first: as long as it is missing, they cannot be tried.
    """
    options, hypothesis = context.options, state.hypothesis
    able = [c for c in attribution.candidates if c.effect != JITTER and may_be_named(c, options)]
    if not able:
        return None
    others_wait = {name for effect in stages.LIBRARY.values() for name in effect.tried_after}
    other = next((c for c in able if c.effect in others_wait), able[0])
    evidence = hypothesis.evidence.weighed(hypothesis.fit.model.circuit())
    standing = stands(evidence, hypothesis.fit, hypothesis.seen, other, options, context.cache)
    if standing.hopeless:
        return None
    state = replace(state, rounds=amended(state.rounds, -1, refused=f"{JITTER}: {UNLIKE_JITTER}"))
    return grown_by(with_accepted(state, other, attribution, standing.firm), other, evidence, context)


def _slewing_through_new_poles(state: State, least: float, context: Context) -> State | None:
    """The state with a slew limit and the poles that its likelihood needs; None where it gains less than `least`.

    Where the limit acts a pole by itself explains nothing, and passes for a jitter: it is not named before what cannot
    be tried without it.
    """
    options, before = context.options, state.hypothesis
    model, start = before.fit.model, before.start
    poles = [pole for pole in stages.effect(SLEW).requires if not model.has(pole)]
    unwanted = {*poles, SLEW} & {*options.leave_out, *state.given_up}
    if not poles or unwanted or not state.remainder(options.alpha_each):
        return None
    for pole in poles:
        model, start = model.with_effect(pole), start.with_effect(pole)
    if not holds_together(model.with_effect(SLEW)):
        return None
    fit = maximise(before.evidence.training, model, tolerance=0.05, max_steps=25, cache=context.cache)
    there = replace(state, hypothesis=replace(before, fit=fit, start=start))
    evidence = before.evidence.weighed(fit.model.circuit())
    elsewhere = restart(there, context)
    candidates = candidates_of(evidence, fit.model, elsewhere, context.cache, context.work, state.on_paths)
    context.report(f"{SLEW} with {' and '.join(poles)}", 0.5)
    attribution = attribute(candidates, [SLEW], options)
    winner = attribution.winner
    if winner is None or winner.gain < least:
        return None
    standing = stands(evidence, fit, before.seen, winner, options, context.cache)
    if standing.hopeless:
        return None
    told = attribution_entry(state.turn - 1, fit, before.seen, attribution, {})
    for name in (*poles, SLEW):
        there = with_accepted(
            replace(there, rounds=(*there.rounds, told)), replace(winner, effect=name), attribution, standing.firm
        )
    steps = tuple(replace(step, before=before) for step in there.steps[len(state.steps) :])
    return grown_by(replace(there, steps=(*state.steps, *steps)), winner, evidence, context)


def _with_jitter_instead(other: State, state: State, attribution: Attribution[Maximum], context: Context) -> State:
    """The state with a jitter named in place of the `other`, where only a jitter gives most events their cause."""
    if not is_astray(other, context):
        return other
    return _behind_coarse_jitter(state, attribution, context) or other


def is_astray(state: State, context: Context) -> bool:
    """Whether more events lack a cause than times drawn behind a jitter may leave."""
    return state.hypothesis.seen.background_fraction > context.options.criteria.max_unexplained_fraction_jittered


def _behind_coarse_jitter(state: State, attribution: Attribution[Maximum], context: Context) -> State | None:
    """The state at the times behind a jitter of dead times; None where none gives most events their cause."""
    hypothesis = state.hypothesis
    if state.jitter_given_up or state.hides_jitter or JITTER in context.options.leave_out:
        return None
    context.report("timestamp_jitter", 0.5)
    tried = len(attribution.screened) + len(attribution.skipped)
    # made feasible for stamps in the order in which they came; a dead time named on the way is as it was added
    shipped = {n: v for n, v in state.model.values.items() if n in (NOISE, DEAD_TIME) and n in hypothesis.start.free}
    start = hypothesis.start.set(shipped)
    options = context.options
    jitter = coarse_jitter(hypothesis.evidence, hypothesis.fit, start, tried, options.alpha_each, options.seed)
    if jitter is None or not may_be_named(jitter, context.options):
        return None
    beside = tuple(c for c in attribution.candidates if c.effect != JITTER)
    attribution = replace(attribution, candidates=(jitter, *beside), winner=jitter, runners_up=())
    unable = impossible(hypothesis.fit.model)
    entry = attribution_entry(state.turn - 1, hypothesis.fit, hypothesis.seen, attribution, unable)
    named = with_accepted(replace(state, rounds=(*state.rounds[:-1], entry)), jitter, attribution, True)
    behind = _behind_jitter(named, jitter, context)
    if _is_unlike(behind, context) or is_astray(behind, context):
        return None
    return behind.then(_next(behind))


def at_times_anew(state: State, model: Model, start: Model, context: Context) -> State:
    """The state at the times that its imputation has last drawn under a model, without effects that these leave idle.

    start: the base as shipped, with every effect named at its shipped value
    """
    assert state.imputation is not None
    setting = Setting(state.split, state.model, start, state.hypothesis.evidence.between)
    imputation, hypothesis = at_imputed_times(state.imputation, model, setting, context)
    state = without_idle(replace(state, imputation=imputation, hypothesis=hypothesis), context)
    return without_misplaced(state, context)


def without_idle(state: State, context: Context) -> State:
    """The state without effects that explain next to nothing at times drawn anew, though drawn with them in the model.

    They were told by times that had been drawn from a model which lacked something, or by chance.
    """
    for effect in [step.effect for step in state.steps]:
        hypothesis, criteria = state.hypothesis, context.options.criteria
        model = hypothesis.fit.model
        if not model.has(effect):
            continue
        without = remove_effect(model, effect, state.model)
        if not holds_together(without):
            continue  # another effect needs this one
        fit = maximise(hypothesis.evidence.training, without, tolerance=0.01, max_steps=40, cache=context.cache)
        if hypothesis.fit.value - fit.value < criteria.min_lead_nats:
            state = _without(state, effect, fit, NOTHING_LEFT_FOR_IT)
    return state


def without_misplaced(state: State, context: Context) -> State:
    """The state without lost events that are only where times are drawn: these are events drawn into a wrong place."""
    hypothesis = state.hypothesis
    model = hypothesis.fit.model
    if LOST not in [step.effect for step in state.steps] or not model.has(LOST):
        return state
    less = remove_effect(model, LOST, state.model)
    fit = maximise(hypothesis.evidence.training, less, tolerance=0.01, max_steps=40, cache=context.cache)
    if not _is_misplaced(state, model, fit.model, context):
        return state
    state = replace(state, given_up=state.given_up | {LOST})
    return without_drawn_anew(state, LOST, fit, ONLY_WHERE_DRAWN, context)


def without_drawn_anew(state: State, effect: str, fit: Maximum, why: str, context: Context) -> State:
    """The state with an effect that was named taken out again, at times drawn without it; fit: without it."""
    state = _without(state, effect, fit, why)
    assert state.imputation is not None
    imputation, model = impute_changed(state.imputation, fit.model, cache=context.cache)
    return at_times_anew(replace(state, imputation=imputation), model, state.hypothesis.start, context)


def _is_misplaced(state: State, fitted: Model, without: Model, context: Context) -> bool:
    """Whether what a model says is lost is so only where times are drawn."""
    imputation = state.imputation
    if imputation is None:
        return False
    return not loses_where_times_are_exact(imputation, fitted, without, context.options)


def _without(state: State, effect: str, fit: Maximum, why: str) -> State:
    """The state with an effect that was named taken out again; fit: without it."""
    hypothesis = state.hypothesis
    start = remove_effect(hypothesis.start, effect, state.model)
    at = next(k for k, step in enumerate(state.steps) if step.effect == effect)
    return replace(
        state, hypothesis=replace(hypothesis, fit=fit, start=start), steps=tuple(_taken_back(state.steps, at)),
        rounds=withdrawn(state.rounds, effect, why),
    )  # fmt: skip
