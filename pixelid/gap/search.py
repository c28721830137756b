"""The search as a fold: each step takes the state and gives the next one, until the last gives the report.

undo_readout → name_effect (again and again; try_in_noise before each where what is left looks like shot noise, stamps
asked where events lack a cause) → ask_stamps → ask_again → ask_recordings → bootstrap_remainder →
try_shot_noise → name_beside_shot_noise (again and again) → discount_imputation_noise → withdraw → confirm
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from pixelid.fit.bench import clocks_of, with_bench
from pixelid.fit.light_unit import in_recorded_unit
from pixelid.fit.measured_light import as_light_tells
from pixelid.gap.detect.diagnostics import diagnose
from pixelid.gap.detect.pixels import SCREEN_EVENTS, fit_base, fit_base_roughly
from pixelid.gap.fold import Step, fold
from pixelid.gap.imputation.impute import QUEUE, is_coarse_tick
from pixelid.gap.options import Context
from pixelid.gap.phases import Phase
from pixelid.gap.result import GapReport
from pixelid.gap.split import split_pixels
from pixelid.gap.state import Hypothesis, State
from pixelid.gap.steps.ask_again import ask_again
from pixelid.gap.steps.ask_stamps import ask_stamps
from pixelid.gap.steps.bootstrap_remainder import bootstrap_remainder
from pixelid.gap.steps.confirm import confirm
from pixelid.gap.steps.discount_imputation_noise import discount_imputation_noise
from pixelid.gap.steps.explain_by_shot_noise import try_in_noise, try_shot_noise
from pixelid.gap.steps.name_beside_shot_noise import name_beside_shot_noise
from pixelid.gap.steps.name_effect import is_astray, name_effect, name_what_settles, restart
from pixelid.gap.steps.recordings_differ import ask_recordings
from pixelid.gap.steps.withdraw import undo_readout, withdraw
from pixelid.inspection.timestamps import find_timestamp_signatures, with_coarse_units_as_grids
from pixelid.likelihood.event_times import EventTimes
from pixelid.likelihood.light_between_samples import with_told
from pixelid.model.model import Model
from pixelid.recordings.own_light import with_pixel_lights
from pixelid.recordings.recording import Recording
from pixelid.recordings.selection import few
from pixelid.stimuli.trace_noise import without_trace_noise


def search(recordings: Sequence[Recording], model: Model, context: Context) -> GapReport:
    """The report on recordings with pixels."""
    return fold(begin(recordings, model, context), STEPS, context)


def begin(recordings: Sequence[Recording], model: Model, context: Context) -> State:
    """Lock the split, fit the base model, look at what it leaves."""
    options, criteria = context.options, context.options.criteria
    split = split_pixels(recordings, options.seed)
    context.report("base model", 0.02)
    recordings = with_coarse_units_as_grids(with_told(with_pixel_lights(without_trace_noise(recordings))))
    model = as_light_tells(model, recordings)
    timely = tuple(r.within_stimulus() for r in recordings)
    some = few(timely, SCREEN_EVENTS, np.random.default_rng(options.seed))
    model = with_bench(in_recorded_unit(model, EventTimes(some)), timely)
    signatures = tuple(find_timestamp_signatures(recordings))
    if any((s.effect == QUEUE or is_coarse_tick(s)) and s.effect not in options.leave_out for s in signatures):
        evidence, base = fit_base_roughly(timely, split, model, options.seed, context.cache)
    else:
        evidence, base = fit_base(timely, split, model, criteria, options.seed, context.cache, context.work)
    allowed = criteria.max_unexplained_fraction
    first = diagnose(evidence.training, base, criteria, options.seed, background_fraction=allowed)
    start = replace(evidence.nominal, nuisances={**evidence.nominal.nuisances, **clocks_of(base.model)})
    hypothesis = Hypothesis(timely, evidence, base, first, start)
    return State(Phase.UNDO_READOUT, tuple(recordings), model, split, base, first, hypothesis, signatures)


def name_next(state: State, context: Context) -> State:
    """One round, before which shot noise has its chance; after the last the stamps are asked."""
    state = try_in_noise(state, context)
    if state.phase is Phase.NAME:
        settled = name_what_settles(state, context)
        state = _one_round(state, context) if settled is None else settled
    state = ask_stamps(state, context) if state.phase is Phase.SHOT_NOISE else state
    return ask_again(state, context) if state.phase is Phase.SHOT_NOISE else state


def _one_round(state: State, context: Context) -> State:
    """The state after what comes before the next effect, and that effect; left to confirm where recordings differ."""
    if state.turn > 0 or restart(state, context) is not None:
        state = ask_recordings(state, context)
        if state.phase is Phase.CONFIRM:
            return state
    if is_astray(state, context):  # a limit of the slew, before what stands in for it
        state = ask_stamps(state, context)
    return name_effect(state, context)


def explain_by_simulation(state: State, context: Context) -> State:
    """What the library's likelihoods leave: recordings that differ, a right model's, or shot noise."""
    state = ask_recordings(state, context)
    if state.phase is Phase.CONFIRM:
        return state
    return try_shot_noise(bootstrap_remainder(state, context), context)


STEPS: Mapping[Phase, Step[State]] = {
    Phase.UNDO_READOUT: undo_readout,
    Phase.NAME: name_next,
    Phase.SHOT_NOISE: explain_by_simulation,
    Phase.BESIDE_SHOT_NOISE: name_beside_shot_noise,
    Phase.DISCOUNT: discount_imputation_noise,
    Phase.WITHDRAW: withdraw,
    Phase.CONFIRM: confirm,
}
