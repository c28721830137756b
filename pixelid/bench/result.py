"""The result of a calibration: one verdict over the checks, the fit, the search and the joint fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from pixelid.bench.check import Row
from pixelid.bench.statements import Statement
from pixelid.fit.result import Estimate, FitResult
from pixelid.gap.result import GapReport
from pixelid.inputs import ModelLike
from pixelid.model.files import save_model
from pixelid.model.model import Model
from pixelid.recordings.recording import Recording
from pixelid.recordings.session_alignment import RecordingAlignment
from pixelid.results import Result, Table
from pixelid.status import Status


@dataclass(frozen=True, repr=False)
class Calibration(Result):
    """A bench calibrated.

    status, advice, sentence: whether the model can be used, what to do, and the answer in one sentence
    fit: the joint fit of circuit, effects and bench;  first: the fit of the base;  gap: the search, None without one
    statements: what is stated about the bench and the events contradict;  rows: of the recordings, as checked
    unidentified: sentences;  held_out: how the fitted model describes pixels that no fit has seen, None without any
    recordings: on the camera's clock, with the pixels that were fitted
    unit: what one unit of the light is in the base model's own, in words
    start: the base model's values where the fit started, in the unit of the light
    alignments: of every recording that was read, for figures; the JSON holds what `rows` have of them

    Example:
        >>> import pixelid as px
        >>> result = px.calibrate("bench/")  # doctest: +SKIP
        >>> result.sentence, result.fit["alpha"].interval_95  # doctest: +SKIP
    """

    FILE: ClassVar[str] = "calibration.json"

    status: Status
    advice: str
    sentence: str
    fit: FitResult
    first: FitResult
    gap: GapReport | None
    statements: tuple[Statement, ...]
    rows: tuple[Row, ...]
    notes: tuple[str, ...]
    held_out: Mapping[str, Any] | None
    unit: str
    recommended_next: Mapping[str, Any]
    recordings: tuple[Recording, ...]
    seconds: float
    seed: int
    start: Mapping[str, float] = field(default_factory=dict)
    alignments: tuple[RecordingAlignment, ...] = ()
    versions: Mapping[str, str] = field(default_factory=dict)
    inputs_sha256: Mapping[str, str] = field(default_factory=dict)

    @property
    def model(self) -> Model:
        """The calibrated model."""
        return self.fit.model

    @property
    def headline(self) -> str:
        """The answer."""
        return self.sentence

    def as_dict(self) -> dict[str, Any]:
        """The content of calibration.json."""
        gap = None if self.gap is None else self.gap.as_dict()
        return {
            "status": self.status,
            "advice": self.advice,
            "sentence": self.sentence,
            "verdict": "none" if gap is None else gap["verdict"],
            "effects": [] if gap is None else _refitted(gap["effects"], self.fit),
            "described": [] if gap is None else gap["described"],
            "gap": None if gap is None else gap["gap"],
            "parameters": {name: estimate.as_dict() for name, estimate in self.fit.estimates.items()},
            "physical": dict(self.fit.physical) if self.fit.physical else None,
            "unidentified": list(self.fit.unidentified),
            "model": "model.toml",
            "base": self.first.model.name,
            "start": dict(self.start),
            "unit": self.unit,
            "bench": [statement.as_dict() for statement in self.statements],
            "recordings": [row.as_dict() for row in self.rows],
            "notes": list(self.notes),
            "held_out": self.held_out,
            "recommended_next": dict(self.recommended_next),
            "events": self.fit.events,
            "pixels": self.fit.pixels,
            "log_likelihood": self.fit.log_likelihood,
            "seconds": self.seconds,
            "seed": self.seed,
            "versions": dict(self.versions),
            "inputs_sha256": dict(self.inputs_sha256),
        }

    def tables(self) -> list[Table]:
        """The circuit's values with intervals, and the recordings."""
        own = self.fit.tables()
        circuit = tuple(row for row in own[0].rows if row[0] in self.model.parameters)
        first = Table(own[0].title, own[0].headings, circuit, own[0].left)
        used = tuple((row.name, str(row.events), "yes" if row.used else "no", row.why) for row in self.rows)
        recordings = Table("", ("recording", "events", "used", "remarks"), used, frozenset({"recording", "remarks"}))
        return [first, *own[1:], recordings]

    def records(self) -> list[dict[str, Any]]:
        """One row per parameter."""
        return self.fit.records()

    def sentences(self) -> list[str]:
        """Advice, contradicted statements, what is not identified, what was inferred."""
        texts = (self.advice, *(s.sentence for s in self.statements), self.unit, *self.fit.unidentified, *self.notes)
        return [text for text in texts if text]

    def __getitem__(self, name: str) -> Estimate:
        """The estimate of a parameter: `result["on_threshold"].interval_95`.  Raises InputError for unknown names."""
        return self.fit[name]

    def plot_intervals(self) -> Any:
        """The free parameters with their 95 % intervals, over the values where the fit started: a matplotlib axis."""
        from pixelid.figures.intervals import draw_intervals

        return draw_intervals(self.as_dict()["parameters"], self.start)

    def plot_truth(self, truth: ModelLike) -> Any:
        """The free parameters with their 95 % intervals and true values: a matplotlib axis."""
        return self.fit.plot_truth(truth)

    def write_companions(self, folder: Path) -> None:
        """Write model.toml."""
        save_model(self.model, folder / "model.toml")

    def write_figures(self, folder: Path, recordings: Sequence[Recording] = ()) -> None:
        """Draw the recordings and what is left over; the result has its recordings itself."""
        from pixelid.bench.figures import write_figures

        write_figures(self, self.recordings, folder)


def _refitted(effects: list[dict[str, Any]], fit: FitResult) -> list[dict[str, Any]]:
    """Entries of named effects with the strengths of the joint fit in place of the search's."""
    changed = []
    for effect in effects:
        values = dict(effect["parameters"])
        for name in values:
            estimate = fit.estimates.get(name)
            if estimate is not None and not estimate.fixed:
                values[name] = {"value": estimate.value, "interval_95": estimate.interval_95}
        changed.append({**effect, "parameters": values})
    return changed
