"""The table as a picture: what each effect gains or would show, along the signal path."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pixelid.conform.result import ConformReport
from pixelid.conform.row import ABSENT, NOT_DECIDABLE, NOT_TESTED, PRESENT, Row
from pixelid.figures.style import IMPROVED, MUTED, SERIES, UNEXPLAINED, legend_above, new_axes, save_figure, styled
from pixelid.gap.figures import write_figures as write_figures_of_search
from pixelid.recordings.recording import Recording

COLOURS = {PRESENT: IMPROVED, ABSENT: SERIES[2], NOT_DECIDABLE: UNEXPLAINED, NOT_TESTED: MUTED}
MARKS = {PRESENT: "o", ABSENT: "x", NOT_DECIDABLE: "D", NOT_TESTED: "|"}


def write_figures(report: ConformReport, recordings: Sequence[Recording], folder: Path) -> list[Path]:
    """Write the table's picture and the search's figures into `folder`; returns their paths."""
    drawn = save_figure(draw_effects(report.rows), folder / "effects.svg")
    return [drawn, *write_figures_of_search(report.gap, recordings, folder)]


@styled
def draw_effects(rows: Sequence[Row], axes: Any = None) -> Any:
    """Every effect in signal order: left, nats gained by those present; right, nats by which the others would show."""
    if axes is None:
        axes = new_axes(1, 2, 4.3, 1.2 + 0.26 * len(rows))
    gained, would_show = np.ravel(axes)
    last = len(rows) - 1
    for verdict, colour in COLOURS.items():
        chosen = [(last - i, row) for i, row in enumerate(rows) if row.verdict == verdict]
        for axis, values in (
            (gained, [(i, row.heldout_gain_nats) for i, row in chosen if verdict == PRESENT]),
            (would_show, [(i, row.shows_nats) for i, row in chosen if verdict != PRESENT]),
        ):
            some = [(max(nats, 0.0), i) for i, nats in values if nats is not None]
            axis.plot(*(np.array(some).T if some else ((), ())), MARKS[verdict], color=colour, clip_on=False,
                      label=verdict.replace("_", " ") if values else None)  # fmt: skip
    names = [f"{row.stage}: {row.effect}".replace("_", " ") for row in reversed(rows)]
    gained.set_yticks(range(len(rows)), names)
    would_show.set_yticks(range(len(rows)), [])
    gained.set_xlabel("present: nats gained on held-out pixels")
    would_show.set_xlabel("others: nats by which they would show")
    for axis in (gained, would_show):
        axis.set(xscale="symlog", ylim=(-0.6, last + 0.6))
        axis.set_xlim(0.0, max(axis.get_xlim()[1], 10.0))
    legend_above(axes)
    return axes
