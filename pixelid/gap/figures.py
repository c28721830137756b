"""Figures of a search: where the base is wrong, what each effect would gain, and the gap before and after."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pixelid.gap.result import GapReport
from pixelid.recordings.recording import Recording
from pixelid.simulate import simulate
from pixelid.stimuli.resample import resampled

BINS = 100


def write_figures(report: GapReport, recordings: Sequence[Recording], folder: Path) -> list[Path]:
    """Write the figures that apply as PNG into `folder`; returns their paths."""
    figures = [_save(draw_map(report), folder / "map.png")]
    if any(entry["candidates"] for entry in report.rounds):
        figures.append(_save(draw_forest(report), folder / "forest.png"))
    if "after_jumps" in report.details:
        figures.append(_save(draw_after_jumps(report), folder / "edges.png"))
    elif report.free_run is not None:
        figures.append(_save(draw_per_recording(report), folder / "closed.png"))
        figures.append(_save(draw_before_after(report, recordings), folder / "before_after.png"))
    if report.term is not None:
        figures.append(_save(draw_term(report), folder / "unknown.png"))
    return figures


def _new(width: float, height: float, rows: int = 1, columns: int = 1):
    import matplotlib.pyplot as plt

    return plt.subplots(rows, columns, figsize=(width, height), squeeze=False, layout="constrained")


def _save(axes: np.ndarray, path: Path) -> Path:
    import matplotlib.pyplot as plt

    figure = axes.flat[0].figure
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return path


def draw_map(report: GapReport) -> np.ndarray:
    """The cells that leave zero most, before and after, as signed bars."""
    _, axes = _new(11, 4.2, 1, 2)
    for axis, key, title in ((axes[0, 0], "seen_before", "base model"), (axes[0, 1], "remaining", "grown model")):
        cells = report.details[key][::-1]
        colours = ["tab:red" if c["score"] > 0 else "tab:blue" for c in cells]
        axis.barh(range(len(cells)), [c["score"] for c in cells], color=colours)
        axis.set_yticks(range(len(cells)), [f"{c['response']}: {c['where']}" for c in cells], fontsize=6)
        axis.axvline(0, color="k", linewidth=0.6)
        axis.set_title(title, fontsize=9)
        axis.set_xlabel("score (standard deviations from nothing)", fontsize=8)
    return axes


def draw_forest(report: GapReport) -> np.ndarray:
    """Held-out gain of every effect fitted, per round."""
    rows = [(entry["round"], c) for entry in report.rounds for c in entry["candidates"]][::-1]
    _, axes = _new(7, 1.2 + 0.28 * len(rows))
    axis = axes[0, 0]
    named = {(entry["round"], entry["named"]) for entry in report.rounds}
    for i, (turn, c) in enumerate(rows):
        colour = "tab:green" if (turn, c["name"]) in named else "0.5"
        axis.plot(c["heldout_gain_nats"], i, "o", color=colour)
        axis.plot(c["gain_nats"], i, "|", color=colour)
    axis.set_yticks(range(len(rows)), [f"round {turn}: {c['name']}" for turn, c in rows], fontsize=7)
    axis.set_xscale("symlog", linthresh=3)
    axis.axvline(0, color="k", linewidth=0.6)
    axis.set_xlabel("nats gained: on held-out pixels (dots), on the pixels fitted (ticks)", fontsize=8)
    return axes


def draw_per_recording(report: GapReport) -> np.ndarray:
    run = report.free_run
    assert run is not None
    names = list(run.per_recording)
    _, axes = _new(max(5.0, 0.8 * len(names)), 3.2)
    axis = axes[0, 0]
    at = np.arange(len(names))
    for k, (label, colour) in enumerate((("before", "0.6"), ("after", "tab:green"), ("chance", "k"))):
        axis.bar(at + 0.27 * (k - 1), [run.per_recording[n][k] for n in names], 0.25, label=label, color=colour)
    axis.set_yscale("symlog", linthresh=1)
    axis.set_xticks(at, names, rotation=45, ha="right", fontsize=7)
    axis.set_ylabel("free-run gap", fontsize=8)
    axis.legend(fontsize=7)
    return axes


def draw_before_after(report: GapReport, recordings: Sequence[Recording]) -> np.ndarray:
    """Event rates of the recordings with the largest gap: measured, base model, grown model."""
    run = report.free_run
    assert run is not None
    worst = sorted(run.per_recording, key=lambda n: -run.per_recording[n][0])[:4]
    shown = [r for r in recordings if r.name in worst]
    figure, axes = _new(9, 2.2 * len(shown), len(shown), 1)
    between = report.details["stimulus_between_samples"]
    for axis, recording in zip(axes[:, 0], shown, strict=True):
        assert recording.stimulus is not None
        stimulus = resampled(recording.stimulus, between)
        edges = np.linspace(stimulus.t[0], stimulus.t[-1], BINS + 1)
        pixels = max(len(np.unique(recording.events.pixel)), 1)
        for model, colour, label in ((report.base, "0.4", "base model"), (report.model, "tab:green", "grown model")):
            copy = simulate(model, stimulus, width=64, height=1, seed=report.seed).events
            for polarity, sign in ((1, 1.0), (0, -1.0)):
                rate = np.histogram(copy.t[copy.p == polarity] * 1e-9, edges)[0] * sign / 64 / np.diff(edges)
                axis.step(
                    edges[:-1], rate, where="post", color=colour, linewidth=0.9, label=label if sign > 0 else None
                )
        for polarity, sign in ((1, 1.0), (0, -1.0)):
            events = recording.events
            rate = np.histogram(events.t[events.p == polarity] * 1e-9, edges)[0] * sign / pixels / np.diff(edges)
            axis.fill_between(edges[:-1], rate, step="post", color="tab:orange", alpha=0.4, linewidth=0)
        axis.set_title(recording.name, fontsize=8)
        axis.legend(fontsize=6, loc="upper right")
    figure.supxlabel("time [s]", fontsize=8)
    figure.supylabel("events per pixel and second, ON up, OFF down (filled: measured)", fontsize=8)
    return axes


def draw_after_jumps(report: GapReport) -> np.ndarray:
    """Pooled counts by the time since the light jumped, over what the base and the grown model expect."""
    rows = report.details["after_jumps"]
    _, axes = _new(9, 1.0 + 0.16 * len(rows))
    axis = axes[0, 0]
    at = np.arange(len(rows))[::-1]
    for key, colour, mark in (("base", "0.5", "o"), ("grown", "tab:green", "|")):
        axis.plot(
            [r["measured"] / max(r[key], 1.0) for r in rows], at, mark, color=colour, label=f"measured / {key} model"
        )
    axis.set_yticks(at, [r["where"] for r in rows], fontsize=5)
    axis.set_xscale("log")
    axis.axvline(1, color="k", linewidth=0.6)
    axis.legend(fontsize=7)
    return axes


def draw_term(report: GapReport) -> np.ndarray:
    term = report.term
    assert term is not None
    order = np.argsort(-np.abs(term.shift / np.maximum(term.se, 1e-12)))[:24]
    order = np.sort(order)[::-1]
    sigma = 100.0 * report.model.values.get("threshold_sigma", 0.02)
    _, axes = _new(7.5, 1.2 + 0.24 * len(order))
    axis = axes[0, 0]
    axis.errorbar(
        sigma * term.shift[order], range(len(order)), xerr=1.96 * sigma * term.se[order], fmt="o", color="tab:purple"
    )
    axis.set_yticks(range(len(order)), [term.labels[i] for i in order], fontsize=7)
    axis.axvline(0, color="k", linewidth=0.6)
    axis.set_xlabel("threshold shift [%] that would explain it", fontsize=8)
    axis.set_title(f"what no effect explains, by {term.factor}", fontsize=9)
    return axes
