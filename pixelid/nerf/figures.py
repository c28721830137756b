"""Figures of a reconstruction: views side by side with their errors, and how training went."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pixelid.figures.style import INK, new_axes, save_figure, series_colours, styled
from pixelid.nerf.reconstruct import Reconstruction

SHOWN = 5


def write_figures(result: Reconstruction, folder: Path) -> None:
    """Write views.svg and training.svg into an existing folder."""
    if len(result.truth):
        save_figure(draw_views(result), folder / "views.svg")
    if result.state.history:
        save_figure(draw_training(result), folder / "training.svg")


@styled
def draw_views(result: Reconstruction, axes: Any = None) -> Any:
    """Test views: reference, reconstruction and absolute error, column by column; returns the axes (3, views)."""
    truth, images = result.truth.images, result.scores.images
    which = np.unique(np.linspace(0, len(truth) - 1, min(SHOWN, len(truth))).astype(int))
    if axes is None:
        axes = new_axes(3, len(which), 2.0, 2.0)
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
    for axis in axes.flat:
        axis.set_xticks([])
        axis.set_yticks([])
        axis.grid(False)
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
    left.legend()
    right.plot(steps, [entry["running_psnr"] for entry in history], color=INK)
    right.set(xlabel="step", ylabel="PSNR of a validation view (dB)")
    for axis in (left, right):
        axis.xaxis.get_major_locator().set_params(integer=True)
    return axes
