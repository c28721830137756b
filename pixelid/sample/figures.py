"""Corner and trace plots of a posterior."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pixelid.figures.style import DENSITY, INK, SERIES, new_axes, save_figure, series_colours, styled
from pixelid.sample.posterior import Posterior

BINS = 30


def write_figures(posterior: Posterior, folder: Path) -> list[Path]:
    """Write corner.svg and trace.svg into `folder`; returns their paths."""
    return [
        save_figure(draw_corner(posterior), folder / "corner.svg"),
        save_figure(draw_trace(posterior), folder / "trace.svg"),
    ]


@styled
def draw_corner(posterior: Posterior, axes: Any = None) -> Any:
    """Every parameter against every other: histograms on the diagonal, densities with 68 and 95 % contours below.

    Returns the (parameters, parameters) axes.
    """
    names = posterior.coordinates.names
    draws = np.stack([v.ravel() for v in posterior.values().values()], axis=1)
    d = len(names)
    if axes is None:
        axes = new_axes(d, d, 1.3, 1.3)
    ranges = [np.quantile(draws[:, i], [0.001, 0.999]) for i in range(d)]
    ranges = [(low, high) if high > low else (low - 0.5, high + 0.5) for low, high in ranges]
    for i in range(d):
        for j in range(d):
            axis = axes[i, j]
            axis.tick_params(labelsize=5)
            if j > i:
                axis.set_axis_off()
                continue
            if i == j:
                axis.hist(draws[:, i], BINS, range=ranges[i], color=SERIES[0], histtype="stepfilled", alpha=0.7)
                axis.set_yticks([])
            else:
                _density(axis, draws[:, j], draws[:, i], (ranges[j], ranges[i]))
            if i < d - 1:
                axis.set_xticklabels([])
            else:
                axis.set_xlabel(names[j], fontsize=6)
            if j > 0 or i == 0:
                axis.set_yticklabels([])
            else:
                axis.set_ylabel(names[i], fontsize=6)
            axis.locator_params(nbins=3)
    return axes


def _density(axis, x: np.ndarray, y: np.ndarray, limits) -> None:
    """A histogram of pairs with the contours that hold 68 and 95 % of it."""
    count, xs, ys = np.histogram2d(x, y, BINS, range=limits)
    axis.pcolormesh(xs, ys, count.T, cmap=DENSITY, rasterized=True)
    ordered = np.sort(count.ravel())[::-1]
    share = np.cumsum(ordered) / max(ordered.sum(), 1)
    levels = sorted({float(ordered[min(np.searchsorted(share, level), len(ordered) - 1)]) for level in (0.68, 0.95)})
    levels = [level for level in levels if 0 < level < count.max()]
    if levels:
        middle_x, middle_y = 0.5 * (xs[1:] + xs[:-1]), 0.5 * (ys[1:] + ys[:-1])
        axis.contour(middle_x, middle_y, count.T, levels, colors=INK, linewidths=0.5)


@styled
def draw_trace(posterior: Posterior, axes: Any = None) -> Any:
    """The mean and the 5 to 95 % range of the walkers at every step, one colour per ensemble: they must overlap.

    Returns the axes, two to a row.
    """
    d = posterior.chain.shape[-1]
    rows = -(-d // 2)
    if axes is None:
        axes = new_axes(rows, 2, 4.6, 1.4)
    colours = series_colours(posterior.chain.shape[0])
    for i, (axis, p) in enumerate(zip(axes.flat, posterior.coordinates.parameters, strict=False)):
        for k, one in enumerate(posterior.chain[..., i]):
            values = np.exp(one) if p.transform == "log" else one
            low, high = np.quantile(values, [0.05, 0.95], axis=1)
            steps = np.arange(len(values))
            axis.fill_between(steps, low, high, color=colours[k], alpha=0.25, linewidth=0)
            axis.plot(steps, values.mean(axis=1), color=colours[k], linewidth=0.8)
        axis.set_title(f"{p.name}, nested R̂ {posterior.convergence.r_hat[i]:.4f}", fontsize=7)
        axis.tick_params(labelsize=6)
    for axis in list(axes.flat)[d:]:
        axis.set_axis_off()
    return axes
