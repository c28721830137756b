"""Figures of a recommended experiment."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pixelid.figures.style import IMPROVED, INK, MUTED, legend_above, new_axes, new_axis, save_figure, styled
from pixelid.figures.words import in_words, light_unit, stimulus
from pixelid.stimuli.files import shape

LABELS = {"bandwidth": "cutoff (Hz)", "noise": "noise (1/s)", "rate": "events (1/s)"}


def write_figures(result: dict, folder: Path) -> None:
    """Write stimulus.svg, ranking.svg and widths.svg into `folder`."""
    save_figure(draw_stimulus(result), folder / "stimulus.svg")
    save_figure(draw_ranking(result), folder / "ranking.svg")
    save_figure(draw_widths(result), folder / "widths.svg")


@styled
def draw_stimulus(result: dict, axis: Any = None) -> Any:
    """The light that is recommended, over time; returns the axis."""
    best = result["recommended"]
    unit = light_unit(result["widths_before"])
    light = shape(best["kind"], best["parameters"])
    axis = axis if axis is not None else new_axis(8.6, 2.0)
    axis.plot(light.t, light.radiance, color=INK, linewidth=0.8)
    axis.set(xlabel="time (s)", ylabel=f"light ({unit})" if unit else "light")
    axis.set_title(stimulus(best["name"], best["parameters"], unit))
    axis.margins(x=0.0)
    return axis


@styled
def draw_ranking(result: dict, axis: Any = None) -> Any:
    """Score of every stimulus on the menu, the recommended one in colour; returns the axis."""
    ranking = result["ranking"][::-1]
    axis = axis if axis is not None else new_axis(7.5, 0.26 * len(ranking) + 0.8)
    best = result["recommended"]["name"]
    axis.barh(
        [stimulus(entry["name"], entry["parameters"], light_unit(result["widths_before"])) for entry in ranking],
        [entry["score"] for entry in ranking],
        xerr=[entry["score_error"] for entry in ranking],
        color=[IMPROVED if entry["name"] == best else MUTED for entry in ranking],
        error_kw={"ecolor": INK, "elinewidth": 0.8},
    )
    axis.grid(False, axis="y")
    axis.margins(y=0.02)
    axis.set_xlabel(f"expected information, {result['criterion']} (nats)")
    return axis


@styled
def draw_widths(result: dict, axis: Any = None) -> Any:
    """Standard error of every parameter before and after the recommended stimulus; returns the axis."""
    names = list(result["widths_before"])[::-1]
    axis = axis if axis is not None else new_axis(7.5, 0.3 * len(names) + 0.8)
    least_change = 1.05  # ratio of standard errors from which an arrow has a length
    for row, name in enumerate(names):
        ends = [result[key][name]["std_coordinate"] for key in ("widths_before", "widths_after")]
        if ends[0] > least_change * ends[1]:
            arrow = {"arrowstyle": "->", "color": IMPROVED, "linewidth": 1.0}
            axis.annotate("", (ends[1], row), (ends[0], row), arrowprops=arrow)
        axis.plot(ends[0], row, "o", color=MUTED, label=None if row else "before")
        axis.plot(ends[1], row, "o", color=IMPROVED, label=None if row else "after")
    axis.set_yticks(range(len(names)), [in_words(name) for name in names])
    axis.set(xscale="log", xlabel="standard error (of parameters on a logarithmic scale, 0.1 is 10 %)")
    legend_above(axis)
    return axis


def write_bias_figure(result: dict, folder: Path) -> None:
    """Write biases.svg into `folder`."""
    save_figure(draw_biases(result), folder / "biases.svg")


@styled
def draw_biases(result: dict, axes: Any = None) -> Any:
    """Every quantity predicted over the bias, with what is wanted and what was measured; returns the axes."""
    curve, best = result["curve"], result["recommended"]
    names = [name for name in LABELS if name in curve]
    if axes is None:
        axes = new_axes(1, len(names), 3.8, 3.0)
    bias = np.asarray(curve["bias_mv"])
    for axis, name in zip(axes[0], names, strict=True):
        middle, low, high = (np.asarray(curve[name][key]) for key in ("middle", "low", "high"))
        axis.fill_between(bias, low, high, color=MUTED, alpha=0.3, linewidth=0)
        axis.plot(bias, middle, color=INK)
        for one in result["measured_settings"]:
            if one.get(name):
                axis.plot([one["bias_mv"]] * 2, one[name]["interval_95"], color=INK, linewidth=1)
                axis.plot(one["bias_mv"], one[name]["value"], "o", color=INK, markersize=4)
        if name in result["wishes"]:
            axis.axhline(result["wishes"][name]["wanted"], color=INK, linestyle="--", linewidth=0.8)
        axis.axvline(best["bias_mv"], color=IMPROVED)
        for side in (slice(None), slice(None, None, -1)):
            axis.axvspan(result["fitted_range_mv"][side][0], bias[side][0], color=MUTED, alpha=0.12, linewidth=0)
        # the band of a quantity that is open spans hundreds of decades
        axis.set(yscale="log", ylim=(1e-3 * middle.min(), 1e3 * middle.max()))
        axis.set(xlabel=f"{result['bias'] or 'bias'} (mV)", ylabel=LABELS[name])
    return axes
