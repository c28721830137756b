"""Corner and trace plots of a posterior."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from pixelid.figures.style import MOST_WIDTH, SERIES, new_axes, save_figure, series_colours, styled
from pixelid.figures.words import in_short_unit, symbol, with_unit
from pixelid.fit.coordinates import Coordinates
from pixelid.sample.convergence import Convergence

LEVELS = (0.68, 0.95)  # of the posterior inside the contours
MOST_POINTS = 300  # of a trace: steps are taken together, for a page of thousands has megabytes
WIDE = 10.0  # ratio of the ends from which an axis is logarithmic


class Draws(Protocol):
    """What figures need of a posterior."""

    @property
    def coordinates(self) -> Coordinates: ...
    @property
    def chain(self) -> np.ndarray: ...
    @property
    def convergence(self) -> Convergence: ...
    def values(self) -> Mapping[str, np.ndarray]: ...


def write_figures(posterior: Draws, folder: Path) -> list[Path]:
    """Write corner.svg and trace.svg into `folder`; returns their paths."""
    return [
        save_figure(draw_corner(posterior), folder / "corner.svg"),
        save_figure(draw_trace(posterior), folder / "trace.svg"),
    ]


@styled
def draw_corner(posterior: Draws) -> Any:
    """Every parameter of the pixel against every other, in its own unit; contours hold 68 and 95 % of the draws.

    Returns the (parameters, parameters) axes.
    """
    import corner
    import matplotlib.pyplot as plt

    every = zip(posterior.coordinates.parameters, posterior.values().values(), strict=True)
    own = [(p, v) for p, v in every if "[" not in p.name and "alignment" not in p.name]
    units = [in_short_unit(float(np.median(v)), p.unit) for p, v in own]
    draws = np.stack([v.ravel() / scale for (_, v), (scale, _) in zip(own, units, strict=True)], axis=1)
    shown = ["" if unit in ("", "log radiance") else f"({unit})" for _, unit in units]  # a threshold's is understood
    labels = [f"{symbol(p.name)}\n{unit}" for (p, _), unit in zip(own, shown, strict=True)]
    # a parameter whose draws all agree to rounding has no range of its own
    ranges = [np.quantile(column, [0.001, 0.999]) for column in draws.T]
    ranges = [(low, high) if high > low else (low - 0.5, high + 0.5) for low, high in ranges]
    scales = [_scale(r) for r in ranges]
    # contours alone: a density of every pair makes a page of megabytes
    histogram_line = 1.2  # points
    smoothing = 1.0  # bins: contours of a few thousand draws are islands otherwise
    figure = corner.corner(
        draws, fig=plt.figure(figsize=(MOST_WIDTH, MOST_WIDTH)), axes_scale=scales,  # pyright: ignore
        labels=labels,
        range=ranges, bins=30, levels=LEVELS, color=SERIES[0], plot_datapoints=False, plot_density=False,
        no_fill_contours=True, quantiles=(0.025, 0.5, 0.975), max_n_ticks=2, labelpad=0.75, smooth=smoothing,
        quiet=True, hist_kwargs={"linewidth": histogram_line},  # which the style's patches, being filled, do not have
    )  # fmt: skip
    figure.subplots_adjust(left=0.16, bottom=0.16, right=0.99, top=0.99)
    d = draws.shape[1]
    return np.array(figure.axes).reshape(d, d)


def _scale(ends: tuple[float, float]) -> str:
    """Of an axis: logarithmic where a parameter is known within a decade only."""
    return "log" if 0.0 < WIDE * ends[0] < ends[1] else "linear"


@styled
def draw_trace(posterior: Draws, axes: Any = None) -> Any:
    """The mean and the 5 to 95 % range of the walkers over the steps, one colour per ensemble: they must overlap.

    Returns the axes, two to a row.
    """
    d = posterior.chain.shape[-1]
    rows = -(-d // 2)
    if axes is None:
        axes = new_axes(rows, 2, 4.3, 1.5, sharex=True)
    colours = series_colours(posterior.chain.shape[0])
    for i, (axis, p) in enumerate(zip(axes.flat, posterior.coordinates.parameters, strict=False)):
        for k, ensemble in enumerate(posterior.chain[..., i]):  # (steps, walkers)
            scale, unit = in_short_unit(p.value, p.unit)
            values = (np.exp(ensemble) if p.transform == "log" else ensemble) / scale
            together = -(-len(values) // MOST_POINTS)
            blocks = values[: len(values) // together * together].reshape(-1, together * values.shape[1])
            low, high = np.quantile(blocks, [0.05, 0.95], axis=1)
            steps = together * (np.arange(len(blocks)) + 0.5)
            axis.fill_between(steps, low, high, color=colours[k], alpha=0.25, linewidth=0)
            axis.plot(steps, blocks.mean(axis=1), color=colours[k], linewidth=0.8)
            axis.set_yscale(_scale((float(low.min()), float(high.max()))))
        axis.set_title(f"{with_unit(p.name, unit)}, R̂ {posterior.convergence.r_hat[i]:.4f}")
    for axis in axes[-1]:
        axis.set_xlabel("step")
    for axis in list(axes.flat)[d:]:
        axis.set_axis_off()
    return axes
