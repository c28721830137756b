"""Fit a circuit to recordings, one function: prepare, search, judge."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from pixelid.errors import InputError
from pixelid.fit.assess import assess
from pixelid.fit.bench import clocks_found, common_delay
from pixelid.fit.bias_priors import beside_events
from pixelid.fit.engines import engine as engine_named
from pixelid.fit.levels.pixel_levels import PixelLevelsLike, Wanted
from pixelid.fit.measured_light import NO_PHYSICAL, held_in_words
from pixelid.fit.pooled import fit_pooled
from pixelid.fit.prepare import prepare
from pixelid.fit.result import FitResult, Stopwatch
from pixelid.fit.search import Settings, search_event_times
from pixelid.fit.shot_noise import without_filter
from pixelid.model.model import Model
from pixelid.parameters.gauge import Gauge
from pixelid.provenance import input_hashes, versions
from pixelid.recordings.recording import Recording

Progress = Callable[[str, float], None]
STARTS = 2  # random starts beside the model's own


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
    bias_priors: bool | str = False,
    seed: int = 0,
    progress: Progress | None = None,
) -> FitResult:
    """Fit the model's free parameters to the recordings, all in one problem.

    Recordings with pixel addresses use the event-time likelihood, pooled ones the pooled-rate likelihood (all or
    none).  The search starts from the model's values and `starts` random points around them, and from a few more while
    the best has not converged.  Recordings whose light was brought onto the camera's clock by a trigger or by their
    events carry a delay and a drift of their clock as nuisances (`likelihood.clocks`).  What has its own value in each
    recording (a lamp's phase), where it is free, is fitted in each (`fit.own_values`).

    Args:
        recordings: one or more, of the same sensor.
        model: what to fit; its values are the start, taken as numbers in the unit of the recordings' light.
        gauge: statements that make physical values unique, instead of the model's own; refused when incomplete or
            over-determined.
        fixed: nuisances of the recordings to hold ("stimulus.gain", "pooled.pixels", "alignment.delay_s[NAME]",
            "mains_flicker.phase_rad[NAME]").
        starts: random starts in addition to the model's own; 0: those alone, however the search ends.
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
            recordings' headers, or by the laws in a folder of `pixelid biases` (`fit.bias_priors`).
        seed: of the random starts.
        progress: progress(what, fraction) is called as the fit goes on.

    Returns:
        The values with their intervals, and how the fit ended.

    Raises:
        InputError: recordings that cannot be fitted together (with light in several units, for one), an impossible
            gauge, or a form that the circuit lacks.
    """
    watch, report = Stopwatch(), progress or (lambda what, fraction: None)
    settings = Settings(engine_named(engine), form, starts, between, fixed or {}, seed)
    ready = prepare(recordings, model, gauge, Wanted.of(pixel_levels), form, bias_priors)
    if ready.pooled:
        found = fit_pooled(ready.recordings, ready.model, settings.fixed, report, seed)
    else:
        rng = np.random.default_rng(seed)
        found = search_event_times(ready.recordings, ready.model, ready.levels, settings, rng, report)
    report("standard errors", 0.9)
    assessment = assess(ready, found, seed, report)
    fitted = without_filter(found.objective.coordinates.model_at(found.optimum.x), ready.model)
    physical, why = (None, NO_PHYSICAL) if ready.sampled else _physical(fitted, gauge is not None)
    apart, of_biases = common_delay(ready.recordings), ready.of_biases
    coordinates, x = found.objective.coordinates, found.optimum.x
    report("done", 1.0)
    value = found.optimum.local.value - coordinates.log_prior(x)
    return FitResult(
        status=assessment.status,
        advice=assessment.advice,
        model=fitted,
        engine="newton" if ready.pooled else settings.engine.name,
        observation="pooled_rate" if ready.pooled else "event_times",
        coordinates=coordinates,
        x=x,
        covariance=assessment.covariance,
        estimates=assessment.estimates,
        unidentified=(
            *assessment.unidentified,
            *found.caveats,
            *held_in_words(ready.held, ready.recordings),
            *([apart] if apart else []),
            *(assessment.levels.notes if assessment.levels is not None else ()),
            *(beside_events(of_biases, coordinates.names, x, assessment.sd) if of_biases else ()),
        ),
        physical=physical,
        physical_why=why,
        log_likelihood=value if found.log_likelihood is None else found.log_likelihood,
        events=found.objective.likelihood.events,
        pixels=found.pixels,
        recordings=tuple(recording.name for recording in ready.recordings),
        seconds=watch.seconds(),
        seed=seed,
        alignment=clocks_found(ready.recordings, coordinates.model, assessment.estimates),
        pixel_levels=assessment.levels,
        bias_priors=of_biases,
        details={**found.details, **assessment.details},
        versions=versions(),
        inputs_sha256=input_hashes(recording.source for recording in ready.recordings),
    )


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
