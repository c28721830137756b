"""A posterior: draws in fitting coordinates, and what follows from them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from pixelid.arrays import load_arrays
from pixelid.documents import interpreting
from pixelid.errors import InputError
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.result import as_document, from_document
from pixelid.model.files import load_model, save_model
from pixelid.model.model import Model
from pixelid.results import Result, Table, interval, number, read_result, required
from pixelid.sample.convergence import Convergence, convergence
from pixelid.status import Status

if TYPE_CHECKING:
    from jaxtyping import Float64


@dataclass(frozen=True, repr=False)
class Posterior(Result):
    """Draws of the exact posterior.

    status, advice: how the sampling ended and what to do;  chain: (ensembles, steps, walkers, d) fitting coordinates
    log_prob: (ensembles, steps, walkers);  pieces: (…, r + 1 + p) log-likelihoods, see `target.Target`
    convergence: per coordinate;  details: how it was made;  recordings: their names

    Example:
        >>> import pixelid as px
        >>> posterior = px.sample("fit/", "session/")  # doctest: +SKIP
        >>> posterior.to_arviz().posterior["alpha"].mean()  # doctest: +SKIP
    """

    FILE: ClassVar[str] = "posterior.json"

    status: Status
    advice: str
    coordinates: Coordinates
    chain: Float64[np.ndarray, "ensembles steps walkers free"]
    log_prob: Float64[np.ndarray, "ensembles steps walkers"]
    pieces: Float64[np.ndarray, "ensembles steps walkers pieces"]
    convergence: Convergence
    details: Mapping = field(default_factory=dict)
    recordings: tuple[str, ...] = ()
    versions: Mapping[str, str] = field(default_factory=dict)
    inputs_sha256: Mapping[str, str] = field(default_factory=dict)

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
        draws = {}
        for i, p in enumerate(self.coordinates.parameters):
            c = self.chain[..., i].transpose(0, 2, 1).reshape(-1, self.chain.shape[1])
            draws[p.name] = np.exp(c) if p.transform == "log" else c
        return draws

    def statistics(self) -> dict[str, dict]:
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

    def as_dict(self) -> dict[str, Any]:
        """The content of posterior.json, and (but for provenance) what fit.json says about it."""
        return {
            "status": self.status,
            "advice": self.advice,
            **self.details,
            "parameters": self.statistics(),
            "recordings": list(self.recordings),
            "nuisances": {name: as_document(p) for name, p in self.coordinates.nuisances.items()},
            "versions": dict(self.versions),
            "inputs_sha256": dict(self.inputs_sha256),
        }

    @property
    def headline(self) -> str:
        """Model, status, and how many draws."""
        ensembles, steps, walkers, _ = self.chain.shape
        return (
            f"posterior of {self.coordinates.model.name}: {self.status}; {ensembles} ensembles × {walkers} walkers × "
            f"{steps} steps, {self.convergence.effective.min():.0f} effective samples or more"
        )

    def tables(self) -> list[Table]:
        """Mean, sd, 95 % interval and convergence of every parameter."""
        rows = tuple(
            (
                name, number(row["mean"]), number(row["sd"]), interval(row["interval_95"]),
                self.coordinates.parameters[i].unit, f"{row['effective_samples']:.0f}", f"{row['nested_r_hat']:.4f}",
            )
            for i, (name, row) in enumerate(self.statistics().items())
        )  # fmt: skip
        headings = ("parameter", "mean", "sd", "95 % interval", "unit", "effective", "nested R̂")
        return [Table("", headings, rows, frozenset({"parameter", "unit"}))]

    def records(self) -> list[dict[str, Any]]:
        """One row per parameter."""
        rows = []
        for name, row in self.statistics().items():
            low, high = row.pop("interval_95")
            rows.append({"parameter": name, **row, "low_95": low, "high_95": high})
        return rows

    def sentences(self) -> list[str]:
        """What to do when it did not converge."""
        return [text for text in (self.advice or self.status.advice,) if text]

    def write_companions(self, folder: Path) -> None:
        """Write draws.npz (chain, log_prob, pieces) and model.toml, the model they were drawn around."""
        np.savez_compressed(folder / "draws.npz", chain=self.chain, log_prob=self.log_prob, pieces=self.pieces)
        save_model(self.coordinates.model, folder / "model.toml")

    @classmethod
    def load(cls, folder: str | Path) -> Posterior:
        """The posterior that `save` wrote.

        Raises:
            InputError: none there, or a damaged one.
        """
        content = read_result(folder, cls.FILE)
        with interpreting(Path(folder) / cls.FILE, "a posterior"):
            status, advice, nuisances = required(content, folder, cls.FILE, "status", "advice", "nuisances")
            model = load_model(Path(folder) / "model.toml")
            coordinates = Coordinates.of(model, tuple(from_document(name, entry) for name, entry in nuisances.items()))
            file = Path(folder) / "draws.npz"
            draws = load_arrays(file)
            missing = [name for name in ("chain", "log_prob", "pieces") if name not in draws]
            if missing:
                raise InputError(f"{file}: {missing[0]}: missing")
            chain, log_prob, pieces = (draws[name] for name in ("chain", "log_prob", "pieces"))
            if chain.ndim != 4 or chain.shape[3] != len(coordinates) or chain.dtype.kind != "f":
                raise InputError(f"{file}: chain: expected (ensembles, steps, walkers, {len(coordinates)}) numbers")
            known = {"status", "advice", "parameters", "recordings", "nuisances", "versions", "inputs_sha256"}
            return cls(
                Status(status), advice, coordinates, chain, log_prob, pieces, convergence(chain),
                {name: value for name, value in content.items() if name not in known}, tuple(content["recordings"]),
                content["versions"], content["inputs_sha256"],
            )  # fmt: skip

    def to_arviz(self) -> Any:
        """An `xarray.DataTree` as ArviZ 1 takes it: posterior (one chain per walker), sample_stats, log_likelihood."""
        from pixelid.sample.drawn_groups import sampled_groups

        return sampled_groups(self)

    def plot_trace(self) -> np.ndarray:
        """Walkers' mean and 5 to 95 % range at every step, one colour per ensemble: matplotlib axes."""
        from pixelid.sample.figures import draw_trace

        return draw_trace(self)

    def plot_corner(self) -> np.ndarray:
        """Every parameter against every other: matplotlib axes, (d, d)."""
        from pixelid.sample.figures import draw_corner

        return draw_corner(self)
