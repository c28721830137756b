"""Shot noise fitted to event times: the circuit under the noise, and the noise given the circuit, in turns.

Given a density, events have the likelihood of `likelihood.shot_noise.under_shot_noise`, which any search maximises;
given a circuit, the filter of that module estimates the density.  Both together settle within a few turns.  Filter and
likelihood take levels as they are at given times, to first order: where noise is strong the density comes out up to
10 % too large, the thresholds' noise by a third.  Sessions simulated from the fit show by how much, and all is
corrected by it (indirect inference: Gouriéroux, Monfort & Renault 1993, J. Appl. Econometrics 8, S85).  They also show
what structure the approximation leaves in the residuals of a true model.

To the rest of a fit, what the filter says of the density is a normal likelihood of its logarithm: it enters as one.

Levels, zeros and clocks of the bench are held where the fit without shot noise had them: with the noise's means held
at an optimum, a level and a zero of slow light are nearly exchangeable.  Their errors there are counted.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from pixelid.dynamics.linear import has_pole
from pixelid.fit.again import can_be_simulated, simulate_again
from pixelid.fit.bench import is_of_bench
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.event_times import LEVELS_TAKEN_AT, EventTimesObjective
from pixelid.fit.judge import residual_tests
from pixelid.fit.newton import Optimum, with_observed_curvature
from pixelid.fit.newton import maximise as newton_steps
from pixelid.likelihood.event_times import EventTimes
from pixelid.likelihood.shot_noise import Division, share_out
from pixelid.model.model import Model
from pixelid.parameters.parameter import Parameter, Prior

EFFECT, DENSITY, NOISE = "shot_noise", "shot_noise.density", "threshold_sigma"
JITTER = "timestamp_jitter.sigma_s"
LEAST_GAIN = 3.0  # nats that a density must be worth: one coordinate gains 0.5 by chance, in one of 70 cases as much
TURNS, AT_REST = 8, 0.3  # until the density's logarithm moves by less of its error
PRIOR_DEGREES = 4.0  # of freedom that curvature lends to the variance of a few fits
MAX_SHIFT = 1.0  # of a coordinate that is put right
HELD = 0.15  # of a coordinate: what fits scatter by more the events do not hold
MOST_STEPS = 3  # sets of simulated sessions, each from where the one before led,
FAR_STEP = 1.0  # in errors, if that is further: what a shorter step is itself put right by is less than a third of one
LEAST_ANSWER = 0.25  # of a step, by which fits answer it
CORRECTION_ERROR = 0.3  # of what simulated sessions put right: they are of a circuit that is a little off itself
REPLICATES, MOST_PIXELS = 3, 16  # simulated sessions, and their pixels
OTHER_PARAMETERS = 1.3  # times the error of a density found with all else known
OPEN = 10.0  # standard deviation of ln density where the events say nothing of it


@dataclass(frozen=True)
class UnderNoise:
    """A fit under shot noise: its objective and optimum, and what fit.json says of it.

    added_sd: coordinate → what putting it right adds to its error
    expected: covariate → share of the residuals' variance that simulated sessions show in the same test
    bench: nuisances of the bench that were held, with what is known of them; None where there are none
    """

    objective: EventTimesObjective
    optimum: Optimum
    details: dict[str, Any]
    added_sd: dict[str, float] = field(default_factory=dict)
    expected: dict[str, float] = field(default_factory=dict)
    bench: HeldBench | None = None


@dataclass(frozen=True)
class HeldBench:
    """Nuisances that a search held at what another fit found.

    names: (k,) of coordinates
    covariance: (k, k) of that fit
    """

    names: tuple[str, ...]
    covariance: np.ndarray

    def counted(self, names: Sequence[str], curvature: np.ndarray) -> np.ndarray:
        """(d, d) curvature of all coordinates of names (d,), for one (d, d) at the optimum with these held.

        With H the curvature, θ the others and η these, θ − θ̂ = −H_θθ⁻¹ H_θη (η − η̂) + N(0, H_θθ⁻¹), and η has its
        covariance.  The precision of both together has for η that of the covariance, and H_ηθ H_θθ⁻¹ H_θη.
        """
        held = np.isin(names, self.names)
        order = [self.names.index(name) for name in np.asarray(names)[held]]
        own = np.linalg.pinv(self.covariance[np.ix_(order, order)], hermitian=True)
        cross = curvature[np.ix_(~held, held)]
        both = curvature.copy()
        through = cross.T @ np.linalg.lstsq(curvature[np.ix_(~held, ~held)], cross, rcond=None)[0]
        both[np.ix_(held, held)] = own + 0.5 * (through + through.T)
        return both


@dataclass(frozen=True)
class _Simulated:
    """What sessions simulated from a fit show.

    at: (d,) what they were simulated with
    off: (d,) by how much their fits are off that, in the mean
    added_sd: (d,) its error, and what their fits scatter by beyond what curvature says
    log_density, density_error: the mean, and its error, of the density as the filter has it
    expected: as of `UnderNoise`
    longer: (d,) by how many times a step of fits is one of what they are fitted to
    """

    at: np.ndarray
    off: np.ndarray
    added_sd: np.ndarray
    log_density: float
    density_error: float
    expected: dict[str, float]
    longer: np.ndarray | float = 1.0

    def after(self, before: _Simulated, variance: np.ndarray) -> _Simulated:
        """The same where sessions simulated elsewhere led here.

        What put this right errs by what the step has changed, no longer by all of it; and where fits answer a step by
        less than its length, an error of theirs is that of a longer step.

        variance: (d,) of the fit to the events measured
        """
        step, changed = self.at - before.at, self.off - before.off
        answer = np.where(np.abs(step) > np.sqrt(variance), 1.0 + changed / np.where(step == 0.0, 1.0, step), 1.0)
        longer = np.maximum(self.longer, np.maximum(before.longer, 1.0 / np.clip(answer, LEAST_ANSWER, 1.0)))
        less = self.added_sd**2 - (CORRECTION_ERROR * self.off) ** 2 + (CORRECTION_ERROR * changed) ** 2
        added = np.where(self.off != 0.0, less + variance * (longer**2 - 1.0), self.added_sd**2)
        return replace(self, added_sd=np.sqrt(np.maximum(added, 0.0)), longer=longer)


def without_density(model: Model) -> Model:
    """The model with its density of shot noise held, as searches without shot noise take it."""
    return model.fix({DENSITY: None}) if model.has(EFFECT) else model


def without_filter(fitted: Model, model: Model) -> Model:
    """A fitted model with the prior that its density had: what the filter said is in the events, not before them."""
    if not model.has(EFFECT) or not fitted.has(EFFECT):
        return fitted
    density = replace(fitted.parameters[DENSITY], prior=model.parameters[DENSITY].prior)
    return replace(fitted, parameters={**fitted.parameters, DENSITY: density})


def fit_under_shot_noise(objective: EventTimesObjective, optimum: Optimum, model: Model, seed: int) -> UnderNoise:
    """The optimum of events under shot noise, from that of a fit which takes all noise for the thresholds'.

    Args:
        objective, optimum: Of that fit, the density of shot noise held.
        model: With the density as the fit has it, free or held.
        seed: Of the sessions that are simulated.
    """
    coordinates, x = objective.coordinates, optimum.x
    held = np.array([is_of_bench(name) for name in coordinates.names])
    if not held.any():
        return _fit(objective, optimum, model, seed)
    at = coordinates.model_at(x)
    fixed = {name: p.fixed() if is_of_bench(name) else p for name, p in at.nuisances.items()}
    fewer = Coordinates.of(replace(at, nuisances=fixed))
    fit = _fit(objective.on(fewer), replace(optimum, x=x[~held], on_bound=optimum.on_bound[~held]), model, seed)
    covariance = np.linalg.pinv(optimum.local.information, hermitian=True)[np.ix_(held, held)]
    bench = HeldBench(tuple(np.asarray(coordinates.names)[held]), covariance)
    return _with_bench(fit, at.nuisances, bench)


def _with_bench(fit: UnderNoise, nuisances: Mapping[str, Parameter], bench: HeldBench) -> UnderNoise:
    """A fit with the nuisances that it held among its coordinates again, as they are."""
    few = fit.objective.coordinates
    coordinates = Coordinates.of(replace(few.model, nuisances=dict(nuisances)))
    known = {**_named(coordinates, coordinates.start), **_named(few, fit.optimum.x)}
    x = np.array([known[name] for name in coordinates.names])
    objective, bound = fit.objective.on(coordinates), dict(zip(few.names, fit.optimum.on_bound, strict=True))
    on_bound = np.array([bound.get(name, False) for name in coordinates.names])
    optimum = replace(fit.optimum, x=x, local=objective.local(x), on_bound=on_bound)
    return replace(fit, objective=objective, optimum=optimum, bench=bench)


def _fit(objective: EventTimesObjective, optimum: Optimum, model: Model, seed: int) -> UnderNoise:
    """As `fit_under_shot_noise`, of all coordinates of the objective."""
    coordinates, x = objective.coordinates, optimum.x
    parameter = model.parameters[DENSITY]
    whole = coordinates.circuit(x).noise  # as all noise is the thresholds'

    def divided(at: np.ndarray) -> Division | None:
        return share_out(objective.at(at), coordinates.circuit(at).with_(noise=whole), seed)

    def settled(at: np.ndarray, density: float) -> tuple[EventTimesObjective, Optimum]:
        noisy = objective.under_shot_noise(at, density)
        details[LEVELS_TAKEN_AT] = _named(coordinates, at)
        return noisy, newton_steps(noisy, at, tolerance=1e-3, max_steps=40)

    if not has_pole(coordinates.circuit(x)):
        return _with_density(objective, optimum, model, parameter.value, OPEN, {"gain_nats": None, "turns": 0})
    found = divided(x) if parameter.free else None
    details: dict[str, Any] = {}
    density, error, turns = parameter.value, 0.0, 0
    if parameter.free and (found is None or found.gain < LEAST_GAIN):
        details = {"gain_nats": 0.0 if found is None else float(found.gain), "turns": 0}
        density = parameter.lower if found is None else found.density
        return _with_density(objective, optimum, model, density, OPEN, details)
    under = objective
    for turns in range(1, TURNS + 1):
        before = density
        if found is not None:
            density, error = found.density, found.error
            if turns == 1:
                x = with_division(coordinates, x, found)
        under, optimum = settled(x, density)
        x = optimum.x
        if turns > 1 and abs(math.log(density / before)) <= AT_REST * error:
            break
        found = divided(x) if parameter.free else None
    details |= {"gain_nats": None if found is None else float(found.gain), "turns": turns}
    if found is not None:
        shown = _simulated_where_it_leads(objective, optimum, density, whole, seed)
        error *= OTHER_PARAMETERS
        if shown is not None:
            density *= math.exp(-shown.log_density)
            error = math.hypot(error, shown.density_error, CORRECTION_ERROR * shown.log_density)
            details["put_right_by"] = -shown.log_density
        for _ in range(2):  # so that means and variances are those of where they lead to
            under, optimum = settled(x, density)
            x = optimum.x
        if shown is not None:
            return _put_right(objective, optimum, shown, model, density, error, details)
    return _with_density(under, optimum, model, density, error, details)


def _simulated_where_it_leads(
    objective: EventTimesObjective, optimum: Optimum, density: float, whole: float, seed: int
) -> _Simulated | None:
    """What sessions show that are simulated from where putting an optimum right by them leads: first from the optimum,
    and from where those led, until that is where they were simulated."""
    variance = np.maximum(np.diag(np.linalg.pinv(optimum.local.information, hermitian=True)), 0.0)
    shown = _simulated(objective, optimum.x, density, whole, seed)
    for _ in range(MOST_STEPS - 1):
        if shown is None:
            break
        there = np.clip(optimum.x - shown.off, *objective.coordinates.bounds())
        error = np.sqrt(variance + shown.added_sd**2)
        if np.all(np.abs(there - shown.at)[shown.off != 0.0] < FAR_STEP * error[shown.off != 0.0]):
            break
        after = _simulated(objective, there, density * math.exp(-shown.log_density), whole, seed)
        if after is None:
            break
        shown = after.after(shown, variance)
    return shown


def _simulated(
    objective: EventTimesObjective, x: np.ndarray, density: float, whole: float, seed: int
) -> _Simulated | None:
    """What sessions simulated from coordinates x and a density show; None where they cannot be made or fitted."""
    likelihood, coordinates = objective.at(x), objective.coordinates
    truth = coordinates.model_at(x).set({DENSITY: density})
    if not can_be_simulated(likelihood.recordings, truth):
        return None
    rng = np.random.default_rng([seed, 23])
    pixels = np.sort(rng.permutation(likelihood.flat_pixels)[:MOST_PIXELS])
    of_bench = np.array([name in coordinates.nuisances for name in coordinates.names])
    logs, ends, shares = [], [], []
    for k in range(REPLICATES):
        made = EventTimes(simulate_again(likelihood.recordings, truth, pixels, None, seed + 31 * (k + 1)))
        own = EventTimesObjective(made, coordinates)
        found = share_out(own.at(x), truth.circuit().with_(noise=whole), seed)
        if found is None:
            return None
        logs.append(math.log(found.density / density))
        end = newton_steps(own.under_shot_noise(x, density), x, tolerance=1e-3, max_steps=40)
        under = own.under_shot_noise(end.x, density)
        ends.append(newton_steps(under, end.x, tolerance=1e-3, max_steps=40))
        shares.append({test.covariate: test.share for test in residual_tests(under, ends[-1].x)})
    off = np.clip(np.array([end.x for end in ends]) - x, -MAX_SHIFT, MAX_SHIFT)
    told = np.mean([np.diag(np.linalg.pinv(end.local.information)) for end in ends], axis=0)
    degrees = len(ends) - 1
    variance = (PRIOR_DEGREES * told + degrees * off.var(axis=0, ddof=1)) / (PRIOR_DEGREES + degrees)
    known = ~of_bench & (variance > 0.0) & (variance < HELD**2)
    off = np.where(known, off.mean(axis=0), 0.0)
    added = variance / len(ends) + np.maximum(variance - told, 0.0) + (CORRECTION_ERROR * off) ** 2
    covariates = set.intersection(*map(set, shares)) if shares else set()
    expected = {name: _high([each[name] for each in shares]) for name in sorted(covariates)}
    return _Simulated(
        x, off, np.where(known, np.sqrt(np.maximum(added, 0.0)), 0.0), float(np.mean(logs)),
        float(np.std(logs, ddof=1) / math.sqrt(len(logs))), expected,
    )  # fmt: skip


def with_division(coordinates: Coordinates, x: np.ndarray, found: Division) -> np.ndarray:
    """Coordinates x of a fit to which all noise is the thresholds', with the noise as the filter shares it out."""
    x = x.copy()
    for k, name in enumerate(coordinates.names):
        if name == NOISE:
            x[k] += found.log_noise
        elif name == JITTER and found.jitter_s > 0.0:
            x[k] = math.log(found.jitter_s)
    return np.clip(x, *coordinates.bounds())


