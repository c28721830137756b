"""The result of a low-light analysis: where one pole describes the photoreceptor, and what recordings say."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from pixelid.documents import interpreting
from pixelid.errors import InputError
from pixelid.lowlight.table import (
    LATENCY_HEADINGS,
    MEASURED_HEADINGS,
    RADII_HEADINGS,
    latency_rows,
    measured_rows,
    not_measurable,
    radii_rows,
)
from pixelid.model.files import load_model, save_model
from pixelid.model.model import Model
from pixelid.provenance import provenance
from pixelid.recordings.recording import Recording
from pixelid.results import ContentResult, Table, latency_fit_of, read_result, required
from pixelid.status import Status


@dataclass(frozen=True, repr=False)
class LowlightReport(ContentResult):
    """A finished low-light analysis.

    content: of lowlight.json (docs/schemas/lowlight.json);  model: the circuit analysed
    """

    FILE: ClassVar[str] = "lowlight.json"

    model: Model

    @property
    def headline(self) -> str:
        """Model and status."""
        return f"low light of {self.content['model']}: {self.status} in {self.content['seconds']:.1f} s"

    def tables(self) -> list[Table]:
        """Radiance from which the approximations err; what was measured, and the model's."""
        unit = self.content["radiance_unit"]
        content = dict(self.content)
        radii = tuple(tuple(row) for row in radii_rows(content))
        tables = [
            Table(f"radiance [{unit}] above which an approximation is off by 1, 10, 50 %", RADII_HEADINGS, radii,
                  frozenset(RADII_HEADINGS[:2]))
        ]  # fmt: skip
        if self.content["measured"]:
            rows = tuple(tuple(row) for row in measured_rows(content))
            left = frozenset({"recording", "quantity"})
            tables.append(Table("measured, and the model under the same light", MEASURED_HEADINGS, rows, left))
        if latency := self.content.get("latency"):
            rows = tuple(tuple(row) for row in latency_rows(latency))
            title = f"dominant pole [rad/s] of {latency['camera']} from its latencies, and of the model"
            tables.append(Table(title, LATENCY_HEADINGS, rows, frozenset(LATENCY_HEADINGS[:2])))
        return tables

    def records(self) -> list[dict[str, Any]]:
        """One row per approximation, quantity and scope: largest errors, first radiance of each level."""
        return [
            {"approximation": kind, "quantity": quantity, "scope": scope, "largest_under": entry["largest_under"],
             "largest_over": entry["largest_over"],
             **{f"first_{level}": limits["first"] for level, limits in entry["levels"].items()}}
            for kind, by_quantity in self.content["errors"].items()
            for quantity, by_scope in by_quantity.items()
            for scope, entry in by_scope.items()
        ]  # fmt: skip

    def sentences(self) -> list[str]:
        """The regimes in words, what could not be measured, and advice."""
        latency = self.content.get("latency") or {"sentences": []}
        said = [*self.content["sentences"], *not_measurable(dict(self.content)), *latency["sentences"]]
        said.append(self.content["advice"])
        return [text for text in said if text]

    def write_companions(self, folder: Path) -> None:
        """Write model.toml, the circuit analysed."""
        save_model(self.model, folder / "model.toml")

    def write_figures(self, folder: Path, recordings: Sequence[Recording] = ()) -> None:
        """Draw what the page shows."""
        from pixelid.lowlight.figures import write_figures

        write_figures(dict(self.content), self.model.circuit(), folder)

    @classmethod
    def load(cls, folder: str | Path) -> LowlightReport:
        """The analysis of a folder.

        Raises:
            InputError: none there, or a damaged one.
        """
        content = read_result(folder, cls.FILE)
        required(content, folder, cls.FILE, "status", "errors", "regimes", "curves", "sentences")
        with interpreting(Path(folder) / cls.FILE, "a low-light analysis"):
            content["curves"] = _arrays(content["curves"])
            if content.get("bands"):
                content["bands"] = _arrays(content["bands"])
            return cls(content, load_model(Path(folder) / "model.toml"))

    def plot_poles(self) -> np.ndarray:
        """Poles, −3 dB frequency and step time over radiance: matplotlib axes."""
        from pixelid.lowlight.figures import draw_poles, kinds_of

        circuit = self.model.circuit()
        return draw_poles(dict(self.content), circuit, kinds_of(circuit))

    def plot_errors(self) -> np.ndarray:
        """Relative errors of the approximations over radiance: matplotlib axes."""
        from pixelid.lowlight.figures import draw_errors, kinds_of

        circuit = self.model.circuit()
        return draw_errors(dict(self.content), circuit, kinds_of(circuit)[1:])


def lowlight_report(
    model: Model,
    recordings: Sequence[Recording],
    *,
    fitted: dict[str, Any] | None = None,
    sources: Sequence[Path] = (),
    latency: Sequence[Path] = (),
    camera: str | None = None,
    seed: int = 0,
    progress: Callable[[str, float], None] | None = None,
) -> LowlightReport:
    """The whole analysis, with provenance.

    fitted: the fit.json that the model came from, whose uncertainty is drawn as bands;  sources: the model's files
    latency: tables of latencies, a recipe, or the folder of a finished fit; that of `sources` by default
    camera: which of the tables' cameras the model is
    """
    from pixelid.fit.draws import drawn, uncertainty
    from pixelid.lowlight.analysis import analyse, sentences
    from pixelid.lowlight.latencies import latency_analysis
    from pixelid.lowlight.latency_source import camera_of, latency_draws, read_source
    from pixelid.tables.latency.camera import Camera

    draws: list[Model] = []
    band_draws = 60  # models behind the bands of a fit: their 95 % limits to about a tenth of their width
    if fitted is not None:
        draws = drawn(model, *uncertainty(fitted, model), band_draws, np.random.default_rng(seed))
    finished = latency_fit_of(sources[0]) if sources else None
    if finished is not None and not draws:
        draws = latency_draws(finished[0], model, band_draws, np.random.default_rng(seed), finished[1])
    tables = list(latency) or ([finished[0]] if finished is not None and draws else [])
    if camera is not None and not tables:
        raise InputError("--camera: which of the cameras of --latency; expected that option with it")
    content = analyse(model, recordings, draws=draws, seed=seed, progress=progress)
    content["latency"] = None
    files = [*sources, *(r.source for r in recordings if r.source is not None)]
    if tables:
        known = replace(camera_of(sources[0]) if sources else Camera(model.name, model, ()), model=model)
        source = read_source(tables, known, camera)
        found = latency_analysis(source, known, draws, seed)
        worst = Status.worst([content["status"], found["status"]])
        advice = "; ".join(text for text in (content["advice"], found["advice"]) if text)
        content |= {"latency": found, "status": worst, "advice": advice}
        files += source.files
    return LowlightReport({**content, "sentences": sentences(content), "seed": seed, **provenance(*files)}, model)


def _arrays(value: Any) -> Any:
    """Lists of numbers as arrays (null as NaN), inside dictionaries."""
    if isinstance(value, dict):
        return {name: _arrays(entry) for name, entry in value.items()}
    if isinstance(value, list) and value and all(entry is None or isinstance(entry, int | float) for entry in value):
        return np.array([np.nan if entry is None else entry for entry in value], dtype=float)
    return value
