"""Figures of a recommended experiment."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pixelid.figures.style import IMPROVED, INK, MUTED, new_axis, save_figure, styled


def write_figures(result: dict, folder: Path) -> None:
    """Write ranking.svg and widths.svg into `folder`."""
    save_figure(draw_ranking(result), folder / "ranking.svg")
    save_figure(draw_widths(result), folder / "widths.svg")


@styled
def draw_ranking(result: dict, axis: Any = None) -> Any:
    """Score of every stimulus on the menu, the recommended one in colour; returns the axis."""
    ranking = result["ranking"][::-1]
    axis = axis if axis is not None else new_axis(7.5, 0.26 * len(ranking) + 0.8)
    best = result["recommended"]["name"]
    axis.barh(
        [entry["name"] for entry in ranking],
        [entry["score"] for entry in ranking],
        xerr=[entry["score_error"] for entry in ranking],
        color=[IMPROVED if entry["name"] == best else MUTED for entry in ranking],
        error_kw={"ecolor": INK, "elinewidth": 0.8},
    )
    axis.grid(False, axis="y")
    axis.margins(y=0.02)
    axis.set_xlabel(f"score by {result['criterion']} (nats)")
    return axis


@styled
def draw_widths(result: dict, axis: Any = None) -> Any:
    """Standard error of every parameter before and after the recommended stimulus; returns the axis."""
    names = list(result["widths_before"])[::-1]
    axis = axis if axis is not None else new_axis(7.5, 0.3 * len(names) + 0.8)
    for row, name in enumerate(names):
        ends = [result[key][name]["std_coordinate"] for key in ("widths_before", "widths_after")]
        axis.annotate(
            "", (ends[1], row), (ends[0], row), arrowprops={"arrowstyle": "->", "color": IMPROVED, "linewidth": 1.0}
        )
        axis.plot(ends[0], row, "o", color=MUTED, label=None if row else "before")
        axis.plot(ends[1], row, "o", color=IMPROVED, label=None if row else "after")
    axis.set_yticks(range(len(names)), names)
    axis.set(xscale="log", xlabel="standard error in the fitting coordinate (0.1 is 10 % for log parameters)")
    axis.legend()
    return axis
