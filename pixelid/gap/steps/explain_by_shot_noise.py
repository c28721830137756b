"""The step that asks simulation whether shot noise explains what the library's likelihoods leave.

It may take the place of effects that rounds have named, which only stood in for it, or stand beside them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from pixelid.fit.maximise import maximise
from pixelid.fit.shot_noise import EFFECT
from pixelid.gap.attribute.candidates import remove_effect
from pixelid.gap.detect.diagnostics import diagnose
from pixelid.gap.detect.pixels import is_noisy
from pixelid.gap.options import Context
from pixelid.gap.phases import Phase
from pixelid.gap.rounds import amended, entry, withdrawn
from pixelid.gap.shot_noise.shot_noise import ShotNoise, find_shot_noise, looks_like_shot_noise
from pixelid.gap.state import Hypothesis, State
from pixelid.gap.steps.name_beside_shot_noise import name_beside_shot_noise
from pixelid.gap.steps.name_in_noise import named_in_noise


@dataclass(frozen=True)
class Trial:
    """A hypothesis beside which shot noise is looked for;  kept: number of named effects that it has;  hypothesis: None
    for the base that the named effects lead to."""

    hypothesis: Hypothesis | None
    kept: int


@dataclass(frozen=True)
class _Found:
    """Shot noise found in a trial;  index: of the round that says so."""

    noise: ShotNoise
    hypothesis: Hypothesis
    kept: int
    index: int


def try_before_first_effect(state: State, context: Context) -> State:
    """The state with what shows under the noise that the filter finds named, and shot noise where replicates bear all
    of that out; as it is where the base does not look like shot noise, or they do not."""
    options, hypothesis = context.options, state.hypothesis
    asked = EFFECT not in options.leave_out and not hypothesis.fit.model.has(EFFECT) and not state.imputed
    if not (asked and state.remainder(options.alpha_each) and looks_like_shot_noise(hypothesis.seen, options.criteria)):
        return state
    more = named_in_noise(state.with_global_p(), context)
    if more is None:
        return state
    if not more.remainder(options.alpha_each):
        return more.then(Phase.SHOT_NOISE)
    more, noise = _look_beside(more, more.hypothesis, context)
    if noise is None or noise.corrected.seen.p < options.alpha_each:
        return replace(state, shot_noise_tried=more.shot_noise_tried)
    return _named(more, _Found(noise, more.hypothesis, len(more.steps), len(more.rounds) - 1)).then(Phase.DISCOUNT)


def try_before_next_effect(state: State, context: Context) -> State:
    """Shot noise tried after an effect, where the base looked like it, or what is left scatters more than thresholds of
    such pixels do."""
    hypothesis, criteria = state.hypothesis, context.options.criteria
    first = state.steps[0].before
    trials = (Trial(None, 0), Trial(hypothesis, len(state.steps)))
    if state.turn == 1 and looks_like_shot_noise(first.seen, criteria):
        trials = (Trial(first, 0), *trials)
    elif state.imputed or not is_noisy(hypothesis.fit.model, state.model):
        return state
    return explain_by_shot_noise(state, trials, context)


def try_shot_noise(state: State, context: Context) -> State:
    """Shot noise tried when nothing else can be named: in place of all that was, and beside it."""
    trials = tuple(Trial(step.before, 0) for step in state.steps[:1])
    trials = (*trials, Trial(state.hypothesis, len(state.steps)))
    state = explain_by_shot_noise(state, trials, context)
    return state if state.shot_noise is not None else state.then(Phase.DISCOUNT)


def explain_by_shot_noise(state: State, trials: tuple[Trial, ...], context: Context) -> State:
    """The state with shot noise, where one of the trials explains what is left, by itself or with other effects beside
    it, or as it is."""
    options = context.options
    if EFFECT in options.leave_out or not state.remainder(options.alpha_each):
        return state
    left_alone: float | None = None  # at least, with nothing beside it, ∞ where it explains too little; None: not tried
    enough: _Found | None = None
    nearest: _Found | None = None  # what leaves least of those that leave something
    waiting = list(trials)
    while waiting:
        trial = waiting.pop(0)
        hypothesis = trial.hypothesis or _bare(state, context)
        undecidable = hypothesis.corrected is not None or hypothesis.jitter is not None
        if undecidable or hypothesis.fit.model.has(EFFECT):
            continue  # imputed times scatter as they were drawn: replicates know nothing of that
        state, noise = _look_beside(state, hypothesis, context)
        if trial.kept == 0:
            left_alone = min(math.inf if left_alone is None else left_alone, math.inf if noise is None else noise.left)
        if noise is None:
            continue
        found, p = _Found(noise, hypothesis, trial.kept, len(state.rounds) - 1), noise.corrected.seen.p
        if p < options.alpha_each and (nearest is None or noise.left < nearest.noise.left):
            nearest = found
        if trial.kept == 0:
            if p >= options.criteria.sufficient_p_shot_noise:
                return _named(state, found)
            if p >= options.alpha_each and enough is None:
                enough = found
        elif p >= options.alpha_each:
            # effects named before, in a likelihood that misread the noise, must weigh more than the noise does; what
            # was named first may also show by what noise alone leaves
            least = options.criteria.min_shot_noise_gain_nats
            needed = left_alone is not None and noise.left < left_alone - least
            if trial.kept == 1 and needed:
                return _named(state, found)
            if all(step.winner.heldout_gain > noise.gain for step in state.steps[: trial.kept]):
                return _named(state, found)
            if not any(one.hypothesis is None for one in trials):
                trials = (*trials, Trial(None, 0))
                waiting.append(trials[-1])
    if enough is not None:
        return _named(state, enough)
    if nearest is None or any(nearest.hypothesis is other for other in state.noise_pursued):
        return state
    state = replace(state, noise_pursued=(*state.noise_pursued, nearest.hypothesis))
    return _with_others_beside(state, nearest, context) or state


def _look_beside(state: State, hypothesis: Hypothesis, context: Context) -> tuple[State, ShotNoise | None]:
    """Shot noise beside a hypothesis, looked for once; the rounds say what it leaves."""
    known = [noise for tried, noise in state.shot_noise_tried if tried is hypothesis]
    if known:
        noise = known[0]
    else:
        context.report("shot noise", 0.7)
        noise = find_shot_noise(
            hypothesis.evidence, hypothesis.fit, hypothesis.seen, context.options, context.cache, context.work
        )
        state = replace(state, shot_noise_tried=(*state.shot_noise_tried, (hypothesis, noise)))
    if noise is not None:
        left = {"name": EFFECT, "density": noise.density, "p_of_what_is_left": noise.corrected.seen.p}
        told = entry(len(state.rounds) + 1, hypothesis.seen.p, by_simulation=left)
        state = replace(state, rounds=(*state.rounds, told))
    return state, noise


def _with_others_beside(state: State, found: _Found, context: Context) -> State | None:
    """The state with shot noise that leaves something, and the effects that explain that in the likelihood which knows
    the noise; None where something is left all the same."""
    more = _named(state, found)
    while more.phase is Phase.BESIDE_SHOT_NOISE:
        more = name_beside_shot_noise(more, context)
    return None if more.remainder(context.options.alpha_each) else more


def _named(state: State, found: _Found) -> State:
    rounds = amended(state.rounds, found.index, named=EFFECT)
    for step in state.steps[found.kept :]:
        rounds = withdrawn(rounds, step.effect, f"{EFFECT} explains it")
    corrected = found.noise.corrected
    return replace(
        state, phase=Phase.BESIDE_SHOT_NOISE, steps=state.steps[: found.kept], rounds=rounds, shot_noise=found.noise,
        shot_noise_p=found.hypothesis.seen.p,
        hypothesis=replace(found.hypothesis, seen=corrected.seen, corrected=corrected),
    )  # fmt: skip


def _bare(state: State, context: Context) -> Hypothesis:
    """The hypothesis without the effects named, its base fitted again from where they have led it."""
    options, hypothesis = context.options, state.hypothesis
    model, start = hypothesis.fit.model, hypothesis.start
    for step in state.steps:
        model, start = (remove_effect(one, step.effect, state.model) for one in (model, start))
    training = hypothesis.evidence.training
    fit = maximise(training, model, tolerance=0.01, max_steps=40, cache=context.cache)
    allowed = None if state.undone else options.criteria.max_unexplained_fraction
    seen = diagnose(training, fit, options.criteria, options.seed, background_fraction=allowed)
    return replace(hypothesis, fit=fit, seen=seen, start=start, corrected=None)
