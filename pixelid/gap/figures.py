"""Figures of a search: where the base is wrong, what each effect would gain, and the gap before and after."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from pixelid.figures.style import (
    IMPROVED,
    INK,
    MUTED,
    OFF,
    ON,
    UNEXPLAINED,
    finish_pair,
    legend_above,
    new_axes,
    new_axis,
    new_pairs,
    save_figure,
    styled,
)
from pixelid.fit.levels.figures import draw_levels
from pixelid.fit.levels.pixel_levels import PixelLevels
from pixelid.fit.panels import draw_difference, draw_light, draw_rates, light_of, simulated
from pixelid.gap.attribute.flexible import Flexible
from pixelid.gap.confirm.free_run import FreeRun
from pixelid.model.model import Model
from pixelid.recordings.recording import Recording
from pixelid.statistics import Z95

FEW = 3  # effects fitted, of which the page's table is a better picture
DIRECTIONS = {"level": ("early", "late"), "spread": ("less scatter", "more scatter")}  # score below and above 0


class Searched(Protocol):
    """What figures need of a search's report."""

    @property
    def base(self) -> Model: ...
    @property
    def model(self) -> Model: ...
    @property
    def rounds(self) -> tuple[dict, ...]: ...
    @property
    def free_run(self) -> FreeRun | None: ...
    @property
    def term(self) -> Flexible | None: ...
    @property
    def seed(self) -> int: ...
    @property
    def pixel_levels(self) -> PixelLevels | None: ...
    @property
    def details(self) -> Mapping: ...


def write_figures(report: Searched, recordings: Sequence[Recording], folder: Path) -> list[Path]:
    """Write the figures that apply as SVG into `folder`; returns their paths."""
    drawn = {"map": draw_map(report)}
    if sum(len(entry["candidates"]) for entry in report.rounds) > FEW:
        drawn["forest"] = draw_gains(report)
    if "after_jumps" in report.details:
        drawn["edges"] = draw_after_jumps(report)
    elif report.free_run is not None:
        drawn["closed"] = draw_free_run(report)
        drawn["before_after"] = draw_before_after(report, recordings)
    if report.term is not None:
        drawn["unknown"] = draw_unexplained(report)
    if report.pixel_levels is not None:
        drawn["levels"] = draw_levels(report.pixel_levels)
    return [save_figure(axes, folder / f"{name}.svg") for name, axes in drawn.items()]


@styled
def draw_map(report: Searched, axes: Any = None) -> Any:
    """The cells that leave zero most, as signed bars: of the base, and below of the grown model where it is another.

    Args:
        report: of a search.
        axes: as many as models; new ones by default.

    Returns:
        The axes.
    """
    shown = [("seen_before", report.base.name, UNEXPLAINED)]
    if report.model.effects != report.base.effects:
        shown.append(("remaining", f"grown model, {report.model.name}", IMPROVED))
    if axes is None:
        most = max(len(report.details[key]) for key, _, _ in shown)
        axes = new_axes(len(shown), 1, 8.5, 1.0 + 0.27 * most)
    pooled = "after_jumps" in report.details
    for axis, (key, title, colour) in zip(np.ravel(axes), shown, strict=False):
        cells = report.details[key][::-1]
        axis.barh(range(len(cells)), [c["score"] for c in cells], color=colour, height=0.7)
        axis.set_yticks(range(len(cells)), [c["where"] if pooled else _in_words(c) for c in cells])
        axis.axvspan(-4, 4, color=MUTED, alpha=0.15, linewidth=0, zorder=0)
        axis.axvline(0, color=INK, linewidth=0.6)
        axis.grid(False, axis="y")
        axis.set_title(title)
        axis.set_xlabel(
            "events beyond the model's expectation (standard deviations)" if pooled else "score (standard deviations)"
        )
    left, right = zip(*(axis.get_xlim() for axis in np.ravel(axes)[: len(shown)]), strict=True)
    for axis in np.ravel(axes)[: len(shown)]:  # models are compared: one scale
        axis.set_xlim(min(left), max(right))
    return axes


