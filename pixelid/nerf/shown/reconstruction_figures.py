"""Figures of a reconstruction: views side by side with their errors, how training went, what events say beyond it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pixelid.figures.style import INK, MOST_WIDTH, OFF, ON, legend_above, new_axes, save_figure, series_colours, styled
from pixelid.nerf.reconstruct import Reconstruction
from pixelid.nerf.shown.beside import write_slider
from pixelid.nerf.shown.figures import hide_ticks_and_frames
from pixelid.nerf.shown.given import draw_given
from pixelid.nerf.training.residuals import Left

SHOWN = 5
TITLE_HEIGHT = 0.25  # inches, of a line of text


def write_figures(result: Reconstruction, folder: Path) -> None:
    """Write given.svg, views.svg, the slider's pictures, training.svg and, after a search for effects, gap.svg and what
    is left in the end: final.svg and pixels.svg."""
    save_figure(draw_given(result.given), folder / "given.svg")
    if len(result.truth):
        save_figure(draw_views(result), folder / "views.svg")
        write_slider(result.truth, result.scores, result.beside, folder)
    if result.state.history:
        save_figure(draw_training(result), folder / "training.svg")
    if result.gap and result.gap["residuals"]:
        save_figure(draw_residuals(result.gap["residuals"]), folder / "gap.svg")
    if result.left:
        save_figure(draw_residual_pixels(result.left), folder / "pixels.svg")
        if result.left.maps:
            save_figure(draw_residuals(result.left.maps, (("final", "trained to the end"),)), folder / "final.svg")


@styled
def draw_views(result: Reconstruction, axes: Any = None) -> Any:
    """Test views: reference, reconstruction and absolute error, column by column; returns the axes (3, views)."""
    truth, images = result.truth.images, result.scores.images
    which = np.unique(np.linspace(0, len(truth) - 1, min(SHOWN, len(truth))).astype(int))
    if axes is None:
        width = min(2.9, MOST_WIDTH / len(which))
        axes = new_axes(3, len(which), width, 0.9 * width * truth.shape[1] / truth.shape[2] + TITLE_HEIGHT)
    peak = result.truth.peak
    for column, k in enumerate(which):
        error = np.abs(images[k] - np.clip(truth[k], 0, peak)).mean(axis=-1)
        for row, image in enumerate((truth[k], images[k])):
            shown = np.clip(image / peak, 0, 1)
            axes[row, column].imshow(shown if shown.shape[-1] == 3 else shown[..., 0], cmap="gray", vmin=0, vmax=1)
        error_map = axes[2, column].imshow(error, cmap="magma", vmin=0, vmax=0.3 * peak)
        axes[1, column].set_xlabel(f"PSNR {result.scores.psnr[k]:.1f} dB")
        axes[0, column].set_title(result.truth.names[k])
    for row, name in enumerate(("reference", "reconstruction", "absolute error")):
        axes[row, 0].set_ylabel(name)
    hide_ticks_and_frames(axes)
    axes[2, 0].figure.colorbar(error_map, ax=axes[2].tolist(), shrink=0.8, label="radiance (units of the views)")
    return axes


@styled
def draw_training(result: Reconstruction, axes: Any = None) -> Any:
    """Loss terms, and the PSNR of a validation view, over the steps; returns the two axes."""
    if axes is None:
        axes = new_axes(1, 2, 4.2, 2.8)
    left, right = axes.flat
    history = result.state.history
    steps = [entry["iteration"] for entry in history]
    terms = {"diff": "changes between events", "chain": "chains of changes", "tv": "total variation"}
    for (name, words), colour in zip(terms.items(), series_colours(3), strict=True):
        left.plot(steps, [entry[name] for entry in history], label=words, color=colour)
    left.set(yscale="log", xlabel="step", ylabel="loss")
    legend_above(left, 1)
    right.plot(steps, [entry["running_psnr"] for entry in history], color=INK)
    right.set(xlabel="step", ylabel="PSNR of a validation view (dB)")
    for axis in (left, right):
        axis.xaxis.get_major_locator().set_params(integer=True)
    return axes


COVARIATES = {
    "interval_s": "time since the last event (s)",
    "time_s": "time in the recording (s)",
    "radiance": "radiance (units of the views)",
}


BOTH = (("before", "stated pixel"), ("after", "with what was found"))


@styled
def draw_residuals(
    residuals: Mapping[str, Mapping[str, list]], shown: Sequence[tuple[str, str]] = BOTH, axes: Any = None
) -> Any:
    """What held-out events say beyond the scene, without and, below, with what was found, if anything was.

    shown: names of `residual_map`, and what they are;  returns the axes (rows, covariates).
    """
    first, last = shown[0][0], shown[-1][0]
    found = any(one[f"{p}_{first}"] != one[f"{p}_{last}"] for one in residuals.values() for p in ("on", "off"))
    shown = shown if found else shown[:1]
    if axes is None:
        axes = new_axes(len(shown), len(residuals), 2.8, 2.2)
    axes = axes.reshape(len(shown), -1)
    for column, (name, one) in enumerate(residuals.items()):
        edges = np.array(one["edges"])
        logarithmic = name != "time_s" and edges[0] > 0
        middle = np.sqrt(edges[1:] * edges[:-1]) if logarithmic else 0.5 * (edges[1:] + edges[:-1])
        for row, (when, _) in enumerate(shown):
            axis = axes[row, column]
            for polarity, colour in (("on", ON), ("off", OFF)):
                values = np.array([np.nan if v is None else v for v in one[f"{polarity}_{when}"]])
                axis.plot(middle, values, "o-", color=colour, label=polarity.upper())
            axis.axhline(0.0, color=INK, linewidth=0.6)
            if logarithmic:
                axis.set_xscale("log")
        axes[-1, column].set_xlabel(COVARIATES.get(name, name))
        low, high = (f(f(axis.get_ylim()) for axis in axes[:, column]) for f in (min, max))
        for axis in axes[:, column]:
            axis.set_ylim(low, high)
    for row, (_, words) in enumerate(shown):
        axes[row, 0].set_ylabel(f"{words}:\nmean residual (thresholds)")
    legend_above(axes)
    return axes


@styled
def draw_residual_pixels(left: Left, axes: Any = None) -> Any:
    """What ON and OFF events of each pixel say beyond the scene in the end, and their size; returns the axes (3,)."""
    if axes is None:
        axes = new_axes(1, 3, 3.0, 2.6)
    axes = np.ravel(axes)
    most = float(np.nanquantile(np.abs(np.stack([left.on, left.off])), 0.99)) if np.isfinite(left.rms).any() else 1.0
    for axis, values, words in zip(
        axes, (left.on, left.off, left.rms), ("ON, mean", "OFF, mean", "root mean square"), strict=True
    ):
        signed = values is not left.rms
        spread = {"cmap": "RdBu_r", "vmin": -most, "vmax": most} if signed else {"cmap": "magma", "vmin": 0.0}
        picture = axis.imshow(values, **spread)
        axis.set_title(words)
        axis.set_xticks([])
        axis.set_yticks([])
        axis.grid(False)
        axis.figure.colorbar(picture, ax=axis, shrink=0.8, label="thresholds")
    return axes
