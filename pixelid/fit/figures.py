"""Figures of a fit: measured and simulated per condition, and what is left over."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from pixelid.figures.style import INK, MUTED, OFF, ON, finish_pair, new_axes, new_pairs, save_figure, styled
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.levels.figures import draw_levels
from pixelid.fit.levels.pixel_levels import PixelLevels
from pixelid.fit.pooled_rate import PooledRateObjective
from pixelid.likelihood.event_times import EventTimes
from pixelid.likelihood.pooled_rate import PooledRate
from pixelid.model.model import Model
from pixelid.recordings.own_light import with_fine_light
from pixelid.recordings.recording import Recording
from pixelid.stimuli.pixel_lights import in_a_row
from pixelid.stimuli.stimulus import Stimulus

BINS = 120


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
    """Event rates over time, measured (filled) and simulated by the fitted model (lines); below, what is left.

    Args:
        result: the fit.
        recordings: what it was fitted to.
        axes: (2 rows, columns), residuals in every second row; new ones by default, a pair per recording.

    Returns:
        The axes.
    """
    from pixelid.simulate import simulate_row

    shown = [r for r in recordings if len(r.events)] or list(recordings)[:1]
    columns = min(3, len(shown))
    rows = -(-len(shown) // columns)
    if axes is None:
        axes = new_pairs(rows, columns, 4.2, 3.4)
    for axis, left, recording in zip(axes[::2].flat, axes[1::2].flat, shown, strict=False):
        stimulus = _as_seen(result, [recording])[0].stimulus
        assert stimulus is not None
        edges = np.linspace(stimulus.start_s, stimulus.end_s, BINS + 1)
        events = recording.events
        active = np.unique(events.pixel)
        pixels = max(len(active), 1)
        light = in_a_row(stimulus, active)
        copy = simulate_row(result.model, light, pixels, seed=result.seed).events
        for polarity, sign, colour in ((1, 1.0, ON), (0, -1.0, OFF)):
            scale = sign / pixels / np.diff(edges)
            measured = np.histogram(events.t[events.p == polarity] * 1e-9, edges)[0]
            model = np.histogram(copy.t[copy.p == polarity] * 1e-9, edges)[0]
            name = "ON" if polarity else "OFF"
            axis.fill_between(
                edges[:-1],
                measured * scale,
                step="post",
                color=colour,
                alpha=0.4,
                linewidth=0,
                label=f"{name}, measured",
            )
            axis.step(edges[:-1], model * scale, where="post", color=colour, linewidth=0.8, label=f"{name}, model")
            some = measured + model > 0
            left.plot(
                0.5 * (edges[1:] + edges[:-1])[some], (measured - model)[some] / np.sqrt(measured + model)[some], ".",
                color=colour, markersize=3,
            )  # fmt: skip
        axis.axhline(0.0, color=INK, linewidth=0.5)
        axis.set_title(recording.name)
        left.set_xlabel("time (s)")
        finish_pair(axis, left)
    for axis in (*axes[::2].flat[len(shown) :], *axes[1::2].flat[len(shown) :]):
        axis.set_axis_off()
    for top, bottom in zip(axes[::2, 0], axes[1::2, 0], strict=True):
        top.set_ylabel("events per\npixel and second")
        bottom.set_ylabel("difference (σ)")
    axes[0, 0].legend(ncols=2, fontsize=7)
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
    """Residual levels against time in the recording, time since the last event, and their distribution."""
    likelihood, residual, kept = standardised(result, recordings)
    since = np.concatenate([iv.time_s - iv.previous_s for iv in likelihood.intervals])
    if axes is None:
        axes = new_axes(2, 2, 4.6, 2.8)
    stretch = np.concatenate(
        [
            (iv.time_s - r.stimulus.start_s) / max(r.stimulus.duration_s, 1e-12)
            for iv, r in zip(likelihood.intervals, likelihood.recordings, strict=True)
            if r.stimulus is not None
        ]
    )
    for axis, values, label in (
        (axes.flat[0], stretch, "time in the recording (0 start, 1 end)"),
        (axes.flat[1], since, "time since the pixel's last event (s)"),
        (axes.flat[2], likelihood.recording_of_event + 1.0, "recording (in the order given)"),
    ):
        for polarity, colour, name in ((1.0, ON, "ON"), (-1.0, OFF, "OFF")):
            chosen = kept & (likelihood.sign == polarity)
            if chosen.sum() < 2:
                continue
            low, high = values[chosen].min(), values[chosen].max()
            if values is since:
                low = max(low, 1e-9)  # two events of one timestamp
                bins = np.geomspace(low, 1.001 * max(high, low), 31)
            else:
                bins = np.linspace(low, high + 1e-9, 31)
            index = np.digitize(values[chosen], bins) - 1
            count = np.bincount(index, minlength=30)[:30]
            mean = np.bincount(index, residual[chosen], 30)[:30] / np.maximum(count, 1)
            full = count > 3
            if not full.any():
                continue
            centre = np.sqrt(bins[1:] * bins[:-1]) if values is since else 0.5 * (bins[1:] + bins[:-1])
            axis.errorbar(
                centre[full], mean[full], 2 / np.sqrt(count[full]), fmt=".", color=colour, label=name, linewidth=0.8
            )
        axis.axhline(0.0, color=INK, linewidth=0.5)
        axis.set_xlabel(label)
        axis.set_ylabel("mean residual (standard deviations)")
    if axes.flat[1].containers:  # a logarithmic axis needs data
        axes.flat[1].set_xscale("log")
    axes.flat[2].xaxis.get_major_locator().set_params(integer=True)
    if axes.flat[0].containers:
        axes.flat[0].legend()
    axis = axes.flat[3]
    grid = np.linspace(-5, 5, 81)
    axis.hist(residual[kept], grid, density=True, color=MUTED, alpha=0.6)
    axis.plot(grid, np.exp(-0.5 * grid**2) / np.sqrt(2 * np.pi), color=INK, linewidth=0.8)
    axis.set(xlabel="residual (standard deviations)", ylabel="density, standard normal as a line")
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
    axes[0, 0].legend()
    return axes
