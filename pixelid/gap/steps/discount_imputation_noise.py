"""The step that discounts imputation noise: what a simulated session shows as well, its times imputed alike.

Imputed times come near true ones where intervals tell them; where events crowd, how they were drawn shows.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

from pixelid.fit.again import simulate_again
from pixelid.gap.detect.covariates import Factor
from pixelid.gap.imputation.impute import impute_behind_jitter, impute_changed, impute_simulated
from pixelid.gap.imputation.imputed import Imputation
from pixelid.gap.options import Context
from pixelid.gap.phases import Phase
from pixelid.gap.rounds import entry
from pixelid.gap.shot_noise.replicates import subtract_replicates
from pixelid.gap.split import split_pixels
from pixelid.gap.state import Hypothesis, State
from pixelid.gap.steps.impute_hypothesis import Setting, at_imputed_times
from pixelid.recordings.recording import Recording

SEED_OFFSET = 5003  # of the simulated session's seed: none of the replicates' (31 apart) or twins' (101 apart)


def discount_imputation_noise(state: State, context: Context) -> State:
    """Take from what is left what a session simulated from the model shows as well, imputed in the same way."""
    if not (state.remainder(context.options.alpha_each) and state.imputed):
        return state.then(Phase.WITHDRAW)
    hypothesis, seen = state.hypothesis, state.hypothesis.seen
    seed, pixels = context.options.seed + SEED_OFFSET, state.split.everyone
    left_out = Counter(state.lost)  # recordings may share a name
    looked_at = []
    for recording in state.recordings:
        left_out[recording.name] -= 1
        if left_out[recording.name] < 0:
            looked_at.append(recording)
    made = simulate_again(looked_at, hypothesis.model, pixels, hypothesis.evidence.between, seed)
    shown = _imputed_alike(made, state, seen.factors, context)[1].seen.maps
    cells, p = subtract_replicates(seen, [shown.scores])
    told = {"p_of_what_is_left": p, "background_events": shown.background}
    if p < context.options.alpha_each:  # some times may have stayed where a model that lacked something put them
        imputation, again = _imputed_alike(looked_at, state, seen.factors, context)
        afresh, p_afresh = subtract_replicates(again.seen, [shown.scores])
        told["p_at_times_drawn_afresh"] = p_afresh
        if p_afresh >= context.options.alpha_each:
            state = replace(state, imputation=imputation)
            hypothesis, seen, cells, p = again, again.seen, afresh, p_afresh
    rounds = (*state.rounds, entry(len(state.rounds) + 1, state.hypothesis.seen.p, drawn_alike=told))
    left = replace(seen, maps=replace(seen.maps, cells=cells, p=p), p=p)
    return state.then(Phase.WITHDRAW, rounds=rounds, hypothesis=replace(hypothesis, seen=left))


def _imputed_alike(
    made: Sequence[Recording], state: State, like: Sequence[Factor], context: Context
) -> tuple[Imputation, Hypothesis]:
    """Times imputed as in the search, but from first guesses on under the model found, and what is left at them.

    made: recordings simulated from that model, or the measured ones
    """
    options, cache, hypothesis = context.options, context.cache, state.hypothesis
    recordings = tuple(r.within_stimulus() for r in made)
    model, imputation = hypothesis.model, None

    def report(what: str) -> None:
        context.report(f"{what}, as simulated", 0.65)

    for signature in state.undone:
        model = model.without_effect(signature.effect)
        imputation = impute_simulated(recordings, signature, model, options.seed, report)
        recordings = imputation.recordings
        model = model.with_effect(signature.effect, {signature.parameter: signature.value})
        model = model.fix({signature.parameter: None})
    between, start = hypothesis.evidence.between, hypothesis.start
    if hypothesis.jitter is not None:
        imputation, model = impute_behind_jitter(recordings, model, start, between, options.seed, report, cache)
    else:
        assert imputation is not None
        imputation, model = impute_changed(imputation, model, report, cache)
    setting = Setting(split_pixels(made, options.seed), state.model, start, between, like)
    return at_imputed_times(imputation, model, setting, context)
