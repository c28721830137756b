"""The table as a picture: what each effect gains or would show, along the signal path."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pixelid.conform.result import ConformReport
from pixelid.conform.row import ABSENT, NOT_DECIDABLE, NOT_TESTED, PRESENT, Row
from pixelid.figures.style import IMPROVED, INK, MEASURED, MUTED, UNEXPLAINED, new_axis, save_figure, styled
from pixelid.gap.figures import write_figures as write_figures_of_search
from pixelid.recordings.recording import Recording

COLOURS = {PRESENT: IMPROVED, ABSENT: MEASURED, NOT_DECIDABLE: UNEXPLAINED, NOT_TESTED: MUTED}
MARKS = {PRESENT: "o", ABSENT: "x", NOT_DECIDABLE: "D", NOT_TESTED: "|"}


def write_figures(report: ConformReport, recordings: Sequence[Recording], folder: Path) -> list[Path]:
    """Write the table's picture and the search's figures into `folder`; returns their paths."""
    drawn = save_figure(draw_effects(report.rows), folder / "effects.svg")
    return [drawn, *write_figures_of_search(report.gap, recordings, folder)]


@styled
def draw_effects(rows: Sequence[Row], axes: Any = None) -> Any:
    """Every effect in signal order: nats gained on held-out pixels (present), or by which it would have shown."""
    axis = axes if axes is not None else new_axis(7.5, 1.2 + 0.26 * len(rows))
    for verdict, colour in COLOURS.items():
        chosen = [(i, row) for i, row in enumerate(reversed(rows)) if row.verdict == verdict]
        heights = [i for i, _ in chosen]
        nats = [next((x for x in (row.heldout_gain_nats, row.shows_nats) if x is not None), 0.0) for _, row in chosen]
        axis.plot(nats, heights, MARKS[verdict], color=colour, label=verdict.replace("_", " "))
    axis.set_yticks(range(len(rows)), [f"{row.stage}: {row.effect}" for row in reversed(rows)])
    axis.set_xscale("symlog", linthresh=3)
    axis.axvline(0, color=INK, linewidth=0.6)
    axis.set_xlabel("nats: gained on held-out pixels, or (absent) shown at typical strength")
    axis.legend(loc="lower right")
    return axis
