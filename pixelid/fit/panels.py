"""Panels that figures of fits, searches and calibrations share: the light, event rates, differences, residuals."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d

from pixelid.figures.style import INK, MUTED, OFF, ON
from pixelid.likelihood.clocks import light_on_clock
from pixelid.model.model import Model
from pixelid.recordings.events import Events
from pixelid.recordings.own_light import with_fine_light
from pixelid.recordings.recording import Recording
from pixelid.simulate import simulate_row
from pixelid.stimuli.pixel_lights import Light, PixelLights, in_a_row

POINTS = 150  # of a curve: two per pixel of a screen
# Events are counted in `FINE` bins per point and smoothed over `SMOOTH` points: bins alone beat with a periodic light.
FINE, SMOOTH = 4, 0.7
BINS = 100  # of differences, whose counts must not be smoothed: their scatter is what they are compared with
RESIDUAL_BINS = 24
LEAST_IN_BIN = 8  # events whose mean is drawn: its error is then below 0.36 standard deviations
SHORTEST = 1e-9  # seconds: two events of one timestamp, on a logarithmic axis
SIDES = ((1, 1.0, ON, "ON"), (0, -1.0, OFF, "OFF"))  # polarity, its side of the axis, colour, name


def light_of(recording: Recording, between: str) -> Light:
    """The light of a recording as a fit reads it, `between` its samples."""
    light = with_fine_light(recording, between).stimulus
    assert light is not None
    return light


def simulated(model: Model, recording: Recording, light: Any, seed: int, pixels: int) -> Events:
    """Events of a model on the clock of a recording, of so many of its active pixels in a row."""
    active = np.unique(recording.events.pixel)
    chosen = active[np.linspace(0, len(active) - 1, pixels).astype(int)]
    own = model.in_recording(recording.name)
    row = light_on_clock(recording, in_a_row(light, chosen), own.circuit())
    return simulate_row(own, row, pixels, seed=seed).events


def draw_light(axis: Any, recording: Recording) -> None:
    """The light over time, as recorded."""
    light = recording.stimulus
    assert light is not None
    light = light.average() if isinstance(light, PixelLights) else light
    values = light.radiance if light.radiance.ndim == 1 else light.radiance.mean(axis=(1, 2))
    t, low, high = envelope(light.t, values)
    axis.fill_between(t, low, high, color=INK, alpha=0.85, linewidth=0.8, edgecolor=INK)
    axis.set_ylabel(f"light\n({light.unit})")
    axis.tick_params(labelbottom=False)
    axis.margins(y=0.15)
    axis.yaxis.get_major_locator().set_params(nbins=3)


def draw_rates(
    axis: Any, recording: Recording, light: Any, copies: Mapping[str, tuple[Events, int, str | None, str]]
) -> None:
    """Events per second and pixel, ON up and OFF down: measured as areas, simulated as lines.

    Args:
        axis: to draw on.
        recording: measured.
        light: that spans the time shown.
        copies: by label, simulated events, of how many pixels, colour (None: that of the polarity), kind of line.
    """
    edges = np.linspace(light.start_s, light.end_s, FINE * POINTS + 1)
    centre = 0.5 * (edges[1:] + edges[:-1])[FINE // 2 :: FINE]
    pixels = max(len(np.unique(recording.events.pixel)), 1)
    for polarity, sign, colour, name in SIDES:
        scale = sign / np.diff(edges)[0]
        measured = scale / pixels * _smooth(recording.events, polarity, edges)
        axis.fill_between(centre, measured, color=colour, alpha=0.4, linewidth=0, label=f"{name}, measured")
        for label, (copy, many, own, line) in copies.items():
            rate = scale / many * _smooth(copy, polarity, edges)
            shown = f"{name}, {label}" if own is None else label if polarity else None
            axis.plot(centre, rate, line, color=own or colour, linewidth=0.9, label=shown)
    axis.axhline(0.0, color=INK, linewidth=0.5)
    axis.set_xlim(edges[0], edges[-1])
    axis.set_ylabel("events/s\nper pixel")
    axis.yaxis.get_major_locator().set_params(nbins=4)


def draw_difference(axis: Any, recording: Recording, light: Any, copy: Events, pixels: int, mark: str = ".") -> None:
    """Measured minus simulated counts, in standard deviations of their difference.

    Args:
        axis: to draw on.
        recording: measured.
        light: that spans the time shown.
        copy: simulated events.
        pixels: that were simulated.
        mark: of a bin.
    """
    edges = np.linspace(light.start_s, light.end_s, BINS + 1)
    share = max(len(np.unique(recording.events.pixel)), 1) / pixels
    for polarity, _, colour, _ in SIDES:
        measured, expected = (
            np.histogram(events.t[events.p == polarity] * 1e-9, edges)[0] for events in (recording.events, copy)
        )
        chance = np.sqrt(measured + expected * share**2)
        some = chance > 0
        score = (measured - expected * share)[some] / chance[some]
        axis.plot(0.5 * (edges[1:] + edges[:-1])[some], score, mark, color=colour, markersize=3)
    axis.set_ylabel("difference\n(σ)")


def _smooth(events: Any, polarity: int, edges: np.ndarray) -> np.ndarray:
    """(POINTS,) counts per fine bin, smoothed: what a light that is periodic within a bin would make a comb of."""
    counts = np.histogram(events.t[events.p == polarity] * 1e-9, edges)[0].astype(float)
    return gaussian_filter1d(counts, SMOOTH * FINE, mode="nearest")[FINE // 2 :: FINE]


def envelope(t: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(times, least, largest value) in at most `POINTS` stretches: nothing that a long curve does is left out.

    >>> t, low, high = envelope(np.arange(1000.0), np.arange(1000.0) % 2)
    >>> len(t), float(low.max()), float(high.min())
    (143, 0.0, 1.0)
    """
    step = max(-(-len(t) // POINTS), 1)
    starts = np.arange(0, len(t), step)
    return t[starts], np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)


def draw_by_interval(axis: Any, likelihood: Any, residual: np.ndarray, kept: np.ndarray) -> None:
    """Mean residuals against the time since the pixel's previous event."""
    since = np.concatenate([iv.time_s - iv.previous_s for iv in likelihood.intervals])
    ends = _ends(np.maximum(since[kept], SHORTEST))
    bins = np.geomspace(*ends, RESIDUAL_BINS + 1)
    _draw_means(axis, np.maximum(since, SHORTEST), bins, np.sqrt(bins[1:] * bins[:-1]), likelihood, residual, kept)
    axis.set(xscale="log", xlim=ends)


def draw_by_time(axis: Any, likelihood: Any, residual: np.ndarray, kept: np.ndarray) -> None:
    """Mean residuals against the time in the recording, as a share of it."""
    pairs = zip(likelihood.intervals, likelihood.recordings, strict=True)
    share = np.concatenate([(iv.time_s - r.stimulus.start_s) / max(r.stimulus.duration_s, 1e-12) for iv, r in pairs])
    bins = np.linspace(0.0, 1.0, RESIDUAL_BINS + 1)
    _draw_means(axis, share, bins, 0.5 * (bins[1:] + bins[:-1]), likelihood, residual, kept)
    axis.set_xlim(0.0, 1.0)


def draw_by_recording(axis: Any, likelihood: Any, residual: np.ndarray, kept: np.ndarray) -> None:
    """Mean residuals of each recording, under its name."""
    names = [recording.name for recording in likelihood.recordings]
    bins = np.arange(len(names) + 1) - 0.5
    for shift, sign in ((-0.12, 1.0), (0.12, -1.0)):
        own = kept & (likelihood.sign == sign)
        _draw_means(axis, likelihood.recording_of_event, bins, np.arange(len(names)) + shift, likelihood, residual, own)
    axis.set_xticks(range(len(names)), names, rotation=90 if len(names) > 2 else 0)
    axis.set_xlim(-0.6, len(names) - 0.4)
    axis.grid(False, axis="x")


def _draw_means(
    axis: Any, values: np.ndarray, bins: np.ndarray, at: np.ndarray, likelihood: Any, residual: np.ndarray,
    kept: np.ndarray,
) -> None:  # fmt: skip
    """Means with two standard errors, of ON and OFF, of the residuals whose `values` are in each of the bins."""
    index = np.clip(np.digitize(values, bins) - 1, 0, len(bins) - 2)
    for sign, colour, name in ((1.0, ON, "ON"), (-1.0, OFF, "OFF")):
        own = kept & (likelihood.sign == sign)
        count = np.bincount(index[own], minlength=len(at))
        mean = np.bincount(index[own], residual[own], len(at)) / np.maximum(count, 1)
        full = count >= LEAST_IN_BIN
        if full.any():
            axis.errorbar(
                at[full], mean[full], 2 / np.sqrt(count[full]), fmt=".", color=colour, linewidth=0.9, label=name
            )
    axis.axhline(0.0, color=INK, linewidth=0.6)


def _ends(values: np.ndarray) -> tuple[float, float]:
    return (float(values.min()), 1.001 * float(values.max())) if len(values) else (1e-4, 1.0)


def draw_distribution(axis: Any, residual: np.ndarray) -> None:
    """Histogram of residuals and the standard normal; those beyond ±5 are in the outermost bins."""
    grid = np.linspace(-5, 5, 61)
    axis.hist(np.clip(residual, -5, 5), grid, density=True, color=MUTED, alpha=0.6, label="residuals")
    axis.plot(grid, np.exp(-0.5 * grid**2) / np.sqrt(2 * np.pi), color=INK, linewidth=0.9, label="standard normal")
    axis.set(ylabel="density", xlim=(-5, 5))
    axis.set_ylim(0, None)
