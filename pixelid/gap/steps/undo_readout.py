"""The step that undoes what timestamps and single pixels give away, before anything is attributed."""

from __future__ import annotations

from pixelid.gap.detect.diagnostics import diagnose
from pixelid.gap.detect.pixels import fit_base
from pixelid.gap.imputation.impute import TICK, impute
from pixelid.gap.imputation.windows import with_stamp_delay
from pixelid.gap.options import Context
from pixelid.gap.phases import Phase
from pixelid.gap.rounds import signature_entry
from pixelid.gap.state import Hypothesis, State
from pixelid.inspection.hot_pixels import find_hot_pixels_in_silence
from pixelid.recordings.selection import only


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
