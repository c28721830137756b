"""The search of a fit to event times: from a few pixels and several starts to the optimum of all events."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from pixelid.errors import InputError
from pixelid.fit.bench import common_delay, held, with_bench
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.engines import Engine
from pixelid.fit.engines import engine as engine_named
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.judge import residual_tests
from pixelid.fit.levels.pixel_levels import Wanted
from pixelid.fit.levels.scales import Levelled, fit_levels
from pixelid.fit.light_unit import in_recorded_unit
from pixelid.fit.newton import Optimum
from pixelid.fit.newton import maximise as newton_steps
from pixelid.fit.refine import BETWEEN, refine
from pixelid.fit.ridge_of_stamps import Ridge, ridge_of_stamps
from pixelid.fit.shot_noise import EFFECT, HeldBench, fit_under_shot_noise, without_density
from pixelid.fit.starts import feasible, narrower, random_starts
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import Model
from pixelid.recordings.bench import without_pixel_gains
from pixelid.recordings.recording import Recording
from pixelid.recordings.selection import few
from pixelid.recordings.sensor_light import is_measured, light_caveats

MORE_STARTS, FAR = 6, 1.0  # tried one after the other, factors e^±FAR away, while the best end has not converged
# Nats: a step of 0.01 standard errors, well below the difference of the two forms; each step integrates anew.
CONTINUOUS_TOLERANCE = 1e-4
SCOUT_EVENTS = 6_000  # events the search from afar looks at
WARM_STEPS = 10  # of such a search before levels of pixels are looked at: orders of magnitude, not an optimum


@dataclass(frozen=True)
class Settings:
    """How an optimum is searched for; fields as of `fit`, `engine` the one that maximises."""

    engine: Engine
    form: str = "discrete"
    starts: int = 0
    between: str = "auto"
    fixed: Mapping[str, float] = field(default_factory=dict)
    seed: int = 0


@dataclass(frozen=True)
class SearchResult:
    """An optimum, and what a fit goes on with.

    Attributes:
        objective, optimum: What was maximised, and where.
        pixels: Number of pixels with events.
        details: What fit.json says of the search.
        log_likelihood: Without priors, where that is not the optimum's value less theirs.
        added_sd: Coordinate → error in addition to that of the curvature.
        caveats: Sentences on what the light leaves open.
        levels: Of pixels, where they were fitted.
        dispersion: Variance of counts over what the model expects; 1 of event times.
        information: (d, d) inverse of the estimates' covariance, where it is not the curvature's (pooled counts).
        bench: Nuisances that were held at what a fit without shot noise found.
        ridge: Along which what is held of the noise of stamps misleads, where there is one.
    """

    objective: Any
    optimum: Optimum
    pixels: int
    details: dict[str, Any]
    log_likelihood: float | None = None
    added_sd: Mapping[str, float] = field(default_factory=dict)
    caveats: Sequence[str] = ()
    levels: Levelled | None = None
    dispersion: float = 1.0
    information: np.ndarray | None = None
    bench: HeldBench | None = None
    ridge: Ridge | None = None


def check_event_times(model: Model) -> None:
    """Raise InputError for a model without threshold noise: event times have no density under it."""
    if "threshold_noise" not in model.effects:
        raise InputError(
            f"model {model.name}: the event-time likelihood needs threshold_noise (add it with --with threshold_noise)"
        )


def search_event_times(
    recordings: Sequence[Recording],
    model: Model,
    wanted: Wanted | None,
    settings: Settings,
    rng: np.random.Generator,
    report: Callable[[str, float], None],
) -> SearchResult:
    """The optimum of event times.

    Args:
        recordings: With pixels and their light.
        model: Where to start.
        wanted: Levels of pixels to be fitted too.
        settings: Of the search.
        rng: Of starts and pixels.
        report: Called with what is done and the share of the fit.

    Raises:
        InputError: A model without threshold noise, or shot noise with levels of pixels or in the continuous form.
    """
    check_event_times(model)
    if EFFECT in model.effects and wanted is not None:
        raise InputError(f"{EFFECT}: not identified together with levels of pixels; leave one of them out")
    if EFFECT in model.effects and settings.form != "discrete":
        raise InputError(f"form: {EFFECT} is fitted in the discrete form only")
    # from afar a field that is uneven by percents is even, and gains cost as much as all else
    scout = EventTimes([without_pixel_gains(recording) for recording in few(recordings, SCOUT_EVENTS, rng)])
    if common_delay(recordings):
        model = model.fix({"delay_s": None})
    report("unit of the light", 0.02)
    whole = with_bench(in_recorded_unit(model, scout), recordings)
    model = held(feasible(without_density(whole), scout), settings.fixed)
    coordinates = Coordinates.of(model)
    report("searching", 0.05)
    ends = _from_afar(scout, coordinates, wanted, settings, rng, report)
    best = max(ends, key=lambda end: end.local.value)
    # where sensors measured the light, only its samples are known
    kinds = ("linear",) if any(map(is_measured, recordings)) else BETWEEN
    kinds = kinds if settings.between == "auto" or kinds == ("linear",) else (settings.between,)
    levels = ridge = None
    if wanted is None:
        refined = refine(
            recordings, coordinates, best.x, kinds, settings.engine, rng,
            lambda share: report("refining", 0.5 + 0.4 * share),
        )  # fmt: skip
        objective, optimum = refined.objective, refined.optimum
        # under shot noise the likelihood is another, with an optimum and a ridge of its own
        ridge = None if EFFECT in model.effects else ridge_of_stamps(objective, optimum)
        if ridge is not None:
            objective, optimum = ridge.objective, ridge.optimum
        details = {"stimulus_between_samples": refined.between, **refined.details}
    else:  # without levels the optimum of all events is far off, and it is not known how light runs between its samples
        report("gain and background of pixels", 0.5)
        levels = fit_levels(recordings, coordinates, (best.x, coordinates.start), wanted, kinds)
        objective, optimum, details = levels.objective, levels.optimum, dict(levels.details)
    found = SearchResult(objective, optimum, EventTimes(recordings).pixels, details, levels=levels, ridge=ridge,
                  caveats=light_caveats(recordings))  # fmt: skip
    if levels is not None:
        found = replace(found, log_likelihood=objective.terms(optimum.x).total)
    expected: Mapping[str, float] = {}
    if EFFECT in model.effects:
        report("shot noise", 0.85)
        under = fit_under_shot_noise(objective, optimum, whole, settings.seed)
        expected = under.expected
        found = replace(found, objective=under.objective, optimum=under.optimum, added_sd=under.added_sd,
                        bench=under.bench, details={**details, EFFECT: under.details})  # fmt: skip
    if settings.form == "continuous":
        report("continuous form", 0.9)
        found = _continuous(found, settings.engine)
    return _with_details(found, settings.form, ends, best, expected)


def _from_afar(
    scout: EventTimes, coordinates: Coordinates, wanted: Wanted | None, settings: Settings, rng, report
) -> list[Optimum]:
    """Ends of searches of a few pixels from the model's own values and random ones."""
    objective, starts = EventTimesObjective(scout, coordinates), settings.starts
    engine = settings.engine
    searcher = engine_named("scipy") if engine.name == "torch" else engine  # far starts need curvature
    ends: list[Optimum] = []

    def feasible_start(point: np.ndarray) -> np.ndarray:
        return Coordinates.of(feasible(coordinates.model_at(point), scout)).start

    points = [coordinates.start, *map(feasible_start, random_starts(coordinates.start, starts, rng))]
    if wanted is not None:  # searches without levels end far off, if they end: a few steps tell the best start
        return [newton_steps(objective, point, tolerance=1.0, max_steps=WARM_STEPS) for point in points]

    def search(begun: np.ndarray) -> None:
        ends.append(searcher.maximise(objective, begun, tolerance=1e-2, max_steps=80))
        closer = narrower(coordinates.model_at(ends[-1].x), scout)
        if closer is not None:
            ends.append(searcher.maximise(objective, Coordinates.of(closer).start, tolerance=1e-2, max_steps=80))
        report("searching", 0.05 + 0.45 * len(ends) / (len(ends) + starts + 1))

    for point in points:
        search(point)
    while starts and not max(ends, key=lambda end: end.local.value).converged and len(ends) <= starts + MORE_STARTS:
        search(feasible_start(random_starts(coordinates.start, 1, rng, FAR)[0]))
    return ends


