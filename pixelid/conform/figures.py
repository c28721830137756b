"""The table as a picture: what each effect gains or would show, along the signal path."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pixelid.conform.result import ConformReport
from pixelid.conform.row import ABSENT, NOT_DECIDABLE, NOT_TESTED, PRESENT, Row
from pixelid.figures.style import IMPROVED, MUTED, SERIES, UNEXPLAINED, legend_above, new_axes, save_figure, styled
from pixelid.figures.words import in_words
from pixelid.gap.figures import write_figures as write_figures_of_search
from pixelid.recordings.recording import Recording

COLOURS = {PRESENT: IMPROVED, ABSENT: SERIES[2], NOT_DECIDABLE: UNEXPLAINED, NOT_TESTED: MUTED}
MARKS = {PRESENT: "o", ABSENT: "x", NOT_DECIDABLE: "D", NOT_TESTED: "|"}


def write_figures(report: ConformReport, recordings: Sequence[Recording], folder: Path) -> list[Path]:
    """Write the table's picture and the search's figures into `folder`; returns their paths."""
    drawn = save_figure(draw_effects(report.rows), folder / "effects.svg")
    return [drawn, *(write_figures_of_search(report.gap, recordings, folder) if recordings else [])]


@styled
def draw_effects(rows: Sequence[Row], axes: Any = None) -> Any:
    """Every effect in signal order: left, nats gained by those present; right, nats by which the others would show."""
    drawn = [
        (row, nats) for row in reversed(rows)
        if (nats := row.heldout_gain_nats if row.verdict == PRESENT else row.shows_nats) is not None
    ]  # fmt: skip
    if axes is None:
        axes = new_axes(1, 2, 4.3, 1.2 + 0.26 * len(drawn))
    others = ABSENT, NOT_DECIDABLE, NOT_TESTED
    panels = ((PRESENT,), "nats gained"), (others, "nats it would show")
    for axis, (shown, label) in zip(np.ravel(axes), panels, strict=True):
        for verdict in shown:
            some = [(max(nats, 0.0), i) for i, (row, nats) in enumerate(drawn) if row.verdict == verdict]
            if some:
                words = verdict.replace("_", " ")
                axis.plot(*zip(*some, strict=True), MARKS[verdict], color=COLOURS[verdict], clip_on=False, label=words)
        axis.set(xscale="symlog", ylim=(-0.6, max(len(drawn), 1) - 0.4), xlabel=label)
        axis.set_xlim(0.0, max(axis.get_xlim()[1], 10.0))
        axis.set_yticks(range(len(drawn)), [])
    np.ravel(axes)[0].set_yticks(range(len(drawn)), [in_words(row.effect) for row, _ in drawn])
    legend_above(axes)
    return axes
