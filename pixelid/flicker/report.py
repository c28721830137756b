"""A flicker fit on disk: flicker.json, phase histograms beside the fit, and maps of amplitude and phase."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pixelid.flicker.fit import FlickerFit
from pixelid.flicker.phases import BINS
from pixelid.outputs import write_json


def save(fit: FlickerFit, folder: Path) -> dict:
    """Write flicker.json, phases.png and maps.png into an existing folder; returns the JSON."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    found = fit.as_dict()
    write_json(folder / "flicker.json", found)
    shown = sorted(fit.groups, key=lambda g: -g.table.events)[:9]
    figure, axes = plt.subplots(3, 3, figsize=(11, 8), sharex=True, layout="constrained", squeeze=False)
    phase = (np.arange(BINS) + 0.5) / BINS
    for axis, g in zip(axes.flat, shown, strict=False):
        for counts, expected, colour, side in (
            (g.table.on.sum(0), g.fit.expected[0], "C1", 1),
            (g.table.off.sum(0), g.fit.expected[1], "C0", -1),
        ):
            axis.bar(phase, side * counts, 1 / BINS, color=colour, alpha=0.4)
            axis.plot(phase, side * expected, color=colour)
        axis.set_title(f"group {g.column}, {g.row}: {g.table.events} events", fontsize=9)
    figure.supxlabel(f"phase of {fit.frequency_hz:.3f} Hz [cycles]")
    figure.supylabel("events per bin, ON up and OFF down; lines: fit")
    figure.savefig(folder / "phases.png", dpi=100)
    plt.close(figure)
    figure, axes = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
    for axis, name, colours in (
        (axes[0], "amplitude_over_on_threshold", "viridis"),
        (axes[1], "phase_cycles", "twilight"),
    ):
        values = np.full(fit.grid[::-1], np.nan)
        for g in fit.groups:
            values[g.row, g.column] = g.fit.values[name]
        figure.colorbar(axis.imshow(values, cmap=colours), ax=axis, label=name)
    figure.savefig(folder / "maps.png", dpi=100)
    plt.close(figure)
    return found
