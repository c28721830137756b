"""A recording as a figure: what came out above what went in."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pixelid.figures.style import INK, OFF, ON, new_axes, styled

if TYPE_CHECKING:
    from pixelid.recordings.recording import Recording

BINS = 200


@styled
def draw_recording(recording: Recording) -> np.ndarray:
    """Event rates, ON up and OFF down, and below them the light when it is known: axes (rows, 1)."""
    events, stimulus = recording.events, recording.stimulus
    time_s = events.t * 1e-9
    rows = 1 if stimulus is None else 2
    axes = new_axes(rows, 1, 7.0, 2.2, sharex=True)
    if stimulus is not None:
        start, end = stimulus.start_s, stimulus.end_s
    else:
        start, end = (float(time_s[0]), float(time_s[-1])) if len(events) else (0.0, 1.0)
    edges = np.linspace(start, max(end, start + 1e-9), BINS + 1)
    for polarity, sign, colour in ((1, 1.0, ON), (0, -1.0, OFF)):
        rate_hz = np.histogram(time_s[events.p == polarity], edges)[0] / np.diff(edges)
        axes[0, 0].fill_between(edges[:-1], sign * rate_hz, step="post", color=colour, alpha=0.6, linewidth=0)
    axes[0, 0].set_ylabel("events/s, ON up, OFF down")
    axes[0, 0].set_title(recording.name)
    if stimulus is not None:
        light = stimulus.average()
        axes[1, 0].plot(light.t, light.radiance, color=INK, linewidth=0.8)
        axes[1, 0].set_ylabel(f"light ({stimulus.unit})" if stimulus.full_field else f"mean light ({stimulus.unit})")
    axes[-1, 0].set_xlabel("time (s)")
    return axes
