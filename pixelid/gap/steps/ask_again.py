"""The step that asks again for effects named before a jitter was: at times drawn without them.

Under a jitter that is not known yet other effects take the place of what is missing, and times drawn later with them in
the model keep them there.
"""

from __future__ import annotations

from dataclasses import replace

from pixelid.fit.maximise import maximise
from pixelid.gap.attribute.attribute import attribute, may_be_named
from pixelid.gap.attribute.candidates import holds_together, remove_effect
from pixelid.gap.attribute.pixels import candidates_of
from pixelid.gap.imputation.impute import JITTER
from pixelid.gap.options import Context
from pixelid.gap.phases import Phase
from pixelid.gap.state import State
from pixelid.gap.steps.name_effect import restart, without_drawn_anew

NOT_ASKED_FOR = "at times drawn without it nothing asks for it"


def ask_again(state: State, context: Context) -> State:
    """The state without effects named before a jitter that the times behind it do not ask for; then another round."""
    names = [step.effect for step in state.steps]
    if state.hypothesis.jitter is None or JITTER not in names:
        return state
    for effect in names[: names.index(JITTER)]:
        if effect in state.asked_again:
            continue
        state = replace(state, asked_again=state.asked_again | {effect})
        context.report(f"{effect}, again", 0.6)
        less = _without(state, effect, context)
        if less is not None and not _is_asked_for(less, effect, context):
            state = less.then(Phase.NAME)
    return state


def _without(state: State, effect: str, context: Context) -> State | None:
    """The state without an effect, at times drawn without it; None where another effect needs it."""
    model = remove_effect(state.hypothesis.fit.model, effect, state.model)
    if not holds_together(model):
        return None
    training = state.hypothesis.evidence.training
    fit = maximise(training, model, tolerance=0.01, max_steps=40, cache=context.cache)
    return without_drawn_anew(state, effect, fit, NOT_ASKED_FOR, context)


def _is_asked_for(state: State, effect: str, context: Context) -> bool:
    """Whether an effect that the model lacks would be named, were it the only one tried."""
    hypothesis = state.hypothesis
    model = hypothesis.fit.model
    evidence = hypothesis.evidence.weighed(model.circuit())
    elsewhere = restart(state, context)
    candidates = candidates_of(evidence, model, elsewhere, context.cache, context.work, state.on_paths)
    return any(may_be_named(c, context.options) for c in attribute(candidates, [effect], context.options).candidates)
