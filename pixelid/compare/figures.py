"""The figure of a model comparison: held-out log-likelihood behind the best model."""

from __future__ import annotations

from typing import Any

from pixelid.figures.style import IMPROVED, INK, MUTED, new_axis, styled

FAR = 5.0  # times as far behind as the second best: beyond, an arrow


@styled
def draw_held_out(result: dict, axis: Any = None) -> Any:
    """Nats behind the best model on held-out pixels, ± 2 standard errors; returns the axis.

    Args:
        result: the content of compare.json.
        axis: to draw on; a new one by default.
    """
    rows = sorted(result["models"].items(), key=lambda item: item[1]["behind_best_nats"])
    axis = axis if axis is not None else new_axis(7.5, 0.35 * len(rows) + 0.8)
    behind = sorted(-row["behind_best_nats"] for _, row in rows)
    errors = [2.0 * (row["behind_best_se"] or 0.0) for _, row in rows]
    reach = FAR * max(behind[min(1, len(behind) - 1)] + max(errors), 1.0)
    for i, (name, row) in enumerate(rows):
        if -row["behind_best_nats"] > reach:  # it would squeeze the others onto the axis
            axis.annotate(
                f"{row['behind_best_nats']:.0f}", (-reach, i), (-0.92 * reach, i), va="center",
                arrowprops={"arrowstyle": "->", "color": MUTED}, gid="beyond",
            )  # fmt: skip
            continue
        colour = IMPROVED if name == result["best"] else MUTED
        error = 2.0 * (row["behind_best_se"] or 0.0)
        axis.errorbar(row["behind_best_nats"], i, xerr=error, fmt="o", color=colour)
    axis.set_yticks(range(len(rows)), [name for name, _ in rows])
    axis.axvline(0.0, color=INK, linewidth=0.6)
    if behind[-1] > reach:
        axis.set_xlim(-reach, 0.05 * reach)
    axis.set(xlabel="held-out log-likelihood behind the best (nats), ± 2 standard errors", ylim=(-0.6, len(rows) - 0.4))
    return axis