def _named(coordinates: Coordinates, x: np.ndarray) -> dict[str, float]:
    return dict(zip(coordinates.names, x.tolist(), strict=True))


def _high(values: list[float]) -> float:
    """What another one like a few values hardly exceeds."""
    return float(np.mean(values) + 2.0 * np.std(values, ddof=1))


def _put_right(
    objective: EventTimesObjective, optimum: Optimum, shown: _Simulated, model: Model, density, error, details
) -> UnderNoise:
    """A fit without what its simulated sessions are off by;  objective: of the events, all noise the thresholds'."""
    names = objective.coordinates.names
    off = {name: float(by) for name, by in zip(names, shown.off, strict=True) if by != 0.0}
    x = np.clip(optimum.x - shown.off, *objective.coordinates.bounds())
    right = EventTimesObjective(objective.likelihood, objective.coordinates, off).under_shot_noise(x, density)
    details["parameters_put_right_by"] = {name: -by for name, by in off.items()}
    details[LEVELS_TAKEN_AT] = _named(objective.coordinates, x)
    fit = _with_density(right, replace(optimum, x=x), model, density, error, details)
    added = _named(objective.coordinates, shown.added_sd)
    return replace(fit, added_sd=added, expected=shown.expected)


def _with_density(
    objective: EventTimesObjective, optimum: Optimum, model: Model, density: float, error: float, details
) -> UnderNoise:
    """With the density among the coordinates, known as the filter knows it; as it is where it is held."""
    parameter = model.parameters[DENSITY]
    if not parameter.free:
        return UnderNoise(objective, _to_the_end(objective, optimum), details)
    value = parameter.within(density)
    known = replace(parameter, value=value, prior=Prior(parameter.to_coordinate(value), min(error, OPEN)))
    at = objective.coordinates.model_at(optimum.x)
    coordinates = Coordinates.of(replace(at, parameters={**at.parameters, DENSITY: known}))
    here = _named(objective.coordinates, optimum.x)
    x = np.array([here.get(name, parameter.to_coordinate(value)) for name in coordinates.names])
    full = objective.on(coordinates)
    return UnderNoise(full, _to_the_end(full, newton_steps(full, x, tolerance=1e-3, max_steps=80)), details)


def _to_the_end(objective: EventTimesObjective, optimum: Optimum) -> Optimum:
    """An optimum that damped steps may have crawled towards: noise bends the likelihood more than it informs."""
    return optimum if optimum.converged else with_observed_curvature(objective, optimum, tolerance=1e-3)
