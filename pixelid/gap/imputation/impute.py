"""Event times imputed behind a readout: draws of the times and refits of the model in turns.

Stochastic EM (Celeux & Diebolt 1985, Comput. Stat. Quarterly 2, 73).  Behind a queue or a tick, first only recordings
whose windows are short, until thresholds and their noise settle; then those with longer windows, whose times first
follow the model so found.  Filters have wide priors near the model's values meanwhile.  A recording whose events mostly
waited for far longer (a saturated readout) has lost its times and is left out.  Behind a queue whole paths are drawn;
behind a jitter and a coarse tick as well, and the model follows the stamps with the times integrated out
(`blurred.py`).  A model that gains an effect later moves the times behind it: they are drawn again (`impute_again`),
behind a queue anew, since times drawn from a circuit that lacks what was found keep it (a dead time by the shortest
intervals drawn): from recordings in which events hardly waited, then the others, as before (`impute_with_effect`).
Times of a simulated session begin where they settle under the model that it comes from (`impute_simulated`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from pixelid.fit.cache import FitCache
from pixelid.fit.maximise import Maximum, maximise
from pixelid.fit.starts import feasible
from pixelid.gap.detect.pixels import SCREEN_EVENTS
from pixelid.gap.imputation.blurred import draw_once_more, follow, follow_again
from pixelid.gap.imputation.exact import keeps_its_times
from pixelid.gap.imputation.imputed import JITTER, MOSTLY_WAITED, QUEUE, SIGMA, TICK, Imputation, draw_again
from pixelid.gap.imputation.paths import followable
from pixelid.gap.imputation.windows import (
    guess_by_rank,
    guess_edges,
    guess_spaced,
    jitter_windows,
    queue_windows,
    tick_windows,
    with_times,
)
from pixelid.gap.options import Options
from pixelid.inspection.timestamps import TimestampSignature
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import Model
from pixelid.parameters.parameter import Prior
from pixelid.recordings.own_light import with_fine_light
from pixelid.recordings.recording import Recording
from pixelid.recordings.selection import few

FINEST_TICK_S = 5e-6  # a finer tick is a width of the event-time density, not a window
MIN_EVENTS = 100  # to begin with, and to go on with
ROUNDS = (20, 8, 8)  # of draws and refits in each stage, the last with exact draws
# After the model has gained or lost an effect; the last ones with exact draws, which hardly leave times that the model
# does not explain: behind a tick of 20 µs, of 1,846 events that a bandwidth floor had left so 1,471 stayed in 32 sweeps
# of them, none in eight others.
ROUNDS_AGAIN = (8, 16)
SETTLING_DRAWS = 60  # without refits, before the second stage
DRAWS_PER_ROUND = 2
FINEST_PATH_S, COARSE_TICK_S = 6e-6, 3e-5  # jitters and ticks of several cells of a path; finer: drawn one by one
JITTER_DRAWS = 8  # before the first refit behind a jitter
JITTER_ROUNDS = (12, 12, 24)  # with the thresholds' noise held, then free, then with exact draws
# Refits follow the times drawn in small steps: after so many rounds the model is extrapolated along the way that the
# last half of them has gone, so many times as far, but by no more than a fifth of its coordinates' longest moves.
EXTRAPOLATED_ROUNDS, EXTRAPOLATION, MAX_EXTRAPOLATED_MOVE = 6, 3.0, 0.2
# Behind a queue, of whole paths: of so many rounds and one extrapolation each; behind 23 µs a bandwidth floor that came
# from 35 to 31 took five, and two draws under one model differ by 0.7 nats.
MOST_CYCLES, SETTLED_NATS = 7, 3.0
FIRST_CYCLES = 3  # of a model that may lack something, and then is not worth more
IDLE_CYCLES = 2  # one after the other that come no nearer: an extrapolation may lead astray
NOISE, FAST = "threshold_sigma", ("sf_cutoff_hz", "diff_cutoff_hz")
PRIOR_SD = 0.5  # of log filters, while times are drawn
FILTERS = ("alpha", "beta", "gamma", "alpha_over_beta", "sf_cutoff_hz", "diff_cutoff_hz")
MIN_DEAD_SHARE = 0.1  # of the nominal dead time

Report = Callable[[str], None]


def impute_again(
    imputation: Imputation,
    model: Model,
    rounds: int,
    *,
    exact: bool = True,
    report: Report = lambda what: None,
    cache: FitCache | None = None,
) -> tuple[Imputation, Model]:
    """Draw times and refit the model in turns, and the model so found."""
    if not imputation.windows:
        return imputation, model
    if imputation.by_paths:
        return follow_again(imputation, model, report)
    model, ends = imputation.with_filter_priors(model), []
    for turn in range(rounds):
        report("true times")
        for _ in range(1 if imputation.draws_paths(model) else DRAWS_PER_ROUND):
            imputation = draw_again(imputation, model, exact=exact)
        ends.append(maximise(imputation.likelihood, model, tolerance=0.5, max_steps=4, cache=cache))
        model = ends[-1].model
        stride = turn % EXTRAPOLATED_ROUNDS == EXTRAPOLATED_ROUNDS - 1 and turn < rounds - 1
        if imputation.effect in (JITTER, QUEUE) and stride:
            model = _extrapolated(ends[-EXTRAPOLATED_ROUNDS:])
    scatter = np.std([end.x for end in ends[rounds // 2 :]], axis=0)
    by_name = dict(zip(ends[-1].coordinates.names, scatter.tolist(), strict=True))
    return replace(imputation, scatter=by_name), model


def _settle(
    imputation: Imputation, model: Model, report: Report, cache: FitCache | None, most: int = MOST_CYCLES
) -> tuple[Imputation, Model]:
    """Whole paths behind a queue drawn and the model refitted in turns, until the stamps are hardly likelier for it."""
    nats, idle = -np.inf, 0
    for _ in range(most):
        imputation, model = impute_again(imputation, model, EXTRAPOLATED_ROUNDS + 1, report=report, cache=cache)
        idle = idle + 1 if imputation.nats - nats < SETTLED_NATS else 0
        nats = max(nats, imputation.nats)
        if idle == IDLE_CYCLES:
            break
    return imputation, model


def impute_changed(
    imputation: Imputation, model: Model, report: Report = lambda what: None, cache: FitCache | None = None
) -> tuple[Imputation, Model]:
    """Times and model once the model has gained or lost an effect: times drawn before may be far off."""
    if imputation.draws_paths(model) and not imputation.by_paths:
        return _settle(imputation, model, report, cache)
    if not imputation.by_paths:
        imputation, model = impute_again(imputation, model, ROUNDS_AGAIN[0], exact=False, report=report, cache=cache)
    return impute_again(imputation, model, ROUNDS_AGAIN[1], report=report, cache=cache)


def impute_with_effect(
    imputation: Imputation, model: Model, options: Options, cache: FitCache | None = None
) -> tuple[Imputation, Model]:
    """Times and model once the model has gained an effect, without recordings whose times it now shows to be lost.

    Args:
        imputation: With the times drawn without it.
        model: With it.
        options: With the seed of first guesses, and the share of events that lost times leave unexplained.
        cache: Fits already made.
    """
    min_events_at_once = 1000  # of recordings in which few waited, to begin anew with
    rounds_at_once = 12  # with recordings where few waited: hardly anything is drawn
    if imputation.effect == QUEUE and imputation.windows:
        waited = np.array([float(np.mean(w.hi > w.lo)) if len(w.hi) else 0.0 for w in imputation.windows])
        at_once = waited < MOSTLY_WAITED
        events = sum(len(w.hi) for w, use in zip(imputation.windows, at_once, strict=True) if use)
        if events >= min_events_at_once and not at_once.all():
            model = imputation.with_filter_priors(model)
            part, model = impute_again(imputation.only(at_once), model, rounds_at_once, exact=False, cache=cache)
            imputation = _completed(imputation, part, at_once, model, options.seed)
    imputation, model = impute_changed(imputation, model, cache=cache)
    if imputation.effect == QUEUE and imputation.windows:
        imputation = _without_lost_times(imputation, model, options)
    return imputation, model


def impute(
    recordings: Sequence[Recording],
    signature: TimestampSignature,
    model: Model,
    options: Options,
    report: Report = lambda what: None,
    cache: FitCache | None = None,
) -> Imputation:
    """The recordings without what a timestamp signature says the readout did to their times."""
    whole = _with_windows(recordings, signature, model, options.seed)
    if not whole.windows:
        return whole
    reach = np.array([np.quantile(w.hi - w.lo, 0.9) if len(w.hi) else 0.0 for w in whole.windows])
    unit = 1e9 * signature.value
    kept = reach <= options.criteria.max_wait_service_times * unit
    if sum(len(w.hi) for w, stays in zip(whole.windows, kept, strict=True) if stays) < MIN_EVENTS:
        kept = reach <= np.sort(reach)[len(reach) // 2]
    whole = whole.only(kept)
    if _by_paths(whole, signature, model):
        return follow(replace(whole, by_paths=True), model, options.seed, report)[0]
    short_service_times = 20.0  # windows (nine of ten) of the recordings that the first stage begins with
    brief = reach[kept] <= short_service_times * unit
    whole, model = _begin(whole, brief, whole.with_filter_priors(model), options.seed, report, cache)
    if whole.draws_paths(model):
        whole, model = _settle(whole, model, report, cache, FIRST_CYCLES)
    else:
        whole, model = impute_again(whole, model, ROUNDS[1], exact=False, report=report, cache=cache)
        whole, model = impute_again(whole, model, ROUNDS[2], report=report, cache=cache)
    fine_tick = signature.effect == TICK and not is_coarse_tick(signature)  # loses no time that a circuit would miss
    return whole if fine_tick else _without_lost_times(whole, model, options)


def impute_simulated(
    recordings: Sequence[Recording],
    signature: TimestampSignature,
    model: Model,
    seed: int,
    report: Report = lambda what: None,
) -> Imputation:
    """Simulated recordings without what their readout did, their times settled under the model they come from.

    Nothing has to be found out about the model, so nothing is fitted, and no recording is left out.
    """
    whole = _with_windows(recordings, signature, model, seed)
    if not whole.windows:
        return whole
    report("true times")
    if _by_paths(whole, signature, model):
        return draw_once_more(replace(whole, by_paths=True), model)
    none = np.zeros(len(whole.windows), bool)
    return _completed(whole, whole.only(none), none, model, seed)


def _with_windows(
    recordings: Sequence[Recording], signature: TimestampSignature, model: Model, seed: int
) -> Imputation:
    """The windows that a signature leaves, with first guesses of the times in them."""
    random = np.random.default_rng(seed).bit_generator.state
    stimuli = tuple(r.stimulus for r in recordings)
    if signature.effect == TICK and signature.value < FINEST_TICK_S:
        ticked = tuple(_with_tick(r, signature.value) for r in recordings)
        return Imputation(signature.effect, stimuli, ticked, (), (), random, {})
    fine = tuple(with_fine_light(r, "smooth") for r in recordings)
    make = tick_windows if signature.effect == TICK else queue_windows
    windows = tuple(make(r, signature.value) for r in fine)
    times = tuple(guess_edges(fine, windows, early=signature.effect == QUEUE))
    return Imputation(signature.effect, stimuli, fine, windows, times, random, _filter_priors(model))


def _by_paths(whole: Imputation, signature: TimestampSignature, model: Model) -> bool:
    """Whether times are drawn as whole paths."""
    return is_coarse_tick(signature) and followable(whole.fine, model)


def _without_lost_times(whole: Imputation, model: Model, options: Options) -> Imputation:
    """The imputation without recordings that the model leaves unexplained because their times are lost."""
    kept = keeps_its_times(whole, model, options.criteria.max_unexplained_share_of_recording)
    events = sum(len(w.hi) for w, stays in zip(whole.windows, kept, strict=True) if stays)
    # events unexplained everywhere: the model is wrong, not the times
    return whole if events < MIN_EVENTS else whole.only(kept)


def is_coarse_tick(signature: TimestampSignature) -> bool:
    """Whether a signature is a tick behind which times are drawn as paths."""
    return signature.effect == TICK and signature.value >= COARSE_TICK_S


def impute_behind_jitter(
    recordings: Sequence[Recording],
    fitted: Model,
    nominal: Model,
    between: str,
    seed: int,
    report: Report = lambda what: None,
    cache: FitCache | None = None,
) -> tuple[Imputation, Model]:
    """The recordings without the jitter of a model `fitted` to them, and the model of the times so found.

    Args:
        recordings: As stamped.
        fitted: With the jitter.
        nominal: Has the values to begin with of what jitter hides.
        between: How stimuli run between samples.
        seed: Of the draws.
        report: Called with what is being done.
        cache: Fits already made.
    """
    fine = tuple(with_fine_light(r, between) for r in recordings)
    windows = tuple(jitter_windows(r, fitted.values[SIGMA]) for r in recordings)
    model = with_nominal_fast_poles(fitted.without_effect(JITTER), nominal)
    times = tuple(guess_spaced(fine, windows, float(model.circuit().refractory)))
    stimuli = tuple(r.stimulus for r in recordings)
    random = np.random.default_rng(seed).bit_generator.state
    whole = Imputation(JITTER, stimuli, fine, windows, times, random, _filter_priors(nominal))
    if fitted.values[SIGMA] >= FINEST_PATH_S and followable(fine, model):
        stamped = tuple(w.stamp for w in windows if w.stamp is not None)
        return follow(replace(whole, times=stamped, by_paths=True), model, seed, report)
    for _ in range(JITTER_DRAWS):
        whole = draw_again(whole, model, estimate=False)
    held = model.fix({NOISE: None})
    whole, held = impute_again(whole, held, JITTER_ROUNDS[0], exact=False, report=report, cache=cache)
    free = model.set({n: held.values[n] for n in held.free})
    whole, free = impute_again(whole, free, JITTER_ROUNDS[1], exact=False, report=report, cache=cache)
    return impute_again(whole, free, JITTER_ROUNDS[2], report=report, cache=cache)


def with_nominal_fast_poles(fitted: Model, nominal: Model) -> Model:
    """The fitted model with what timestamps that jitter cannot tell apart set as the nominal one has it.

    Fast poles run away under jitter, and the dead time with them; what it and the amplifier's recovery take together
    is known.
    """
    values = {name: nominal.values[name] for name in FAST if name in fitted.free and name in nominal.values}
    if "refractory_s" in fitted.free and "diff_cutoff_hz" in values:
        recovery = [1.0 / (2.0 * np.pi * each["diff_cutoff_hz"]) for each in (fitted.values, values)]
        dead = float(fitted.values["refractory_s"] + recovery[0] - recovery[1])
        values["refractory_s"] = max(dead, MIN_DEAD_SHARE * nominal.values["refractory_s"])
    return fitted.set(values)


def _begin(
    whole: Imputation, brief: np.ndarray, model: Model, seed: int, report: Report, cache: FitCache | None
) -> tuple[Imputation, Model]:
    """The imputation begun, and the model that recordings with brief windows (bool per recording) tell."""
    chosen = brief if brief.any() else ~brief
    timed = [r for r, use in zip(with_times(whole.fine, whole.times), chosen, strict=True) if use]
    screening = EventTimes(few(timed, SCREEN_EVENTS, np.random.default_rng(seed)))
    model = maximise(screening, feasible(model, screening), tolerance=0.1, max_steps=30, cache=cache).model
    if sum(len(r.events) for r in timed) < MIN_EVENTS or not brief.any():
        return whole, model
    part, model = impute_again(whole.only(brief), model, ROUNDS[0], exact=False, report=report, cache=cache)
    return _completed(whole, part, brief, model, seed), model


def _completed(whole: Imputation, part: Imputation, chosen: np.ndarray, model: Model, seed: int) -> Imputation:
    """The imputation with the times of its part, `chosen` (recordings,) bool, and others that follow the model."""
    if chosen.all():
        return part
    times = list(whole.times)
    if whole.effect == QUEUE:
        pixels = np.unique(np.concatenate([r.events.pixel for r in whole.fine]))
        unqueued = model.without_effect(QUEUE) if model.has(QUEUE) else model  # the crowd fires, it is not read out
        times = guess_by_rank(whole.fine, whole.windows, unqueued, pixels, seed)
    for i, t in zip(np.flatnonzero(chosen), part.times, strict=True):
        times[i] = t
    whole = replace(whole, times=tuple(times), random=part.random)
    for _ in range(1 if whole.draws_paths(model) else SETTLING_DRAWS):
        whole = draw_again(whole, model)
    return whole


def _filter_priors(model: Model) -> dict[str, Prior]:
    """A wide prior on each free filter of the model, about where it is."""
    return {
        n: Prior(p.to_coordinate(p.value), PRIOR_SD) for n, p in model.parameters.items() if n in FILTERS and p.free
    }


def _extrapolated(ends: Sequence[Maximum]) -> Model:
    """The model farther along the way that the last refits have gone."""
    coordinates, path = ends[-1].coordinates, [end.x for end in ends]
    gone = np.mean(path[-2:], axis=0) - np.mean(path[-5:-3], axis=0)
    limit = MAX_EXTRAPOLATED_MOVE * coordinates.longest_moves()
    x = path[-1] + EXTRAPOLATION * np.clip(gone, -limit, limit)
    return coordinates.model_at(np.clip(x, *coordinates.bounds()))


def _with_tick(recording: Recording, tick_s: float) -> Recording:
    """The same events, known to be as wide as the tick."""
    return replace(recording, events=replace(recording.events, tick_ns=max(round(1e9 * tick_s), 1)))
