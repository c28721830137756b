"""Figures of a fit: measured and simulated per condition, and what is left over."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from pixelid.figures.style import OFF, ON, finish_pair, legend_above, new_axes, new_pairs, save_figure, styled
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.levels.figures import draw_levels
from pixelid.fit.levels.pixel_levels import PixelLevels
from pixelid.fit.panels import (
    draw_by_interval,
    draw_by_recording,
    draw_by_time,
    draw_difference,
    draw_distribution,
    draw_light,
    draw_rates,
    light_of,
    simulated,
)
from pixelid.fit.pooled_rate import PooledRateObjective
from pixelid.likelihood.event_times import EventTimes
from pixelid.likelihood.pooled_rate import PooledRate
from pixelid.model.model import Model
from pixelid.recordings.own_light import with_fine_light
from pixelid.recordings.recording import Recording
from pixelid.stimuli.stimulus import Stimulus


class Fitted(Protocol):
    """What figures need of a fit's result."""

    @property
    def observation(self) -> str: ...
    @property
    def coordinates(self) -> Coordinates: ...
    @property
    def x(self) -> np.ndarray: ...
    @property
    def model(self) -> Model: ...
    @property
    def seed(self) -> int: ...
    @property
    def details(self) -> Mapping: ...
    @property
    def pixel_levels(self) -> PixelLevels | None: ...


def write_figures(result: Fitted, recordings: Sequence[Recording], folder: Path) -> list[Path]:
    """Write the figures of a fit as SVG into `folder`; returns their paths."""
    if result.observation == "pooled_rate":
        return [save_figure(draw_edges(result, recordings), folder / "edges.svg")]
    drawn = [
        save_figure(draw_conditions(result, recordings), folder / "conditions.svg"),
        save_figure(draw_residuals(result, recordings), folder / "residuals.svg"),
    ]
    if result.pixel_levels is not None:
        drawn.append(save_figure(draw_levels(result.pixel_levels), folder / "levels.svg"))
    return drawn


