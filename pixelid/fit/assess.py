"""What a fit knows at its optimum: errors and intervals, what the data leave open, and its status."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.judge import at_rest_only, open_sides, precision, status_of
from pixelid.fit.levels.found import pixel_levels as levels_of
from pixelid.fit.levels.objective import LevelledObjective
from pixelid.fit.levels.pixel_levels import PixelLevels
from pixelid.fit.measured_light import line_errors
from pixelid.fit.prepare import Prepared
from pixelid.fit.result import Estimate, estimates_of
from pixelid.fit.search import SearchResult
from pixelid.fit.uncertainty.challenge import challenged
from pixelid.fit.uncertainty.curvature import Identified, read_curvature
from pixelid.fit.uncertainty.ridge import profile_of_ridge, widened
from pixelid.fit.uncertainty.small_sample import intervals
from pixelid.likelihood.event_times import EventTimes
from pixelid.recordings.own_light import with_fine_light
from pixelid.recordings.recording import Recording
from pixelid.status import Status
from pixelid.stimuli.stimulus import Stimulus
from pixelid.stimuli.trace_noise import ATTRIBUTE, without_noise

CLOCKS = "alignment."  # what names of the clocks' nuisances begin with


@dataclass(frozen=True)
class Assessment:
    """Of an optimum.

    Attributes:
        status, advice: How the fit ended, and what to do about it.
        estimates: Parameter → value, interval and whether it is identified.
        covariance, sd: (d, d) and (d,) of the coordinates.
        unidentified: Sentences on what the data leave open.
        levels: Of pixels, where they were fitted.
        details: What fit.json says of all this.
    """

    status: Status
    advice: str
    estimates: Mapping[str, Estimate]
    covariance: np.ndarray
    sd: np.ndarray
    unidentified: tuple[str, ...]
    levels: PixelLevels | None
    details: dict[str, Any]


def assess(ready: Prepared, found: SearchResult, seed: int, report: Callable[[str, float], None]) -> Assessment:
    """What is known at an optimum.

    Args:
        ready: The recordings and the model.
        found: The optimum.
        seed: Of traces whose noise is drawn again.
        report: Called with what is done and the share of the fit.
    """
    objective, optimum, coordinates = found.objective, found.optimum, found.objective.coordinates
    clocks_free = not ready.pooled and any(name.startswith(CLOCKS) for name in coordinates.names)
    curvature, of_what = _curvature(found, clocks_free)
    reading = read_curvature(coordinates, curvature, optimum.on_bound)
    levels = None
    if found.levels is not None:
        width = ready.recordings[0].events.width
        levels = levels_of(found.levels, reading.covariance, optimum.on_bound, width)
    report("testing what the stimuli can identify", 0.95)
    identified, limits = challenged(objective, optimum.x, reading.identified, ready.recordings)
    details: dict[str, Any] = {
        "curvature": of_what,
        "condition_number": reading.condition,
        "directions_best_to_least_known": list(reading.directions),
    }
    if ready.sampled and isinstance(objective, EventTimesObjective):
        added = line_errors(objective, optimum.x)
        reading = _wider(reading, added)
        details["added_by_light_between_samples"] = dict(zip(coordinates.names, added.tolist(), strict=True))
    if isinstance(objective, EventTimesObjective):
        between = found.details.get("stimulus_between_samples", "linear")
        reading = _wider(
            reading, trace_errors(objective, optimum.x, reading.covariance, ready.recordings, between, seed)
        )
    reading = _wider(reading, np.array([found.added_sd.get(name, 0.0) for name in coordinates.names]))
    limits_95 = intervals(coordinates.names, optimum.x, reading.sd, found.pixels)
    bends = clocks_free or found.ridge is not None or (reading.bends and not ready.sampled and not ready.pooled)
    if isinstance(objective, EventTimesObjective) and objective.likelihood.shift is not None:
        bends = False  # what shot noise adds is held as at the optimum: the likelihood is not known far from it
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
    status, advice = status_of(objective, optimum, estimates, {**found.details, **details})
    estimates, stopped = at_rest_only(estimates, status)
    details["precision"] = {p.name: precision(estimates[p.name], p, status) for p in coordinates.parameters}
    unidentified = (*stopped, *open_ones, *reading.sentences, *limits)
    return Assessment(status, advice, estimates, reading.covariance, reading.sd, unidentified, levels, details)


def _curvature(found: SearchResult, clocks_free: bool) -> tuple[np.ndarray, str]:
    """((d, d) curvature at the optimum, what it is).

    A clock moves every event across samples of the light, where the density has corners, and is nearly exchangeable for
    the fastest poles: along that ridge differences of the gradient are noise, and the information matrix is not.
    """
    optimum, names = found.optimum, found.objective.coordinates.names
    if found.information is not None:
        # counts that scatter less than the model's do not make it better known
        wide = max(found.dispersion, 1.0)
        return found.information / wide, "information matrix and the scatter of the score over pixels"
    counted = (lambda curvature: curvature) if found.bench is None else partial(found.bench.counted, names)
    information = counted(optimum.local.information / found.dispersion)
    if found.ridge is not None:
        return found.ridge.opened(names, information), "information matrix, opened along the ridge of the stamps' noise"
    if clocks_free:
        return information, "information matrix (the clocks' delays are free)"
    hessian = counted(-found.objective.hessian(optimum.x, optimum.local) / found.dispersion)
    if _positive(hessian):
        return hessian, "Hessian"
    return information, "information matrix (the Hessian is not positive definite)"


def _wider(reading: Identified, added: np.ndarray) -> Identified:
    """The reading of a curvature with errors (d,) that it does not know, added to every coordinate's."""
    if not added.any():
        return reading
    return replace(reading, sd=np.hypot(reading.sd, added), covariance=reading.covariance + np.diag(added**2))


