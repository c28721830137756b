"""The figure of a law: rows, law with its 95 % band, and residuals below."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pixelid.biases.saved import Quantity
from pixelid.figures.style import INK, MUTED, legend_above, new_axes, series_colours, styled
from pixelid.figures.words import with_unit
from pixelid.tables.fit import SUSPECT_SCALES

MARGIN = 0.1  # of the measured range, drawn beyond it


@styled
def draw_law(name: str, entry: Mapping[str, Any], quantity: Quantity | None, axes: Any = None) -> Any:
    """Rows over the first code, one colour per level of the second, with the law's band; returns the two axes.

    Args:
        name: of the quantity.
        entry: of biases.json.
        quantity: its laws; None for a prediction, whose rows have their own intervals.
        axes: two, of a new figure by default.
    """
    top, bottom = new_axes(2, 1, 7.0, 2.8, sharex=True, height_ratios=(2, 1))[:, 0] if axes is None else axes
    rows = [row for row in entry["rows"] if row["measured"] is not None and row["predicted"] is not None]
    codes = [
        key for key in rows[0] if key not in ("measured", "predicted", "standardised", "interval_95", "extrapolated")
    ]
    level = np.array([row[codes[1]] if len(codes) > 1 else 0.0 for row in rows])
    x, y, fit, z = (np.array([row[key] for row in rows], float) for key in
                    (codes[0], "measured", "predicted", "standardised"))  # fmt: skip
    levels = np.unique(level)
    points = 200
    most_residual = 12.0  # scales
    for one, colour in zip(levels, series_colours(len(levels)), strict=True):
        mine = level == one
        label = f"{codes[1]} {one:g}" if len(codes) > 1 else None
        top.plot(x[mine], y[mine], "o", markersize=3, color=colour, label=label)
        for marker, some in (("o", abs(z) <= most_residual), ("^", z > most_residual), ("v", z < -most_residual)):
            shown = np.clip(z[mine & some], -most_residual, most_residual)
            bottom.plot(x[mine & some], shown, marker, markersize=3, color=colour)
        if quantity is None:
            ends = np.array([row["interval_95"] for row in rows], float)[mine]
            middle = fit[mine]
            top.errorbar(x[mine], middle, np.abs(ends.T - middle), fmt="_", color=colour, elinewidth=0.8)
        else:
            reach = MARGIN * np.ptp(x)
            fine = np.linspace(x.min() - reach, x.max() + reach, points)
            at = quantity.predict(np.column_stack([fine, np.full(points, one)][: len(codes)]))
            top.plot(fine, at["value"], color=colour, linewidth=0.8)
            top.fill_between(fine, at["low"], at["high"], color=colour, alpha=0.2, linewidth=0)
    if len(codes) > 1:
        legend_above((top, bottom))
    if y.max() > 5.0 * y.min():
        top.set_yscale("log")
    top.set_ylabel(with_unit(name, entry["unit"]))
    top.set_ylim(0.7 * y.min(), 1.4 * y.max())
    bottom.axhspan(-SUSPECT_SCALES, SUSPECT_SCALES, color=MUTED, alpha=0.15, linewidth=0)
    bottom.axhline(0.0, color=INK, linewidth=0.6)
    bottom.set(xlabel=codes[0], ylabel="residual (σ)", ylim=(-most_residual - 1.0, most_residual + 1.0))
    return top, bottom
