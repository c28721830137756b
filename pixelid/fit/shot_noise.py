"""Shot noise fitted to event times: the circuit under the noise, and the noise beside the circuit, in turns.

Given a density, events have the likelihood of `likelihood.shot_noise.under_shot_noise`, which any search maximises;
given a circuit, the filter of that module tells the density.  Both together settle within a few turns.  The filter
takes levels as they are at given times, and finds up to 10 % too much where noise is strong: sessions simulated from
the fit show by how much, and the density is put right by it (indirect inference: Gouriéroux, Monfort & Renault 1993,
J. Appl. Econometrics 8, S85).

To the rest of a fit, what the filter says of the density is a normal likelihood of its logarithm: it enters as one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pixelid.dynamics.linear import linear_stages
from pixelid.fit.again import can_be_simulated, simulate_again
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.newton import Optimum
from pixelid.fit.newton import maximise as newton_steps
from pixelid.likelihood.event_times import EventTimes
from pixelid.likelihood.shot_noise import Division, share_out, under_shot_noise
from pixelid.model.model import Model
from pixelid.parameters.parameter import Parameter, Prior

EFFECT, DENSITY, NOISE = "shot_noise", "shot_noise.density", "threshold_sigma"
LEAST_GAIN = 3.0  # nats that a density must be worth: one coordinate gains 0.5 by chance, in one of 70 cases as much
TURNS, AT_REST = 8, 0.3  # until the density's logarithm moves by less of its error
CORRECTION_ERROR = 0.3  # of what simulated sessions put right: they are of a circuit that is a little off itself
REPLICATES, MOST_PIXELS = 3, 16  # simulated sessions, and their pixels
OTHER_PARAMETERS = 1.3  # times the error of a density found with all else known
OPEN = 10.0  # standard deviation of ln density where the events say nothing of it


@dataclass(frozen=True)
class UnderNoise:
    """A fit under shot noise: its objective and optimum, and what fit.json says of it."""

    objective: EventTimesObjective
    optimum: Optimum
    details: dict[str, Any]


def without_density(model: Model) -> Model:
    """The model with its density of shot noise held, as searches without shot noise take it."""
    return model.fix({DENSITY: None}) if model.has(EFFECT) else model


def without_filter(fitted: Model, model: Model) -> Model:
    """A fitted model with the prior that its density had: what the filter said is in the events, not before them."""
    if not model.has(EFFECT) or not fitted.has(EFFECT):
        return fitted
    density = replace(fitted.parameters[DENSITY], prior=model.parameters[DENSITY].prior)
    return replace(fitted, parameters={**fitted.parameters, DENSITY: density})


def fit_under_shot_noise(
    objective: EventTimesObjective, optimum: Optimum, model: Model, clocks: tuple[Parameter, ...], seed: int
) -> UnderNoise:
    """The optimum of events under shot noise, from that of a fit which takes all noise for the thresholds'.

    Args:
        objective, optimum: Of that fit, the density of shot noise held.
        model: With the density as the fit has it, free or held.
        clocks: Nuisances of the recordings.
        seed: Of the sessions that are simulated.
    """
    coordinates, x = objective.coordinates, optimum.x
    parameter = model.parameters[DENSITY]
    places = {name: k for k, name in enumerate(coordinates.names)}
    whole = coordinates.circuit(x).noise  # as all noise is the thresholds'

    def divided(at: np.ndarray) -> Division | None:
        return share_out(objective.at(at), coordinates.circuit(at).with_(noise=whole), seed)

    def settled(at: np.ndarray, density: float) -> tuple[EventTimesObjective, Optimum]:
        circuit = coordinates.circuit(at).with_(shot_density=density)
        noisy = EventTimesObjective(under_shot_noise(objective.at(at), circuit), coordinates)
        return noisy, newton_steps(noisy, at, tolerance=1e-3, max_steps=40)

    if not len(linear_stages(coordinates.circuit(x), 1.0)[0]):  # noise without a pole has no level
        return _with_density(objective, optimum, model, clocks, parameter.value, OPEN, {"gain_nats": None, "turns": 0})
    found = divided(x) if parameter.free else None
    density, error, turns = parameter.value, 0.0, 0
    if parameter.free and (found is None or found.gain < LEAST_GAIN):
        details = {"gain_nats": 0.0 if found is None else float(found.gain), "turns": 0}
        density = parameter.lower if found is None else found.density
        return _with_density(objective, optimum, model, clocks, density, OPEN, details)
    under = objective
    for turns in range(1, TURNS + 1):
        before = density
        if found is not None:
            density, error = found.density, found.error
            if NOISE in places and turns == 1:
                x = x.copy()
                x[places[NOISE]] += found.log_noise
        under, optimum = settled(x, density)
        x = optimum.x
        if turns > 1 and abs(math.log(density / before)) <= AT_REST * error:
            break
        found = divided(x) if parameter.free else None
    details = {"gain_nats": None if found is None else float(found.gain), "turns": turns}
    if found is not None:
        off, scatter = _off(objective.at(x), coordinates.model_at(x), density, whole, seed)
        density *= math.exp(-off)
        error = math.hypot(OTHER_PARAMETERS * error, scatter, CORRECTION_ERROR * off)
        details["put_right_by"] = -off
        for _ in range(2):  # so that means and variances are those of where they lead to
            under, optimum = settled(x, density)
            x = optimum.x
    return _with_density(under, optimum, model, clocks, density, error, details)


def _off(likelihood: EventTimes, model: Model, density: float, whole: float, seed: int) -> tuple[float, float]:
    """(by how much the filter's ln density is off in sessions simulated with it, its standard error)."""
    truth = model.set({DENSITY: density})
    if not can_be_simulated(likelihood.recordings, truth):
        return 0.0, 0.0
    rng = np.random.default_rng([seed, 23])
    pixels = np.sort(rng.permutation(likelihood.flat_pixels)[:MOST_PIXELS])
    logs = []
    for k in range(REPLICATES):
        made = EventTimes(simulate_again(likelihood.recordings, truth, pixels, None, seed + 31 * (k + 1)))
        found = share_out(made, truth.circuit().with_(noise=whole), seed)
        if found is not None:
            logs.append(math.log(found.density / density))
    if len(logs) < REPLICATES:
        return 0.0, 0.0
    return float(np.mean(logs)), float(np.std(logs, ddof=1) / math.sqrt(len(logs)))


def _with_density(
    objective: EventTimesObjective, optimum: Optimum, model: Model, clocks, density: float, error: float, details
) -> UnderNoise:
    """With the density among the coordinates, known as the filter knows it; as it is where it is held."""
    parameter = model.parameters[DENSITY]
    if not parameter.free:
        return UnderNoise(objective, optimum, details)
    value = parameter.within(density)
    known = replace(parameter, value=value, prior=Prior(parameter.to_coordinate(value), min(error, OPEN)))
    at = objective.coordinates.model_at(optimum.x)
    coordinates = Coordinates.of(replace(at, parameters={**at.parameters, DENSITY: known}), clocks)
    here = dict(zip(objective.coordinates.names, optimum.x, strict=True))
    x = np.array([here.get(name, parameter.to_coordinate(value)) for name in coordinates.names])
    full = EventTimesObjective(objective.likelihood, coordinates)
    return UnderNoise(full, newton_steps(full, x, tolerance=1e-3, max_steps=20), details)