def _in_words(cell: Mapping) -> str:
    """A cell and what it shows."""
    direction = DIRECTIONS.get(cell["response"])
    return f"{cell['where']}: {cell['response'] if direction is None else direction[cell['score'] > 0]}"


@styled
def draw_gains(report: Searched, axes: Any = None) -> Any:
    """Held-out gain of every effect fitted, per round."""
    rows = [(entry["round"], c) for entry in report.rounds for c in entry["candidates"]][::-1]
    axis = axes if axes is not None else new_axis(7, 0.8 + 0.28 * len(rows))
    named = {(entry["round"], entry["named"]) for entry in report.rounds}
    for i, (turn, c) in enumerate(rows):
        colour = IMPROVED if (turn, c["name"]) in named else MUTED
        axis.plot(c["heldout_gain_nats"], i, "o", color=colour)
        axis.plot(c["gain_nats"], i, "|", color=colour)
    axis.set_yticks(range(len(rows)), [f"{c['name'].replace('_', ' ')} (round {turn})" for turn, c in rows])
    axis.set_xscale("symlog", linthresh=3)
    axis.axvline(0, color=INK, linewidth=0.6)
    axis.set_xlabel("log-likelihood gained (nats); dots: data held out, ticks: data fitted")
    return axis


@styled
def draw_free_run(report: Searched, axes: Any = None) -> Any:
    run = report.free_run
    assert run is not None
    names = list(run.per_recording)
    axis = axes if axes is not None else new_axis(max(5.0, 0.8 * len(names)), 3.2)
    at = np.arange(len(names))
    for k, (label, colour) in enumerate((("before", MUTED), ("after", IMPROVED), ("expected from noise", INK))):
        axis.bar(at + 0.27 * (k - 1), [run.per_recording[n][k] for n in names], 0.25, label=label, color=colour)
    large_gap = 10.0  # times chance, from which what is left beside it shows on a logarithmic scale only
    if max(map(max, run.per_recording.values())) > large_gap:
        axis.set_yscale("symlog", linthresh=1)
    axis.set_xticks(at, names, rotation=45, ha="right")
    axis.set_ylabel("difference of event counts\n(about 1: chance)")
    legend_above(axis)
    return axis


@styled
def draw_before_after(report: Searched, recordings: Sequence[Recording], axes: Any = None) -> Any:
    """The recordings with the largest gap: the light, event rates measured and of both models, differences of each.

    Args:
        report: of a search that named something.
        recordings: that were searched.
        axes: (4, recordings): light, rates, difference of the base and of the grown model; new ones by default.

    Returns:
        The axes.
    """
    run = report.free_run
    assert run is not None
    most_shown = 2  # recordings, those with the largest gap
    worst = sorted(run.per_recording, key=lambda n: -run.per_recording[n][0])[:most_shown]
    shown = [r for r in recordings if r.name in worst]
    if report.pixel_levels is not None:
        shown = report.pixel_levels.seen(shown)
    if axes is None:
        axes = new_axes(4, len(shown), 8.6, 1.5, height_ratios=(1.0, 2.6, 1.2, 1.2))
    models = ((report.base, MUTED, "--", "before"), (report.model, IMPROVED, "-", "after"))
    simulated_pixels = 64  # their scatter adds to the measured one, a fourth of it where 16 pixels were recorded
    for (light_axis, axis, *lefts), recording in zip(axes.T, shown, strict=True):
        light = light_of(recording, report.details["stimulus_between_samples"])
        copies = [simulated(model, recording, light, report.seed, simulated_pixels) for model, _, _, _ in models]
        draw_light(light_axis, recording)
        lines = {
            f"{when}: {model.name}": (copy, simulated_pixels, colour, line)
            for (model, colour, line, when), copy in zip(models, copies, strict=True)
        }
        draw_rates(axis, recording, light, lines)
        for left, copy, (_, _, _, when) in zip(lefts, copies, models, strict=True):
            draw_difference(left, recording, light, copy, simulated_pixels)
            finish_pair(axis, left)
            left.set_ylabel(f"{when}\n(σ)")
        reach = max(abs(end) for left in lefts for end in left.get_ylim())  # they are compared: one scale
        for left in lefts:
            left.set_ylim(-reach, reach)
        lefts[0].tick_params(labelbottom=False)
        lefts[-1].set_xlabel("time (s)")
        light_axis.set_xlim(axis.get_xlim())
        light_axis.set_title(recording.name)
    legend_above(axes, 2)
    return axes


