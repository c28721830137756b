"""What a fit found: values with intervals, what is not identified, and where it came from."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pixelid.fit.coordinates import Coordinates
from pixelid.model.files import save_model
from pixelid.model.model import Model
from pixelid.outputs import write_json


@dataclass(frozen=True)
class Estimate:
    """One parameter: value, standard error and 95 % interval in its own unit; identified or not, and free or not."""

    name: str
    value: float
    unit: str
    std: float | None
    interval_95: tuple[float | None, float | None] | None
    identified: bool
    fixed: bool

    def as_dict(self) -> dict:
        """The entry in fit.json."""
        return {
            "value": self.value,
            "unit": self.unit,
            "std": self.std,
            "interval_95": self.interval_95,
            "identified": self.identified,
            "fixed": self.fixed,
        }


@dataclass(frozen=True)
class FitResult:
    """A finished fit.

    status: "converged" or why not;  advice: what to do about it;  model: the fitted model;
    estimates: every parameter by name;  x, covariance: optimum and covariance in `coordinates`
    unidentified: sentences;  physical: circuit values under the gauge, or None with `physical_why`
    """

    status: str
    advice: str
    model: Model
    engine: str
    observation: str
    coordinates: Coordinates
    x: np.ndarray
    covariance: np.ndarray
    estimates: Mapping[str, Estimate]
    unidentified: tuple[str, ...]
    physical: Mapping[str, float] | None
    physical_why: str
    log_likelihood: float
    events: int
    pixels: int
    recordings: tuple[str, ...]
    seconds: float
    seed: int
    details: Mapping = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    inputs_sha256: Mapping[str, str] = field(default_factory=dict)

    def as_dict(self) -> dict:
        """The content of fit.json (COMMANDS.md)."""
        return {
            "status": self.status,
            "advice": self.advice,
            "model": self.model.name,
            "engine": self.engine,
            "observation": self.observation,
            "parameters": {name: estimate.as_dict() for name, estimate in self.estimates.items()},
            "physical": dict(self.physical) if self.physical else None,
            "gauge": {
                "fixed": self.model.gauge.statements(),
                "flat_directions": [],
                "why_no_physical": self.physical_why,
            },
            "covariance": {"names": list(self.coordinates.names), "matrix": self.covariance},
            "unidentified": list(self.unidentified),
            "log_likelihood": self.log_likelihood,
            "events": self.events,
            "pixels": self.pixels,
            "recordings": list(self.recordings),
            "details": dict(self.details),
            "seconds": self.seconds,
            "seed": self.seed,
            "versions": dict(self.versions),
            "inputs_sha256": dict(self.inputs_sha256),
        }

    def save(self, folder: Path) -> None:
        """Write fit.json and model.toml into an existing folder."""
        write_json(folder / "fit.json", self.as_dict())
        save_model(self.model, folder / "model.toml")


def estimates_of(
    coordinates: Coordinates,
    x: np.ndarray,
    sd: np.ndarray,
    identified: np.ndarray,
    limits: tuple[np.ndarray, np.ndarray],
) -> dict[str, Estimate]:
    """Estimates of all parameters: free ones with errors mapped from the fitting coordinates, fixed ones as is.

    x, sd: (d,) optimum and standard errors;  limits: lower and upper 95 % limits, (d,) each
    """
    values = coordinates.values(x)
    index = {name: i for i, name in enumerate(coordinates.names)}
    everything = {**coordinates.model.parameters, **coordinates.nuisances}
    found = {}
    for name, parameter in everything.items():
        i = index.get(name)
        if i is None:
            found[name] = Estimate(name, values[name], parameter.unit, None, None, True, True)
            continue
        value, s = values[name], float(sd[i])
        if np.isfinite(s):
            reach = np.clip([limits[0][i], limits[1][i]], x[i] - 300.0, x[i] + 300.0)
            bounds = [parameter.from_coordinate(float(c)) for c in reach]
            interval = (max(bounds[0], parameter.lower), min(bounds[1], parameter.upper))
            std = s * value if parameter.transform == "log" else s
        else:
            interval, std = (parameter.lower, parameter.upper), None
        found[name] = Estimate(name, value, parameter.unit, std, interval, bool(identified[i]), False)
    return found


class Stopwatch:
    """Seconds since it was made."""

    def __init__(self) -> None:
        self._start = time.perf_counter()

    def seconds(self) -> float:
        return time.perf_counter() - self._start
