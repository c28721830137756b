"""Figures of latency tables: medians over irradiance and the model, and which stage takes how much of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pixelid.figures.style import legend_above, new_axes, series_colours, styled
from pixelid.tables.latency.limits import STAGES


@styled
def draw_latency(rows: Sequence[Mapping[str, Any]], axes: Any = None) -> Any:
    """Medians over irradiance, one panel per camera and edge, one colour per setting; spoiled rows as crosses."""
    panels = sorted({(str(row.get("camera", "-")), -row["polarity"]) for row in rows})
    if axes is None:
        axes = new_axes(math.ceil(len(panels) / 2), 2, 4.3, 3.4, sharex=True).ravel()
    settings = list(dict.fromkeys(str(row.get("bias_config", "-")) for row in rows))
    colours = dict(zip(settings, series_colours(len(settings)), strict=True))
    for axis, (camera, edge) in zip(axes, panels, strict=False):
        mine = [row for row in rows if (str(row.get("camera", "-")), -row["polarity"]) == (camera, edge)]
        for setting, colour in colours.items():
            here = [row for row in mine if str(row.get("bias_config", "-")) == setting]
            for spoiled, mark in ((False, "o"), (True, "x")):
                some = [r for r in here if r["spoiled"] == spoiled and r["measured"] is not None]
                x, y = [r["irradiance_W_m2"] for r in some], [1e6 * r["measured"] for r in some]
                axis.loglog(x, y, mark, markersize=3, color=colour, label="_")
            for lens in dict.fromkeys(str(r.get("lens", "-")) for r in here):
                some = [r for r in here if str(r.get("lens", "-")) == lens and not r["lost_edges"]]
                pairs = sorted({(r["irradiance_W_m2"], r["predicted"]) for r in some})
                if pairs:
                    x, y = np.array(pairs).T
                    label = setting if lens == str(here[0].get("lens", "-")) else "_"
                    axis.loglog(x, 1e6 * y, color=colour, linewidth=0.8, label=label)
        axis.set_title(f"{camera}, light {'on' if edge == -1 else 'off'}")
        axis.set_ylabel("median latency (µs)")
        axis.set_xlabel("irradiance (W/m²)")
    ends = np.array([axis.get_ylim() for axis in axes[: len(panels)]])
    for axis in axes[: len(panels)]:  # cameras and edges are compared
        axis.set_ylim(ends[:, 0].min(), ends[:, 1].max())
    for axis in axes[len(panels) :]:
        axis.set_axis_off()
    legend_above(axes, 6, "setting")
    return axes


@styled
def draw_limits(limits: Sequence[Mapping[str, Any]], axes: Any = None) -> Any:
    """How much of the median latency goes with each stage, over irradiance."""
    panels = list(dict.fromkeys((entry["camera"], entry["edge"]) for entry in limits))
    if axes is None:
        axes = new_axes(math.ceil(len(panels) / 2), 2, 4.3, 2.8, sharex=True).ravel()
    for axis, panel in zip(axes, panels, strict=False):
        here = [entry for entry in limits if (entry["camera"], entry["edge"]) == panel]
        for stage, colour in zip(STAGES, series_colours(len(STAGES)), strict=True):
            x, y = [e["irradiance_W_m2"] for e in here], [100 * e["shares"][stage] for e in here]
            axis.semilogx(x, y, "o-", markersize=3, color=colour, label=stage.replace("_", " "))
        axis.set_title(f"{panel[0]}, light {panel[1]}")
        axis.set_xlabel("irradiance (W/m²)")
        axis.set(ylabel="share of latency (%)", ylim=(-3.0, 103.0))
    for axis in axes[len(panels) :]:
        axis.set_axis_off()
    legend_above(axes, 4)
    return axes
