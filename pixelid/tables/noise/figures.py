"""The figure of noise rates: against light with the circuit's curves, and their ratio."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pixelid.figures.style import INK, MUTED, OFF, ON, new_axes, styled
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
            top.loglog(table.light[here], predicted[here], color=colour)
            shown = here[measured[here] > 0]
            bottom.semilogx(table.light[shown], measured[shown] / predicted[shown], marker, color=colour, ms=4)
    bottom.axhspan(0.85, 1.15, color=MUTED, alpha=0.15, linewidth=0)
    bottom.axhline(1.0, color=INK, linewidth=0.6)
    top.set_ylabel("events per pixel and second")
    top.legend()
    bottom.set(xlabel=f"light ({table.unit})", ylabel="measured / predicted", ylim=(0.0, 2.0))
    return axes
