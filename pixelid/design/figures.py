"""Figures of a recommended experiment."""

from __future__ import annotations

from pathlib import Path

import numpy as np


def write_figures(found: dict, folder: Path) -> None:
    """Write ranking.png and widths.png into `folder`."""
    import matplotlib.pyplot as plt

    for name, axes in (("ranking", draw_ranking(found)), ("widths", draw_widths(found))):
        figure = axes.flat[0].figure
        figure.savefig(folder / f"{name}.png", dpi=110)
        plt.close(figure)


def draw_ranking(found: dict) -> np.ndarray:
    """Bars of the candidates' scores."""
    import matplotlib.pyplot as plt

    ranking = found["ranking"][::-1]
    _, axes = plt.subplots(figsize=(7, 0.3 * len(ranking) + 1), squeeze=False, layout="constrained")
    axis = axes[0, 0]
    axis.barh(
        [entry["name"] for entry in ranking],
        [entry["score"] for entry in ranking],
        xerr=[entry["score_error"] for entry in ranking],
        color="tab:blue",
    )
    axis.set_xlabel(f"score by {found['criterion']} [nats]")
    return axes


def draw_widths(found: dict) -> np.ndarray:
    """Standard errors before and after, as arrows."""
    import matplotlib.pyplot as plt

    names = list(found["widths_before"])[::-1]
    _, axes = plt.subplots(figsize=(7, 0.35 * len(names) + 1), squeeze=False, layout="constrained")
    axis = axes[0, 0]
    for row, name in enumerate(names):
        ends = [found[key][name]["std_coordinate"] for key in ("widths_before", "widths_after")]
        axis.annotate("", (ends[1], row), (ends[0], row), arrowprops={"arrowstyle": "->", "color": "tab:blue"})
        axis.plot(ends[0], row, "o", color="grey")
        axis.plot(ends[1], row, "o", color="tab:blue")
    axis.set_yticks(range(len(names)), names)
    axis.set(xscale="log", xlabel="standard error in the fitting coordinate (grey before, blue after)")
    return axes
