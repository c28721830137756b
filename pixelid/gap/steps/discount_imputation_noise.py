"""The step that discounts imputation noise: what a simulated session shows as well, its times imputed alike.

Imputed times come near true ones where intervals tell them; where events crowd, how they were drawn shows.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

from pixelid.fit.again import simulate_again
from pixelid.gap.imputation.impute import QUEUE, impute_behind_jitter, impute_changed, impute_simulated
from pixelid.gap.imputation.imputed import Imputation
from pixelid.gap.options import Context
from pixelid.gap.phases import Phase
from pixelid.gap.rounds import entry
from pixelid.gap.shot_noise.replicates import subtract_replicates
from pixelid.gap.split import Split, split_pixels
from pixelid.gap.state import Hypothesis, State
from pixelid.gap.steps.impute_hypothesis import Setting, at_imputed_times
from pixelid.recordings.recording import Recording


def discount_imputation_noise(state: State, context: Context) -> State:
    """Take from what is left what a session simulated from the model shows as well, imputed in the same way.

    Some of the measured times may have stayed where a model that lacked something put them.  They are drawn afresh
    behind a queue, where an effect has been named since, and behind any readout where more is left than there.
    """
    if not state.imputed:
        return state.then(Phase.WITHDRAW)
    alpha, looked_at = context.options.alpha_each, _looked_at(state)
    queued = any(signature.effect == QUEUE for signature in state.undone)
    drawn_afresh = queued and bool(state.steps) and state.hypothesis.corrected is None
    if drawn_afresh:
        imputation, again = _imputed_alike(looked_at, state.split, state, context)
        if again.seen.p >= min(alpha, state.hypothesis.seen.p):
            state = replace(state, imputation=imputation, hypothesis=again)
    if not state.remainder(alpha):
        return state.then(Phase.WITHDRAW)
    hypothesis, seen = state.hypothesis, state.hypothesis.seen
    seed_offset = 5003  # of the simulated session's seed: none of the replicates' (31 apart) or twins' (101 apart)
    seed, pixels = context.options.seed + seed_offset, state.split.everyone
    made = simulate_again(looked_at, hypothesis.model, pixels, hypothesis.evidence.between, seed)
    shown = _imputed_alike(made, split_pixels(made, context.options.seed), state, context)[1].seen.maps
    cells, p = subtract_replicates(seen, [shown.scores])
    told = {"p_of_what_is_left": p, "background_events": shown.background}
    if p < alpha and not drawn_afresh:
        imputation, again = _imputed_alike(looked_at, state.split, state, context)
        afresh, p_afresh = subtract_replicates(again.seen, [shown.scores])
        told["p_at_times_drawn_afresh"] = p_afresh
        if p_afresh >= alpha:
            state = replace(state, imputation=imputation)
            hypothesis, seen, cells, p = again, again.seen, afresh, p_afresh
    rounds = (*state.rounds, entry(len(state.rounds) + 1, state.hypothesis.seen.p, drawn_alike=told))
    left = replace(seen, maps=replace(seen.maps, cells=cells, p=p), p=p)
    return state.then(Phase.WITHDRAW, rounds=rounds, hypothesis=replace(hypothesis, seen=left))


def _looked_at(state: State) -> list[Recording]:
    """The recordings whose times are not lost."""
    left_out = Counter(state.lost)  # recordings may share a name
    looked_at = []
    for recording in state.recordings:
        left_out[recording.name] -= 1
        if left_out[recording.name] < 0:
            looked_at.append(recording)
    return looked_at


def _imputed_alike(
    made: Sequence[Recording], split: Split, state: State, context: Context
) -> tuple[Imputation, Hypothesis]:
    """Times imputed as in the search, but from first guesses on under the model found, and what is left at them.

    made: recordings simulated from that model, or the measured ones;  split: of their pixels
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
    setting = Setting(split, state.model, start, between, hypothesis.seen.factors)
    return at_imputed_times(imputation, model, setting, context)