@styled
def draw_conditions(result: Fitted, recordings: Sequence[Recording], axes: Any = None) -> Any:
    """The light, event rates measured (filled) and simulated by the fitted model (lines), and what is left.

    Args:
        result: the fit.
        recordings: what it was fitted to.
        axes: (3 rows, columns): light, rates and differences below each other; new ones by default.

    Returns:
        The axes.
    """
    shown = [r for r in recordings if len(r.events)] or list(recordings)[:1]
    most_columns = 2  # side by side: more would be too narrow to read
    columns = min(most_columns, len(shown))
    rows = -(-len(shown) // columns)
    if axes is None:
        axes = new_axes(3 * rows, columns, 4.2, 1.5, height_ratios=(1.0, 2.4, 1.1) * rows)
    between = result.details.get("stimulus_between_samples", "linear")
    for k, recording in enumerate(shown):
        light_axis, axis, left = axes[3 * (k // columns) : 3 * (k // columns) + 3, k % columns]
        seen = _as_seen(result, [recording])[0]
        light, pixels = light_of(seen, between), max(len(np.unique(seen.events.pixel)), 1)
        copy = simulated(result.model, seen, light, result.seed, pixels) if len(seen.events) else None
        draw_light(light_axis, seen)
        draw_rates(axis, seen, light, {} if copy is None else {"model": (copy, pixels, None, "-")})
        if copy is not None:
            draw_difference(left, seen, light, copy, pixels)
        light_axis.set_title(recording.name)
        left.set_xlabel("time (s)")
        finish_pair(axis, left)
        light_axis.set_xlim(axis.get_xlim())
    for k in range(len(shown), rows * columns):
        for axis in axes[3 * (k // columns) : 3 * (k // columns) + 3, k % columns]:
            axis.set_axis_off()
    legend_above(axes)
    return axes


def standardised(result: Fitted, recordings: Sequence[Recording]) -> tuple[EventTimes, np.ndarray, np.ndarray]:
    """(likelihood, residuals, kept): (z − threshold) / σ of every interval, and which are not background events."""
    likelihood = EventTimes(_as_seen(result, [r for r in recordings if r.stimulus]))
    objective = EventTimesObjective(likelihood, result.coordinates)
    terms = objective.terms(result.x)
    residual = (terms.z - terms.group_mean[likelihood.group]) / terms.scale
    return likelihood, residual, ~terms.background & ~terms.at_once


def _as_seen(result: Fitted, recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings with the light that the fit read, of pixels with levels of their own as each saw it."""
    between = result.details.get("stimulus_between_samples", "linear")
    finer = [with_fine_light(recording, between) for recording in recordings]
    return finer if result.pixel_levels is None else result.pixel_levels.seen(finer)


@styled
def draw_residuals(result: Fitted, recordings: Sequence[Recording], axes: Any = None) -> Any:
    """Residual levels against the time since the last event, time and recording, on one scale; their distribution."""
    likelihood, residual, kept = standardised(result, recordings)
    if axes is None:
        axes = new_axes(2, 2, 4.3, 2.6)
    for axis, draw, label in (
        (axes.flat[0], draw_by_interval, "time since the pixel's previous event (s)"),
        (axes.flat[1], draw_by_time, "time in the recording (0 start, 1 end)"),
        (axes.flat[2], draw_by_recording, "recording"),
    ):
        draw(axis, likelihood, residual, kept)
        axis.set(xlabel=label, ylabel="mean residual (σ)")
    reach = max(1.0, *(abs(end) for axis in axes.flat[:3] for end in axis.get_ylim()))
    for axis in axes.flat[:3]:
        axis.set_ylim(-reach, reach)
    draw_distribution(axes.flat[3], residual[kept])
    axes.flat[3].set_xlabel("residual (σ)")
    legend_above(axes)
    return axes


@styled
def draw_edges(result: Fitted, recordings: Sequence[Recording], axes: Any = None) -> Any:
    """Events after rising and falling edges of the light, averaged over edges, measured and fitted; what is left below.

    Args:
        result: a fit of pooled recordings.
        recordings: what it was fitted to.
        axes: (2 recordings, 2), residuals in every second row; new ones by default.

    Returns:
        The axes.
    """
    likelihood = PooledRate(recordings)
    objective = PooledRateObjective(likelihood, result.coordinates)
    expected = objective.expected(result.x)
    if axes is None:
        axes = new_pairs(len(recordings), 2, 4.6, 3.4)
    spread = max(float(result.details.get("dispersion", 1.0)), 1.0)  # of counts, over Poisson's
    at = 0
    for row, (recording, counts) in enumerate(zip(recordings, likelihood.counts, strict=True)):
        n = len(counts.on)
        model_on, model_off = expected[at : at + n], expected[at + n : at + 2 * n]
        at += 2 * n
        stimulus = recording.stimulus
        assert isinstance(stimulus, Stimulus)
        jump = np.diff(stimulus.radiance)
        width = counts.edges[1] - counts.edges[0]
        before, after = int(0.5e-3 / width), int(3e-3 / width)
        for column, edges, name in (
            (0, stimulus.t[1:][jump > 0], "after the light steps up"),
            (1, stimulus.t[1:][jump < 0], "after the light steps down"),
        ):
            axis, left = axes[2 * row : 2 * row + 2, column]
            centre = ((edges - counts.edges[0]) / width).astype(int)
            centre = centre[(centre > before) & (centre + after < n)]
            window = np.arange(-before, after)
            time_ms = 1e3 * width * window
            for measured, model, colour, label in (
                (counts.on, model_on, ON, "ON"),
                (counts.off, model_off, OFF, "OFF"),
            ):
                index = centre[:, None] + window
                seen, mu = measured[index].sum(axis=0), model[index].sum(axis=0)
                many = max(len(index), 1)
                axis.fill_between(
                    time_ms, seen / many, step="post", color=colour, alpha=0.4, linewidth=0, label=f"{label}, measured"
                )
                axis.step(time_ms, mu / many, where="post", color=colour, linewidth=0.9, label=f"{label}, model")
                left.plot(time_ms, (seen - mu) / np.sqrt(spread * np.maximum(mu, 1.0)), ".", color=colour, markersize=3)
            axis.set_title(f"{recording.name}: {name}")
            left.set_xlabel("time after the edge, stimulus clock (ms)")
            axis.set_ylabel(f"events per {1e6 * width:.0f} µs")
            left.set_ylabel("difference (σ)")
            finish_pair(axis, left)
    legend_above(axes)
    return axes
