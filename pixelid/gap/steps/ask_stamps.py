"""The step that asks the stamps for effects which times drawn without them hide.

Times behind a readout follow the model that they are drawn from.  A pole that it lacks moves events by less than a
queue leaves open, so that other parameters take its place; a limit of the slew forbids times drawn without it.  Each
such effect is followed to times of its own, and what it gains is asked of the stamps (`imputation/stamps.py`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pixelid.fit.maximise import Maximum
from pixelid.gap.attribute.attribute import Attribution, Candidate, may_be_named
from pixelid.gap.attribute.candidates import SLEW, USUAL_POLES, missing, strongest_slew_start
from pixelid.gap.attribute.significance import chance_of_gain
from pixelid.gap.imputation.impute import FAST, QUEUE, impute_with_effect, with_fast_poles
from pixelid.gap.imputation.imputed import Imputation
from pixelid.gap.imputation.paths import is_summed_whole
from pixelid.gap.imputation.stamps import Stamps
from pixelid.gap.options import Context, Options
from pixelid.gap.phases import Phase
from pixelid.gap.rounds import attribution_entry
from pixelid.gap.state import State
from pixelid.gap.steps.name_effect import at_times_anew, is_astray, with_accepted
from pixelid.model.model import Model

NEARER_NATS = 200.0  # more than refits gain by themselves, of which the base else gets as many again
EVENTS = 1_500  # of the pixels that limits of the slew are tried on: some forty of them, half a second each


def ask_stamps(state: State, context: Context) -> State:
    """The state with an effect named that the stamps ask for, and another round; else as it is."""
    imputation, model = state.imputation, state.hypothesis.fit.model
    if imputation is None or not imputation.windows or not imputation.draws_paths(model):
        return state
    if not is_summed_whole(model.circuit()):
        return state
    for effect in _hidden(state, context):
        state = replace(state, asked_of_stamps=state.asked_of_stamps | {effect})
        context.report(f"{effect}, of the stamps", 0.6)
        start = _start(state, effect)
        if start is None:
            continue
        steps, state = len(state.steps), _asked(state, effect, start, context)
        if len(state.steps) > steps:
            return state.then(Phase.NAME)
    return state


def _hidden(state: State, context: Context) -> list[str]:
    """Effects that drawn times may hide and that the stamps were not asked for."""
    model, imputation = state.hypothesis.fit.model, state.imputation
    assert imputation is not None
    some = {*USUAL_POLES} if imputation.effect == QUEUE else set()
    if imputation.by_paths and is_astray(state, context):
        some = {SLEW}
    skip = {*context.options.leave_out, *state.given_up, *state.asked_of_stamps}
    return [effect for effect in missing(model) if effect in some and effect not in skip]


def _start(state: State, effect: str) -> Model | None:
    """Where the effect is followed from: of a few pixels, the likeliest limits of the slew, or poles."""
    hypothesis, imputation = state.hypothesis, state.imputation
    model = hypothesis.fit.model
    assert imputation is not None
    few = Stamps(imputation.of(state.split.fit).few(EVENTS, np.random.default_rng(0)))
    if effect == SLEW:
        return strongest_slew_start(few, model, few.log_likelihood(model.circuit()))
    return max(_poles(model, hypothesis.start, effect), key=lambda start: few.log_likelihood(start.circuit()))


def _poles(model: Model, shipped: Model, effect: str) -> list[Model]:
    """A model with a pole more: as shipped, and where the other one is, which may have taken its place."""
    grown = model.with_effect(effect)
    usual = {name: shipped.with_effect(effect).values[name] for name in FAST if name in grown.values}
    starts = [with_fast_poles(grown, usual)]
    own = next(name for name in usual if name not in model.values)
    return starts + [with_fast_poles(grown, usual | {own: model.values[name]}) for name in usual if name != own]


def _asked(state: State, effect: str, start: Model, context: Context) -> State:
    """The state with a round more, and with the effect, at times drawn with it, where the stamps ask for it."""
    hypothesis, options, before = state.hypothesis, context.options, state.imputation
    assert before is not None
    imputation, model = impute_with_effect(before, start, options, context.cache)
    base = before, hypothesis.fit.model
    winner = _candidate(effect, (imputation, model), base, state)
    if _is_asked_for(winner, options) and winner.gain < NEARER_NATS:
        again = impute_with_effect(*base, options, context.cache)
        winner = min(winner, _candidate(effect, (imputation, model), again, state), key=lambda c: c.gain)
    able = _is_asked_for(winner, options)
    attribution = Attribution((winner,), {}, winner if able else None, (), {})
    told = attribution_entry(state.turn, hypothesis.fit, hypothesis.seen, attribution, {})
    asked = replace(state, rounds=(*state.rounds, {**told, "by_stamps": True}), turn=state.turn + 1)
    if not able:
        return asked
    asked = with_accepted(asked, winner, attribution, True)
    asked = replace(asked, imputation=imputation, lost=state.lost + imputation.lost[len(before.lost) :])
    return at_times_anew(asked, model, hypothesis.start.with_effect(effect), context)


Drawn = tuple[Imputation, Model]  # times, and the model that they were drawn from


def _candidate(effect: str, after: Drawn, before: Drawn, state: State) -> Candidate[Maximum]:
    """What the effect gains on stamps, each model at times of its own, in recordings that are left out of neither."""
    kept = {r.name for r in after[0].fine} & {r.name for r in before[0].fine}

    def of_stamps(drawn: Drawn, pixels: np.ndarray) -> np.ndarray:
        imputation = drawn[0].only(np.array([r.name in kept for r in drawn[0].fine]))
        return Stamps(imputation.of(pixels)).per_pixel(drawn[1].circuit())

    def gained(pixels: np.ndarray) -> np.ndarray:
        return of_stamps(after, pixels) - of_stamps(before, pixels)

    fit = state.hypothesis.fit
    gain = float(gained(state.split.fit).sum())
    p = chance_of_gain(effect, gain, len(missing(fit.model)))
    return Candidate(effect, replace(fit, model=after[1]), gain, p, gained(state.split.select))


def _is_asked_for(candidate: Candidate[Maximum], options: Options) -> bool:
    return candidate.gain > options.criteria.min_stamps_gain_nats and may_be_named(candidate, options)
