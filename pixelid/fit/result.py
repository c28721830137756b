"""The result of a fit: values with intervals, what is not identified, and where it came from."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from pixelid.documents import interpreting
from pixelid.errors import InputError, did_you_mean
from pixelid.fit.bias_priors import prior_sentences, prior_table
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.levels.pixel_levels import PixelLevels
from pixelid.model.files import load_model, save_model
from pixelid.model.fitted import as_fitted, fit_hash, today
from pixelid.model.model import Model
from pixelid.parameters.invariants import PHYSICAL_UNITS, Physical
from pixelid.parameters.parameter import Parameter, Prior
from pixelid.results import Result, Table, check_kinds, check_parameters, interval, number, read_result, required
from pixelid.status import Status

if TYPE_CHECKING:
    from jaxtyping import Float64

    from pixelid.inputs import ModelLike, RecordingsLike
    from pixelid.recordings.recording import Recording


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


@dataclass(frozen=True, repr=False)
class FitResult(Result):
    """A finished fit.

    status, advice: how it ended, and what to do about it;  model: the fitted model;
    estimates: every parameter by name;  x, covariance: optimum (d,) and covariance (d, d) in `coordinates`
    unidentified: sentences;  physical: circuit values under the gauge, or None with `physical_why`
    alignment: by recording, what was found of a clock that `convert --align` had estimated (docs/formats.md)
    pixel_levels: gain and background of every pixel, None where they were not asked for
    bias_priors: what the recordings' biases imply and which priors the fit took of them, None where not asked for
    date: of the fit, ISO; empty where a file does not say it
    fitted: the recordings themselves, where `px.fit` made the result: figures and report need no others

    Example:
        >>> import pixelid as px
        >>> result = px.fit(px.simulate("dvs128", "chirp", pixels=4), "dvs128", starts=0)  # doctest: +SKIP
        >>> print(result.summary())  # doctest: +SKIP
        >>> result.save("fit")  # doctest: +SKIP
    """

    FILE: ClassVar[str] = "fit.json"

    status: Status
    advice: str
    model: Model
    engine: str
    observation: str
    coordinates: Coordinates
    x: Float64[np.ndarray, " free"]
    covariance: Float64[np.ndarray, "free free"]
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
    alignment: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    pixel_levels: PixelLevels | None = None
    bias_priors: Mapping[str, Any] | None = None
    details: Mapping = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    inputs_sha256: Mapping[str, str] = field(default_factory=dict)
    date: str = field(default_factory=today)
    fitted: tuple[Recording, ...] = field(default=(), compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "model", self._truthful())  # whatever made the result

    @property
    def hash(self) -> str:
        """A short name of this fit, which model.toml gives as the source of its values."""
        limits = {name: e.interval_95 for name, e in self.estimates.items()}
        return fit_hash("fit", self.model, [limits, self.recordings, self.inputs_sha256, self.seed, self.date])

    def _truthful(self) -> Model:
        """The model, saying of every fitted value that it is fitted, and how well it is known."""
        free = {name: e for name, e in self.estimates.items() if not e.fixed}
        return as_fitted(
            self.model, fit=self.hash, day=self.date, fitted=free, limits={n: e.interval_95 for n, e in free.items()},
            unidentified=[name for name, e in free.items() if not e.identified],
            to=f"{', '.join(self.recordings)}: {self.events} events of {self.pixels} pixels, {self.status}",
            physical=(Physical(**self.physical) if self.physical else None, self.physical_why),
        )  # fmt: skip

    def as_dict(self) -> dict[str, Any]:
        """The content of fit.json (docs/formats.md)."""
        return {
            "status": self.status,
            "advice": self.advice,
            "model": self.model.name,
            "engine": self.engine,
            "observation": self.observation,
            "parameters": {name: estimate.as_dict() for name, estimate in self.estimates.items()},
            "physical": dict(self.physical) if self.physical else None,
            "physical_intervals_95": self.physical_intervals() if self.physical else None,
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
            "alignment": {name: dict(clock) for name, clock in self.alignment.items()},
            **({} if self.pixel_levels is None else {"pixel_levels": self.pixel_levels.as_dict()}),
            **({} if self.bias_priors is None else {"bias_priors": dict(self.bias_priors)}),
            "details": dict(self.details),
            "nuisances": {name: as_document(p) for name, p in self.coordinates.nuisances.items()},
            "seconds": self.seconds,
            "seed": self.seed,
            "date": self.date,
            "hash": self.hash,
            "versions": dict(self.versions),
            "inputs_sha256": dict(self.inputs_sha256),
        }

    def __getitem__(self, name: str) -> Estimate:
        """The estimate of a parameter: `result["on_threshold"].interval_95`.  Raises InputError for unknown names."""
        if name not in self.estimates:
            known = f"{', '.join(self.estimates)}{did_you_mean(name, self.estimates)}"
            raise InputError(f"fit of {self.model.name}: no parameter {name!r}; it has {known}")
        return self.estimates[name]

    @property
    def headline(self) -> str:
        """Model, status, and what it was fitted to."""
        number_of = f"{len(self.recordings)} recording{'s' * (len(self.recordings) != 1)}"
        return (
            f"fit of {self.model.name}: {self.status}; {self.events} events, {self.pixels} pixels, {number_of}, "
            f"{self.seconds:.1f} s"
        )

    def tables(self) -> list[Table]:
        """Values with 95 % intervals; physical values where the gauge makes them unique."""
        rows = tuple(
            (e.name, number(e.value), interval(e.interval_95), e.unit, self._known(e)) for e in self.estimates.values()
        )
        headings = ("parameter", "value", "95 % interval", "unit", "identified?")
        tables = [Table("", headings, rows, frozenset({"parameter", "unit", "identified?"}))]
        if self.physical:
            ends, unknown = self.physical_intervals(), dict.fromkeys(self.model.gauge.fixed, "assumed")
            assumed = ", ".join(f"{name} = {value}" for name, value in self.model.gauge.statements().items())
            physical = tuple(
                (
                    name,
                    number(value),
                    interval(ends[name]) if ends[name] else unknown.get(name, "not identified"),
                    PHYSICAL_UNITS[name],
                )
                for name, value in self.physical.items()
            )
            headings = ("circuit", "value", "95 % interval", "unit")
            tables.append(
                Table(f"circuit values, assuming {assumed}", headings, physical, frozenset({"circuit", "unit"}))
            )
        if self.pixel_levels is not None:
            spread = tuple(
                (f"{kind} over pixels", number(scale["value"]), interval(scale["interval_95"]), scale["unit"])
                for kind, scale in self.pixel_levels.scales.items()
            )
            headings = ("scale of", "value", "95 % interval", "unit")
            tables.append(Table("levels of pixels", headings, spread, frozenset({"scale of", "unit"})))
        if self.bias_priors is not None:
            tables.append(prior_table(self.bias_priors))
        return tables

    def physical_intervals(self) -> dict[str, tuple[float, float] | None]:
        """95 % intervals of the physical values; None where the gauge states the value, and where it stays open."""
        from pixelid.fit.uncertainty.physical import physical_intervals

        return physical_intervals(self.model, self.coordinates, self.covariance, self.physical or {})

    def _known(self, estimate: Estimate) -> str:
        """How well a parameter is known, in words."""
        if estimate.fixed:
            return "fixed"
        words = self.details.get("precision", {}).get(estimate.name, "")
        return words or ("yes" if estimate.identified else "no")

    def records(self) -> list[dict[str, Any]]:
        """One row per parameter."""
        rows = []
        for e in self.estimates.values():
            low, high = e.interval_95 or (None, None)
            rows.append(
                {"parameter": e.name, "value": e.value, "unit": e.unit, "std": e.std, "low_95": low, "high_95": high,
                 "identified": e.identified, "fixed": e.fixed}
            )  # fmt: skip
        return rows

    def sentences(self) -> list[str]:
        """Advice, and what the data leave open."""
        biases = [] if self.bias_priors is None else prior_sentences(self.bias_priors)
        return [text for text in (self.advice or self.status.advice, *self.unidentified, *biases) if text]

    def write_companions(self, folder: Path) -> None:
        """Write model.toml, the fitted model."""
        save_model(self.model, folder / "model.toml")

    def write_figures(self, folder: Path, recordings: Sequence[Recording] = ()) -> None:
        """Draw rates and residuals, which need the recordings."""
        from pixelid.fit.figures import write_figures

        if recordings or self.fitted:
            write_figures(self, recordings or self.fitted, folder)

    @classmethod
    def load(cls, folder: str | Path) -> FitResult:
        """The fit of a folder, as good as new: it can be sampled, simulated, plotted.

        Raises:
            InputError: no fit there, or a damaged one.
        """
        content = read_result(folder, cls.FILE)
        check_parameters(content, Path(folder) / cls.FILE)
        check_kinds(
            content, Path(folder) / cls.FILE,
            text=("status", "advice", "engine", "observation"), a_list_of_texts=("unidentified", "recordings"),
            a_number=("log_likelihood", "events", "pixels", "seconds", "seed"),
            a_table=(
                "covariance", "gauge", "alignment", "pixel_levels", "bias_priors", "details", "nuisances", "versions",
                "inputs_sha256",
            ),
        )  # fmt: skip
        with interpreting(Path(folder) / cls.FILE, "a fit"):
            for name, words in content["details"].get("precision", {}).items():
                if not isinstance(words, str):
                    raise ValueError(f"details.precision.{name} is no text")
            (parameters, covariance, status) = required(content, folder, cls.FILE, "parameters", "covariance", "status")
            model = load_model(Path(folder) / "model.toml")
            nuisances = tuple(from_document(name, entry) for name, entry in content.get("nuisances", {}).items())
            coordinates = Coordinates.of(model, nuisances)
            if list(coordinates.names) != covariance["names"]:
                raise InputError(
                    f"{Path(folder) / cls.FILE}: covariance: expected the free parameters of model.toml, "
                    f"{', '.join(coordinates.names)}, found {', '.join(covariance['names'])}"
                )
            matrix = np.array(covariance["matrix"], dtype=float)
            if matrix.shape != (len(coordinates), len(coordinates)):
                raise ValueError(f"covariance.matrix: {matrix.shape} numbers of {len(coordinates)} parameters")
            estimates = {
                name: Estimate(
                    name, entry["value"], entry["unit"], entry["std"], _pair(entry["interval_95"]),
                    entry["identified"], entry["fixed"],
                )
                for name, entry in parameters.items()
            }  # fmt: skip
            x = np.array([p.to_coordinate(parameters[p.name]["value"]) for p in coordinates.parameters])
            plain = ("engine", "observation", "log_likelihood", "events", "pixels", "seconds", "seed", "details")
            known = dict(zip(plain, required(content, folder, cls.FILE, *plain), strict=True))
            result = cls(
                status=Status(status),
                advice=content.get("advice", ""),
                model=coordinates.model,
                coordinates=coordinates,
                x=x,
                covariance=matrix,
                estimates=estimates,
                unidentified=tuple(content["unidentified"]),
                physical=content["physical"],
                physical_why=content["gauge"]["why_no_physical"],
                recordings=tuple(content["recordings"]),
                alignment={name: dict(clock) for name, clock in content.get("alignment", {}).items()},
                pixel_levels=PixelLevels.from_dict(content["pixel_levels"]) if "pixel_levels" in content else None,
                bias_priors=content.get("bias_priors"),
                versions=content["versions"],
                inputs_sha256=content["inputs_sha256"],
                date=str(content.get("date", "")),
                **known,
            )
            if result.bias_priors is not None:
                result.tables()  # which need every entry
                result.sentences()
            if result.physical:
                result.physical_intervals()  # which needs every value to be a number
            return result

    def plot_intervals(self, start: ModelLike | None = None) -> Any:
        """The free parameters with their 95 % intervals, over the values of `start` or their own: a matplotlib axis."""
        return self._plot_intervals(start, None)

    def plot_truth(self, truth: ModelLike, start: ModelLike | None = None) -> Any:
        """The same with true values, as of the model that simulated the recordings: a matplotlib axis."""
        return self._plot_intervals(start, truth)

    def _plot_intervals(self, start: ModelLike | None, truth: ModelLike | None) -> Any:
        from pixelid.figures.intervals import draw_intervals
        from pixelid.inputs import as_model

        reference, true = (None if model is None else as_model(model).values for model in (start, truth))
        return draw_intervals(self.as_dict()["parameters"], reference, true)

    def plot_response(self, recordings: RecordingsLike | None = None) -> np.ndarray:
        """Measured event rates (filled) and the fitted model's (lines): matplotlib axes, one per recording.

        recordings: by default those fitted; a fit that was read from a folder needs them
        """
        from pixelid.fit import figures

        draw = figures.draw_edges if self.observation == "pooled_rate" else figures.draw_conditions
        return draw(self, self._given_or_fitted(recordings))

    def plot_residuals(self, recordings: RecordingsLike | None = None) -> np.ndarray:
        """What is left over, standardised, over time, wait and recording, and its distribution: matplotlib axes.

        recordings: by default those fitted; a fit that was read from a folder needs them

        Raises:
            InputError: a fit of pooled counts, which have no residual per event.
        """
        from pixelid.fit import figures

        if self.observation == "pooled_rate":
            raise InputError("plot_residuals: pooled counts have no residual per event; use plot_response")
        return figures.draw_residuals(self, self._given_or_fitted(recordings))

    def _given_or_fitted(self, recordings: RecordingsLike | None) -> list[Recording]:
        from pixelid.inputs import as_recordings

        if recordings is None and not self.fitted:
            raise InputError("recordings: expected those of the fit, which its folder does not hold")
        return as_recordings(self.fitted if recordings is None else recordings)


def _pair(limits: list | None) -> tuple[float | None, float | None] | None:
    """An interval as JSON holds it: an open side is null."""
    return None if limits is None else (limits[0], limits[1])


def as_document(parameter: Parameter) -> dict[str, Any]:
    """A nuisance parameter as fit.json holds it."""
    document = asdict(parameter)
    del document["name"], document["source"]
    return document | {"prior": parameter.prior.as_dict() if parameter.prior else None}


def from_document(name: str, document: Mapping[str, Any]) -> Parameter:
    """The parameter that `as_document` wrote."""
    low, high = document["lower"], document["upper"]  # JSON has no infinity
    bounds = (-np.inf if low is None else low, np.inf if high is None else high)
    prior = Prior(**document["prior"]) if document["prior"] else None
    return Parameter(name, document["value"], document["unit"], *bounds, document["transform"], prior, document["free"])


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
    estimates = {}
    for name, parameter in everything.items():
        i = index.get(name)
        if i is None:
            estimates[name] = Estimate(name, values[name], parameter.unit, None, None, True, True)
            continue
        value, s = values[name], float(sd[i])
        if np.isfinite(s):
            reach = np.clip([limits[0][i], limits[1][i]], x[i] - 300.0, x[i] + 300.0)
            bounds = [parameter.from_coordinate(float(c)) for c in reach]
            limits_95 = (max(bounds[0], parameter.lower), min(bounds[1], parameter.upper))
            std = s * value if parameter.transform == "log" else s
        else:
            limits_95, std = (parameter.lower, parameter.upper), None
        estimates[name] = Estimate(name, value, parameter.unit, std, limits_95, bool(identified[i]), False)
    return estimates


class Stopwatch:
    """Seconds since it was made."""

    def __init__(self) -> None:
        self._start = time.perf_counter()

    def seconds(self) -> float:
        return time.perf_counter() - self._start
