"""Event times imputed behind a readout: draws of the times and refits of the model in turns.

Stochastic EM (Celeux & Diebolt 1985, Comput. Stat. Quarterly 2, 73).  Behind a queue or a tick, first only recordings
whose windows are short, until thresholds and their noise settle; then those with longer windows, whose times first
follow the model so found.  Filters have wide priors near the model's values meanwhile.  A recording whose events mostly
waited for far longer (a saturated readout) has lost its times and is left out.  Behind a jitter all times are drawn at
once, and its spread is estimated with them.  A model that gains an effect later moves the times behind it: they are
drawn again (`impute_again`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pixelid.fit.cache import FitCache
from pixelid.fit.maximise import Maximum, maximise
from pixelid.fit.starts import feasible
from pixelid.gap.detect.pixels import SCREEN_EVENTS
from pixelid.gap.imputation.draws import draw_times
from pixelid.gap.imputation.jitter import estimate_spread, exchange_stamps, uneven
from pixelid.gap.imputation.windows import (
    Windows,
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
from pixelid.stimuli.pixel_lights import Light

QUEUE, TICK, JITTER, SIGMA = (
    "readout_latency", "timestamp_quantisation", "timestamp_jitter", "timestamp_jitter.sigma_s",
)  # fmt: skip
FINEST_TICK_S = 5e-6  # a finer tick is a width of the event-time density, not a window
SHORT_SERVICE_TIMES = 20.0  # windows (nine of ten) of the recordings that the first stage begins with
MIN_EVENTS = 100  # to begin with
ROUNDS = (20, 8, 8)  # of draws and refits in each stage, the last with exact draws
ROUNDS_AGAIN = 24  # with exact draws, after the model has gained an effect
SETTLING_DRAWS = 60  # without refits, before the second stage
DRAWS_PER_ROUND = 2
JITTER_DRAWS = 8  # before the first refit behind a jitter
JITTER_ROUNDS = (12, 12, 24)  # with the thresholds' noise held, then free, then with exact draws
# Refits follow the times drawn in small steps: after so many rounds the model is extrapolated along the way that the
# last half of them has gone, so many times as far, but by no more than a fifth of its coordinates' longest moves.
EXTRAPOLATED_ROUNDS, EXTRAPOLATION, MAX_EXTRAPOLATED_MOVE = 6, 3.0, 0.2
NOISE, FAST = "threshold_sigma", ("sf_cutoff_hz", "diff_cutoff_hz")
PRIOR_SD = 0.5  # of log filters, while times are drawn
FILTERS = ("alpha", "beta", "gamma", "alpha_over_beta", "sf_cutoff_hz", "diff_cutoff_hz")
MIN_DEAD_SHARE = 0.1  # of the nominal dead time

Report = Callable[[str], None]


@dataclass(frozen=True)
class Imputation:
    """Recordings at imputed event times.

    Attributes:
        effect: What the readout did.
        stimuli: As they came.
        fine: The recordings as stamped, their stimuli as a fit reads them.
        windows, times: Per recording (`windows.py`); () where nothing has to be drawn.
        random: State of the generator that the next draw begins with.
        priors: Of filters, while times are drawn.
        lost: Names of recordings left out.
        error: Relative standard error of a jitter's spread.
        scatter: By parameter, standard deviation of its coordinate between draws.
    """

    effect: str
    stimuli: tuple[Light | None, ...]
    fine: tuple[Recording, ...]
    windows: tuple[Windows, ...]
    times: tuple[np.ndarray, ...]
    random: Mapping
    priors: Mapping[str, Prior]
    lost: tuple[str, ...] = ()
    error: float = 0.0
    scatter: Mapping[str, float] = field(default_factory=dict)

    @property
    def recordings(self) -> tuple[Recording, ...]:
        """At the times drawn last, with the stimuli they came with."""
        made = with_times(self.fine, self.times) if self.windows else self.fine
        return tuple(replace(r, stimulus=stimulus) for r, stimulus in zip(made, self.stimuli, strict=True))

    @property
    def sigma_s(self) -> float:
        """The jitter's standard deviation."""
        return 1e-9 * self.windows[0].sd

    @property
    def likelihood(self) -> EventTimes:
        """Of the times drawn last."""
        return EventTimes(with_times(self.fine, self.times))

    def with_filter_priors(self, model: Model) -> Model:
        """The model with the priors on its free filters."""
        parameters = {
            name: replace(p, prior=self.priors[name]) if p.free and name in self.priors else p
            for name, p in model.parameters.items()
        }
        return replace(model, parameters=parameters)

    def only(self, kept: np.ndarray) -> Imputation:
        """Without some recordings: kept (recordings,) bool."""

        def some(values: Sequence) -> tuple:
            return tuple(value for value, stays in zip(values, kept, strict=True) if stays)

        lost = tuple(r.name for r, stays in zip(self.fine, kept, strict=True) if not stays)
        return replace(
            self, stimuli=some(self.stimuli), fine=some(self.fine), windows=some(self.windows),
            times=some(self.times), lost=self.lost + lost,
        )  # fmt: skip

    def is_uneven(self, options: Options) -> bool:
        """Whether what was imputed does not look like a jitter, the same for all recordings and polarities."""
        limit = options.criteria.max_jitter_divergence_nats
        return uneven(self.fine, self.windows, self.times, limit, options.alpha_each)


