"""Fit a circuit to recordings: from observation model to intervals, one function."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from pixelid.errors import InputError
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.engines import Engine
from pixelid.fit.engines import engine as engine_named
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.newton import Optimum
from pixelid.fit.pooled import fit_pooled
from pixelid.fit.result import FitResult, Stopwatch, estimates_of
from pixelid.fit.starts import feasible, random_starts
from pixelid.fit.uncertainty.challenge import tested
from pixelid.fit.uncertainty.curvature import read_curvature
from pixelid.fit.uncertainty.small_sample import intervals
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import Model
from pixelid.parameters.gauge import Gauge
from pixelid.provenance import input_hashes, versions
from pixelid.recordings.recording import Recording
from pixelid.recordings.selection import few
from pixelid.status import Status
from pixelid.stimuli.resample import resampled

Progress = Callable[[str, float], None]
STARTS = 2  # random starts beside the model's own
MORE_STARTS, FAR = 6, 1.0  # tried one after the other, factors e^±FAR away, while the best end has not converged
SCOUT_EVENTS = 6_000  # events the search from afar looks at


def fit(
    recordings: Sequence[Recording],
    model: Model,
    *,
    gauge: Gauge | None = None,
    fixed: Mapping[str, float] | None = None,
    starts: int = STARTS,
    between: str = "auto",
    engine: str = "casadi",
    seed: int = 0,
    progress: Progress | None = None,
) -> FitResult:
    """Fit the model's free parameters to the recordings, all in one problem.

    Recordings with pixel addresses use the event-time likelihood, pooled ones the pooled-rate likelihood (all or
    none).  The search starts from the model's values and `starts` random points around them, and from a few more while
    the best has not converged.
    between: how recorded stimuli run between their samples, "linear", "smooth", or "auto": whichever explains the
    events better.  fixed: nuisances of the recordings to hold ("stimulus.gain", "pooled.pixels").
    engine: what climbs the event-time likelihood (`fit.engines`); all engines find the same optimum.  Pooled counts,
    whose likelihood has kinks, are always climbed by the damped Newton steps of `newton.py`, and the result says so.
    gauge: statements that make physical values unique, instead of the model's own; refused when
    incomplete or over-determined.  progress(what, fraction) reports.

    Raises InputError for recordings that cannot be fitted together, and for an impossible gauge.
    """
    watch = Stopwatch()
    climber = engine_named(engine)
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
    recordings = [recording.within_stimulus() for recording in recordings]
    rng = np.random.default_rng(seed)
    if all(pooled):
        objective, optimum, details, pixels = fit_pooled(recordings, model, fixed or {}, report)
        dispersion = details["dispersion"]
    else:
        if fixed:
            raise InputError(f"model {model.name} has no parameter {next(iter(fixed))!r} to hold")
        objective, optimum, details, pixels = _fit_event_times(recordings, model, starts, between, climber, rng, report)
        dispersion = 1.0
    report("standard errors", 0.9)
    curvature = -objective.hessian(optimum.x, optimum.local) / dispersion
    if not _positive(curvature):
        curvature = optimum.local.information / dispersion
        details["curvature"] = "information matrix (the Hessian is not positive definite)"
    else:
        details["curvature"] = "Hessian"
    coordinates = objective.coordinates
    reading = read_curvature(coordinates, curvature, optimum.on_bound)
    report("testing what the stimuli can tell", 0.95)
    identified, limits = tested(objective, optimum.x, reading.identified, recordings)
    details["condition_number"] = reading.condition
    details["directions_best_to_least_known"] = list(reading.directions)
    fitted = coordinates.model_at(optimum.x)
    physical, why = _physical(fitted, gauge is not None)
    status, advice = _status(optimum, coordinates.names, details)
    report("done", 1.0)
    return FitResult(
        status=status,
        advice=advice,
        model=fitted,
        engine="newton" if all(pooled) else climber.name,
        observation="pooled_rate" if all(pooled) else "event_times",
        coordinates=coordinates,
        x=optimum.x,
        covariance=reading.covariance,
        estimates=estimates_of(
            coordinates,
            optimum.x,
            reading.sd,
            identified,
            intervals(coordinates.names, optimum.x, reading.sd, pixels),
        ),
        unidentified=(*reading.sentences, *limits, *details.pop("caveats", ())),
        physical=physical,
        physical_why=why,
        log_likelihood=optimum.local.value - coordinates.log_prior(optimum.x),
        events=objective.likelihood.events,
        pixels=pixels,
        recordings=tuple(recording.name for recording in recordings),
        seconds=watch.seconds(),
        seed=seed,
        details=details,
        versions=versions(),
        inputs_sha256=input_hashes(recording.source for recording in recordings),
    )


def _fit_event_times(recordings, model, starts, between, climber: Engine, rng, report):
    if "threshold_noise" not in model.effects:
        raise InputError(
            f"model {model.name}: the event-time likelihood needs threshold_noise (add it with --with threshold_noise)"
        )
    full = EventTimes(recordings)
    scout = EventTimes(few(recordings, SCOUT_EVENTS, rng))
    model = feasible(model, scout)
    coordinates = Coordinates.of(model)
    report("searching", 0.05)
    searcher = engine_named("scipy") if climber.name == "torch" else climber  # far starts need curvature
    ends: list[Optimum] = []

    def search(begun: np.ndarray) -> None:
        ends.append(searcher.maximise(EventTimesObjective(scout, coordinates), begun, tolerance=1e-2, max_steps=80))
        report("searching", 0.05 + 0.45 * len(ends) / (len(ends) + starts + 1))

    def feasible_start(point: np.ndarray) -> np.ndarray:
        return Coordinates.of(feasible(coordinates.model_at(point), scout)).start

    search(coordinates.start)
    for point in random_starts(coordinates.start, starts, rng):
        search(feasible_start(point))
    while not max(ends, key=lambda end: end.local.value).converged and len(ends) <= starts + MORE_STARTS:
        search(feasible_start(random_starts(coordinates.start, 1, rng, FAR)[0]))
    best = max(ends, key=lambda end: end.local.value)
    agree = sum(end.local.value > best.local.value - 1.0 for end in ends)
    candidates = {}
    x = best.x
    for kind in ("linear", "smooth") if between == "auto" else (between,):
        finer = [r.with_stimulus(resampled(r.stimulus, kind)) for r in recordings]
        likelihood = EventTimes(finer)
        if "timestamp_jitter" in model.effects:
            likelihood.weigh_clock(coordinates.circuit(x))
        objective = EventTimesObjective(likelihood, coordinates)
        candidates[kind] = objective, climber.maximise(objective, x, max_steps=60)
        x = candidates[kind][1].x
        report("refining", 0.5 + 0.2 * len(candidates))
    kind = max(candidates, key=lambda k: candidates[k][1].local.value)
    objective, optimum = candidates[kind]
    strays = objective.likelihood.terms(coordinates.circuit(optimum.x)).stray
    details = {
        "stimulus_between_samples": kind,
        "starts": len(ends),
        "starts_at_this_optimum": agree,
        "steps": optimum.steps,
        "strays": int(strays.sum()),
        "stray_fraction": float(strays.mean()),
    }
    if len(candidates) == 2:
        details["smooth_minus_linear_nats"] = float(
            candidates["smooth"][1].local.value - candidates["linear"][1].local.value
        )
    return objective, optimum, details, full.pixels


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


def _status(optimum: Optimum, names: Sequence[str], details: dict) -> tuple[Status, str]:
    """How the fit ended, and what to do about it in words."""
    advice, statuses = [], []
    if details.get("stray_fraction", 0.0) > 1e-3:
        advice.append(
            f"{details['strays']} events ({100 * details['stray_fraction']:.2g} %) do not fit the model at all: "
            "it misses an effect"
        )
        statuses.append(Status.misfit)
    if details.get("dispersion", 1.0) > 3.0:
        advice.append(
            f"counts vary {details['dispersion']:.1f} times more about the model than Poisson counts would: "
            "errors are scaled for it, but the model misses an effect"
        )
        statuses.append(Status.misfit)
    held = [name for name, on_bound in zip(names, optimum.on_bound, strict=True) if on_bound]
    if held:
        advice.append(f"{', '.join(held)} on the bound: fix there, remove the effect, or widen the bound")
        statuses.append(Status.at_bound)
    if not optimum.converged:
        advice.insert(0, "the search ended before its maximum: fix a parameter that is not identified, or start closer")
        statuses.append(Status.not_converged)
    return Status.worst(statuses), "; ".join(advice)
