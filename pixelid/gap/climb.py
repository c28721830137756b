"""A model fitted to a part of the pixels: what every step of the workflow asks for, again and again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pixelid.fit.coordinates import Coordinates
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.newton import maximise
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import Model


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
    objective = EventTimesObjective(likelihood, coordinates)
    end = maximise(objective, coordinates.start, tolerance=tolerance, max_steps=max_steps)
    _, here = objective.density(end.x)
    return Climbed(
        coordinates.model_at(end.x), coordinates, end.x, here.total, end.local.information, int(here.stray.sum()),
        end.converged,
    )  # fmt: skip


def per_pixel(likelihood: EventTimes, model: Model) -> np.ndarray:
    """(pixels,) log-likelihood of each pixel under a model."""
    return likelihood.terms(model.circuit()).per_pixel
