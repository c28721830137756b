"""Figures of an inspection: rate over time, intervals within pixels, events per pixel."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pixelid.inspection.health import Health
from pixelid.inspection.intervals import pixel_intervals
from pixelid.recordings.recording import Recording

RATE_BINS = 500


def write_figures(recording: Recording, health: Health, folder: Path) -> None:
    """Write rate.png, and for recordings with addresses intervals.png and pixels.png, into `folder`."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figures = {"rate": _draw_rate}
    if not recording.pooled:
        figures |= {"intervals": _draw_intervals, "pixels": _draw_pixels}
    for name, draw in figures.items():
        figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
        draw(axes, recording, health)
        figure.savefig(folder / f"{name}.png", dpi=120)
        plt.close(figure)


def _draw_rate(axes, recording: Recording, health: Health) -> None:
    events = recording.events
    time = (events.t - events.t[0]) * 1e-9 if len(events) else np.empty(0)
    edges = np.linspace(0, max(events.duration_s, 1e-9), RATE_BINS + 1)
    for polarity, label in ((1, "ON"), (0, "OFF")):
        counts, _ = np.histogram(time[events.p == polarity], edges)
        axes.stairs(counts / np.diff(edges), edges, label=label)
    axes.set(xlabel="time since the first event [s]", ylabel="events per second")
    axes.set_title(", ".join(f"line at {line.frequency_hz:.2f} Hz" for line in health.lines[:3]))
    axes.legend()


def _draw_intervals(axes, recording: Recording, health: Health) -> None:
    intervals = pixel_intervals(recording.events)
    intervals = intervals[intervals > 0] * 1e-9
    if len(intervals):
        axes.hist(intervals, np.geomspace(intervals.min(), intervals.max() * 1.001, 200), histtype="step")
        axes.set(xscale="log", yscale="log")
    if health.dead_time.value_s is not None:
        axes.axvline(health.dead_time.value_s, color="k", ls="--", label=f"dead time {health.dead_time.value_s:.3g} s")
        axes.legend()
    axes.set(xlabel="interval between events of a pixel [s]", ylabel="intervals")


def _draw_pixels(axes, recording: Recording, health: Health) -> None:
    events = recording.events
    image = np.bincount(events.pixel, minlength=events.width * events.height).reshape(events.height, events.width)
    shown = axes.imshow(np.log10(image + 1), cmap="viridis", interpolation="nearest")
    for pixel in health.hot_pixels[:100]:
        axes.plot(pixel.x, pixel.y, "o", mfc="none", mec="r")
    axes.figure.colorbar(shown, label="log10 (events + 1)")
    axes.set(xlabel="x", ylabel="y", title=f"{len(health.hot_pixels)} hot pixels")