def draw_again(imputation: Imputation, model: Model, *, estimate: bool = True, exact: bool = False) -> Imputation:
    """All times drawn once more, and the jitter estimated from them."""
    rng = np.random.default_rng(0)
    rng.bit_generator.state = imputation.random
    draw = draw_times(imputation.fine, imputation.windows, imputation.times, model, rng, exact)
    windows, error = imputation.windows, imputation.error
    if imputation.effect == JITTER:
        windows = tuple(exchange_stamps(imputation.fine, windows, draw.times, rng))
        if estimate:
            sd, error = estimate_spread(draw, windows[0].sd)
            windows = tuple(replace(w, sd=sd) for w in windows)
    random = rng.bit_generator.state
    return replace(imputation, windows=windows, times=tuple(draw.times), random=random, error=error)


def impute_again(
    imputation: Imputation,
    model: Model,
    rounds: int = ROUNDS_AGAIN,
    *,
    exact: bool = True,
    report: Report = lambda what: None,
    cache: FitCache | None = None,
) -> tuple[Imputation, Model]:
    """Draw times and refit the model in turns, and the model so found."""
    if not imputation.windows:
        return imputation, model
    model, ends = imputation.with_filter_priors(model), []
    for turn in range(rounds):
        report("true times")
        for _ in range(DRAWS_PER_ROUND):
            imputation = draw_again(imputation, model, exact=exact)
        ends.append(maximise(imputation.likelihood, model, tolerance=0.5, max_steps=4, cache=cache))
        model = ends[-1].model
        stride = turn % EXTRAPOLATED_ROUNDS == EXTRAPOLATED_ROUNDS - 1 and turn < rounds - 1
        if imputation.effect == JITTER and stride:
            model = _extrapolated(ends[-EXTRAPOLATED_ROUNDS:])
    scatter = np.std([end.x for end in ends[rounds // 2 :]], axis=0)
    by_name = dict(zip(ends[-1].coordinates.names, scatter.tolist(), strict=True))
    return replace(imputation, scatter=by_name), model


def impute(
    recordings: Sequence[Recording],
    signature: TimestampSignature,
    model: Model,
    options: Options,
    report: Report = lambda what: None,
    cache: FitCache | None = None,
) -> Imputation:
    """The recordings without what a timestamp signature says the readout did to their times."""
    random = np.random.default_rng(options.seed).bit_generator.state
    stimuli = tuple(r.stimulus for r in recordings)
    if signature.effect == TICK and signature.value < FINEST_TICK_S:
        ticked = tuple(_with_tick(r, signature.value) for r in recordings)
        return Imputation(signature.effect, stimuli, ticked, (), (), random, {})
    fine = tuple(with_fine_light(r, "smooth") for r in recordings)
    make = tick_windows if signature.effect == TICK else queue_windows
    windows = tuple(make(r, signature.value) for r in fine)
    reach = np.array([np.quantile(w.hi - w.lo, 0.9) if len(w.hi) else 0.0 for w in windows])
    unit = 1e9 * signature.value
    kept = reach <= options.criteria.max_wait_service_times * unit
    if sum(len(w.hi) for w, stays in zip(windows, kept, strict=True) if stays) < MIN_EVENTS:
        kept = reach <= np.sort(reach)[len(reach) // 2]
    times = tuple(guess_edges(fine, windows, early=signature.effect == QUEUE))
    priors = _filter_priors(model)
    whole = Imputation(signature.effect, stimuli, fine, windows, times, random, priors).only(kept)
    brief = reach[kept] <= SHORT_SERVICE_TIMES * unit
    whole, model = _begin(whole, brief, whole.with_filter_priors(model), options.seed, report, cache)
    whole, model = impute_again(whole, model, ROUNDS[1], exact=False, report=report, cache=cache)
    whole, model = impute_again(whole, model, ROUNDS[2], report=report, cache=cache)
    kept = _unexplained_share(whole.likelihood, model) <= options.criteria.max_unexplained_share_of_recording
    return whole.only(kept) if kept.any() else whole  # events unexplained everywhere: the model is wrong, not the times


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
    model = _with_nominal_fast_poles(fitted.without_effect(JITTER), nominal)
    times = tuple(guess_spaced(fine, windows, float(model.circuit().refractory)))
    stimuli = tuple(r.stimulus for r in recordings)
    random = np.random.default_rng(seed).bit_generator.state
    whole = Imputation(JITTER, stimuli, fine, windows, times, random, _filter_priors(nominal))
    for _ in range(JITTER_DRAWS):
        whole = draw_again(whole, model, estimate=False)
    held = model.fix({NOISE: None})
    whole, held = impute_again(whole, held, JITTER_ROUNDS[0], exact=False, report=report, cache=cache)
    free = model.set({n: held.values[n] for n in held.free})
    whole, free = impute_again(whole, free, JITTER_ROUNDS[1], exact=False, report=report, cache=cache)
    return impute_again(whole, free, JITTER_ROUNDS[2], report=report, cache=cache)


def _with_nominal_fast_poles(fitted: Model, nominal: Model) -> Model:
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
    times = list(whole.times)
    if whole.effect == QUEUE:
        pixels = np.unique(np.concatenate([r.events.pixel for r in whole.fine]))
        times = guess_by_rank(whole.fine, whole.windows, model, pixels, seed)
    for i, t in zip(np.flatnonzero(brief), part.times, strict=True):
        times[i] = t
    whole = replace(whole, times=tuple(times), random=part.random)
    for _ in range(SETTLING_DRAWS):
        whole = draw_again(whole, model)
    return whole, model


def _unexplained_share(likelihood: EventTimes, model: Model) -> np.ndarray:
    """(recordings,) share of the events without a cause."""
    background = likelihood.terms(model.circuit()).unexplained
    n = np.bincount(likelihood.recording_of_event, minlength=len(likelihood.recordings))
    return np.bincount(likelihood.recording_of_event, background, len(likelihood.recordings)) / np.maximum(n, 1)


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
