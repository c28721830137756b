"""Corner and trace plots of a posterior."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from pixelid.figures.style import MOST_WIDTH, SERIES, new_axes, save_figure, series_colours, styled
from pixelid.figures.words import symbol, with_unit
from pixelid.fit.coordinates import Coordinates
from pixelid.sample.convergence import Convergence

LEVELS = (0.68, 0.95)  # of the posterior inside the contours


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

    values = {name: v for name, v in posterior.values().items() if "[" not in name and "alignment" not in name}
    draws = np.stack([value.ravel() for value in values.values()], axis=1)
    # a parameter whose draws all agree to rounding has no range of its own
    ranges = [np.quantile(column, [0.001, 0.999]) for column in draws.T]
    ranges = [(low, high) if high > low else (low - 0.5, high + 0.5) for low, high in ranges]
    # contours alone: a density of every pair makes a page of megabytes
    histogram_line = 1.2  # points
    smoothing = 1.0  # bins: contours of a few thousand draws are islands otherwise
    figure = corner.corner(
        draws, fig=plt.figure(figsize=(MOST_WIDTH, MOST_WIDTH)), labels=[symbol(name) for name in values],
        range=ranges, bins=30, levels=LEVELS, color=SERIES[0], plot_datapoints=False, plot_density=False,
        no_fill_contours=True, quantiles=(0.025, 0.5, 0.975), max_n_ticks=2, labelpad=0.75, smooth=smoothing,
        quiet=True, hist_kwargs={"linewidth": histogram_line},  # which the style's patches, being filled, do not have
    )  # fmt: skip
    figure.subplots_adjust(left=0.16, bottom=0.16, right=0.99, top=0.99)
    d = draws.shape[1]
    return np.array(figure.axes).reshape(d, d)


@styled
def draw_trace(posterior: Draws, axes: Any = None) -> Any:
    """The mean and the 5 to 95 % range of the walkers at every step, one colour per ensemble: they must overlap.

    Returns the axes, two to a row.
    """
    d = posterior.chain.shape[-1]
    rows = -(-d // 2)
    if axes is None:
        axes = new_axes(rows, 2, 4.3, 1.5, sharex=True)
    colours = series_colours(posterior.chain.shape[0])
    for i, (axis, p) in enumerate(zip(axes.flat, posterior.coordinates.parameters, strict=False)):
        for k, ensemble in enumerate(posterior.chain[..., i]):  # (steps, walkers)
            values = np.exp(ensemble) if p.transform == "log" else ensemble
            low, high = np.quantile(values, [0.05, 0.95], axis=1)
            steps = np.arange(len(values))
            axis.fill_between(steps, low, high, color=colours[k], alpha=0.25, linewidth=0)
            axis.plot(steps, values.mean(axis=1), color=colours[k], linewidth=0.8)
        axis.set_title(f"{with_unit(p.name, p.unit)}, R̂ {posterior.convergence.r_hat[i]:.4f}")
    for axis in axes[-1]:
        axis.set_xlabel("step")
    for axis in list(axes.flat)[d:]:
        axis.set_axis_off()
    return axes
