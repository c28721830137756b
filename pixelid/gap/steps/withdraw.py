"""Steps that take back: timestamps and single pixels before anything is attributed, and in the end effects which only
stand in for what is left."""

from __future__ import annotations

from pixelid.gap.attribute.alternative import flexible_alternative
from pixelid.gap.detect.diagnostics import diagnose
from pixelid.gap.detect.pixels import fit_base
from pixelid.gap.imputation.impute import JITTER, TICK, impute
from pixelid.gap.imputation.windows import with_stamp_delay
from pixelid.gap.options import Context
from pixelid.gap.phases import Phase
from pixelid.gap.rounds import signature_entry, withdrawn
from pixelid.gap.state import Hypothesis, State
from pixelid.inspection.hot_pixels import find_hot_pixels_in_silence
from pixelid.recordings.selection import only


def withdraw(state: State, context: Context) -> State:
    """Where something significant is left: without the first effect that may stand in for it, and all after that.

    Those are effects that a flexible alternative leaves little to explain, those that explain less than it would, and a
    jitter, for which any scatter passes.
    """
    state = state.then(Phase.CONFIRM)
    if not state.remainder(context.options.alpha_each):
        return state
    hypothesis = state.hypothesis
    term = flexible_alternative(hypothesis.evidence, hypothesis.fit, hypothesis.seen)
    left = 0.0 if term is None else float(term.held_out.sum())
    weak = (
        i
        for i, step in enumerate(state.steps)
        if not step.firm or step.winner.heldout_gain < left or step.effect == JITTER
    )
    kept = next(weak, None)
    if kept is None:
        return state
    rounds = state.rounds
    for step in state.steps[kept:]:
        rounds = withdrawn(rounds, step.effect, "it may only stand in for what is left")
    known = (step.noise_before for step in state.steps[kept:] if step.noise_before is not None)
    noise = next(known, state.shot_noise)  # as it was found before effects beside it
    before = state.steps[kept].before
    return state.then(Phase.CONFIRM, hypothesis=before, steps=state.steps[:kept], rounds=rounds, shot_noise=noise)


def undo_readout(state: State, context: Context) -> State:
    """Set hot pixels aside, impute event times behind queue and tick, and fit the base model again."""
    options, report, cache = context.options, context.report, context.cache
    report("timestamps", 0.06)
    recordings, split, model = state.hypothesis.recordings, state.split, state.model
    undone = tuple(f for f in state.signatures if f.effect not in options.leave_out)
    rounds, lost, imputation, hot = state.rounds, state.lost, None, None
    if "hot_pixels" not in options.leave_out:  # known or not: the density of event times does not know them
        hot = find_hot_pixels_in_silence(recordings)
    if hot is not None:
        rounds = (*rounds, signature_entry(hot.signature, model.has("hot_pixels")))
        split = split.without(hot.pixels)
        recordings = tuple(only(recordings, split.everyone))
    for signature in undone:
        rounds = (*rounds, signature_entry(signature, model.has(signature.effect)))
        if signature.effect == TICK:
            model = with_stamp_delay(model, signature.value)
        imputation = impute(recordings, signature, model, options, lambda what: report(what, 0.08), cache)
        recordings, lost = imputation.recordings, lost + imputation.lost
        model = model.with_effect(signature.effect, {signature.parameter: signature.value})
        model = model.fix({signature.parameter: None})
    state = state.then(
        Phase.NAME, undone=undone, hot=hot, split=split, rounds=rounds, imputation=imputation,
        lost=lost, model=model,
    )  # fmt: skip
    if not undone and hot is None:
        return state
    criteria, seed = options.criteria, options.seed
    evidence, fit = fit_base(recordings, split, model, criteria, seed, cache)
    allowed = None if undone else criteria.max_unexplained_fraction
    seen = diagnose(evidence.training, fit, criteria, seed, background_fraction=allowed)
    return state.then(Phase.NAME, hypothesis=Hypothesis(recordings, evidence, fit, seen, evidence.nominal))
