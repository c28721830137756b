"""What a search leaves in the end, described, where a description holds on the pixels that confirm."""

from __future__ import annotations

from dataclasses import dataclass, replace

from pixelid.gap.confirm.free_run import FreeRun, closes_nothing
from pixelid.gap.describe.describe import Candidate, describe
from pixelid.gap.detect.diagnostics import Diagnostics
from pixelid.gap.options import Context
from pixelid.gap.result import DescribedEffect
from pixelid.gap.state import State
from pixelid.gap.steps.numbers import free_run_of, intervals_of
from pixelid.model.model import Model
from pixelid.stages.described import equation
from pixelid.stages.described_words import in_words


@dataclass(frozen=True)
class Described:
    """What became of a search for descriptions.

    Attributes:
        tried: What each round tried, for the details of the result.
        effects: The descriptions that hold; with none there is nothing below.
        run: The gap before, and after with them.
        model: With them.
        seen: What it leaves of the training events.
    """

    tried: tuple[dict, ...] = ()
    effects: tuple[DescribedEffect, ...] = ()
    run: FreeRun | None = None
    model: Model | None = None
    seen: Diagnostics | None = None


def describe_remainder(state: State, withdrawn: bool, context: Context) -> Described:
    """What a state leaves, described.

    Behind shot noise nothing is: there the maps are corrected by simulation, which the likelihood is not.

    Args:
        state: Whose verdict is `unknown`.
        withdrawn: Whether the effects that it named have been taken back.
        context: Of the search.
    """
    hypothesis, steps = state.hypothesis, state.steps
    if withdrawn:
        hypothesis, steps = (steps[0].before if steps else None), ()
    if hypothesis is None or hypothesis.corrected is not None or state.shot_noise is not None:
        return Described()
    ended = describe(hypothesis, context)
    if not ended.found:
        return Described(ended.tried)
    grown = replace(state, hypothesis=ended.hypothesis, steps=steps)
    run = free_run_of(grown, context)
    if closes_nothing(run, grown.remainder(context.options.alpha_each), context.options.criteria):
        refused = {**ended.tried[-1], "refused": "on the pixels that confirm it closes next to nothing of the gap"}
        return Described((*ended.tried[:-1], refused))
    intervals = intervals_of(ended.hypothesis)
    told = tuple(_told(one, ended.hypothesis.model, intervals, run) for one in ended.found)
    return Described(ended.tried, told, run, grown.grown_model, ended.hypothesis.seen)


def _told(found: Candidate, model: Model, intervals: dict[str, tuple[float, float]], run: FreeRun) -> DescribedEffect:
    own, begin = found.own, len(found.own.name) + 1
    values = {p.name[begin:]: model.values[p.name] for p in own.parameters}
    return DescribedEffect(
        effect=own.name,
        equation=equation(own.quantity, own.covariate, own.form, values),
        words=in_words(own, values),
        parameters={p.name[begin:]: (model.values[p.name], intervals.get(p.name)) for p in own.parameters},
        heldout_gain=found.heldout_gain,
        closed=run.closed,
    )
