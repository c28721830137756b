"""Intervals of parameters on one logarithmic axis, relative to a reference, with the truth where it is known."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from pixelid.figures.style import IMPROVED, INK, MUTED, OFF, legend_above, new_axis, styled
from pixelid.figures.words import in_words


@styled
def draw_intervals(
    parameters: Mapping[str, Mapping[str, Any]],
    reference: Mapping[str, float] | None = None,
    truth: Mapping[str, float] | None = None,
    axis: Any = None,
) -> Any:
    """One row for each free parameter that is positive: its estimate and 95 % interval over the reference.

    Args:
        parameters: value, interval_95, identified and fixed of each, as in the JSON of a result.
        reference: what 1 stands for, by parameter; its own estimate where there is none.
        truth: true values by parameter, where they are known.
        axis: to draw on; a new one by default.

    Returns:
        The axis.
    """
    truth = truth or {}
    shown = {name: p for name, p in parameters.items() if not p["fixed"] and (p["value"] or 0.0) > 0.0}
    axis = axis if axis is not None else new_axis(7.0, 0.9 + 0.26 * len(shown))
    widest = 30.0  # times the reference, on either side, beyond which an interval ends in an arrow
    for row, (name, entry) in enumerate(reversed(shown.items())):
        one = (reference or {}).get(name) or entry["value"]
        colour = INK if entry["identified"] else MUTED
        low, high = (None if end is None else end / one for end in entry["interval_95"] or (None, None))
        ends = [
            max(low or 0.0, 1.0 / widest),
            min(high if high is not None and math.isfinite(high) else math.inf, widest),
        ]
        axis.plot(ends, [row, row], color=colour)
        for end, kept, mark in ((low, ends[0], "<"), (high, ends[1], ">")):
            if end is None or end != kept:
                axis.plot(kept, row, mark, color=colour)
        axis.plot(entry["value"] / one, row, "o", color=colour)
        if truth.get(name, 0.0) > 0.0:
            right = (low or 0.0) <= truth[name] / one <= (math.inf if high is None else high)
            label = "truth, in the interval" if right else "truth, outside the interval"
            axis.plot(truth[name] / one, row, "x", color=IMPROVED if right else OFF, markersize=7, label=label)
    axis.axvline(1.0, color=MUTED, linewidth=0.6)
    axis.set_yticks(range(len(shown)), [in_words(name) for name in reversed(shown)])
    axis.set_xscale("log")
    axis.set_xlabel(f"over {'the start' if reference else 'the estimate'}; 95 % intervals, grey: not identified")
    legend_above(axis)
    return axis
