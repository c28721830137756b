"""The result of a search for the next experiment: a ranked menu, and what the best stimulus would add."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from pixelid.design.table import RANKING_HEADINGS, WIDTHS_HEADINGS, ranking_rows, widths_rows
from pixelid.errors import InputError
from pixelid.model.model import Model
from pixelid.provenance import provenance
from pixelid.recordings.recording import Recording
from pixelid.results import ContentResult, Table, read_result, required
from pixelid.stimuli.files import shape
from pixelid.stimuli.stimulus import Stimulus

SPREAD = 0.2  # standard deviation in ln of the values averaged over, where no fit says how uncertain they are


@dataclass(frozen=True, repr=False)
class DesignReport(ContentResult):
    """A recommended experiment.

    content: of design.json (docs/schemas/design.json)
    """

    FILE: ClassVar[str] = "design.json"

    @property
    def stimulus(self) -> Stimulus:
        """The stimulus to record next."""
        best = self.content["recommended"]
        return shape(best["kind"], best["parameters"])

    @property
    def headline(self) -> str:
        """Model, criterion and recommendation."""
        c = self.content
        return (
            f"next: {c['recommended']['name']}, for {c['model']} by {c['criterion']}; {self.status} in "
            f"{c['seconds']:.1f} s"
        )

    def tables(self) -> list[Table]:
        """The ranking, and the intervals expected with the best."""
        content = dict(self.content)
        ranking = tuple(tuple(row) for row in ranking_rows(content))
        widths = tuple(tuple(row) for row in widths_rows(content))
        title = f"expected with {content['recommended']['name']}, {content['pixels']} pixels"
        return [
            Table("", RANKING_HEADINGS, ranking, frozenset({"stimulus"})),
            Table(title, WIDTHS_HEADINGS, widths, frozenset({"parameter", "unit"})),
        ]

    def records(self) -> list[dict[str, Any]]:
        """One row per candidate, best first."""
        keys = ("score", "score_error", "score_per_second", "duration_s", "events")
        return [{"stimulus": row["name"], **{key: row[key] for key in keys}} for row in self.content["ranking"]]

    def sentences(self) -> list[str]:
        """Why, and advice."""
        return [text for text in (self.content["why"], self.content["advice"]) if text]

    def write_companions(self, folder: Path) -> None:
        """Write next.toml, the recommended stimulus."""
        import tomli_w

        best = self.content["recommended"]
        document = {"stimulus": {"kind": best["kind"], **best["parameters"]}}
        (folder / "next.toml").write_bytes(tomli_w.dumps(document).encode())

    def write_figures(self, folder: Path, recordings: Sequence[Recording] = ()) -> None:
        """Draw what the page shows."""
        from pixelid.design.figures import write_figures

        write_figures(dict(self.content), folder)

    @classmethod
    def load(cls, folder: str | Path) -> DesignReport:
        """The recommendation of a folder.

        Raises:
            InputError: none there, or a damaged one.
        """
        content = read_result(folder, cls.FILE)
        required(content, folder, cls.FILE, "status", "recommended", "ranking", "widths_before", "widths_after", "why")
        return cls(content)

    def plot_ranking(self) -> np.ndarray:
        """The scores of all candidates: matplotlib axes."""
        from pixelid.design.figures import draw_ranking

        return draw_ranking(dict(self.content))

    def plot_widths(self) -> np.ndarray:
        """Standard errors before and after: matplotlib axes."""
        from pixelid.design.figures import draw_widths

        return draw_widths(dict(self.content))


def design_report(
    model: Model,
    recordings: Sequence[Recording],
    *,
    fitted: dict[str, Any] | None = None,
    sources: Sequence[Path] = (),
    criterion: str = "D",
    menu: Path | None = None,
    pixels: int | None = None,
    draws: int = 4,
    spread: float | None = None,
    per_second: bool = False,
    seed: int = 0,
    progress: Callable[[str, float], None] | None = None,
) -> DesignReport:
    """The whole search, with provenance.

    fitted: the fit.json that the model came from, which says what is known already;  sources: the model's files

    Raises InputError for options that exclude each other and an unknown criterion.
    """
    from pixelid.design import criteria
    from pixelid.design.design import known_from, recommend
    from pixelid.design.menu import default_menu, read_menu
    from pixelid.fit.coordinates import Coordinates
    from pixelid.fit.draws import drawn, uncertainty

    if pixels is not None and recordings:
        raise InputError("--pixels: the recordings say how many pixels there are")
    if spread is not None and (recordings or fitted):
        raise InputError("--spread: a fit brings its own uncertainty, and recordings belong to one set of values")
    names = Coordinates.of(model).names
    criteria.check(criterion, names)
    rng = np.random.default_rng(seed)
    known, others = None, []
    if fitted is not None:
        free, covariance = uncertainty(fitted, model)
        known = known_from(free, covariance) if free else None
        others = drawn(model, free, covariance, draws - 1, rng)
        pixels = pixels or fitted.get("pixels")
    elif not recordings:
        wide = np.eye(len(names)) * (SPREAD if spread is None else spread) ** 2
        others = drawn(model, list(names), wide, draws - 1, rng)
    candidates = read_menu(menu) if menu is not None else default_menu(model)
    content = recommend(
        model, candidates, criterion=criterion, recordings=recordings, known=known, draws=others, pixels=pixels or 25,
        per_second=per_second, seed=seed, progress=progress,
    )  # fmt: skip
    files = [*sources, *([menu] if menu is not None else [])]
    files += [r.source for r in recordings if r.source is not None]
    return DesignReport({**content, "seed": seed, **provenance(*files)})
