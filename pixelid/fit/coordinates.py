"""Fitting coordinates: the free parameters of a model, and nuisances of the recordings, as one vector."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from pixelid.errors import InputError
from pixelid.model.model import Model
from pixelid.parameters.parameter import RATE_UNIT, Parameter, log_prior


@dataclass(frozen=True)
class Coordinates:
    """The map between free parameters and a vector (log coordinates where the transform says so).

    model: fixed and free parameters of the circuit;  nuisances: parameters of the recordings (delays, light
    levels, background), all by name;  parameters: the free ones of both, in the order of the vector.
    """

    model: Model
    nuisances: Mapping[str, Parameter]
    parameters: tuple[Parameter, ...]

    @staticmethod
    def of(model: Model, nuisances: tuple[Parameter, ...] = ()) -> Coordinates:
        """Coordinates of everything free.

        Nuisances that a circuit knows ("mains_flicker.phase_rad[NAME]", "alignment.clock_rate") become the model's own.
        Raises InputError when nothing is free.
        """
        own = {p.name: p for p in nuisances if model.knows(p.name)}
        model = replace(model, nuisances={**model.nuisances, **own}) if own else model
        nuisances = tuple(p for p in nuisances if p.name not in own)
        nuisances = (*model.nuisances.values(), *nuisances)
        replaced = {name.split("[", 1)[0] for name in model.nuisances}
        shared = [p for p in model.parameters.values() if p.name not in replaced]
        free = [p for p in (*shared, *nuisances) if p.free]
        if not free:
            raise InputError(f"model {model.name}: every parameter is fixed, there is nothing to fit")
        return Coordinates(model, {p.name: p for p in nuisances}, tuple(free))

    def __len__(self) -> int:
        return len(self.parameters)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return tuple(p.name for p in self.parameters)

    @property
    def start(self) -> np.ndarray:
        """The parameters' own values as a vector."""
        return np.array([p.to_coordinate(p.value) for p in self.parameters])

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """(lower, upper) of every coordinate."""
        pairs = [p.coordinate_bounds() for p in self.parameters]
        return np.array([p[0] for p in pairs]), np.array([p[1] for p in pairs])

    def longest_moves(self) -> np.ndarray:
        """The longest sensible step of every coordinate: a factor e, a millisecond (in each second), or one unit.

        One unit of light is the library's own in the numbers of this light, so nothing depends on what light is counted
        in.  Bounds of a linear coordinate leave no more than half of what lies between them.
        """
        unit, small = self.model.light_scale, ("s", RATE_UNIT)
        units = [1e-3 if p.unit in small else unit**p.radiance_power for p in self.parameters]
        room = [0.5 * (p.upper - p.lower) for p in self.parameters]
        return np.where([p.transform == "linear" for p in self.parameters], np.minimum(units, room), 1.0)

    def values(self, x: np.ndarray) -> dict:
        """Values of all parameters, fixed and free, at a coordinate vector, real or with complex steps."""
        convert = complex if np.iscomplexobj(x) else float
        free = {p.name: p.from_coordinate(convert(c)) for p, c in zip(self.parameters, x, strict=True)}
        fixed = {name: p.value for name, p in self.nuisances.items()}
        return {**self.model.values, **fixed, **free}

    def circuit(self, x: np.ndarray):
        """The circuit at a coordinate vector."""
        return self.model.circuit(self.values(x))

    def model_at(self, x: np.ndarray) -> Model:
        """The model at a coordinate vector; bounds widen where the vector sits on them."""
        values = self.values(x)
        inside = {p.name: p.within(values[p.name]) for p in self.model.parameters.values()}
        own = {name: p.within(values[name]) for name, p in self.model.nuisances.items()}
        model = self.model.set(inside)
        return replace(model, nuisances={name: p.at(own[name]) for name, p in self.model.nuisances.items()})

    def nuisances_at(self, x: np.ndarray) -> dict[str, float]:
        """Values of the nuisances at a coordinate vector."""
        values = self.values(x)
        return {name: values[name] for name in self.nuisances}

    def log_prior(self, x: np.ndarray) -> float:
        """Log prior density, up to a constant."""
        return log_prior(self.parameters, x)

    def prior_gradient_and_curvature(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """First derivative and negated second derivative of the log prior, per coordinate."""
        gradient, curvature = np.zeros(len(self)), np.zeros(len(self))
        for i, (p, c) in enumerate(zip(self.parameters, x, strict=True)):
            if p.prior is not None:
                gradient[i], curvature[i] = p.prior.slope_and_information(c)
        return gradient, curvature
