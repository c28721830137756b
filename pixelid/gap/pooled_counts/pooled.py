"""The gap of pooled recordings: events without pixels, counted in bins, explained by the pooled rate.

What pooled counts cannot show is not tried (`NOT_IN_COUNTS`).  `stretches.py` holds counts, cells and maps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pixelid.errors import InputError
from pixelid.fit.judge import LARGEST_DISPERSION
from pixelid.fit.pooled import READOUT, fit_pooled
from pixelid.fit.pooled_rate import PooledRateObjective
from pixelid.gap.attribute.attribute import Attribution, Candidate, attribute
from pixelid.gap.confirm.free_run import FreeRun, closes_nothing
from pixelid.gap.fold import Step, fold
from pixelid.gap.options import Context
from pixelid.gap.phases import Phase
from pixelid.gap.pooled_counts.candidates import NOT_IN_COUNTS, STEPS, effects_to_try, pooled_candidates
from pixelid.gap.pooled_counts.stretches import (
    Cells,
    Fitted,
    PooledDiagnostics,
    Stretches,
    closed_gap,
    cut_into_stretches,
    diagnose_pooled,
    flexible_factor,
    profiles_after_jumps,
    sort_bins,
)
from pixelid.gap.result import SHOWN_CELLS, GapReport, Named
from pixelid.gap.rounds import Rounds, amended, candidate_entries, entry
from pixelid.gap.rounds import withdrawn as taken_back
from pixelid.gap.verdict import TELLING_NATS, describe, judge
from pixelid.likelihood.pooled_rate import PooledRate
from pixelid.model.model import Model
from pixelid.provenance import input_hashes, versions
from pixelid.recordings.recording import Recording
from pixelid.statistics import Z95
from pixelid.stimuli.stimulus import Stimulus

MAX_EVENTS = 60_000  # of each recording that the search looks at: a pool's counts scatter little
LEAST_SECONDS = 0.25  # of each, enough for stretches much longer than the pixels' memory
MAX_ROUNDS = 3
TRAINING = (0, 1)  # roles of stretches: to fit and to select


@dataclass(frozen=True)
class PooledStep:
    """An effect named: how it was tried, what was tried beside it, where the model was wrong before."""

    winner: Candidate[Fitted]
    attribution: Attribution[Fitted]
    where: str


@dataclass(frozen=True)
class PooledState:
    """A search of pooled recordings under way.

    Attributes:
        phase: What comes next.
        stated: The model as it came.
        recordings: Cut to what is looked at.
        stretches, cells: Their counts, and ways to sort the bins.
        base, fit: The base model and the model so far, on the training stretches.
        first, seen: What each leaves.
        steps, turn, rounds: Effects named, rounds so far, what the result says of them.
    """

    phase: Phase
    stated: Model
    recordings: tuple[Recording, ...]
    stretches: Stretches
    cells: tuple[Cells, ...]
    base: Fitted
    fit: Fitted
    first: PooledDiagnostics
    seen: PooledDiagnostics
    steps: tuple[PooledStep, ...] = ()
    turn: int = 0
    rounds: Rounds = ()

    @property
    def doubts(self) -> list[str]:
        """Effects that explain as well as a named one what it does, and are not named themselves."""
        return [effect for others in self.rivals.values() for effect in others]

    @property
    def rivals(self) -> dict[str, list[str]]:
        """By effect named, those that explain as well what it does; none where there are none."""
        named = {step.winner.effect for step in self.steps}
        others = {s.winner.effect: [o.effect for o in s.attribution.runners_up if o.effect not in named]
                  for s in self.steps}  # fmt: skip
        return {effect: some for effect, some in others.items() if some}


def search_pooled(recordings: Sequence[Recording], model: Model, context: Context) -> GapReport:
    """Search pooled recordings for effects that the model lacks.

    Raises InputError for fewer than 100 events and stimuli that are missing or differ from pixel to pixel.
    """
    return fold(_begin(recordings, model, context), STEPS_OF_POOLED, context)


def _begin(recordings: Sequence[Recording], model: Model, context: Context) -> PooledState:
    shortened = tuple(_shortened(r) for r in recordings)
    options, report = context.options, context.report
    report("base model", 0.02)
    found = fit_pooled(shortened, model, {}, lambda what, share: report(what, 0.3 * share))
    objective, optimum = found.objective, found.optimum
    nuisances = objective.coordinates.nuisances_at(optimum.x)
    parameters = [
        p for name, p in objective.coordinates.nuisances.items() if not objective.coordinates.model.knows(name)
    ]
    stretches = cut_into_stretches(objective.likelihood, found.dispersion, parameters, options.seed)
    fitted = objective.coordinates.model_at(optimum.x)
    base = stretches.fit(fitted, nuisances, stretches.part(*TRAINING), STEPS)
    cells = tuple(sort_bins(stretches, base))
    first = diagnose_pooled(stretches, cells, base, options.criteria, options.seed)
    return PooledState(Phase.NAME, model, shortened, stretches, cells, base, base, first, first)


def _name_effect(state: PooledState, context: Context) -> PooledState:
    """One round: the state with one effect more, or as it is where none can be named."""
    options, turn = context.options, state.turn
    if turn >= MAX_ROUNDS or state.seen.p >= options.alpha_each or state.doubts:
        return replace(state, phase=Phase.CONFIRM)
    share = 0.3 + 0.15 * turn
    context.report(f"round {turn + 1}", share)
    effects = effects_to_try(state.stretches, state.fit.model, options.leave_out)
    attribution = attribute(
        pooled_candidates(state.stretches, state.fit), effects, options,
        lambda what: context.report(f"round {turn + 1}: {what}", share),
    )  # fmt: skip
    state = replace(state, turn=turn + 1, rounds=(*state.rounds, _entry(turn, state, attribution)))
    winner = attribution.winner
    if winner is None:
        return replace(state, phase=Phase.CONFIRM)
    stretches = state.stretches.near(winner.end)
    part = stretches.part(*TRAINING)
    if winner.effect == READOUT:  # for which other parameters had stood in
        fit = _fitted_anew(state, winner.effect, stretches, part)
    else:
        fit = stretches.fit(winner.end.model, winner.end.nuisances, part, STEPS)
    stretches = stretches.near(fit)
    seen = diagnose_pooled(stretches, state.cells, fit, options.criteria, options.seed)
    step = PooledStep(winner, attribution, state.seen.words)
    rounds = amended(state.rounds, -1, named=winner.effect)
    return replace(state, stretches=stretches, fit=fit, seen=seen, steps=(*state.steps, step), rounds=rounds)


def _fitted_anew(state: PooledState, effect: str, stretches: Stretches, part: PooledRate) -> Fitted:
    """The model as it came with an effect, and those named before, fitted as the base model was."""
    grown = state.stated
    for name in (*(step.winner.effect for step in state.steps), effect):
        grown = grown.with_effect(name)
    found = fit_pooled(state.recordings, grown, {}, lambda what, share: None)
    coordinates, x = found.objective.coordinates, found.optimum.x
    return stretches.fit(coordinates.model_at(x), coordinates.nuisances_at(x), part, STEPS)


def _confirm(state: PooledState, context: Context) -> GapReport:
    """The report on a search whose rounds are over."""
    options, criteria = context.options, context.options.criteria
    context.report("confirm", 0.9)
    run, withdrawn, doubts = None, [], state.doubts
    remainder = state.seen.p < options.alpha_each
    if not state.steps:  # so much scatter hides which part is wrong, and is a misfit
        remainder = remainder or state.stretches.dispersion > LARGEST_DISPERSION
    else:
        run = closed_gap(state.stretches, state.cells[0], state.base, state.fit, criteria, options.seed)
        if closes_nothing(run, remainder, criteria):
            withdrawn = [step.winner.effect for step in state.steps]
            rounds = state.rounds
            for effect in withdrawn:
                rounds = taken_back(
                    rounds, effect, "on the stretches that confirm it closes next to nothing of the gap"
                )
            state = replace(state, steps=(), fit=state.base, seen=state.first, rounds=rounds)
            run, remainder = None, True
    errors = _errors(state.stretches, state.fit) if state.steps else {}
    effects = tuple(_named(step, state.fit, errors) for step in state.steps)
    said = judge(bool(effects), bool(doubts), remainder, None)
    term = flexible_factor(state.stretches, state.cells, state.fit)
    shared = any(state.stretches.whole.cycles) and not state.fit.model.has(READOUT)
    context.report("done", 1.0)
    return GapReport(
        verdict=said,
        sentence=_describe(said, effects, doubts, run, state.seen, term, shared),
        remainder=remainder,
        global_p=state.first.p,
        alpha=options.alpha,
        effects=effects,
        free_run=run,
        rounds=state.rounds,
        base=state.base.model,
        model=replace(state.fit.model, name=f"{state.stated.name}_grown") if effects else state.base.model,
        term=None,
        recommended_next={
            "why": "events with pixel addresses, under known light: pooled counts show the pixels of a pool together",
            "stimulus": None,
        },
        seconds=context.watch.seconds(),
        seed=options.seed,
        details=_details(state, withdrawn, criteria.min_cell_events),
        versions=versions(),
        inputs_sha256=input_hashes(r.source for r in state.recordings),
    )


STEPS_OF_POOLED: Mapping[Phase, Step[PooledState]] = {Phase.NAME: _name_effect, Phase.CONFIRM: _confirm}


def _details(state: PooledState, withdrawn: Sequence[str], min_events: int) -> dict:
    return {
        "dispersion": state.stretches.dispersion,
        "seconds_used": max(float(np.ptp(r.events.t)) * 1e-9 for r in state.recordings),
        "stimulus_between_samples": "as recorded",
        "held_out": True,
        "withdrawn": list(withdrawn),
        "rivals": state.rivals,
        "remaining_p": state.seen.p,
        "remaining": state.seen.cells[:SHOWN_CELLS],
        "seen_before": state.first.cells[:SHOWN_CELLS],
        "shows_at_typical_strength_nats": {},
        "nuisances": state.fit.nuisances,
        "not_in_pooled_counts": sorted(NOT_IN_COUNTS),
        "after_jumps": profiles_after_jumps(state.stretches, state.cells[0], state.base, state.fit, min_events),
    }


def _entry(turn: int, state: PooledState, attribution: Attribution[Fitted]) -> dict:
    return entry(
        turn + 1, state.seen.p, screened_nats=attribution.screened, model_effects=list(state.fit.model.effects),
        candidates=candidate_entries(attribution),
    )  # fmt: skip


def _shortened(recording: Recording) -> Recording:
    """The first of a recording, up to some `MAX_EVENTS` events."""
    stimulus = recording.stimulus
    if stimulus is None:
        raise InputError(f"{recording.name}: no stimulus; the gap is between a model's events and the measured ones")
    if not isinstance(stimulus, Stimulus) or not stimulus.full_field:
        raise InputError(f"{recording.name}: pooled events need full-field light, found light of each pixel's own")
    t = recording.events.t
    last_s = float(t[MAX_EVENTS]) * 1e-9 if len(t) > MAX_EVENTS else stimulus.end_s
    shown = stimulus.until(max(last_s, stimulus.start_s + LEAST_SECONDS))
    if shown is stimulus:
        return recording
    events = recording.events.select(recording.events.t * 1e-9 <= shown.end_s)
    return replace(recording, events=events).with_stimulus(shown)


def _errors(stretches: Stretches, fit: Fitted) -> dict[str, float]:
    """Standard errors of the coordinates, scaled by the dispersion."""
    objective = PooledRateObjective(stretches.part(*TRAINING), fit.coordinates)
    covariance = np.linalg.pinv(objective.local(fit.x).information) * stretches.dispersion
    return dict(zip(fit.coordinates.names, np.sqrt(np.maximum(np.diag(covariance), 0.0)), strict=True))


def _named(step: PooledStep, fit: Fitted, errors: Mapping[str, float]) -> Named:
    winner, parameters = step.winner, {}
    for parameter in fit.model.library(winner.effect):
        value, interval = fit.model.values[parameter.name], None
        if parameter.name in errors:
            x, reach = parameter.to_coordinate(value), Z95 * errors[parameter.name]
            low, high = (float(parameter.from_coordinate(float(np.clip(c, -300, 300)))) for c in (x - reach, x + reach))
            interval = max(low, parameter.lower), min(high, parameter.upper)
        parameters[parameter.name] = value, interval
    second = next((c for c in step.attribution.candidates if c is not winner), None)
    return Named(
        winner.effect, winner.p, winner.heldout_gain, second.effect if second else None,
        second.heldout_gain if second else None, 0.0, "", parameters, step.where,
    )  # fmt: skip


def _describe(
    said: str,
    effects: Sequence[Named],
    doubts: Sequence[str],
    run: FreeRun | None,
    seen: PooledDiagnostics,
    term: tuple[str, float],
    shared: bool = False,
) -> str:
    if said == "unknown":
        text = f"Something is missing that no effect of the library explains: {seen.words}."
        if term[0] and term[1] > TELLING_NATS:
            text += f" Rates that depend on {term[0]} gain {term[1]:.3g} nats on stretches not used to find them."
        if shared:
            text += " Bursts show a shared readout, for which all pixels wait; the model has none."
        listed = "; ".join(e.name for e in effects)
        return (f"Found on the way: {listed}. " if listed else "") + text
    if said == "ambiguous":  # rounds end with the first doubt: the last one named is in doubt
        *firm, doubted = (effect.name for effect in effects)
        found = f"Found: {'; '.join(firm)}. " if firm else ""
        return f"{found}Something is missing, and these recordings cannot say which: {doubted}, or {', '.join(doubts)}."
    return describe(said, effects, (), None, run, seen.words, None, seen.p)
