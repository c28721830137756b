"""Figures of a sensor fit: each map before and after shrinkage."""

from __future__ import annotations

from typing import Any

import numpy as np

from pixelid.figures.style import INK, MUTED, SEQUENTIAL, legend_above, new_axes, styled
from pixelid.figures.words import with_unit
from pixelid.sensors.map import Map


@styled
def draw_map(m: Map, axes: Any = None) -> Any:
    """A map before and after shrinkage on one colour scale, its error, and the distributions; returns the four axes."""
    if axes is None:
        axes = new_axes(2, 2, 4.3, 3.2).ravel()
    raw = np.exp(m.raw)
    seen = raw[np.isfinite(raw)]
    low, high = np.percentile(seen if len(seen) else m.value, [2, 98])
    for axis, values, title in (
        (axes[0], raw, "each pixel alone"),
        (axes[1], m.value, "shrunk towards the population"),
    ):
        image = axis.imshow(values, vmin=low, vmax=high, cmap=SEQUENTIAL)
        axis.grid(False)
        axis.set(title=title, xlabel="column (pixels)", ylabel="row (pixels)")
        for side in (axis.xaxis, axis.yaxis):
            side.get_major_locator().set_params(integer=True)
    axes[1].figure.colorbar(image, ax=list(axes[:2]), label=with_unit(m.name, m.unit))
    error = axes[2].imshow(100.0 * m.sd, vmin=0.0, cmap=SEQUENTIAL)
    axes[2].set(title="error of the shrunk map", xlabel="column (pixels)", ylabel="row (pixels)")
    axes[2].grid(False)
    for side in (axes[2].xaxis, axes[2].yaxis):
        side.get_major_locator().set_params(integer=True)
    axes[2].figure.colorbar(error, ax=axes[2], label="standard error (%)")
    bins = int(np.clip(2 * np.sqrt(m.value.size), 8, 50))
    edges = np.linspace(low - 0.3 * (high - low), high + 0.3 * (high - low) + 1e-12, bins + 1)
    axes[3].hist(seen, edges, color=MUTED, alpha=0.6, label="each pixel alone")
    axes[3].hist(m.value.ravel(), edges, histtype="step", color=INK, linewidth=1.2, label="shrunk")
    axes[3].set(xlabel=with_unit(m.name, m.unit), ylabel="pixels")
    axes[3].locator_params(axis="x", nbins=5)
    axes[3].yaxis.get_major_locator().set_params(integer=True)
    legend_above(axes)
    return axes
