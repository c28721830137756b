"""Figures of rate tables: measured and fitted over frequency, and what is left."""

from __future__ import annotations

from typing import Any

import numpy as np

from pixelid.figures.style import INK, MUTED, legend_above, new_axes, series_colours, styled
from pixelid.tables.fit import SUSPECT_SCALES
from pixelid.tables.rates.pixel import PixelFit
from pixelid.tables.rates.pool import PoolFit


@styled
def draw_pixel(fit: PixelFit, axes: Any = None) -> Any:
    """Rates of every setting over frequency with the fit, residuals below; returns the two axes."""
    if axes is None:
        axes = new_axes(2, 1, 8.0, 3.4, sharex=True, height_ratios=(2, 1))[:, 0]
    top, bottom = axes
    frequency = np.geomspace(fit.table.frequency_hz.min(), fit.table.frequency_hz.max(), 300)
    floor = 0.3 * fit.table.resolution_hz
    reach = 12.0  # standard deviations; what is further out is an arrow with its value
    for k, (name, colour) in enumerate(zip(fit.table.columns, series_colours(len(fit.table.columns)), strict=True)):
        here = fit.column == k
        x = fit.table.frequency_hz[fit.row[here]]
        top.loglog(x, np.maximum(fit.observed[here], floor), "o", color=colour, label=name)
        top.loglog(frequency, np.maximum(fit.curve(k, frequency), floor), color=colour)
        residual = fit.regression.residual[here]
        far = np.abs(residual) > reach
        bottom.semilogx(x[~far], residual[~far], "o", color=colour)
        for at, value in zip(x[far], residual[far], strict=True):
            bottom.plot(at, np.sign(value) * reach, "^" if value > 0 else "v", color=colour)
            bottom.annotate(f" {value:+.0f}", (at, np.sign(value) * reach), va="center", fontsize=8)
    top.set_ylabel("events per second")
    top.set_xlim(bottom.get_xlim())
    legend_above(axes, 5, "setting")
    bottom.axhspan(-SUSPECT_SCALES, SUSPECT_SCALES, color=MUTED, alpha=0.15, linewidth=0)
    bottom.axhline(0.0, color=INK, linewidth=0.6)
    bottom.set(xlabel="frequency of the light (Hz)", ylabel="residual (σ)", ylim=(-reach - 1, reach + 1))
    return axes


@styled
def draw_pool(fit: PoolFit, alike: PoolFit, axes: Any = None) -> Any:
    """Events per cycle of every condition with the fit, and relative residuals of both; returns the two axes."""
    if axes is None:
        axes = new_axes(2, 1, 8.0, 3.4, sharex=True, height_ratios=(2, 1))[:, 0]
    top, bottom = axes
    count = len(fit.table.conditions)
    for k, colour in enumerate(series_colours(count)):
        here = fit.column == k
        x, y = fit.table.frequency_hz[fit.row[here]], fit.table.per_cycle[fit.row[here], k]
        top.loglog(x, y, "o", markersize=3, color=colour)
        top.loglog(x, fit.regression.predicted[here], color=colour, linewidth=0.8)
        bottom.semilogx(x, y / fit.regression.predicted[here] - 1, "o", markersize=3, color=colour)
        bottom.semilogx(x, y / alike.regression.predicted[here] - 1, "x", markersize=3, color=MUTED, zorder=0)
    top.set_ylabel("events per cycle")
    bottom.axhline(0.0, color=INK, linewidth=0.6)
    bottom.set(xlabel="frequency of the light (Hz)", ylabel="measured / fit − 1", ylim=(-1, 2))
    return axes
