"""The figures of noise: rates against light with the circuit's curves and their ratio, and intervals between events."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pixelid.figures.style import INK, MUTED, OFF, ON, legend_above, new_axes, styled
from pixelid.tables.noise.model import NoiseModel


@styled
def draw_noise(model: NoiseModel, rows: Sequence[dict[str, Any]], axes: Any = None) -> Any:
    """Measured and predicted rates over light, and measured over predicted below; returns the two axes."""
    if axes is None:
        axes = new_axes(2, 1, 7.0, 3.2, sharex=True, height_ratios=(2, 1))[:, 0]
    top, bottom = axes
    table = model.table
    measured = np.array([row["measured"] for row in rows])
    predicted = np.array([row["predicted"] for row in rows])
    aside = 1.04  # by which OFF stands right of ON, which it would hide
    dense = 12  # lights from which a line through what is predicted is drawn
    reach = 2.0  # of ratios; what is further out is an arrow
    for on, colour, name in ((True, ON, "ON"), (False, OFF, "OFF")):
        for group in sorted(set(table.group.tolist())):
            here = np.flatnonzero((table.on == on) & (table.group == group))
            here = here[np.argsort(table.light[here])]
            if not len(here):
                continue
            label = name if group == 0 else None
            marker = "os^D"[group % 4]
            least = np.maximum(measured[here], table.last_digit[here])
            top.loglog(table.light[here], least, marker, color=colour, ms=4, label=label)
            # between few lights a straight line would not be the circuit's
            line = {} if len(here) >= dense else {"marker": "_", "linestyle": "none", "markersize": 14, "mew": 1.5}
            top.loglog(table.light[here], predicted[here], color=colour, **line)
            shown = here[measured[here] > 0]
            ratio, light = measured[shown] / predicted[shown], table.light[shown] * (1.0 if on else aside)
            far = ratio > reach
            bottom.semilogx(light[~far], ratio[~far], marker, color=colour, ms=4)
            bottom.semilogx(light[far], np.full(far.sum(), reach - 0.08), "^", color=colour, ms=6)
    bottom.axhspan(0.85, 1.15, color=MUTED, alpha=0.15, linewidth=0)
    bottom.axhline(1.0, color=INK, linewidth=0.6)
    top.set_ylabel("events per pixel and second")
    legend_above(axes)
    bottom.set(xlabel=f"light ({table.unit})", ylabel="measured / predicted", ylim=(0.0, reach))
    return axes


@styled
def draw_intervals(entries: Sequence[dict[str, Any]], unit: str, axes: Any = None) -> Any:
    """Histograms of intervals between events, measured and predicted, one light below the other; returns the axes."""
    predicted = [entry for entry in entries if entry["distance"] is not None]
    shown = sorted(predicted or entries[:1], key=lambda entry: entry["radiance"])
    if axes is None:
        axes = new_axes(len(shown), 1, 7.0, 1.6, sharex=True)[:, 0]
    for ax, entry in zip(axes, shown, strict=True):
        histogram = entry["histogram"]
        if histogram["edges_s"]:
            ax.stairs(histogram["measured"], histogram["edges_s"], color=MUTED, fill=True, alpha=0.4, label="measured")
            if histogram["predicted"] is not None:
                ax.stairs(histogram["predicted"], histogram["edges_s"], color=INK, linewidth=1.2, label="predicted")
        ax.set(xscale="log", ylabel="share", title=f"{entry['radiance']:.3g} {unit}, {entry['count']} intervals")
    legend_above(axes)
    axes[-1].set_xlabel("interval between events of a pixel (s)")
    return axes
