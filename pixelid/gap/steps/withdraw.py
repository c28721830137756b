"""The step that takes back effects which only stand in for what is left in the end."""

from __future__ import annotations

from pixelid.gap.attribute.alternative import flexible_alternative
from pixelid.gap.imputation.impute import JITTER
from pixelid.gap.options import Context
from pixelid.gap.phases import Phase
from pixelid.gap.rounds import withdrawn
from pixelid.gap.state import State


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
