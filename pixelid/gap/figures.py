"""Figures of a search: where the base is wrong, what each effect would gain, and the gap before and after."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from pixelid.figures.style import (
    IMPROVED,
    INK,
    MEASURED,
    MUTED,
    OFF,
    ON,
    UNEXPLAINED,
    new_axes,
    new_axis,
    save_figure,
    styled,
)
from pixelid.gap.attribute.flexible import Flexible
from pixelid.gap.confirm.free_run import FreeRun
from pixelid.model.model import Model
from pixelid.recordings.own_light import with_fine_light
from pixelid.recordings.recording import Recording
from pixelid.simulate import simulate
from pixelid.stimuli.pixel_lights import in_a_row

BINS = 100
COPIES = 64  # pixels simulated beside the measured ones
LATE, EARLY = ON, OFF  # warm and cold


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
    def details(self) -> Mapping: ...


def write_figures(report: Searched, recordings: Sequence[Recording], folder: Path) -> list[Path]:
    """Write the figures that apply as PNG into `folder`; returns their paths."""
    drawn = {"map": draw_map(report)}
    if any(entry["candidates"] for entry in report.rounds):
        drawn["forest"] = draw_gains(report)
    if "after_jumps" in report.details:
        drawn["edges"] = draw_after_jumps(report)
    elif report.free_run is not None:
        drawn["closed"] = draw_free_run(report)
        drawn["before_after"] = draw_before_after(report, recordings)
    if report.term is not None:
        drawn["unknown"] = draw_unexplained(report)
    return [save_figure(axes, folder / f"{name}.svg") for name, axes in drawn.items()]


@styled
def draw_map(report: Searched, axes: Any = None) -> Any:
    """The cells that leave zero most, before and after, as signed bars."""
    if axes is None:
        axes = new_axes(2, 1, 8.5, 3.2)
    for axis, key, title in ((axes.flat[0], "seen_before", "base model"), (axes.flat[1], "remaining", "grown model")):
        cells = report.details[key][::-1]
        colours = [LATE if c["score"] > 0 else EARLY for c in cells]
        axis.barh(range(len(cells)), [c["score"] for c in cells], color=colours)
        axis.set_yticks(range(len(cells)), [f"{c['response']}: {c['where']}" for c in cells])
        axis.axvline(0, color=INK, linewidth=0.6)
        axis.set_title(title)
        axis.set_xlabel("score (standard deviations)")
    return axes


@styled
def draw_gains(report: Searched, axes: Any = None) -> Any:
    """Held-out gain of every effect fitted, per round."""
    rows = [(entry["round"], c) for entry in report.rounds for c in entry["candidates"]][::-1]
    axis = axes if axes is not None else new_axis(7, 1.2 + 0.28 * len(rows))
    named = {(entry["round"], entry["named"]) for entry in report.rounds}
    for i, (turn, c) in enumerate(rows):
        colour = IMPROVED if (turn, c["name"]) in named else MUTED
        axis.plot(c["heldout_gain_nats"], i, "o", color=colour)
        axis.plot(c["gain_nats"], i, "|", color=colour)
    axis.set_yticks(range(len(rows)), [f"round {turn}: {c['name']}" for turn, c in rows])
    axis.set_xscale("symlog", linthresh=3)
    axis.axvline(0, color=INK, linewidth=0.6)
    axis.set_xlabel("log-likelihood gained (nats); dots: held-out pixels, ticks: fitted pixels")
    return axis


@styled
def draw_free_run(report: Searched, axes: Any = None) -> Any:
    run = report.free_run
    assert run is not None
    names = list(run.per_recording)
    axis = axes if axes is not None else new_axis(max(5.0, 0.8 * len(names)), 3.2)
    at = np.arange(len(names))
    for k, (label, colour) in enumerate((("before", MUTED), ("after", IMPROVED), ("chance", INK))):
        axis.bar(at + 0.27 * (k - 1), [run.per_recording[n][k] for n in names], 0.25, label=label, color=colour)
    axis.set_yscale("symlog", linthresh=1)
    axis.set_xticks(at, names, rotation=45, ha="right")
    axis.set_ylabel("free-run gap")
    axis.legend()
    return axis


@styled
def draw_before_after(report: Searched, recordings: Sequence[Recording], axes: Any = None) -> Any:
    """Event rates of the recordings with the largest gap: measured, base model, grown model."""
    run = report.free_run
    assert run is not None
    worst = sorted(run.per_recording, key=lambda n: -run.per_recording[n][0])[:4]
    shown = [r for r in recordings if r.name in worst]
    if axes is None:
        axes = new_axes(len(shown), 1, 8.5, 2.2)
    between = report.details["stimulus_between_samples"]
    for axis, recording in zip(axes.flat, shown, strict=True):
        stimulus = with_fine_light(recording, between).stimulus
        assert stimulus is not None
        edges = np.linspace(stimulus.start_s, stimulus.end_s, BINS + 1)
        active = np.unique(recording.events.pixel)
        pixels = max(len(active), 1)
        light = in_a_row(stimulus, active[np.linspace(0, pixels - 1, COPIES).astype(int)])
        for model, colour, label in ((report.base, MUTED, "base model"), (report.model, IMPROVED, "grown model")):
            copy = simulate(model, light, width=COPIES, height=1, seed=report.seed).events
            for polarity, sign in ((1, 1.0), (0, -1.0)):
                rate = np.histogram(copy.t[copy.p == polarity] * 1e-9, edges)[0] * sign / COPIES / np.diff(edges)
                axis.step(
                    edges[:-1], rate, where="post", color=colour, linewidth=0.9, label=label if sign > 0 else None
                )
        for polarity, sign in ((1, 1.0), (0, -1.0)):
            events = recording.events
            rate = np.histogram(events.t[events.p == polarity] * 1e-9, edges)[0] * sign / pixels / np.diff(edges)
            axis.fill_between(edges[:-1], rate, step="post", color=MEASURED, alpha=0.4, linewidth=0)
        axis.set(title=recording.name, xlabel="time (s)", ylabel="events per pixel and second")
        axis.legend(loc="upper left")
    return axes


@styled
def draw_after_jumps(report: Searched, axes: Any = None) -> Any:
    """Pooled counts by the time since the light jumped, over what the base and the grown model expect."""
    rows = report.details["after_jumps"]
    axis = axes if axes is not None else new_axis(9, 1.0 + 0.16 * len(rows))
    at = np.arange(len(rows))[::-1]
    for key, colour, mark in (("base", MUTED, "o"), ("grown", IMPROVED, "|")):
        axis.plot(
            [r["measured"] / max(r[key], 1.0) for r in rows], at, mark, color=colour, label=f"measured / {key} model"
        )
    axis.set_yticks(at, [r["where"] for r in rows])
    axis.set_xscale("log")
    axis.axvline(1, color=INK, linewidth=0.6)
    axis.legend()
    return axis


@styled
def draw_unexplained(report: Searched, axes: Any = None) -> Any:
    term = report.term
    assert term is not None
    order = np.argsort(-np.abs(term.shift / np.maximum(term.se, 1e-12)))[:24]
    order = np.sort(order)[::-1]
    sigma = 100.0 * report.model.values.get("threshold_sigma", 0.02)
    axis = axes if axes is not None else new_axis(7.5, 1.2 + 0.24 * len(order))
    axis.errorbar(
        sigma * term.shift[order], range(len(order)), xerr=1.96 * sigma * term.se[order], fmt="o", color=UNEXPLAINED
    )
    axis.set_yticks(range(len(order)), [term.labels[i] for i in order])
    axis.axvline(0, color=INK, linewidth=0.6)
    axis.set_xlabel("threshold shift (%) that would explain it")
    axis.set_title(f"what no effect explains, by {term.factor}")
    return axis
