"""One parameter over a sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pixelid.sensors.shrinkage import Population


@dataclass(frozen=True)
class Map:
    """One parameter over the sensor; logs are natural.

    raw, raw_sd: (h, w) each pixel's (or block's) own log estimate and standard error, NaN and inf where there is none
    log, sd: (h, w) shrunk towards the population;  population, interval: in log coordinates, interval of mean and
    spread
    """

    name: str
    unit: str
    raw: np.ndarray
    raw_sd: np.ndarray
    log: np.ndarray
    sd: np.ndarray
    population: Population
    mean_interval: tuple[float, float]
    spread_interval: tuple[float, float]

    @property
    def value(self) -> np.ndarray:
        """(h, w) shrunk values in the parameter's unit."""
        return np.exp(self.log)

    def as_dict(self) -> dict:
        """The entry in sensor.json."""
        p = self.population
        return {
            "unit": self.unit,
            "mean": np.exp(p.mean),
            "mean_interval_95": [np.exp(v) for v in self.mean_interval],
            "relative_spread": p.spread,
            "relative_spread_interval_95": list(self.spread_interval),
            "estimates": p.count,
            "without_estimate": int(self.raw.size - p.count),
            "typical_error_before": float(np.median(self.raw_sd[np.isfinite(self.raw_sd)])) if p.count else None,
            "typical_error_after": float(np.median(self.sd)) if p.count else None,
            "identified": bool(p.count > 1),
        }
