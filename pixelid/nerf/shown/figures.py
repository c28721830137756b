"""Figure of what was rendered: some frames, and their depths below."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pixelid.figures.style import SEQUENTIAL, new_axes, save_figure, styled
from pixelid.nerf.shown.render import Rendered


def write_figures(result: Rendered, folder: Path) -> None:
    """Write views.svg into an existing folder."""
    save_figure(draw_frames(result), folder / "views.svg")


@styled
def draw_frames(result: Rendered, axes: Any = None) -> Any:
    """Frames, and depths where there are any; returns the axes (1 or 2, frames)."""
    rows = 1 if result.depths is None else 2
    if axes is None:
        axes = new_axes(rows, len(result.shown), 2.0, 2.0)
    axes = axes.reshape(rows, -1)
    for k, image in enumerate(result.shown):
        axes[0, k].imshow(image)
        if result.depths is not None:
            shown = axes[1, k].imshow(result.depths[k], cmap=f"{SEQUENTIAL}_r")
    for axis in axes.flat:
        axis.set_xticks([])
        axis.set_yticks([])
        axis.grid(False)
    if result.depths is not None:
        axes[0, 0].figure.colorbar(shown, ax=axes[1].tolist(), shrink=0.8, label="distance (units of the poses)")
    return axes
