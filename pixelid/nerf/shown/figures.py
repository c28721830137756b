"""Figure of what was rendered: some frames, their errors and depths below."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pixelid.figures.style import SEQUENTIAL, new_axes, save_figure, styled
from pixelid.nerf.shown.render import Rendered


def write_figures(result: Rendered, folder: Path) -> None:
    """Write views.svg into an existing folder."""
    save_figure(draw_frames(result), folder / "views.svg")


def hide_ticks_and_frames(axes: Any) -> None:
    """Take ticks, grid and frame from axes that show pictures."""
    for axis in axes.flat:
        axis.set(xticks=[], yticks=[])
        axis.grid(False)
        axis.spines[:].set_visible(False)


@styled
def draw_frames(result: Rendered, axes: Any = None) -> Any:
    """Frames, errors where there are pictures, and depths where asked for; returns the axes (1 to 3, frames)."""
    below: list[tuple[Any, dict[str, Any], str]] = []
    if result.errors is not None:
        scale = {"cmap": "magma", "vmin": 0, "vmax": result.content["errors"]["full_scale"]}
        below.append((result.errors, scale, "absolute error (units of the views)"))
    if result.depths is not None:
        finite = result.depths[np.isfinite(result.depths)]
        low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
        scale = {"cmap": f"{SEQUENTIAL}_r", "vmin": low, "vmax": high}
        below.append((result.depths, scale, "distance, near bright"))
    rows = 1 + len(below)
    if axes is None:
        axes = new_axes(rows, len(result.shown), 2.0, 2.0)
    axes = axes.reshape(rows, -1)
    for k, image in enumerate(result.shown):
        axes[0, k].imshow(image)
    hide_ticks_and_frames(axes)
    for row, (images, scale, label) in enumerate(below, start=1):
        shown = [axes[row, k].imshow(image, **scale) for k, image in enumerate(images)]
        axes[0, 0].figure.colorbar(shown[-1], ax=axes[row].tolist(), shrink=0.8, label=label)
    return axes
