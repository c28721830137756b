"""Figures of a calibration: each recording with light and alignment, residuals before and after, and the map."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d

from pixelid.bench.result import Calibration
from pixelid.figures.style import IMPROVED, INK, MUTED, OFF, ON, new_axes, save_figure, styled
from pixelid.fit.figures import standardised
from pixelid.fit.result import FitResult
from pixelid.gap.figures import draw_map
from pixelid.likelihood.clocks import light_on_clock
from pixelid.model.model import Model
from pixelid.recordings.own_light import with_fine_light
from pixelid.recordings.recording import Recording
from pixelid.recordings.session_alignment import RecordingAlignment
from pixelid.simulate import simulate
from pixelid.stimuli.pixel_lights import PixelLights, in_a_row

POINTS = 150  # of a curve in a thumbnail: two per pixel of a screen
# Events are counted in `FINE` bins per point and smoothed over `SMOOTH` points: bins alone beat with a periodic light.
FINE, SMOOTH = 4, 0.7
RESIDUAL_BINS = 24
LEAST_IN_BIN = 8  # events whose mean is drawn: its error is then below 0.36 standard deviations
LAST_STAGE = 1e-9  # seconds: two events of one timestamp, on a logarithmic axis


def write_figures(result: Calibration, recordings: Sequence[Recording], folder: Path) -> list[Path]:
    """Write the figures of a calibration as SVG into `folder`; returns their paths."""
    aligned = {one.name: one for one in result.alignments}
    used = {recording.name: recording for recording in recordings}
    drawn = {}
    for k, row in enumerate(result.rows):
        recording, alignment = used.get(row.name), aligned.get(row.name)
        if recording is not None or _has_evidence(alignment):
            axes = draw_recording(result, recording, alignment)
            drawn[f"recording_{k:03d}"] = save_figure(axes, folder / f"recording_{k:03d}.svg")
    drawn["residuals"] = save_figure(draw_before_after(result, recordings), folder / "residuals.svg")
    if result.gap is not None and "seen_before" in result.gap.details:
        drawn["map"] = save_figure(draw_map(result.gap), folder / "map.svg")
    return list(drawn.values())


@styled
def draw_recording(result: Calibration, recording: Recording | None, alignment: RecordingAlignment | None) -> Any:
    """One recording as a thumbnail: light, events measured and simulated, and what its alignment rests on.

    Args:
        result: the calibration, whose model simulates.
        recording: aligned, with the pixels that were fitted; None where it could not be used.
        alignment: of the recording; None where there was nothing to align.

    Returns:
        The axes, one below the other, of what there is of the three.
    """
    evidence = _has_evidence(alignment)
    heights = ([1.0, 1.7] if recording is not None else []) + ([1.1] if evidence else [])
    axes = new_axes(len(heights), 1, 3.0, 0.62 * sum(heights) / len(heights) + 0.35, height_ratios=heights)
    if recording is not None:
        _draw_light(axes[0, 0], recording)
        _draw_events(axes[1, 0], result.fit, recording)
        axes[0, 0].sharex(axes[1, 0])
    if evidence and alignment is not None:
        _draw_evidence(axes[-1, 0], alignment)
    return axes


def _has_evidence(alignment: RecordingAlignment | None) -> bool:
    """Whether the events were compared with the light at several offsets."""
    return alignment is not None and alignment.evidence is not None and len(alignment.evidence.lags_s) > 1


def _draw_light(axis: Any, recording: Recording) -> None:
    light = recording.stimulus
    assert light is not None
    light = light.average() if isinstance(light, PixelLights) else light
    values = light.radiance if light.radiance.ndim == 1 else light.radiance.mean(axis=(1, 2))
    t, low, high = envelope(light.t, values)
    axis.fill_between(t, low, high, color=INK, alpha=0.85, linewidth=0.8, edgecolor=INK)
    axis.set_ylabel(f"light\n({light.unit})")
    axis.tick_params(labelbottom=False)
    axis.margins(y=0.15)
    axis.yaxis.get_major_locator().set_params(nbins=3)


def _draw_events(axis: Any, fit: FitResult, recording: Recording) -> None:
    """Rates per pixel, ON up and OFF down: measured as areas, simulated as lines."""
    light = with_fine_light(recording, fit.details.get("stimulus_between_samples", "linear")).stimulus
    assert light is not None
    edges = np.linspace(light.start_s, light.end_s, FINE * POINTS + 1)
    active = np.unique(recording.events.pixel)
    pixels = max(len(active), 1)
    copy = _simulated(fit.model, recording, in_a_row(light, active), pixels, fit.seed) if len(active) else None
    centre = 0.5 * (edges[1:] + edges[:-1])[FINE // 2 :: FINE]
    for polarity, sign, colour in ((1, 1.0, ON), (0, -1.0, OFF)):
        scale = sign / pixels / np.diff(edges)[0]
        axis.fill_between(centre, scale * _smooth(recording.events, polarity, edges), color=colour, alpha=0.4)
        if copy is not None:
            axis.plot(centre, scale * _smooth(copy, polarity, edges), color=colour, linewidth=0.9)
    axis.axhline(0.0, color=INK, linewidth=0.5)
    axis.set(xlabel="time (s)", ylabel="events/s\nper pixel")
    axis.set_xlim(edges[0], edges[-1])
    axis.yaxis.get_major_locator().set_params(nbins=4)


def _simulated(model: Model, recording: Recording, light: Any, pixels: int, seed: int) -> Any:
    own = model.in_recording(recording.name)
    return simulate(own, light_on_clock(recording, light, own.circuit()), width=pixels, height=1, seed=seed).events


def _smooth(events: Any, polarity: int, edges: np.ndarray) -> np.ndarray:
    """(POINTS,) counts per fine bin, smoothed: what a light that is periodic within a bin would make a comb of."""
    counts = np.histogram(events.t[events.p == polarity] * 1e-9, edges)[0].astype(float)
    return gaussian_filter1d(counts, SMOOTH * FINE, mode="nearest")[FINE // 2 :: FINE]


def envelope(t: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(times, least, largest value) in at most `POINTS` stretches: nothing that a long curve does is left out.

    >>> t, low, high = envelope(np.arange(1000.0), np.arange(1000.0) % 2)
    >>> len(t), float(low.max()), float(high.min())
    (143, 0.0, 1.0)
    """
    step = max(-(-len(t) // POINTS), 1)
    starts = np.arange(0, len(t), step)
    return t[starts], np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)


def _draw_evidence(axis: Any, alignment: RecordingAlignment) -> None:
    """Mean loss against the offset of the light from the one that was chosen; the lowest of each stretch."""
    evidence = alignment.evidence
    assert evidence is not None
    lags, loss, _ = envelope(1e3 * evidence.lags_s, evidence.loss)
    axis.axvline(0.0, color=IMPROVED if alignment.alignment is not None else MUTED, linewidth=1.4)
    axis.plot(lags, loss, color=INK, linewidth=0.9)
    if alignment.interval_95 is not None and alignment.offset_s is not None:
        low, high = (1e3 * (end - alignment.offset_s) for end in alignment.interval_95)
        axis.axvspan(max(low, lags[0]), min(high, lags[-1]), color=IMPROVED, alpha=0.25, linewidth=0)
    axis.set(xlabel="offset from the chosen start (ms)", ylabel="loss")
    axis.margins(x=0.0)
    axis.yaxis.get_major_locator().set_params(nbins=3)


@styled
def draw_before_after(result: Calibration, recordings: Sequence[Recording], axes: Any = None) -> Any:
    """Mean residuals of the base's fit, and below of the final fit, on the same axes; one row where they are the same.

    Args:
        result: the calibration.
        recordings: that were fitted.
        axes: (rows, 3); new ones by default.

    Returns:
        The axes.
    """
    fits = [(result.first.model.name, result.first)]
    if result.fit is not result.first:
        fits = [(f"before: {result.first.model.name}", result.first)]
        grown = [e.replace("_", " ") for e in result.fit.model.effects if e not in result.first.model.effects]
        fits.append(("after: " + " + ".join([result.first.model.name, *grown]), result.fit))
    seen = [(title, *standardised(fit, recordings)) for title, fit in fits]
    if axes is None:
        axes = new_axes(len(fits), 3, 2.87, 2.5)
    for row, (title, likelihood, residual, kept) in zip(axes, seen, strict=True):
        _draw_means(row[0], row[1], likelihood, residual, kept)
        _draw_distribution(row[2], residual[kept])
        row[0].set_title(title)
        row[0].set_ylabel("mean residual (σ)")
    for column in axes.T[:2]:
        reach = max(1.0, *(abs(end) for axis in column for end in axis.get_ylim()))
        for axis in column:
            axis.set_ylim(-reach, reach)
    for column in axes.T:
        left, right = zip(*(axis.get_xlim() for axis in column), strict=True)
        top = max(axis.get_ylim()[1] for axis in column)
        for axis in column:
            axis.set_xlim(min(left), max(right))
            axis.set_ylim(axis.get_ylim()[0], top)
            axis.tick_params(labelbottom=axis is column[-1])
    for axis, label in zip(
        axes[-1], ("time since the pixel's last event (s)", "recording", "residual (σ)"), strict=True
    ):
        axis.set_xlabel(label)
    return axes


def _draw_means(by_interval: Any, by_recording: Any, likelihood: Any, residual: np.ndarray, kept: np.ndarray) -> None:
    """Means with two standard errors, of ON and OFF, against the interval and the recording."""
    since = np.maximum(np.concatenate([iv.time_s - iv.previous_s for iv in likelihood.intervals]), LAST_STAGE)
    chosen = since[kept]
    ends = (chosen.min(), 1.001 * chosen.max()) if len(chosen) else (1e-4, 1.0)
    bins = np.geomspace(*ends, RESIDUAL_BINS + 1)
    centre = np.sqrt(bins[1:] * bins[:-1])
    index = np.clip(np.digitize(since, bins) - 1, 0, RESIDUAL_BINS - 1)
    names = [recording.name for recording in likelihood.recordings]
    for polarity, colour, shift in ((1.0, ON, -0.12), (-1.0, OFF, 0.12)):
        own = kept & (likelihood.sign == polarity)
        for axis, group, at in (
            (by_interval, index, centre),
            (by_recording, likelihood.recording_of_event, np.arange(len(names)) + shift),
        ):
            count = np.bincount(group[own], minlength=len(at))
            mean = np.bincount(group[own], residual[own], len(at)) / np.maximum(count, 1)
            full = count >= LEAST_IN_BIN
            axis.errorbar(at[full], mean[full], 2 / np.sqrt(count[full]), fmt=".", color=colour, linewidth=0.9)
    by_interval.set_xscale("log")
    by_interval.set_xlim(*ends)
    by_recording.set_xticks(range(len(names)), names, rotation=90)
    by_recording.set_xlim(-0.6, len(names) - 0.4)
    by_recording.grid(False, axis="x")
    for axis in (by_interval, by_recording):
        axis.axhline(0.0, color=INK, linewidth=0.6)


def _draw_distribution(axis: Any, residual: np.ndarray) -> None:
    grid = np.linspace(-5, 5, 61)
    axis.hist(np.clip(residual, -5, 5), grid, density=True, color=MUTED, alpha=0.6)
    axis.plot(grid, np.exp(-0.5 * grid**2) / np.sqrt(2 * np.pi), color=INK, linewidth=0.9)
    axis.set(ylabel="density", xlim=(-5, 5))
    axis.set_ylim(0, None)
