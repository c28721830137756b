"""Figures of a flicker fit: phase histograms and the fit, and maps of amplitude and phase."""

from __future__ import annotations

from typing import Any

import numpy as np

from pixelid.figures.style import (
    CYCLIC,
    INK,
    OFF,
    ON,
    SEQUENTIAL,
    finish_pair,
    legend_above,
    new_axes,
    new_pairs,
    styled,
)
from pixelid.tables.flicker.fit import FlickerFit
from pixelid.tables.flicker.phases import BINS

SHOWN = 9


@styled
def draw_phases(fit: FlickerFit, axes: Any = None) -> Any:
    """Events by phase of the groups with most events, ON up and OFF down, with the fit; what is left below.

    Args:
        fit: of a flickering light.
        axes: (2 rows, columns), residuals in every second row; new ones by default, a pair per group.

    Returns:
        The axes.
    """
    shown = sorted(fit.groups, key=lambda g: -g.table.events)[:SHOWN]
    columns = min(3, len(shown))
    if axes is None:
        axes = new_pairs(-(-len(shown) // columns), columns, 3.2, 3.2)
    phase = (np.arange(BINS) + 0.5) / BINS
    for axis, left, g in zip(axes[::2].flat, axes[1::2].flat, shown, strict=False):
        for counts, expected, colour, side, name in (
            (g.table.on.sum(0), g.fit.expected[0], ON, 1, "ON"),
            (g.table.off.sum(0), g.fit.expected[1], OFF, -1, "OFF"),
        ):
            axis.bar(phase, side * counts, 1 / BINS, color=colour, alpha=0.4, label=f"{name}, measured")
            axis.plot(phase, side * expected, color=colour, label=f"{name}, fitted")
            chance = np.sqrt(max(g.fit.dispersion, 1.0) * np.maximum(expected, 1.0))
            left.plot(phase, (counts - expected) / chance, ".", color=colour, markersize=4)
        axis.axhline(0.0, color=INK, linewidth=0.5)
        axis.set_title(f"group {g.column}, {g.row}: {g.table.events} events")
        left.set_xlabel("phase of the light (cycles)")
        finish_pair(axis, left)
    for axis in (*axes[::2].flat[len(shown) :], *axes[1::2].flat[len(shown) :]):
        axis.set_axis_off()
    for top, bottom in zip(axes[::2, 0], axes[1::2, 0], strict=True):
        top.set_ylabel("events per bin")
        bottom.set_ylabel("difference (σ)")
    legend_above(axes)
    return axes


@styled
def draw_maps(fit: FlickerFit, axes: Any = None) -> Any:
    """Amplitude over the ON threshold, and phase, group by group; returns the two axes."""
    if axes is None:
        axes = new_axes(1, 2, 4.4, 3.4)
    for axis, name, label, colours, ends in (
        (axes.flat[0], "amplitude_over_on_threshold", "amplitude (ON thresholds)", SEQUENTIAL, (0.0, None)),
        (axes.flat[1], "phase_cycles", "phase (cycles)", CYCLIC, (0.0, 1.0)),
    ):
        values = np.full(fit.grid[::-1], np.nan)
        for g in fit.groups:
            values[g.row, g.column] = g.fit.values[name] % 1.0 if name == "phase_cycles" else g.fit.values[name]
        axis.figure.colorbar(axis.imshow(values, cmap=colours, vmin=ends[0], vmax=ends[1]), ax=axis, label=label)
        axis.set(xlabel="group, across", ylabel="group, down")
        for side in (axis.xaxis, axis.yaxis):
            side.get_major_locator().set_params(integer=True, min_n_ticks=1)
        axis.grid(False)
    return axes
