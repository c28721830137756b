"""The last step: confirm what was named on pixels that nothing has looked at, and say it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pixelid import stages
from pixelid.fit.shot_noise import DENSITY, EFFECT
from pixelid.gap.attribute.alternative import flexible_alternative
from pixelid.gap.attribute.candidates import missing
from pixelid.gap.attribute.directions import Direction, Space, confusion, direction, residual_space, similarities
from pixelid.gap.attribute.flexible import Flexible
from pixelid.gap.confirm.free_run import FreeRun, closes_nothing, leaves_much
from pixelid.gap.confirm.intervals import open_sides
from pixelid.gap.detect.maps import Cell
from pixelid.gap.detect.pixels import relative_noise
from pixelid.gap.detect.words import where
from pixelid.gap.imputation.imputed import JITTER
from pixelid.gap.options import Context
from pixelid.gap.recommend import advise
from pixelid.gap.result import SHOWN_CELLS, GapReport, Named
from pixelid.gap.rounds import withdrawn as taken_back
from pixelid.gap.state import NamedStep, State
from pixelid.gap.steps.describe_remainder import Described, describe_remainder
from pixelid.gap.steps.numbers import free_run_of, intervals_of
from pixelid.gap.steps.recordings_differ import in_words, own_values, with_recordings_that_differ
from pixelid.gap.verdict import Confounder, confounded, judge
from pixelid.gap.verdict import describe as in_a_sentence
from pixelid.inspection.timestamps import TimestampSignature
from pixelid.provenance import input_hashes, versions

TAKEN_BACK = "on the pixels that confirm it closes next to nothing of the gap"


@dataclass(frozen=True)
class _Findings:
    """What was found, as confirmed so far."""

    verdict: str
    remainder: bool
    effects: tuple[Named, ...]
    run: FreeRun | None
    withdrawn: tuple[str, ...] = ()
    described: Described = field(default_factory=Described)


def confirm(state: State, context: Context) -> GapReport:
    """The report on a search whose rounds are over."""
    options, report, hypothesis = context.options, context.report, state.hypothesis
    remainder = state.remainder(options.alpha_each)
    report("what these stimuli can tell", 0.75)
    at, directions = _directions(state)
    named_any = bool(state.steps or state.new_signatures or state.shot_noise)
    confounder = None if named_any or remainder else confounded(at, directions, options)
    said = judge(named_any, bool(state.doubts), remainder, confounder)
    findings = _confirmed(state, at, directions, said, context)
    if findings.verdict == "unknown":
        known = bool(state.steps or not findings.withdrawn)  # not where what timestamps showed has been taken back
        state = without(findings.withdrawn, state)
        alike = with_recordings_that_differ(state, context) if known else None
        if alike is not None:
            return confirm(alike, context)
        described = describe_remainder(state, context) if known else Described()
        findings = _with_descriptions(findings, described)
        state = described.beside or state
    if findings.withdrawn or state.hypothesis is not hypothesis:
        hypothesis, remainder = state.hypothesis, True
        at, directions = _directions(state)
    term = flexible_alternative(hypothesis.evidence, hypothesis.fit, hypothesis.seen) if remainder else None
    report("what to record next", 0.95)
    next_ = advise(state, at, directions, confounder, findings.remainder, options) if options.recommend else {}
    report("done", 1.0)
    return _report(state, context, findings, term, confounder, directions, next_)


def _confirmed(state: State, at: Space, directions: Sequence[Direction], said: str, context: Context) -> _Findings:
    """The findings that hold on the pixels that confirm."""
    options, report = context.options, context.report
    remainder = state.remainder(options.alpha_each)
    report("intervals", 0.8)
    effects = _effects(at, directions, state)
    report("free run", 0.85)
    run = free_run_of(state, context) if effects else None
    if run is not None and closes_nothing(run, remainder, options.criteria):
        return _Findings("unknown", True, (), None, tuple(effect.name for effect in effects))
    # under shot noise maps are compared roughly, and recordings that were left out are in none
    if run is not None and (state.shot_noise is not None or state.lost) and leaves_much(run, options.criteria):
        return _Findings("unknown", True, effects, run)
    return _Findings(said, remainder, effects, run)


def _with_descriptions(findings: _Findings, described: Described) -> _Findings:
    """The findings with descriptions, and the strengths of named effects beside them."""
    grown = described.grown
    if grown is None:
        return replace(findings, described=described)
    effects = () if findings.withdrawn else _effects(*_directions(grown), grown)
    return replace(findings, effects=effects, run=described.run, described=described)


def _effects(at: Space, directions: Sequence[Direction], state: State) -> tuple[Named, ...]:
    """Entries of everything found, in the order in which it was."""
    read_off = (_from_signature(f, state) for f in state.new_signatures)
    return (*read_off, *_named(at, directions, state), *_shot_noise(state))


def without(effects: Sequence[str], state: State) -> State:
    """The state as it was before its steps, where the effects that they named have been taken back."""
    if not effects or not state.steps:
        return state
    rounds = state.rounds
    for step in state.steps:
        rounds = taken_back(rounds, step.effect, TAKEN_BACK)
    return replace(state, hypothesis=state.steps[0].before, steps=(), rounds=rounds)


def _directions(state: State) -> tuple[Space, list[Direction]]:
    """(the space of residuals of the hypothesis, in which direction each effect that it lacks would move them)."""
    hypothesis = state.hypothesis
    at = residual_space(hypothesis.evidence.training, hypothesis.fit, state.unknown_s)
    effects = [e for e in missing(hypothesis.fit.model) if not (e == JITTER and state.hides_jitter)]
    return at, [d for d in (direction(at, name) for name in effects) if d is not None]


def _named(at: Space, directions: Sequence[Direction], state: State) -> tuple[Named, ...]:
    """Entries of the effects that the rounds named."""
    if not state.steps:
        return ()
    intervals = intervals_of(state.hypothesis)
    fitted = state.hypothesis.fit.model
    alike = [similarities(at, s.effect, directions) if fitted.has(s.effect) else {} for s in state.steps]
    return tuple(_of_step(step, state, intervals, those) for step, those in zip(state.steps, alike, strict=True))


def _of_step(
    step: NamedStep, state: State, intervals: dict[str, tuple[float, float]], alike: dict[str, float]
) -> Named:
    name, hypothesis = step.effect, state.hypothesis
    others = [c for c in step.attribution.candidates if c.effect != name]
    second = max(others, key=lambda c: c.heldout_gain, default=None)
    nearest = max(alike, key=lambda k: alike[k], default="")
    effect, model = stages.effect(name), hypothesis.model
    ranges = {**model.parameters, **model.nuisances}
    values = {p.name: model.values[p.name] for p in effect.parameters}
    own = {key: p.value for key, p in model.nuisances.items() if key.split("[", 1)[0] in effect.starts_anew}
    if own:
        values = {key: value for key, value in values.items() if key not in effect.starts_anew} | own
    return Named(
        name=name,
        p_value=step.winner.p,
        heldout_gain=step.winner.heldout_gain,
        runner_up=second.effect if second else None,
        runner_up_gain=second.heldout_gain if second else None,
        max_cosine=alike.get(nearest, 0.0),
        max_cosine_with=nearest,
        parameters={key: (value, open_sides(intervals.get(key), ranges[key])) for key, value in values.items()},
        where=step.where,
    )


def _from_signature(signature: TimestampSignature, state: State) -> Named:
    """The entry of an effect read off timestamps or single pixels."""
    selected = sum(int(np.isin(r.events.pixel, state.split.select).sum()) for r in state.recordings)
    gain = signature.nats_per_event * signature.concerned * selected
    strength = {signature.parameter: (signature.value, signature.interval)}
    return Named(signature.effect, signature.p, gain, None, None, 0.0, "", strength, signature.where)


def _shot_noise(state: State) -> tuple[Named, ...]:
    """The entry of shot noise, whose gain is that of maps, not of a likelihood."""
    noise, hypothesis = state.shot_noise, state.hypothesis
    if noise is None:
        return ()
    background, unit = hypothesis.seen.residual.background, relative_noise(hypothesis.fit.model)
    place = where(state.first.maps, hypothesis.evidence.training, background, unit)
    strength = {DENSITY: (noise.density, noise.interval)}
    return (Named(EFFECT, state.shot_noise_p, noise.gain, None, None, 0.0, "", strength, place),)


def _report(
    state: State,
    context: Context,
    findings: _Findings,
    term: Flexible | None,
    confounder: Confounder | None,
    directions: Sequence[Direction],
    recommended_next: dict,
) -> GapReport:
    hypothesis, options, effects = state.hypothesis, context.options, findings.effects
    grown = findings.described.grown or (state if effects else None)
    unit, background = relative_noise(hypothesis.fit.model), hypothesis.seen.residual.background
    place = where(hypothesis.seen.maps, hypothesis.evidence.training, background, unit)
    runners_up = [other for _, other in state.doubts]
    sentence = in_a_sentence(
        findings.verdict, effects, runners_up, confounder, findings.run, place, term, hypothesis.seen.p,
        findings.described.effects,
    )  # fmt: skip
    return GapReport(
        verdict=findings.verdict,
        sentence=sentence + in_words(hypothesis.fit.model),
        remainder=findings.remainder,
        global_p=state.global_p,
        alpha=options.alpha,
        effects=effects,
        free_run=findings.run,
        rounds=(grown or state).rounds,
        base=state.base.model,
        model=grown.grown_model if grown else state.base.model,
        described=findings.described.effects,
        term=term,
        recommended_next=recommended_next,
        seconds=context.watch.seconds(),
        seed=options.seed,
        details=_details(state, directions, findings),
        versions=versions(),
        inputs_sha256=input_hashes(r.source for r in state.recordings),
    )


def _details(state: State, directions: Sequence[Direction], findings: _Findings) -> dict:
    split, seen = state.split, (findings.described.grown or state).hypothesis.seen
    tried = {"descriptions_tried": list(findings.described.tried)} if findings.described.tried else {}
    own = own_values(state.hypothesis.fit.model)
    intervals = intervals_of(state.hypothesis) if own else {}
    differ = {name: {"value": value, "interval_95": intervals.get(name)} for name, value in own.items()}
    return {
        **tried,
        **({"recordings_differ": differ} if differ else {}),
        "stimulus_between_samples": state.hypothesis.evidence.between,
        "pixels": {"fit": len(split.fit), "select": len(split.select), "confirm": len(split.confirm)},
        "held_out": split.apart,
        "withdrawn": [*findings.withdrawn, *findings.described.withdrawn],
        "recordings_whose_times_are_lost": list(state.lost),
        "remaining_p": seen.p,
        "remaining": [_cell(c) for c in seen.maps.cells[:SHOWN_CELLS]],
        "seen_before": [_cell(c) for c in state.first.maps.cells[:SHOWN_CELLS]],
        "shows_at_typical_strength_nats": {d.effect: 0.5 * d.seen for d in directions},
        "confusion": confusion(directions),
    }


def _cell(cell: Cell) -> dict:
    return {
        "response": cell.response, "where": cell.label, "score": cell.score, "events": cell.events, "mean": cell.mean,
    }  # fmt: skip
