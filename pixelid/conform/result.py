"""The table with its verdicts, as JSON, on a terminal and as a page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from pixelid.conform.row import ABSENT, NOT_DECIDABLE, NOT_TESTED, PRESENT, VERDICTS, Row, strengths_in_words
from pixelid.gap.result import GapReport
from pixelid.recordings.recording import Recording
from pixelid.results import Result, Table, number
from pixelid.status import Status

WORDS = {PRESENT: "present", ABSENT: "absent", NOT_DECIDABLE: "not decidable", NOT_TESTED: "not tested"}


@dataclass(frozen=True, repr=False)
class ConformReport(Result):
    """What of the signal path recordings have.

    Attributes:
        gap: The search behind it.
        rows: One for each effect and quantity, in the order of the signal path.
        sensor: What the recordings say they are of.
        seconds: Of the whole.
    """

    FILE: ClassVar[str] = "conform.json"

    gap: GapReport
    rows: tuple[Row, ...]
    sensor: str
    seconds: float

    @property
    def status(self) -> Status:
        """How the search ended."""
        return self.gap.status

    @property
    def counts(self) -> dict[str, int]:
        """How many rows end in each verdict."""
        return {verdict: sum(row.verdict == verdict for row in self.rows) for verdict in VERDICTS}

    def as_dict(self) -> dict[str, Any]:
        """The content of conform.json (docs/formats.md)."""
        gap = self.gap
        return {
            "status": gap.status,
            "advice": gap.advice,
            "verdict": gap.verdict,
            "sentence": gap.sentence,
            "sensor": self.sensor,
            "base": gap.base.name,
            "rows": [row.as_dict() for row in self.rows],
            "counts": self.counts,
            "remainder": gap.remainder,
            "departs": [dict(cell) for cell in gap.details.get("seen_before", ())],
            "left": [dict(cell) for cell in gap.details.get("remaining", ())],
            "gap": gap.free_run.as_dict() if gap.free_run else None,
            "model": "model.toml",
            "search": GapReport.FILE,
            "alpha": gap.alpha,
            "seconds": self.seconds,
            "seed": gap.seed,
            "versions": dict(gap.versions),
            "inputs_sha256": dict(gap.inputs_sha256),
        }

    @property
    def headline(self) -> str:
        """Of what, and how many effects it has."""
        counts = ", ".join(f"{n} {WORDS[verdict]}" for verdict, n in self.counts.items())
        return f"{self.sensor or 'these recordings'} against {self.gap.base.name}: {self.gap.verdict}; {counts}"

    def tables(self) -> list[Table]:
        """The rows."""
        rows = tuple(
            (row.stage, row.effect, WORDS[row.verdict], strengths_in_words(row.as_dict()), number(row.p_value),
             number(row.heldout_gain_nats), row.why)
            for row in self.rows
        )  # fmt: skip
        headings = ("stage", "effect", "verdict", "strength (95 %)", "p", "held-out [nats]", "why")
        return [Table("", headings, rows, frozenset({"stage", "effect", "verdict", "strength (95 %)", "why"}))]

    def records(self) -> list[dict[str, Any]]:
        """One row per effect."""
        return [{"effect": row.effect, "stage": row.stage, "verdict": row.verdict, "p_value": row.p_value,
                 "heldout_gain_nats": row.heldout_gain_nats, "why": row.why} for row in self.rows]  # fmt: skip

    def sentences(self) -> list[str]:
        """The search's verdict in words, and its advice."""
        return self.gap.sentences()

    def write_companions(self, folder: Path) -> None:
        """Write the search next to the table: gap.json, model.toml (the grown model) and base.toml."""
        self.gap.write(folder)

    def write_figures(self, folder: Path, recordings: Sequence[Recording] = ()) -> None:
        """Draw the table, and the search."""
        from pixelid.conform.figures import write_figures

        write_figures(self, recordings, folder)