def _continuous(found: SearchResult, engine: Engine) -> SearchResult:
    """The optimum of the continuous form, from that of the discrete one; residuals are tested under the latter."""
    continuous, discrete = engine.continuous(found.objective, found.optimum.x), found.optimum
    optimum = newton_steps(continuous, discrete.x, tolerance=CONTINUOUS_TOLERANCE, max_steps=20)
    more = {"continuous_minus_discrete_nats": float(optimum.local.value - discrete.local.value)}
    return replace(found, optimum=optimum, details={**found.details, **more})


def _with_details(
    found: SearchResult, form: str, ends: Sequence[Optimum], best: Optimum, expected: Mapping[str, float]
) -> SearchResult:
    """With how the search went and what the optimum leaves;  expected: as of `UnderNoise`."""
    background = found.objective.terms(found.optimum.x).unexplained
    tests = residual_tests(found.objective, found.optimum.x)
    details = {
        **found.details,
        "starts": len(ends),
        "starts_at_this_optimum": sum(end.local.value > best.local.value - 1.0 for end in ends),
        "steps": found.optimum.steps,
        "background_events": int(background.sum()),
        "background_fraction": float(background.mean()),
        "residual_tests": [replace(t, expected=expected.get(t.covariate, 0.0)).as_dict() for t in tests],
        "form": form,
    }
    return replace(found, details=details)
