"""The result of a gap search: verdict, effects, the numbers behind them, and the grown model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from pixelid.documents import interpreting
from pixelid.errors import InputError
from pixelid.fit.levels.pixel_levels import PixelLevels
from pixelid.gap.attribute.flexible import Flexible
from pixelid.gap.confirm.free_run import FreeRun
from pixelid.model.files import load_model, save_model
from pixelid.model.fitted import as_fitted, fit_hash, today
from pixelid.model.model import Model
from pixelid.results import Result, Table, check_kinds, interval, number, read_result, required
from pixelid.stages.described import cell, described
from pixelid.stages.described_words import words_of_entry
from pixelid.status import Status

if TYPE_CHECKING:
    from pixelid.inputs import RecordingsLike
    from pixelid.recordings.recording import Recording

Limits = tuple[float | None, float | None] | None  # of 95 %; None for a side that the data leave open

SHOWN_CELLS = 8  # of the maps
VERDICTS = ("none", "named", "ambiguous", "unknown")


@dataclass(frozen=True)
class Named:
    """One effect found.

    p_value: adjusted for all effects tried;  heldout_gain, runner_up_gain: nats on pixels no fit had seen
    max_cosine, max_cosine_with: the most similar other effect or parameter under these stimuli
    parameters: name → (value, 95 % interval);  where: what it was found by
    """

    name: str
    p_value: float
    heldout_gain: float
    runner_up: str | None
    runner_up_gain: float | None
    max_cosine: float
    max_cosine_with: str
    parameters: Mapping[str, tuple[float, Limits]]
    where: str

    def as_dict(self) -> dict:
        """Its entry in gap.json."""
        return {
            "name": self.name,
            "p_value": self.p_value,
            "heldout_gain_nats": self.heldout_gain,
            "runner_up": self.runner_up,
            "runner_up_gain_nats": self.runner_up_gain,
            "max_cosine": self.max_cosine,
            "max_cosine_with": self.max_cosine_with,
            "parameters": {k: {"value": v, "interval_95": i} for k, (v, i) in self.parameters.items()},
            "where": self.where,
        }


@dataclass(frozen=True)
class DescribedEffect:
    """An effect without a name, written as an equation.

    effect: its name in the model, of `stages/described.py`;  equation, words: with numbers
    parameters: short name → (value, 95 % interval);  heldout_gain: nats on pixels no fit had seen
    closed: fraction of the free-run gap that the model with all of `described` closes
    """

    effect: str
    equation: str
    words: str
    parameters: Mapping[str, tuple[float, Limits]]
    heldout_gain: float
    closed: float | None

    def as_dict(self) -> dict:
        """Its entry in gap.json."""
        own = described(self.effect)
        return {
            "stage": own.stage,
            "quantity": own.quantity,
            "covariate": own.covariate,
            "form": own.form,
            "equation": self.equation,
            "parameters": {k: {"value": v, "interval_95": i} for k, (v, i) in self.parameters.items()},
            "heldout_gain_nats": self.heldout_gain,
            "closed_fraction": self.closed,
        }


@dataclass(frozen=True, repr=False)
class GapReport(Result):
    """A finished search.

    verdict: one of `VERDICTS`;  remainder: whether something significant is left unexplained
    base, model: the fitted base model and the grown one;  rounds: what each round saw, as JSON
    described: effects without a name, where the verdict is "unknown"
    free_run: the gap before and after;  term: the flexible alternative, for what no effect explains
    pixel_levels: gain and background of every pixel, taken as known by the search; None where they were not asked for
    status: a search that ends has a verdict that can be trusted, "unknown" included

    Example:
        >>> import pixelid as px
        >>> report = px.gap("session/", "dvs128")  # doctest: +SKIP
        >>> report.verdict, report.sentence  # doctest: +SKIP
    """

    FILE: ClassVar[str] = "gap.json"

    verdict: str
    sentence: str
    remainder: bool
    global_p: float
    alpha: float
    effects: tuple[Named, ...]
    free_run: FreeRun | None
    rounds: tuple[dict, ...]
    base: Model
    model: Model
    term: Flexible | None
    recommended_next: Mapping
    seconds: float
    seed: int
    described: tuple[DescribedEffect, ...] = ()
    details: Mapping = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    inputs_sha256: Mapping[str, str] = field(default_factory=dict)
    pixel_levels: PixelLevels | None = None
    status: Status = Status.converged
    advice: str = ""
    date: str = field(default_factory=today)

    def __post_init__(self) -> None:
        for name in ("base", "model"):  # whatever made the report
            object.__setattr__(self, name, self._truthful(getattr(self, name)))

    def _hash(self, model: Model) -> str:
        """A short name of the search's fit of a model."""
        return fit_hash("gap", model, [self.inputs_sha256, self.seed, self.date])

    def _truthful(self, model: Model) -> Model:
        """The model, saying of every fitted value that it is fitted, and how well it is known."""
        known = {**{e.name: e.parameters for e in self.effects}, **{e.effect: e.parameters for e in self.described}}
        limits = {name: limits for each in known.values() for name, (_, limits) in each.items()}
        limits |= {f"{e.effect}.{name}": limits for e in self.described for name, (_, limits) in e.parameters.items()}
        added = limits if model.name != self.base.name else {}
        to = f"the recordings of a search for the gap, verdict {self.verdict}"
        return as_fitted(model, fit=self._hash(model), day=self.date, to=to, fitted=model.free, limits=added)

    def as_dict(self) -> dict[str, Any]:
        """The content of gap.json (docs/formats.md)."""
        return {
            "status": self.status,
            "advice": self.advice,
            "verdict": self.verdict,
            "sentence": self.sentence,
            "remainder": self.remainder,
            "global_p": self.global_p,
            "alpha": self.alpha,
            "effects": [effect.as_dict() for effect in self.effects],
            "described": [effect.as_dict() for effect in self.described],
            "gap": self.free_run.as_dict() if self.free_run else None,
            "rounds": list(self.rounds),
            "unknown_term": self.term.as_dict(self._sigma) if self.term else None,
            "model": "model.toml",
            "recommended_next": dict(self.recommended_next),
            **({} if self.pixel_levels is None else {"pixel_levels": self.pixel_levels.as_dict()}),
            "details": dict(self.details),
            "seconds": self.seconds,
            "seed": self.seed,
            "date": self.date,
            "hash": self._hash(self.model),
            "versions": dict(self.versions),
            "inputs_sha256": dict(self.inputs_sha256),
        }

    @property
    def _sigma(self) -> float:
        return _sigma_of(self.model)

    @property
    def headline(self) -> str:
        """Base model and verdict."""
        return f"gap of {self.base.name}: {self.verdict}; global p {self.global_p:.2g}, {self.seconds:.1f} s"

    def tables(self) -> list[Table]:
        """The effects named, then every effect tried, round by round."""
        rows = tuple(
            (e.name, f"{e.p_value:.2g}", f"{e.heldout_gain:.1f}", e.runner_up or "–", number(e.runner_up_gain),
             _in_words(e.parameters))
            for e in self.effects
        )  # fmt: skip
        headings = ("effect", "adjusted p", "held-out [nats]", "runner-up", "its gain [nats]", "strength (95 %)")
        named = Table("", headings, rows, frozenset({"effect", "runner-up", "strength (95 %)"}))
        tried = tuple(
            (str(entry["round"]), c["name"], f"{c['gain_nats']:.1f}", f"{c['heldout_gain_nats']:.1f}",
             f"{c['p_value']:.2g}", "named" if c["name"] == entry["named"] else "")
            for entry in self.rounds for c in entry["candidates"]
        )  # fmt: skip
        headings = ("round", "effect", "gain [nats]", "held-out [nats]", "adjusted p", "said")
        tables = [named, *([self._descriptions] if self.described else [])]
        return [*tables, Table("effects tried", headings, tried, frozenset({"effect", "said"}))]

    @property
    def _descriptions(self) -> Table:
        rows = tuple(
            (e.words, e.equation, f"{e.heldout_gain:.1f}",
             _in_words(e.parameters))
            for e in self.described
        )  # fmt: skip
        headings = ("in words", "equation", "held-out [nats]", "parameters (95 %)")
        return Table("described", headings, rows, frozenset({"in words", "equation", "parameters (95 %)"}))

    def records(self) -> list[dict[str, Any]]:
        """One row per effect named."""
        return [
            {"effect": e.name, "p_value": e.p_value, "heldout_gain_nats": e.heldout_gain, "runner_up": e.runner_up,
             "runner_up_gain_nats": e.runner_up_gain, "max_cosine": e.max_cosine, "where": e.where,
             **{name: value for name, (value, _) in e.parameters.items()}}
            for e in self.effects
        ]  # fmt: skip

    def sentences(self) -> list[str]:
        """The verdict in words, and what to record next."""
        levels = () if self.pixel_levels is None else self.pixel_levels.notes
        said = (self.sentence, *levels, str(self.recommended_next.get("why", "")), self.advice)
        return [text for text in said if text]

    def write_companions(self, folder: Path) -> None:
        """Write model.toml (the grown model) and base.toml (the fitted base)."""
        save_model(self.model, folder / "model.toml")
        save_model(self.base, folder / "base.toml")

    def write_figures(self, folder: Path, recordings: Sequence[Recording] = ()) -> None:
        """Draw the search, and rates before and after, which need the recordings."""
        from pixelid.gap.figures import write_figures

        if recordings:
            write_figures(self, recordings, folder)

    @classmethod
    def load(cls, folder: str | Path) -> GapReport:
        """The report of a folder, with its models.

        Raises:
            InputError: no search there, or a damaged one.
        """
        content = read_result(folder, cls.FILE)
        check_kinds(
            content, Path(folder) / cls.FILE,
            text=("verdict", "sentence", "status", "advice"), a_list_of_tables=("effects", "rounds"),
            a_number=("global_p", "alpha", "seconds", "seed"),
            a_table=("recommended_next", "details", "versions", "inputs_sha256"),
        )  # fmt: skip
        with interpreting(Path(folder) / cls.FILE, "a gap search"):
            plain = ("verdict", "sentence", "remainder", "global_p", "alpha", "recommended_next", "seconds", "seed",
                     "details", "versions", "inputs_sha256")  # fmt: skip
            known = dict(zip(plain, required(content, folder, cls.FILE, *plain), strict=True))
            effects, gap, rounds, term = required(content, folder, cls.FILE, "effects", "gap", "rounds", "unknown_term")
            model = load_model(Path(folder) / "model.toml")
            base = Path(folder) / "base.toml"
            report = cls(
                effects=tuple(_named(entry) for entry in effects),
                described=tuple(_described(entry) for entry in content.get("described", [])),
                free_run=_free_run(gap) if gap else None,
                rounds=tuple(rounds),
                base=load_model(base) if base.is_file() else model,
                model=model,
                term=_flexible(term, _sigma_of(model)) if term else None,
                pixel_levels=PixelLevels.from_dict(content["pixel_levels"]) if "pixel_levels" in content else None,
                status=Status(content.get("status", "converged")),
                advice=content.get("advice", ""),
                date=str(content.get("date", "")),
                **known,
            )
            report.summary()  # what cannot be shown is of another kind than it should be
            return report

    def plot_map(self) -> np.ndarray:
        """Where the base model is wrong, and what is left with the grown one: matplotlib axes."""
        from pixelid.gap.figures import draw_map

        return draw_map(self)

    def plot_forest(self) -> Any:
        """What every effect that was fitted gains, per round: a matplotlib axis."""
        from pixelid.gap.figures import draw_gains

        return draw_gains(self)

    def plot_gap(self, recordings: RecordingsLike | None = None) -> np.ndarray:
        """The gap before and after, matplotlib axes: per recording, or with recordings as event rates over time.

        Raises:
            InputError: nothing was named, so that there is no before and after.
        """
        from pixelid.gap import figures
        from pixelid.inputs import as_recordings

        if "after_jumps" in self.details:
            return figures.draw_after_jumps(self)
        if self.free_run is None:
            raise InputError(f"plot_gap: the verdict is {self.verdict!r} and no effect was named; use plot_map")
        if recordings is None:
            return figures.draw_free_run(self)
        return figures.draw_before_after(self, as_recordings(recordings))


