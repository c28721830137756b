"""A model fitted to a part of the pixels: what every step of the workflow asks for, again and again."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pixelid.fit.coordinates import Coordinates
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.newton import maximise
from pixelid.gap.ledger import ledger, signature
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import Model

AWAY = math.log(5.0)  # from nominal: a pole so far off is tried again


@dataclass(frozen=True)
class Climbed:
    """A model at its optimum for some events.

    model: at the fitted values;  coordinates, x: the same as a vector;  value: log-likelihood;
    information: (d, d) at the optimum;  strays: events that no threshold explains;  converged: whether it settled
    """

    model: Model
    coordinates: Coordinates
    x: np.ndarray
    value: float
    information: np.ndarray
    strays: int
    converged: bool

    @property
    def values(self) -> Mapping[str, float]:
        """All parameter values."""
        return self.model.values


def climbed(likelihood: EventTimes, model: Model, *, tolerance: float, max_steps: int) -> Climbed:
    """The model's free parameters fitted to a likelihood's events, from the model's own values."""
    coordinates = Coordinates.of(model)
    book = ledger()
    key = signature(likelihood, model, tolerance, max_steps) if book is not None else ""
    known = book.get(key) if book is not None else None
    if known is None:
        known = _fit(likelihood, coordinates, tolerance, max_steps)
        if book is not None:
            book.add(key, known)
    x = np.array(known["x"])
    return Climbed(
        coordinates.model_at(x), coordinates, x, known["value"], np.array(known["information"]), known["strays"],
        known["converged"],
    )  # fmt: skip


def settled(likelihood: EventTimes, model: Model, nominal: Model, *, tolerance: float, max_steps: int) -> Climbed:
    """As `climbed`; poles that ran away to where they no longer matter get a second chance from their nominal place.

    A cutoff far above all others leaves the likelihood flat: a climb that got there by accident stays, though a better
    optimum lies where the pole belongs.  Then a neighbour would be named for a pole that the model has.
    """
    end = climbed(likelihood, model, tolerance=tolerance, max_steps=max_steps)
    values = {name: end.values[name] for name in end.coordinates.names if name.endswith("cutoff_hz")}
    away = {
        name: nominal.values[name] for name, value in values.items()
        if name in nominal.values and abs(math.log(value / nominal.values[name])) > AWAY
    }  # fmt: skip
    if not away:
        return end
    again = climbed(likelihood, end.model.set(away), tolerance=tolerance, max_steps=max_steps)
    return again if again.value > end.value else end


def _fit(likelihood: EventTimes, coordinates: Coordinates, tolerance: float, max_steps: int) -> dict:
    objective = EventTimesObjective(likelihood, coordinates)
    end = maximise(objective, coordinates.start, tolerance=tolerance, max_steps=max_steps)
    _, here = objective.density(end.x)
    return {
        "x": end.x.tolist(),
        "value": float(here.total),
        "information": end.local.information.tolist(),
        "strays": int(here.stray.sum()),
        "converged": bool(end.converged),
    }


def per_pixel(likelihood: EventTimes, model: Model) -> np.ndarray:
    """(pixels,) log-likelihood of each pixel under a model."""
    return likelihood.terms(model.circuit()).per_pixel
