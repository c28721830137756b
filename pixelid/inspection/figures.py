"""Figures of an inspection: rate over time, intervals within pixels, events per pixel."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pixelid.figures.style import INK, OFF, ON, SEQUENTIAL, UNEXPLAINED, new_axis, save_figure, styled
from pixelid.inspection.health import Health, Overview

HOT_PIXELS_SHOWN = 100


def write_figures(health: Health, overview: Overview, folder: Path) -> None:
    """Write rate.svg, and for recordings with addresses intervals.svg and pixels.svg, into `folder`."""
    save_figure(draw_rate(health, overview), folder / "rate.svg")
    if not health.pooled:
        save_figure(draw_intervals(health, overview), folder / "intervals.svg")
        save_figure(draw_pixels(health, overview), folder / "pixels.svg")


@styled
def draw_rate(health: Health, overview: Overview, axis: Any = None) -> Any:
    """Events per second over time, by polarity; returns the axis."""
    axis = axis if axis is not None else new_axis(8.0, 3.2)
    edges = overview.edges_s
    for counts, label, colour in ((overview.on, "ON", ON), (overview.off, "OFF", OFF)):
        axis.stairs(counts / np.diff(edges), edges, label=label, color=colour, linewidth=0.9)
    axis.set(xlabel="time since the first event (s)", ylabel="events per second")
    axis.set_title(", ".join(f"line at {line.frequency_hz:.2f} Hz" for line in health.lines[:3]))
    axis.legend()
    return axis


@styled
def draw_intervals(health: Health, overview: Overview, axis: Any = None) -> Any:
    """Histogram of the intervals within pixels, with the dead time or its bound; returns the axis."""
    axis = axis if axis is not None else new_axis(8.0, 3.2)
    intervals = overview.intervals[overview.intervals > 0] * 1e-9
    if len(intervals):
        bins = np.geomspace(intervals.min(), intervals.max() * 1.001, 200)
        axis.hist(intervals, bins, histtype="step", color=INK, linewidth=0.9)
        axis.set(xscale="log", yscale="log")
    dead = health.dead_time
    if dead.value_s is not None:
        label = "dead time" if dead.kind == "measured" else "upper bound of the dead time"
        axis.axvline(dead.value_s, color=UNEXPLAINED, ls="--", label=f"{label}, {dead.value_s:.3g} s")
        axis.legend()
    part = f" (a random {health.intervals_share:.3g} of them)" if health.intervals_share < 1 else ""
    axis.set(xlabel="interval between events of a pixel (s)", ylabel=f"intervals{part}")
    return axis


@styled
def draw_pixels(health: Health, overview: Overview, axis: Any = None) -> Any:
    """Events per pixel as an image, hot pixels ringed; returns the axis."""
    axis = axis if axis is not None else new_axis(6.0, 4.2)
    shown = axis.imshow(np.log10(overview.image + 1), cmap=SEQUENTIAL)
    for pixel in health.hot_pixels[:HOT_PIXELS_SHOWN]:
        axis.plot(pixel.x, pixel.y, "o", mfc="none", mec=ON, mew=1.2, markersize=8)
    axis.figure.colorbar(shown, ax=axis, label="events + 1 (log10)")
    axis.grid(False)
    axis.set(xlabel="column (pixels)", ylabel="row (pixels)")
    return axis
