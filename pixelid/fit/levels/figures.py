"""The figure of pixels' gain and background."""

from __future__ import annotations

from typing import Any

import numpy as np

from pixelid.figures.style import INK, MUTED, new_axes, styled
from pixelid.fit.levels.pixel_levels import PixelLevels
from pixelid.statistics import Z95


@styled
def draw_levels(levels: PixelLevels, axes: Any = None) -> Any:
    """Gain and background of every pixel with 95 % bars, sorted; lines: the spread over pixels.

    Args:
        levels: as fits and searches find them.
        axes: (2,), new ones by default.

    Returns:
        The axes.
    """
    if axes is None:
        axes = new_axes(1, len(levels.scales), 4.6, 2.8)
    unit = levels.scales.get("background", {}).get("unit", "")
    drawn = {
        "gain": (np.log(levels.gain), levels.ln_gain_sd, "ln gain, about the mean of these pixels"),
        "background": (levels.background, levels.background_sd, f"background ({unit})"),
    }
    for axis, (kind, scale) in zip(np.ravel(axes), levels.scales.items(), strict=True):
        value, sd, label = drawn[kind]
        order = np.argsort(value)
        rank = np.arange(1, len(value) + 1)
        axis.errorbar(rank, value[order], Z95 * sd[order], fmt=".", color=INK, linewidth=0.8, markersize=3)
        for at in (-scale["value"], scale["value"]) if kind == "gain" else (scale["value"],):
            axis.axhline(at, color=MUTED, linewidth=0.9)
        axis.set(xlabel="pixel, in order of its value", ylabel=label)
        axis.xaxis.get_major_locator().set_params(integer=True)
    return axes
