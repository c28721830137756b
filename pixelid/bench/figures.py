"""Figures of a calibration: each recording with light and alignment, residuals before and after, and the map."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pixelid.bench.result import Calibration
from pixelid.figures.style import IMPROVED, INK, MUTED, new_axes, save_figure, styled
from pixelid.fit.figures import standardised
from pixelid.fit.panels import (
    draw_by_interval,
    draw_by_recording,
    draw_distribution,
    draw_light,
    draw_rates,
    envelope,
    light_of,
    simulated,
)
from pixelid.fit.result import FitResult
from pixelid.gap.figures import draw_map
from pixelid.recordings.recording import Recording
from pixelid.recordings.session_alignment import RecordingAlignment


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
        draw_light(axes[0, 0], recording)
        _draw_events(axes[1, 0], result.fit, recording)
        axes[0, 0].sharex(axes[1, 0])
    if evidence and alignment is not None:
        _draw_evidence(axes[-1, 0], alignment)
    return axes


def _has_evidence(alignment: RecordingAlignment | None) -> bool:
    """Whether the events were compared with the light at several offsets."""
    return alignment is not None and alignment.evidence is not None and alignment.evidence.shape[1] > 1


def _draw_events(axis: Any, fit: FitResult, recording: Recording) -> None:
    light = light_of(recording, fit.details.get("stimulus_between_samples", "linear"))
    pixels = len(np.unique(recording.events.pixel))
    copy = {"model": (simulated(fit.model, recording, light, fit.seed, pixels), pixels, None, "-")} if pixels else {}
    draw_rates(axis, recording, light, copy)
    axis.set_xlabel("time (s)")


def _draw_evidence(axis: Any, alignment: RecordingAlignment) -> None:
    """Mean loss against the offset of the light from the one that was chosen; the lowest of each stretch."""
    evidence = alignment.evidence
    assert evidence is not None
    lags, loss, _ = envelope(1e3 * evidence[0], evidence[1])
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
        draw_by_interval(row[0], likelihood, residual, kept)
        draw_by_recording(row[1], likelihood, residual, kept)
        draw_distribution(row[2], residual[kept])
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
