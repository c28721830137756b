"""Figures of an inspection: rate over time, intervals within pixels, events per pixel; conditions of still scenes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d

from pixelid.arrays import save_arrays
from pixelid.figures.style import (
    INK,
    MUTED,
    OFF,
    ON,
    SEQUENTIAL,
    UNEXPLAINED,
    legend_above,
    new_axes,
    new_axis,
    save_figure,
    styled,
)
from pixelid.figures.words import seconds
from pixelid.inspection.health import Health, Overview
from pixelid.inspection.static_noise_result import StaticNoise

PREVIEW = "preview.npz"  # t [ns], x, y, p of consecutive events
HOT_PIXELS_SHOWN = 100
SMOOTH = 2.8  # bins of time
WIDE = 20.0  # ratio of counts from which a map of them takes logarithms


def write_figures(health: Health, folder: Path) -> None:
    """Write rate.svg, and of recordings with addresses intervals.svg, pixels.svg and preview.npz, into `folder`."""
    overview = health.overview
    if overview is None:
        return
    save_figure(draw_rate(health, overview), folder / "rate.svg")
    if not health.pooled:
        save_figure(draw_intervals(health, overview), folder / "intervals.svg")
        save_figure(draw_pixels(health, overview), folder / "pixels.svg")
        save_arrays(folder / PREVIEW, overview.preview)


@styled
def draw_rate(health: Health, overview: Overview, axis: Any = None) -> Any:
    """Events per second over time, ON up and OFF down; returns the axis."""
    axis = axis if axis is not None else new_axis(8.0, 3.2)
    edges = overview.edges_s
    for counts, label, colour, sign in ((overview.on, "ON", ON, 1.0), (overview.off, "OFF", OFF, -1.0)):
        # bins alone beat with a periodic light
        rate = gaussian_filter1d(np.asarray(counts, dtype=float), SMOOTH, mode="nearest") / np.diff(edges)
        middle = 0.5 * (edges[1:] + edges[:-1])
        axis.fill_between(middle, sign * rate, label=label, color=colour, alpha=0.7, linewidth=0)
    axis.axhline(0.0, color=INK, linewidth=0.5)
    axis.set(xlabel="time since the first event (s)", ylabel="events per second, OFF downwards")
    axis.yaxis.set_major_formatter(lambda rate, _: _prefixed(abs(rate)))
    axis.set_title(", ".join(f"line at {line.frequency_hz:.2f} Hz" for line in health.lines[:3]))
    legend_above(axis)
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
    bound = dead.kind == "upper_bound" and dead.interval_95_s is not None
    at = dead.interval_95_s[1] if bound and dead.interval_95_s else dead.value_s
    if at is not None:
        label = f"dead time ≤ {seconds(at)}" if bound else f"dead time {seconds(at)}"
        axis.axvline(at, color=UNEXPLAINED, ls="--", label=label)
        axis.legend()
    part = f" (a random {health.intervals_share:.3g} of them)" if health.intervals_share < 1 else ""
    axis.set(xlabel="interval between events of a pixel (s)", ylabel=f"number of intervals{part}")
    return axis


@styled
def draw_pixels(health: Health, overview: Overview, axis: Any = None) -> Any:
    """Events per pixel as an image, hot pixels ringed; returns the axis."""
    axis = axis if axis is not None else new_axis(6.0, 4.2)
    least, most = float(overview.image.min()), float(overview.image.max())
    wide = most > WIDE * (least + 1.0)  # then as logarithms, zero a step below one
    # from zero: a small spread is to look small
    shown = axis.imshow(np.log10(overview.image + 1.0) if wide else overview.image, cmap=SEQUENTIAL, vmin=0.0)
    for pixel in health.hot_pixels[:HOT_PIXELS_SHOWN]:
        axis.plot(pixel.x, pixel.y, "o", mfc="none", mec=UNEXPLAINED, mew=1.2, markersize=8)
    rows, columns = overview.image.shape
    high = 0.047 * min(rows / columns, 1.0)  # of the axis' width: as high as the image
    bar = axis.figure.colorbar(shown, ax=axis, label="events of the pixel", fraction=high, pad=0.03)
    if wide:
        ticks = [0, *(n for k in range(9) for n in (10**k, 3 * 10**k))]
        ticks = [n for n in ticks if least <= n <= most]
        bar.set_ticks(list(np.log10(np.add(ticks, 1.0))), labels=[f"{n:g}" for n in ticks])
    for one in (axis.xaxis, axis.yaxis):
        one.get_major_locator().set_params(integer=True)
    axis.grid(False)
    axis.set(xlabel="column (pixels)", ylabel="row (pixels)")
    return axis


@styled
def draw_static_noise(noise: StaticNoise, axes: Any = None) -> Any:
    """Rate of the median pixel and regularity of its intervals over light, by polarity; returns the two axes."""
    if axes is None:
        axes = new_axes(1, 2, 4.4, 3.0)
    rate, regularity = np.ravel(axes)
    for polarity, colour, mark in (("ON", ON, "^"), ("OFF", OFF, "v")):
        here = sorted((c for c in noise.conditions if c.polarity == polarity), key=lambda c: c.lux)
        for axis, values in ((rate, [c.rate_hz for c in here]), (regularity, [c.cv for c in here])):
            known = [(c.lux, *v) for c, v in zip(here, values, strict=True) if v is not None]
            if known:
                lux, value, low, high = np.array(known).T
                ends = np.maximum([value - low, high - value], 0.0)
                axis.errorbar(lux, value, ends, fmt=mark, color=colour, label=polarity, linewidth=1.0)
        limits = [(c.lux, c.second_event_hz) for c in here if c.rate_hz is None and c.second_event_hz]
        if limits:
            lux, bound = np.array(limits).T
            rate.plot(lux, bound, "_", color=colour, markersize=9, label=f"{polarity}, below (95 %)")
            rate.vlines(lux, bound / 2.0, bound, color=colour, linewidth=1.0, linestyles=":")
    rate.set(xscale="log", yscale="log", xlabel="light (lux)", ylabel="events per second, median pixel")
    regularity.axhline(1.0, color=MUTED, linewidth=0.8, linestyle="--")
    regularity.set(xscale="log", ylim=(0.0, 1.15), xlabel="light (lux)", ylabel="coefficient of variation of intervals")
    legend_above(axes)
    return axes


def _prefixed(rate: float) -> str:
    """A rate at a tick, in thousands or millions where it has so many.

    >>> _prefixed(0.0), _prefixed(500.0), _prefixed(2e4), _prefixed(1.5e7)
    ('0', '500', '20 k', '15 M')
    """
    scale, letter = next((pair for pair in ((1e6, " M"), (1e3, " k")) if rate >= pair[0]), (1.0, ""))
    return f"{rate / scale:g}{letter}"