@styled
def draw_after_jumps(report: Searched, axes: Any = None) -> Any:
    """Pooled counts by the time since the light jumped, ON up and OFF down, with what the models expect; rest below.

    Args:
        report: of a search of pooled recordings.
        axes: (2 recordings, 2), residuals in every second row; new ones by default.

    Returns:
        The axes.
    """
    rows, spread = report.details["after_jumps"], max(float(report.details["dispersion"]), 1.0)
    names = list(dict.fromkeys(row["recording"] for row in rows))
    models = [("base", report.base.name, INK)]
    if report.model.effects != report.base.effects:
        models.append(("grown", report.model.name, IMPROVED))
    if axes is None:
        axes = new_pairs(max(len(names), 1), 2, 4.6, 4.0)
    places = sorted({(row["from_s"], row["to_s"] or np.inf) for row in rows})
    labels = [f"{1e3 * a:.3g}–{1e3 * b:.3g}" if np.isfinite(b) else f"> {1e3 * a:.3g}" for a, b in places]
    for k, name in enumerate(names):
        for column, jump in enumerate(("rose", "fell")):
            axis, left = axes[2 * k : 2 * k + 2, column]
            for polarity, sign, colour in (("ON", 1.0, ON), ("OFF", -1.0, OFF)):
                here = [r for r in rows if (r["recording"], r["light"], r["polarity"]) == (name, jump, polarity)]
                at = np.array([places.index((r["from_s"], r["to_s"] or np.inf)) for r in here], dtype=float)
                measured = np.array([r["measured"] for r in here])
                axis.bar(at, sign * measured, 0.8, color=colour, alpha=0.45, label=f"{polarity}, measured")
                for model, label, line in models:
                    expected = np.array([r[model] for r in here])
                    axis.hlines(
                        sign * expected, at - 0.4, at + 0.4, color=line, linewidth=1.6,
                        label=f"expected by {label}" if sign > 0 else None,
                    )  # fmt: skip
                    side = 0.12 * sign if line == INK else 0.28 * sign
                    residual = (measured - expected) / np.sqrt(spread * np.maximum(expected, 1.0))
                    left.plot(at + side, residual, "o" if line == INK else "D", color=colour, markersize=4)
            axis.axhline(0.0, color=INK, linewidth=0.5)
            axis.set_title(f"{name}: the light {jump}")
            axis.set_ylabel("events, OFF downwards")
            left.set_xticks(range(len(places)), labels, rotation=45, ha="right")
            axis.set_xticks(range(len(places)), [])
            left.set(xlabel="time since the light jumped (ms)", ylabel="difference\n(σ)")
            left.set_xlim(-0.6, len(places) - 0.4)
            axis.set_xlim(-0.6, len(places) - 0.4)
            finish_pair(axis, left)
    legend_above(axes)
    return axes


@styled
def draw_unexplained(report: Searched, axes: Any = None) -> Any:
    term = report.term
    assert term is not None
    order = np.argsort(-np.abs(term.shift / np.maximum(term.se, 1e-12)))[:24]
    order = np.sort(order)[::-1]
    sigma = 100.0 * report.model.values.get("threshold_sigma", 0.02)
    axis = axes if axes is not None else new_axis(7.5, 1.2 + 0.24 * len(order))
    axis.errorbar(
        sigma * term.shift[order], range(len(order)), xerr=Z95 * sigma * term.se[order], fmt="o", color=UNEXPLAINED
    )
    axis.set_yticks(range(len(order)), [term.labels[i] for i in order])
    axis.axvline(0, color=INK, linewidth=0.6)
    axis.set_xlabel("threshold shift (%) that would explain it")
    axis.set_title(f"what no effect explains, by {term.factor}")
    return axis
