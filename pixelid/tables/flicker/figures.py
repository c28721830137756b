"""Figures of a flicker fit: phase histograms beside the fit, and maps of amplitude and phase."""

from __future__ import annotations

from typing import Any

import numpy as np

from pixelid.figures.style import OFF, ON, new_axes, styled
from pixelid.tables.flicker.fit import FlickerFit
from pixelid.tables.flicker.phases import BINS

SHOWN = 9


@styled
def draw_phases(fit: FlickerFit, axes: Any = None) -> Any:
    """Events by phase of the groups with most events, ON up and OFF down, with the fit; returns the axes."""
    shown = sorted(fit.groups, key=lambda g: -g.table.events)[:SHOWN]
    columns = min(3, len(shown))
    if axes is None:
        axes = new_axes(-(-len(shown) // columns), columns, 3.2, 2.3, sharex=True)
    phase = (np.arange(BINS) + 0.5) / BINS
    for axis, g in zip(axes.flat, shown, strict=False):
        for counts, expected, colour, side in (
            (g.table.on.sum(0), g.fit.expected[0], ON, 1),
            (g.table.off.sum(0), g.fit.expected[1], OFF, -1),
        ):
            axis.bar(phase, side * counts, 1 / BINS, color=colour, alpha=0.4)
            axis.plot(phase, side * expected, color=colour)
        axis.set_title(f"group {g.column}, {g.row}: {g.table.events} events")
    for axis in axes.flat[len(shown) :]:
        axis.set_axis_off()
    for axis in axes[-1]:
        axis.set_xlabel("phase of the light (cycles)")
    for axis in axes[:, 0]:
        axis.set_ylabel("events per bin")
    return axes


@styled
def draw_maps(fit: FlickerFit, axes: Any = None) -> Any:
    """Amplitude over the ON threshold, and phase, group by group; returns the two axes."""
    if axes is None:
        axes = new_axes(1, 2, 4.4, 3.4)
    for axis, name, label, colours in (
        (axes.flat[0], "amplitude_over_on_threshold", "amplitude (ON thresholds)", "viridis"),
        (axes.flat[1], "phase_cycles", "phase (cycles)", "twilight"),
    ):
        values = np.full(fit.grid[::-1], np.nan)
        for g in fit.groups:
            values[g.row, g.column] = g.fit.values[name]
        axis.figure.colorbar(axis.imshow(values, cmap=colours), ax=axis, label=label)
        axis.set(xlabel="group, across", ylabel="group, down")
        axis.grid(False)
    return axes
