"""Windows that a readout leaves of each event time, and first guesses of the times in them.

Of an event that waited in a queue: from the arrival of the one that began the busy period to its own departure less one
service time.  Of a rounded one: the tick around it.  Of a jittered one: a normal about its stamp.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import isotonic_regression

from pixelid.likelihood.clocks import light_on_clock
from pixelid.model.model import Model
from pixelid.recordings.recording import Recording
from pixelid.simulate import simulate_row
from pixelid.stimuli.pixel_lights import in_a_row

DELAY = "delay_s"  # of the stamps, which is also that of the clock of events against the light


@dataclass(frozen=True)
class Windows:
    """One recording's windows.

    lo, hi: (n,) ns, in the order of its events; equal where the time is exact
    stamp: (n,) ns, about which times scatter, and sd: ns, by how much; without jitter nothing but the window counts
    in_order: whether a pixel's events came in the order of their stamps
    """

    lo: np.ndarray
    hi: np.ndarray
    stamp: np.ndarray | None = None
    sd: float = np.inf
    in_order: bool = False

    @property
    def centre(self) -> np.ndarray:
        """(n,) ns, what stands for the stamp: it, or the middle of the window."""
        return 0.5 * (self.lo + self.hi) if self.stamp is None else self.stamp

    @property
    def spread_s(self) -> float:
        """Standard deviation of the centres about the times, s."""
        return float(np.mean(self.spreads_s))

    @property
    def spreads_s(self) -> np.ndarray:
        """(n,) s, of each centre about its time: that of a uniform window, or the jitter's."""
        if self.stamp is not None:
            return np.full(len(self.lo), 1e-9 * self.sd)
        return 1e-9 * (self.hi - self.lo) / np.sqrt(12.0)

    def only(self, kept: np.ndarray) -> Windows:
        """Of some events: kept (n,) bool."""
        stamp = None if self.stamp is None else self.stamp[kept]
        return replace(self, lo=self.lo[kept], hi=self.hi[kept], stamp=stamp)


def queue_windows(recording: Recording, service_s: float) -> Windows:
    """When the events of a recording can have arrived at a server of that service time."""
    t = recording.events.t.astype(float)
    service = service_s * 1e9
    slack = 2.0 * recording.events.tick_ns + 1e-6 * service  # rounding of both stamps, and of the service time
    waited = np.concatenate([[False], np.diff(t) <= service + slack])
    begins = np.maximum.accumulate(np.where(waited, -1, np.arange(len(t)))) if len(t) else np.empty(0, int)
    arrival = t - service
    return Windows(np.minimum(arrival[begins], arrival), arrival, in_order=True)


def tick_windows(recording: Recording, tick_s: float) -> Windows:
    """When rounded events can have come."""
    t = recording.events.t.astype(float)
    half = 0.5e9 * tick_s
    return Windows(t - half, t + half)


def with_stamp_delay(model: Model, tick_s: float) -> Model:
    """The model with a free delay of the stamps, within half a tick of the one it has.

    Cameras stamp a tick's beginning, its middle, or its end, and say so nowhere; windows are about its middle.
    """
    delay = model.parameter(DELAY)
    half = 0.5 * tick_s
    freed = replace(delay, lower=delay.value - half, upper=delay.value + half, free=True)
    return replace(model, parameters={**model.parameters, DELAY: freed})


def jitter_windows(recording: Recording, sigma_s: float) -> Windows:
    """When jittered events can have come."""
    assert recording.stimulus is not None
    n, light = len(recording.events), recording.stimulus
    lo, hi = (np.full(n, edge) for edge in (np.ceil(1e9 * light.start_s), np.floor(1e9 * light.end_s)))
    return Windows(lo, hi, recording.events.t.astype(float), 1e9 * sigma_s)


def guess_edges(recordings: Sequence[Recording], windows: Sequence[Windows], early: bool) -> list[np.ndarray]:
    """First guesses of the times (n,) ns: where windows begin (`early`), or their middles."""
    return [in_order(r, w.lo if early else 0.5 * (w.lo + w.hi)) for r, w in zip(recordings, windows, strict=True)]


def guess_by_rank(
    recordings: Sequence[Recording], windows: Sequence[Windows], model: Model, pixels: np.ndarray, seed: int
) -> list[np.ndarray]:
    """First guesses of the times (n,) ns of queued events, from how fast `pixels` (flat indices) of the model fire.

    First come, first served keeps the order: the k-th event of a busy period is the k-th of all pixels to fire since
    it began, so it came about when the expected number of events since then was k.
    """
    guesses = []
    crowd_pixels = 400  # simulated, behind an expected number of events: it is known to a twentieth of an event
    for i, (recording, window) in enumerate(zip(recordings, windows, strict=True)):
        assert recording.stimulus is not None
        copies = max(1, round(crowd_pixels / len(pixels)))
        here = model.in_recording(recording.name)
        seen = light_on_clock(recording, recording.stimulus, here.circuit())
        light = in_a_row(seen, np.tile(pixels, copies))
        crowd = simulate_row(here, light, copies * len(pixels), seed=seed + i).events
        when, number = crowd.t.astype(float), np.arange(len(crowd)) / copies
        begins = window.hi <= window.lo
        head = np.maximum.accumulate(np.where(begins, np.arange(len(begins)), 0))
        if len(when) < 2 or not len(head):
            guesses.append(window.lo.copy())
            continue
        since = np.arange(len(head)) - head
        expected = np.interp(np.interp(window.lo[head], when, number) + since, number, when)
        guesses.append(in_order(recording, np.clip(expected, window.lo, window.hi)))
    return guesses


def guess_spaced(recordings: Sequence[Recording], windows: Sequence[Windows], dead_s: float) -> list[np.ndarray]:
    """The times (n,) ns nearest to the stamps, by squares, with a pixel's events a dead time apart at least."""
    spacing = 1.1  # times the dead time that first guesses are apart: just feasible
    gap, guesses = spacing * 1e9 * dead_s, []
    for recording, window in zip(recordings, windows, strict=True):
        assert window.stamp is not None
        t = window.stamp
        order = np.lexsort((t, recording.events.pixel))
        out = t.copy()
        for chunk in np.split(order, np.flatnonzero(np.diff(recording.events.pixel[order])) + 1):
            if len(chunk):
                least = gap * np.arange(len(chunk))
                out[chunk] = isotonic_regression(t[chunk] - least).x + least
        guesses.append(np.clip(out, window.lo, window.hi))
    return guesses


def with_times(recordings: Sequence[Recording], times: Sequence[np.ndarray]) -> list[Recording]:
    """The recordings at other times (n,) ns, given in the order of their events."""
    moved = []
    for recording, t in zip(recordings, times, strict=True):
        order = np.argsort(t, kind="stable")
        events = recording.events.select(order)
        events = replace(events, t=np.maximum(np.rint(t[order]), 0).astype(np.int64), tick_ns=1)
        moved.append(replace(recording, events=events))
    return moved


def in_order(recording: Recording, t: np.ndarray) -> np.ndarray:
    """The times with each pixel's events in the order they were read out."""
    t = t.copy()
    order = np.argsort(recording.events.pixel, kind="stable")
    pixel = recording.events.pixel[order]
    for chunk in np.split(order, np.flatnonzero(np.diff(pixel)) + 1):
        t[chunk] = np.maximum.accumulate(t[chunk] + 0.0)
    return t
