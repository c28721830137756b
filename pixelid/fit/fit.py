"""Fit a circuit to recordings: from observation model to intervals, one function."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from pixelid.errors import InputError
from pixelid.fit.bench import clocks_found, common_delay, held, with_bench
from pixelid.fit.bias_priors import beside_events, with_bias_priors
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.data import as_fitted
from pixelid.fit.engines import FORMS, Engine
from pixelid.fit.engines import engine as engine_named
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.judge import at_rest_only, open_sides, precision, residual_tests, status_of
from pixelid.fit.levels.found import pixel_levels as levels_of
from pixelid.fit.levels.objective import LevelledObjective
from pixelid.fit.levels.pixel_levels import PixelLevelsLike, Wanted
from pixelid.fit.levels.scales import fit_levels
from pixelid.fit.light_unit import in_recorded_unit
from pixelid.fit.measured_light import NO_PHYSICAL, as_light_tells, held_in_words, line_errors, unresolved
from pixelid.fit.newton import Optimum
from pixelid.fit.newton import maximise as newton_steps
from pixelid.fit.pooled import fit_pooled
from pixelid.fit.refine import BETWEEN, refine
from pixelid.fit.result import FitResult, Stopwatch, estimates_of
from pixelid.fit.shot_noise import EFFECT, fit_under_shot_noise, without_density, without_filter
from pixelid.fit.starts import feasible, narrower, random_starts
from pixelid.fit.trace_errors import trace_errors
from pixelid.fit.uncertainty.challenge import challenged
from pixelid.fit.uncertainty.curvature import read_curvature
from pixelid.fit.uncertainty.ridge import profile_of_ridge, widened
from pixelid.fit.uncertainty.small_sample import intervals
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import Model
from pixelid.parameters.gauge import Gauge
from pixelid.provenance import input_hashes, versions
from pixelid.recordings.recording import Recording
from pixelid.recordings.selection import few, unit_of_light
from pixelid.recordings.sensor_light import is_measured, light_caveats

Progress = Callable[[str, float], None]
CLOCKS = "alignment."  # what names of the clocks' nuisances begin with
STARTS = 2  # random starts beside the model's own
MORE_STARTS, FAR = 6, 1.0  # tried one after the other, factors e^±FAR away, while the best end has not converged
# Nats: a step of 0.01 standard errors, well below the difference of the two forms; each step integrates anew.
CONTINUOUS_TOLERANCE = 1e-4
SCOUT_EVENTS = 6_000  # events the search from afar looks at
WARM_STEPS = 10  # of such a search before levels of pixels are looked at: orders of magnitude, not an optimum


def fit(
    recordings: Sequence[Recording],
    model: Model,
    *,
    gauge: Gauge | None = None,
    fixed: Mapping[str, float] | None = None,
    starts: int = STARTS,
    between: str = "auto",
    engine: str = "casadi",
    form: str = "discrete",
    pixel_levels: PixelLevelsLike = None,
    bias_priors: bool = False,
    seed: int = 0,
    progress: Progress | None = None,
) -> FitResult:
    """Fit the model's free parameters to the recordings, all in one problem.

    Recordings with pixel addresses use the event-time likelihood, pooled ones the pooled-rate likelihood (all or
    none).  The search starts from the model's values and `starts` random points around them, and from a few more while
    the best has not converged.  Recordings whose light was brought onto the camera's clock by a trigger or by their
    events carry a delay and a drift of their clock as nuisances (`likelihood.clocks`).  What starts anew in each
    recording (a lamp's phase), where it is free, is fitted in each (`fit.own_values`).

    Args:
        recordings: one or more, of the same sensor.
        model: what to fit; its values are the start, taken as numbers in the unit of the recordings' light.
        gauge: statements that make physical values unique, instead of the model's own; refused when incomplete or
            over-determined.
        fixed: nuisances of the recordings to hold ("stimulus.gain", "pooled.pixels", "alignment.delay_s[NAME]",
            "mains_flicker.phase_rad[NAME]").
        starts: random starts beside the model's own.
        between: how recorded stimuli run between their samples, "linear", "smooth", or "auto": whichever explains the
            events better.
        engine: what maximises the event-time likelihood (`fit.engines`); all engines find the same optimum.  Pooled
            counts, whose likelihood has kinks, are always maximised by the damped Newton steps of `newton.py`, and the
            result says so.
        form: "discrete", the photoreceptor linearised once per step of the stimulus, or "continuous", its coefficients
            following the light at every instant: started from the discrete optimum, see docs/methods/fitting.md for the
            cost.
        pixel_levels: "gain", "background" or "both" of every pixel are nuisances, and the light is not taken as exact
            (`fit.levels.pixel_levels`); with scales that are known, "gain=0.2,background=3" or {"gain": 0.2}.
        bias_priors: thresholds, dead time and the source follower's cutoff have priors from the bias settings in the
            recordings' headers (`fit.bias_priors`).
        seed: of the random starts.
        progress: progress(what, fraction) is called as the fit goes on.

    Returns:
        The values with their intervals, and how the fit ended.

    Raises:
        InputError: recordings that cannot be fitted together (with light in several units, for one), an impossible
            gauge, or a form that the circuit lacks.
    """
    watch = Stopwatch()
    maximiser = engine_named(engine)
    if form not in FORMS:
        raise InputError(f"form must be one of {', '.join(FORMS)}, found {form!r}")
    report = progress or (lambda what, fraction: None)
    if not recordings:
        raise InputError("no recordings to fit")
    if gauge is not None:
        if model.physical is None:
            raise InputError(f"model {model.name} has no [physical] values, so a gauge has nothing to map to")
        gauge.check(model.physical)
        model = replace(model, gauge=gauge)
    pooled = [recording.pooled for recording in recordings]
    if any(pooled) and not all(pooled):
        raise InputError("some recordings are pooled and some have pixels; fit them separately")
    for recording in recordings:
        recording.check_stimulus_covers_events()
    model = model.with_radiance_in(unit_of_light(recordings))
    wanted = Wanted.of(pixel_levels)
    if wanted is not None:
        wanted.check(recordings, model, form)
    recordings = as_fitted(recordings)
    sampled = any(map(is_measured, recordings))
    held, model = unresolved(model) if sampled else [], as_light_tells(model, recordings)
    if sampled and form != "discrete":
        raise InputError("form: light that the sensor measured itself is followed in the discrete form only")
    model, of_biases = with_bias_priors(model, recordings) if bias_priors else (model, None)
    rng = np.random.default_rng(seed)
    if all(pooled):
        if form != "discrete":
            raise InputError("form: the continuous form is for event times, these recordings are pooled")
        objective, optimum, details, pixels = fit_pooled(recordings, model, fixed or {}, report, seed)
        dispersion = details["dispersion"]
    else:
        objective, optimum, details, pixels = _fit_event_times(
            recordings, model, fixed or {}, starts, between, maximiser, form, wanted, rng, seed, report
        )
        dispersion = 1.0
    report("standard errors", 0.9)
    coordinates = objective.coordinates
    # A clock moves every event across samples of the light, where the density has corners, and is nearly exchangeable
    # for the fastest poles: along that ridge differences of the gradient are noise, and the information matrix is not.
    clocks_free = not all(pooled) and any(name.startswith(CLOCKS) for name in coordinates.names)
    information = details.pop("information", optimum.local.information) / max(dispersion, 1.0)
    direct = clocks_free or all(pooled)
    curvature = information if direct else -objective.hessian(optimum.x, optimum.local)
    if all(pooled):
        details["curvature"] = "information matrix and the scatter of the score over pixels"
    elif clocks_free:
        details["curvature"] = "information matrix (the clocks' delays are free)"
    elif not _positive(curvature):
        curvature = information
        details["curvature"] = "information matrix (the Hessian is not positive definite)"
    else:
        details["curvature"] = "Hessian"
    reading = read_curvature(coordinates, curvature, optimum.on_bound)
    levels = details.pop("levels", None)
    if levels is not None:
        levels = levels_of(levels, reading.covariance, optimum.on_bound, recordings[0].events.width)
    report("testing what the stimuli can tell", 0.95)
    identified, limits = challenged(objective, optimum.x, reading.identified, recordings)
    details["condition_number"] = reading.condition
    details["directions_best_to_least_known"] = list(reading.directions)
    fitted = without_filter(coordinates.model_at(optimum.x), model)
    physical, why = (None, NO_PHYSICAL) if sampled else _physical(fitted, gauge is not None)
    if sampled and isinstance(objective, EventTimesObjective):
        added = line_errors(objective, optimum.x)
        reading = _wider(reading, added)
        details["added_by_light_between_samples"] = dict(zip(coordinates.names, added.tolist(), strict=True))
    if isinstance(objective, EventTimesObjective):
        between_samples = details.get("stimulus_between_samples", "linear")
        added = trace_errors(objective, optimum.x, reading.covariance, recordings, between_samples, seed)
        reading = _wider(reading, added) if added.any() else reading
    added_sd = details.pop("added_sd", {})
    if added_sd:
        reading = _wider(reading, np.array([added_sd.get(name, 0.0) for name in coordinates.names]))
    limits_95 = intervals(coordinates.names, optimum.x, reading.sd, pixels)
    bends = clocks_free or (reading.bends and not sampled and not all(pooled))
    # Levels are held along the ridge: fast poles and dead time, which make it, owe next to nothing to them.
    ridge = objective.held(optimum.x) if isinstance(objective, LevelledObjective) else objective
    along = profile_of_ridge(ridge, optimum.x, reading) if bends else None
    if along is not None:
        wider = widened(limits_95, along, ridge, optimum.x, reading.covariance)
        if levels is not None:  # never narrower than with levels free
            wider = np.minimum(wider[0], limits_95[0]), np.maximum(wider[1], limits_95[1])
        limits_95 = wider
        details["intervals_follow_profile_of"] = along.name
    estimates, open_ones = open_sides(
        estimates_of(coordinates, optimum.x, reading.sd, identified, limits_95), coordinates.parameters
    )
    status, advice = status_of(objective, optimum, estimates, details)
    estimates, stopped = at_rest_only(estimates, status)
    details["precision"] = {p.name: precision(estimates[p.name], p, status) for p in coordinates.parameters}
    apart = common_delay(recordings)
    report("done", 1.0)
    return FitResult(
        status=status,
        advice=advice,
        model=fitted,
        engine="newton" if all(pooled) else maximiser.name,
        observation="pooled_rate" if all(pooled) else "event_times",
        coordinates=coordinates,
        x=optimum.x,
        covariance=reading.covariance,
        estimates=estimates,
        unidentified=(
            *stopped,
            *open_ones,
            *reading.sentences,
            *limits,
            *details.pop("caveats", ()),
            *held_in_words(held, recordings),
            *([apart] if apart else []),
            *(levels.notes if levels is not None else ()),
            *(beside_events(of_biases, coordinates.names, optimum.x, reading.sd) if of_biases else ()),
        ),
        physical=physical,
        physical_why=why,
        log_likelihood=details.pop("log_likelihood", optimum.local.value - coordinates.log_prior(optimum.x)),
        events=objective.likelihood.events,
        pixels=pixels,
        recordings=tuple(recording.name for recording in recordings),
        seconds=watch.seconds(),
        seed=seed,
        alignment=clocks_found(recordings, coordinates.model, estimates),
        pixel_levels=levels,
        bias_priors=of_biases,
        details=details,
        versions=versions(),
        inputs_sha256=input_hashes(recording.source for recording in recordings),
    )


def _wider(reading, added: np.ndarray):
    """The reading of a curvature with errors (d,) that it does not know, added to every coordinate's."""
    return replace(reading, sd=np.hypot(reading.sd, added), covariance=reading.covariance + np.diag(added**2))


def check_event_times(model: Model) -> None:
    """Raise InputError for a model without threshold noise: event times have no density under it."""
    if "threshold_noise" not in model.effects:
        raise InputError(
            f"model {model.name}: the event-time likelihood needs threshold_noise (add it with --with threshold_noise)"
        )


def _fit_event_times(recordings, model, fixed, starts, between, maximiser: Engine, form, wanted, rng, seed, report):
    check_event_times(model)
    pixels = EventTimes(recordings).pixels
    scout = EventTimes(few(recordings, SCOUT_EVENTS, rng))
    if common_delay(recordings):
        model = model.fix({"delay_s": None})
    report("unit of the light", 0.02)
    model = in_recorded_unit(model, scout)
    noisy = EFFECT in model.effects
    if noisy and wanted is not None:
        raise InputError(f"{EFFECT}: is not told beside levels of pixels; leave one of them out")
    if noisy and form != "discrete":
        raise InputError(f"form: {EFFECT} is fitted in the discrete form only")
    model = with_bench(model, recordings)
    whole, model = model, without_density(model)
    model = held(feasible(model, scout), fixed)
    coordinates = Coordinates.of(model)
    report("searching", 0.05)
    searcher = engine_named("scipy") if maximiser.name == "torch" else maximiser  # far starts need curvature
    ends: list[Optimum] = []

    def search(begun: np.ndarray) -> None:
        objective = EventTimesObjective(scout, coordinates)
        ends.append(searcher.maximise(objective, begun, tolerance=1e-2, max_steps=80))
        closer = narrower(coordinates.model_at(ends[-1].x), scout)
        if closer is not None:
            begun = Coordinates.of(closer).start
            ends.append(searcher.maximise(objective, begun, tolerance=1e-2, max_steps=80))
        report("searching", 0.05 + 0.45 * len(ends) / (len(ends) + starts + 1))

    def feasible_start(point: np.ndarray) -> np.ndarray:
        return Coordinates.of(feasible(coordinates.model_at(point), scout)).start

    if wanted is None:
        search(coordinates.start)
        for point in random_starts(coordinates.start, starts, rng):
            search(feasible_start(point))
        while not max(ends, key=lambda end: end.local.value).converged and len(ends) <= starts + MORE_STARTS:
            search(feasible_start(random_starts(coordinates.start, 1, rng, FAR)[0]))
    else:  # searches without levels end far off, if they end: a few steps tell which start is the best
        for point in (coordinates.start, *map(feasible_start, random_starts(coordinates.start, starts, rng))):
            ends.append(
                newton_steps(EventTimesObjective(scout, coordinates), point, tolerance=1.0, max_steps=WARM_STEPS)
            )
    best = max(ends, key=lambda end: end.local.value)
    agree = sum(end.local.value > best.local.value - 1.0 for end in ends)
    sampled = any(map(is_measured, recordings))  # then only the samples are known
    kinds = ("linear",) if sampled else BETWEEN if between == "auto" else (between,)
    levels = None
    if wanted is None:
        refined = refine(
            recordings, coordinates, best.x, kinds, maximiser, rng, lambda share: report("refining", 0.5 + 0.4 * share)
        )
        objective, optimum = refined.objective, refined.optimum
        found = {"stimulus_between_samples": refined.between, **refined.details}
    else:  # without levels the optimum of all events is far off, and how light runs between its samples is not told
        report("gain and background of pixels", 0.5)
        levels = fit_levels(recordings, coordinates, (best.x, coordinates.start), wanted, kinds)
        objective, optimum, found = levels.objective, levels.optimum, levels.details
    expected: dict[str, float] = {}
    if noisy:
        report("shot noise", 0.85)
        under = fit_under_shot_noise(objective, optimum, whole, seed)
        objective, optimum, expected = under.objective, under.optimum, under.expected
        found = {**found, EFFECT: under.details, "added_sd": under.added_sd}
    if form == "continuous":
        report("continuous form", 0.9)
        continuous = maximiser.continuous(objective, optimum.x)
        discrete = optimum
        optimum = newton_steps(continuous, discrete.x, tolerance=CONTINUOUS_TOLERANCE, max_steps=20)
    background = objective.terms(optimum.x).unexplained
    details = {
        **found,
        "starts": len(ends),
        "starts_at_this_optimum": agree,
        "steps": optimum.steps,
        "background_events": int(background.sum()),
        "background_fraction": float(background.mean()),
        "residual_tests": [
            replace(test, expected=expected.get(test.covariate, 0.0)).as_dict()
            for test in residual_tests(objective, optimum.x)
        ],
        "form": form,
        "caveats": light_caveats(recordings),
    }
    if form == "continuous":
        details["continuous_minus_discrete_nats"] = float(optimum.local.value - discrete.local.value)
    if levels is not None:
        details |= {"levels": levels, "log_likelihood": objective.terms(optimum.x).total}
    return objective, optimum, details, pixels


def _physical(model: Model, demanded: bool) -> tuple[dict[str, float] | None, str]:
    if model.physical is None or model.photoreceptor != "second_order":
        return None, "the model has no second-order photoreceptor with [physical] values"
    try:
        v = model.values
        values = model.gauge.physical(v["alpha"], v["beta"], v["gamma"], model.physical)
    except InputError as error:
        if demanded:
            raise
        return None, str(error)
    return values.as_dict(), ""


def _positive(matrix: np.ndarray) -> bool:
    try:
        np.linalg.cholesky(matrix + 0.0)
    except np.linalg.LinAlgError:
        return False
    return bool(np.isfinite(matrix).all())
