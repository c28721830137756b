"""A posterior: draws in fitting coordinates, and what follows from them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from pixelid.errors import InputError
from pixelid.fit.coordinates import Coordinates
from pixelid.model.model import Model
from pixelid.sample.convergence import Convergence
from pixelid.status import Status


@dataclass(frozen=True)
class Posterior:
    """Draws of the exact posterior.

    status, advice: how the sampling ended and what to do;  chain: (ensembles, steps, walkers, d) fitting coordinates
    log_prob: (ensembles, steps, walkers);  pieces: (…, r + 1 + p) log-likelihoods, see `target.Target`
    convergence: per coordinate;  details: how it was made
    """

    status: Status
    advice: str
    coordinates: Coordinates
    chain: np.ndarray
    log_prob: np.ndarray
    pieces: np.ndarray
    convergence: Convergence
    details: Mapping = field(default_factory=dict)

    @property
    def flat(self) -> np.ndarray:
        """(draws, d) all draws, in fitting coordinates."""
        return self.chain.reshape(-1, self.chain.shape[-1])

    def thinned(self, count: int) -> np.ndarray:
        """(≤ count, d) draws evenly spaced over ensembles and steps."""
        flat = self.flat
        return flat[np.linspace(0, len(flat) - 1, min(count, len(flat))).astype(np.int64)]

    def values(self) -> dict[str, np.ndarray]:
        """Parameter → (ensembles · walkers, steps) in its own unit: one chain per walker, as ArviZ wants it."""
        found = {}
        for i, p in enumerate(self.coordinates.parameters):
            c = self.chain[..., i].transpose(0, 2, 1).reshape(-1, self.chain.shape[1])
            found[p.name] = np.exp(c) if p.transform == "log" else c
        return found

    def summary(self) -> dict[str, dict]:
        """Parameter → mean, sd, 95 % interval (equal tails), effective samples, tau in steps, nested R̂."""
        table = {}
        for i, (name, draws) in enumerate(self.values().items()):
            low, high = np.quantile(draws, [0.025, 0.975])
            table[name] = {
                "mean": float(draws.mean()),
                "sd": float(draws.std(ddof=1)),
                "interval_95": [float(low), float(high)],
                "effective_samples": float(self.convergence.effective[i]),
                "tau_steps": float(self.convergence.tau[i]),
                "nested_r_hat": float(self.convergence.r_hat[i]),
            }
        return table

    def physical(self, model: Model, count: int = 400) -> dict[str, np.ndarray]:
        """Circuit value → (count,) draws under the model's gauge.

        Raises InputError when the model has no physical values, or its gauge is incomplete or over-determined: a
        gauge that leaves a direction flat has no posterior there.
        """
        names = self.coordinates.names
        fixed = self.coordinates.values(self.flat[0])
        if model.physical is None or not {"alpha", "beta", "gamma"} <= set(fixed):
            raise InputError(f"model {model.name} has no second-order photoreceptor with physical values")
        around = model.physical
        rows = []
        for x in self.thinned(count):
            values = {**fixed, **dict(zip(names, self._from(x), strict=True))}
            around = model.gauge.physical(values["alpha"], values["beta"], values["gamma"], around)
            rows.append(around.as_dict())
        return {name: np.array([row[name] for row in rows]) for name in rows[0]}

    def _from(self, x: np.ndarray) -> list[float]:
        return [p.from_coordinate(float(c)) for p, c in zip(self.coordinates.parameters, x, strict=True)]

    def as_dict(self) -> dict:
        """What fit.json says about it."""
        return {"status": self.status, "advice": self.advice, **self.details, "parameters": self.summary()}
