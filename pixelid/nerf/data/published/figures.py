"""Figure of a converted dataset: where and when its events are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pixelid.figures.style import INK, SEQUENTIAL, new_axes, save_figure, styled
from pixelid.nerf.data.published.convert import Conversion


def write_figures(result: Conversion, folder: Path) -> None:
    """Write events.svg into an existing folder."""
    save_figure(draw_events(result), folder / "events.svg")


@styled
def draw_events(result: Conversion, axes: Any = None) -> Any:
    """Events of every pixel, and their rate over time; returns the two axes."""
    if axes is None:
        axes = new_axes(1, 2, 4.2, 2.8)
    left, right = axes.flat
    high = max(float(np.quantile(result.counts, 0.99)), 1.0)
    image = left.imshow(result.counts, cmap=SEQUENTIAL, vmin=0, vmax=high)
    left.set(xlabel="column", ylabel="row")
    left.grid(False)
    left.figure.colorbar(image, ax=left, label="events", shrink=0.8)
    t = (np.arange(len(result.rate)) + 0.5) * result.content["duration_s"] / len(result.rate)
    right.plot(t, 1e-6 * result.rate, color=INK)
    right.set(xlabel="time (s)", ylabel="million events per second", ylim=(0, None))
    return axes
