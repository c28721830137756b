"""The step that asks the stamps for a limit of the slew, which times drawn without it hide.

Times behind a jitter or a coarse tick follow the model that they are drawn from, and a limit of the slew forbids times
drawn without it: beside them no limit is worth a fit, and many events are left without a cause.  So it is looked for on
the stamps, with all times summed over that they can stand for (`imputation/stamps.py`), followed to times of its own,
and what it gains is asked of the stamps again.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pixelid.fit.maximise import Maximum
from pixelid.gap.attribute.attribute import Attribution, Candidate, may_be_named
from pixelid.gap.attribute.candidates import SLEW, missing, strongest_slew_start
from pixelid.gap.attribute.significance import chance_of_gain
from pixelid.gap.imputation.impute import impute_with_effect
from pixelid.gap.imputation.imputed import Imputation
from pixelid.gap.imputation.paths import is_summed_whole
from pixelid.gap.imputation.stamps import Stamps
from pixelid.gap.options import Context
from pixelid.gap.phases import Phase
from pixelid.gap.rounds import attribution_entry
from pixelid.gap.state import State
from pixelid.gap.steps.name_effect import at_times_anew, is_astray, with_accepted
from pixelid.model.model import Model

EVENTS = 1_500  # of the pixels that limits are tried on: some forty of them, half a second each


def ask_stamps(state: State, context: Context) -> State:
    """The state with a limit of the slew named that the stamps ask for, and another round; else as it is."""
    imputation, model = state.imputation, state.hypothesis.fit.model
    if imputation is None or not imputation.by_paths or not is_summed_whole(model.circuit()):
        return state
    able = SLEW in missing(model) and SLEW not in {*context.options.leave_out, *state.given_up}
    if state.stamps_asked or not able or not is_astray(state, context):
        return state
    state = replace(state, stamps_asked=True)
    context.report(f"{SLEW}, of the stamps", 0.6)
    few = Stamps(imputation.of(state.split.fit).few(EVENTS, np.random.default_rng(0)))
    start = strongest_slew_start(few, model, few.log_likelihood(model.circuit()))
    return state if start is None else _asked(state, imputation, start, context)


def _asked(state: State, before: Imputation, start: Model, context: Context) -> State:
    """The state with a round more; with the limit, and times drawn with it, where the stamps ask for it."""
    hypothesis, options = state.hypothesis, context.options
    imputation, model = impute_with_effect(before, start, options, context.cache)
    winner = _candidate(state, before, imputation, model)
    able = winner.gain > options.criteria.min_stamps_gain_nats and may_be_named(winner, options)
    attribution = Attribution((winner,), {}, winner if able else None, (), {})
    told = attribution_entry(state.turn, hypothesis.fit, hypothesis.seen, attribution, {})
    asked = replace(state, rounds=(*state.rounds, {**told, "by_stamps": True}), turn=state.turn + 1)
    if not able:
        return asked
    asked = replace(with_accepted(asked, winner, attribution, True), imputation=imputation)
    return at_times_anew(asked, model, hypothesis.start.with_effect(SLEW), context).then(Phase.NAME)


def _candidate(state: State, before: Imputation, after: Imputation, model: Model) -> Candidate[Maximum]:
    """What the limit of a model gains on stamps, with and without it at times of its own."""
    fit, split = state.hypothesis.fit, state.split

    def gained(pixels: np.ndarray) -> np.ndarray:
        with_limit = Stamps(after.of(pixels)).per_pixel(model.circuit())
        return with_limit - Stamps(before.of(pixels)).per_pixel(fit.model.circuit())

    gain = float(gained(split.fit).sum())
    p = chance_of_gain(SLEW, gain, len(missing(fit.model)))
    return Candidate(SLEW, replace(fit, model=model), gain, p, gained(split.select))
