"""What a search leaves in the end, described, where a description holds on the pixels that confirm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from pixelid import stages
from pixelid.gap.attribute.significance import leads
from pixelid.gap.confirm.free_run import FreeRun, closes_nothing
from pixelid.gap.describe.describe import Candidate, Descriptions, describe
from pixelid.gap.detect.diagnostics import diagnose
from pixelid.gap.options import Context
from pixelid.gap.result import DescribedEffect
from pixelid.gap.rounds import withdrawn
from pixelid.gap.shot_noise.shot_noise import noise_explains_more
from pixelid.gap.state import State
from pixelid.gap.steps.name_effect import NOISE_EXPLAINS_MORE, restart, without_unneeded
from pixelid.gap.steps.numbers import free_run_of, intervals_of
from pixelid.model.model import Model
from pixelid.recordings.recording import Recording
from pixelid.stages.described import equation
from pixelid.stages.described_words import in_words

WHY = "a description explains better what it did"


@dataclass(frozen=True)
class Described:
    """What became of a search for descriptions.

    Attributes:
        tried: What each round tried, for the details of the result.
        effects: The descriptions that hold; with none there is nothing below.
        run: The gap before, and after with them.
        beside: The state that they were looked for beside.
        grown: The same with them in its model, and without the effects that they took the place of.
        withdrawn: Those effects.
    """

    tried: tuple[dict, ...] = ()
    effects: tuple[DescribedEffect, ...] = ()
    run: FreeRun | None = None
    beside: State | None = None
    grown: State | None = None
    withdrawn: tuple[str, ...] = ()


def describe_remainder(state: State, context: Context) -> Described:
    """What a state leaves, described.

    A neighbour of what is missing may have been named before it could be described.  So what is missing is also
    described beside none of the effects that rounds named, and the better of both holds; of effects that were named,
    those stay that are still wanted beside the description.

    Behind shot noise nothing is described: there the maps are corrected by simulation, which the likelihood is not.

    Args:
        state: Whose verdict is `unknown`.
        context: Of the search.
    """
    hypothesis = state.hypothesis
    if hypothesis.corrected is not None or state.shot_noise is not None:
        return Described()

    def described(beside: State) -> Descriptions:
        return describe(beside.hypothesis, context, lambda at: restart(replace(beside, hypothesis=at), context))

    ended, beside = described(state), state
    tried = ended.tried
    bare = _without_steps(state)
    if bare is not None:
        alone = described(bare)
        tried = (*tried, *({**told, "beside_effects_named": False} for told in alone.tried))
        if alone.found and _is_better(alone, ended, state, context):
            ended, beside = alone, bare
    if not ended.found:
        return Described(tried)
    evidence, gain = ended.hypothesis.evidence, sum(one.gain for one in ended.found)
    if state.imputed and noise_explains_more(evidence, ended.hypothesis.model, gain, context.options):
        return Described((*tried[:-1], {**tried[-1], "refused": NOISE_EXPLAINS_MORE}))
    grown = _without_unneeded(replace(beside, hypothesis=ended.hypothesis), context)
    run = free_run_of(grown, context)
    if closes_nothing(run, grown.remainder(context.options.alpha_each), context.options.criteria):
        refused = {**tried[-1], "refused": "on the pixels that confirm it closes next to nothing of the gap"}
        return Described((*tried[:-1], refused))
    intervals = intervals_of(grown.hypothesis)
    told = tuple(_told(one, grown.hypothesis.model, intervals, run) for one in ended.found)
    kept = {step.effect for step in grown.steps}
    taken_back = tuple(step.effect for step in state.steps if step.effect not in kept)
    return Described(tried, told, run, beside, grown, taken_back)


def _is_better(alone: Descriptions, beside: Descriptions, state: State, context: Context) -> bool:
    """Whether descriptions beside no effect explain pixels that no fit saw better than those beside what was named.

    Parameters are paid for, those of the effects named as those of descriptions.
    """
    criteria = context.options.criteria
    named = sum(p.free for step in state.steps for p in stages.effect(step.effect).parameters)
    saved = beside.price + beside.penalty * named - alone.price
    lead = alone.judged - beside.judged
    return float(lead.sum()) + saved > criteria.min_lead_nats and (saved > 0.0 or leads(lead, criteria))


def _without_steps(state: State) -> State | None:
    """The state as it was before its steps; None where there are none, or its events had other times there."""
    if not state.steps:
        return None
    before = state.steps[0].before
    if before.corrected is not None or not _alike(before.recordings, state.hypothesis.recordings):
        return None
    rounds = state.rounds
    for step in state.steps:
        rounds = withdrawn(rounds, step.effect, WHY)
    return replace(state, hypothesis=before, steps=(), rounds=rounds)


def _alike(some: Sequence[Recording], others: Sequence[Recording]) -> bool:
    """Whether these are the same recordings, with the same times."""
    return len(some) == len(others) and all(a is b for a, b in zip(some, others, strict=True))


def _without_unneeded(state: State, context: Context) -> State:
    """The state without effects that gain nothing any more beside a description."""
    hypothesis, options = state.hypothesis, context.options
    steps, rounds, fit, start = without_unneeded(
        state.steps, state.rounds, hypothesis.evidence, hypothesis.fit, hypothesis.start, state.model, WHY, context
    )
    if len(steps) == len(state.steps):
        return state
    allowed = hypothesis.seen.allowed
    training = hypothesis.evidence.training
    seen = diagnose(training, fit, options.criteria, options.seed, background_fraction=allowed)
    return replace(state, hypothesis=replace(hypothesis, fit=fit, start=start, seen=seen), steps=steps, rounds=rounds)


def _told(found: Candidate, model: Model, intervals: dict[str, tuple[float, float]], run: FreeRun) -> DescribedEffect:
    own = found.own
    values = own.own(model.values)
    return DescribedEffect(
        effect=own.name,
        equation=equation(own.quantity, own.covariate, own.form, values),
        words=in_words(own, values),
        parameters={key: (value, intervals.get(f"{own.name}.{key}")) for key, value in values.items()},
        heldout_gain=found.heldout_gain,
        closed=run.closed,
    )