def _sigma_of(model: Model) -> float:
    return model.values.get("threshold_sigma", 0.02)


def _in_words(parameters: Mapping[str, tuple[float, Limits]]) -> str:
    return "; ".join(f"{name} {number(value)} ({interval(limits)})" for name, (value, limits) in parameters.items())


def _parameters(entry: Mapping[str, Any]) -> Mapping[str, tuple[float, Limits]]:
    """Those of an entry in gap.json."""
    return {
        name: (value["value"], tuple(value["interval_95"]) if value["interval_95"] else None)
        for name, value in entry["parameters"].items()
    }


def _named(entry: Mapping[str, Any]) -> Named:
    return Named(
        entry["name"], entry["p_value"], entry["heldout_gain_nats"], entry["runner_up"], entry["runner_up_gain_nats"],
        entry["max_cosine"], entry["max_cosine_with"], _parameters(entry), entry["where"],
    )  # fmt: skip


def _described(entry: Mapping[str, Any]) -> DescribedEffect:
    own = cell(entry["quantity"], entry["covariate"], entry["form"])
    return DescribedEffect(
        own.name, entry["equation"], words_of_entry(entry), _parameters(entry), entry["heldout_gain_nats"],
        entry["closed_fraction"],
    )  # fmt: skip


def _free_run(entry: Mapping[str, Any]) -> FreeRun:
    limits = entry["closed_fraction_interval"]
    each = {name: (row["before"], row["after"], row["floor"]) for name, row in entry.get("per_recording", {}).items()}
    closed = entry["closed_fraction"]
    return FreeRun(entry["before"], entry["after"], entry["floor"], closed, tuple(limits) if limits else None, each)


def _flexible(entry: Mapping[str, Any], sigma: float) -> Flexible:
    cells = entry["cells"]
    shift, se = (
        np.array([cell[key] for cell in cells], dtype=float) / (100.0 * sigma)
        for key in ("threshold_shift_percent", "se_percent")
    )
    labels = tuple(cell["where"] for cell in cells)
    held_out = np.array([entry["heldout_gain_nats"]], dtype=float)  # its sum over pixels is what is kept
    return Flexible(entry["depends_on"], labels, shift, se, entry["gain_nats"], held_out)