def _positive(matrix: np.ndarray) -> bool:
    try:
        np.linalg.cholesky(matrix + 0.0)
    except np.linalg.LinAlgError:
        return False
    return bool(np.isfinite(matrix).all())


DRAWS = 4  # a variance within a factor of two: it is added to one that is known


def trace_errors(
    objective: EventTimesObjective,
    x: np.ndarray,
    covariance: np.ndarray,
    recordings: Sequence[Recording],
    between: str,
    seed: int,
) -> np.ndarray:
    """(d,) standard errors that the noise of traces adds to the coordinates: the filter that removes it leaves some.

    The filtered trace is taken for the light, noise like the trace's own is added and filtered again, and what the
    gradient changes by says how much the optimum would move, one Newton step away.  Its mean square over a few draws is
    the variance that the trace's noise adds to each coordinate, bias of the filter included.  Shot noise is left out of
    both gradients: to what light does to them it adds in second order.

    Args:
        objective: That was maximised.
        x: (d,) its optimum.
        covariance: (d, d) there.
        recordings: With filtered lights as they came, before samples were added.
        between: How the light runs between its samples.
        seed: Of the draws.
    """
    noisy = [r for r in recordings if r.attributes.get(ATTRIBUTE, 0.0) > 0.0]
    if not noisy or not np.isfinite(covariance).all():
        return np.zeros(len(x))

    def gradient(light: Sequence[Recording]) -> np.ndarray:
        of, likelihood = objective.likelihood, EventTimes([with_fine_light(recording, between) for recording in light])
        likelihood = likelihood.with_stamps(of.carried, of.clock_share, of.placed)
        return EventTimesObjective(likelihood, objective.coordinates, objective.off).gradient(x)

    rng, here = np.random.default_rng([seed, 41]), gradient(recordings)
    drawn = [gradient([_with_noise(r, rng) for r in recordings]) for _ in range(DRAWS)]
    return np.sqrt(np.mean(np.square((drawn - here) @ covariance), axis=0))


def _with_noise(recording: Recording, rng: np.random.Generator) -> Recording:
    light, sd = recording.stimulus, float(recording.attributes.get(ATTRIBUTE, 0.0))
    if sd == 0.0 or not isinstance(light, Stimulus):
        return recording
    noisy = replace(light, radiance=light.radiance * np.exp(sd * rng.standard_normal(len(light.t))))
    return replace(recording, stimulus=without_noise(noisy))
