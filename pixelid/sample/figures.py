"""Corner and trace plots of a posterior."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pixelid.sample.posterior import Posterior

BINS = 30


def _pyplot():
    import matplotlib.pyplot as plt

    return plt


def write_corner(posterior: Posterior, path: Path) -> Path:
    """Write the corner plot."""
    return _save(draw_corner(posterior), path)


def write_trace(posterior: Posterior, path: Path) -> Path:
    """Write the trace plot."""
    return _save(draw_trace(posterior), path)


def _save(axes: np.ndarray, path: Path) -> Path:
    figure = axes.flat[0].figure
    figure.savefig(path, dpi=90)
    _pyplot().close(figure)
    return path


def draw_corner(posterior: Posterior) -> np.ndarray:
    """Every parameter against every other: histograms on the diagonal, densities with 68 and 95 % contours below."""
    plt = _pyplot()
    names = posterior.coordinates.names
    draws = np.stack([v.ravel() for v in posterior.values().values()], axis=1)
    d = len(names)
    figure, axes = plt.subplots(d, d, figsize=(1.3 * d + 1, 1.3 * d + 1), squeeze=False)
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
                axis.hist(draws[:, i], BINS, range=ranges[i], color="tab:blue", histtype="stepfilled", alpha=0.7)
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
    figure.subplots_adjust(wspace=0.06, hspace=0.06)
    return axes


def _density(axis, x: np.ndarray, y: np.ndarray, limits) -> None:
    """A histogram of pairs with the contours that hold 68 and 95 % of it."""
    count, xs, ys = np.histogram2d(x, y, BINS, range=limits)
    axis.pcolormesh(xs, ys, count.T, cmap="Blues", rasterized=True)
    ordered = np.sort(count.ravel())[::-1]
    share = np.cumsum(ordered) / max(ordered.sum(), 1)
    levels = sorted({float(ordered[min(np.searchsorted(share, level), len(ordered) - 1)]) for level in (0.68, 0.95)})
    levels = [level for level in levels if 0 < level < count.max()]
    if levels:
        middle_x, middle_y = 0.5 * (xs[1:] + xs[:-1]), 0.5 * (ys[1:] + ys[:-1])
        axis.contour(middle_x, middle_y, count.T, levels, colors="black", linewidths=0.5)


def draw_trace(posterior: Posterior) -> np.ndarray:
    """The mean and the 5 to 95 % range of the walkers at every step, one colour per ensemble: they must overlap."""
    plt = _pyplot()
    d = posterior.chain.shape[-1]
    rows = -(-d // 2)
    _, axes = plt.subplots(rows, 2, figsize=(10, 1.3 * rows + 0.6), squeeze=False, layout="constrained")
    for i, (axis, p) in enumerate(zip(axes.flat, posterior.coordinates.parameters, strict=False)):
        for k, one in enumerate(posterior.chain[..., i]):
            values = np.exp(one) if p.transform == "log" else one
            low, high = np.quantile(values, [0.05, 0.95], axis=1)
            steps = np.arange(len(values))
            axis.fill_between(steps, low, high, color=f"C{k}", alpha=0.25, linewidth=0)
            axis.plot(steps, values.mean(axis=1), color=f"C{k}", linewidth=0.8)
        axis.set_title(f"{p.name}, nested R̂ {posterior.convergence.r_hat[i]:.4f}", fontsize=7)
        axis.tick_params(labelsize=6)
    for axis in list(axes.flat)[d:]:
        axis.set_axis_off()
    return axes
