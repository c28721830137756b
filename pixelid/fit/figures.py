"""Figures of a fit: measured beside simulated per condition, and what is left over."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from pixelid.figures.style import INK, MUTED, OFF, ON, new_axes, save_figure, styled
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.event_times import EventTimesObjective
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


def write_figures(result: Fitted, recordings: Sequence[Recording], folder: Path) -> list[Path]:
    """Write the figures of a fit as SVG into `folder`; returns their paths."""
    if result.observation == "pooled_rate":
        return [save_figure(draw_edges(result, recordings), folder / "edges.svg")]
    return [
        save_figure(draw_conditions(result, recordings), folder / "conditions.svg"),
        save_figure(draw_residuals(result, recordings), folder / "residuals.svg"),
    ]


@styled
def draw_conditions(result: Fitted, recordings: Sequence[Recording], axes: Any = None) -> Any:
    """Event rates over time, measured (filled) and simulated by the fitted model (lines), an axis per recording."""
    from pixelid.simulate import simulate

    shown = [r for r in recordings if len(r.events)] or list(recordings)[:1]
    columns = min(3, len(shown))
    rows = -(-len(shown) // columns)
    if axes is None:
        axes = new_axes(rows, columns, 4.2, 2.3)
    between = result.details.get("stimulus_between_samples", "linear")
    for axis, recording in zip(axes.flat, shown, strict=False):
        stimulus = with_fine_light(recording, between).stimulus
        assert stimulus is not None
        edges = np.linspace(stimulus.start_s, stimulus.end_s, BINS + 1)
        events = recording.events
        active = np.unique(events.pixel)
        pixels = max(len(active), 1)
        light = in_a_row(stimulus, active)
        copy = simulate(result.model, light, width=pixels, height=1, seed=result.seed).events
        for polarity, sign, colour in ((1, 1.0, ON), (0, -1.0, OFF)):
            scale = sign / pixels / np.diff(edges)
            measured = np.histogram(events.t[events.p == polarity] * 1e-9, edges)[0] * scale
            model = np.histogram(copy.t[copy.p == polarity] * 1e-9, edges)[0] * scale
            axis.fill_between(edges[:-1], measured, step="post", color=colour, alpha=0.35, linewidth=0)
            axis.step(edges[:-1], model, where="post", color=colour, linewidth=0.8)
        axis.axhline(0.0, color=INK, linewidth=0.5)
        axis.set(title=recording.name, xlabel="time (s)")
    for axis in axes.flat[len(shown) :]:
        axis.set_axis_off()
    for axis in axes[:, 0]:
        axis.set_ylabel("events per pixel and second")
    return axes


def standardised(result: Fitted, recordings: Sequence[Recording]) -> tuple[EventTimes, np.ndarray, np.ndarray]:
    """(likelihood, residuals, kept): (z − threshold) / σ of every interval, and which are not background events."""
    between = result.details.get("stimulus_between_samples", "linear")
    likelihood = EventTimes([with_fine_light(r, between) for r in recordings if r.stimulus])
    objective = EventTimesObjective(likelihood, result.coordinates)
    terms = likelihood.terms(objective.coordinates.circuit(result.x))
    residual = (terms.z - terms.group_mean[likelihood.group]) / terms.scale
    return likelihood, residual, ~terms.background


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
        (axes.flat[1], np.log10(since), "time since the last event (log10 s)"),
        (axes.flat[2], likelihood.recording_of_event.astype(float), "recording (in the order given)"),
    ):
        for polarity, colour, name in ((1.0, ON, "ON"), (-1.0, OFF, "OFF")):
            chosen = kept & (likelihood.sign == polarity)
            if chosen.sum() < 2:
                continue
            bins = np.linspace(values[chosen].min(), values[chosen].max() + 1e-9, 31)
            index = np.digitize(values[chosen], bins) - 1
            count = np.bincount(index, minlength=30)[:30]
            mean = np.bincount(index, residual[chosen], 30)[:30] / np.maximum(count, 1)
            full = count > 3
            centre = 0.5 * (bins[1:] + bins[:-1])
            axis.errorbar(
                centre[full], mean[full], 2 / np.sqrt(count[full]), fmt=".", color=colour, label=name, linewidth=0.8
            )
        axis.axhline(0.0, color=INK, linewidth=0.5)
        axis.set_xlabel(label)
        axis.set_ylabel("mean residual (σ) ± 2 SE")
    axes.flat[0].legend()
    axis = axes.flat[3]
    grid = np.linspace(-5, 5, 81)
    axis.hist(residual[kept], grid, density=True, color=MUTED, alpha=0.6)
    axis.plot(grid, np.exp(-0.5 * grid**2) / np.sqrt(2 * np.pi), color=INK, linewidth=0.8)
    axis.set(xlabel="residual (standard deviations)", ylabel="density")
    return axes


@styled
def draw_edges(result: Fitted, recordings: Sequence[Recording], axes: Any = None) -> Any:
    """Event rates after rising and falling edges of the stimulus, measured and fitted, averaged over the edges."""
    likelihood = PooledRate(recordings)
    objective = PooledRateObjective(likelihood, result.coordinates)
    expected = objective.expected(result.x)
    if axes is None:
        axes = new_axes(len(recordings), 2, 4.6, 2.4)
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
        for axis, edges, name in (
            (axes[row, 0], stimulus.t[1:][jump > 0], "after the light steps up"),
            (axes[row, 1], stimulus.t[1:][jump < 0], "after the light steps down"),
        ):
            centre = ((edges - counts.edges[0]) / width).astype(int)
            centre = centre[(centre > before) & (centre + after < n)]
            window = np.arange(-before, after)
            time_ms = 1e3 * width * window
            for measured, model, colour, label in (
                (counts.on, model_on, ON, "ON"),
                (counts.off, model_off, OFF, "OFF"),
            ):
                index = centre[:, None] + window
                axis.fill_between(
                    time_ms, measured[index].mean(axis=0), step="post", color=colour, alpha=0.35, label=label
                )
                axis.step(time_ms, model[index].mean(axis=0), where="post", color=colour, linewidth=0.9)
            axis.set_title(f"{recording.name}: {name}")
            axis.set_xlabel("time after the edge, stimulus clock (ms)")
            axis.set_ylabel(f"events per {1e6 * width:.0f} µs")
    axes[0, 0].legend()
    return axes
