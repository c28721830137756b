"""Fingerprints of the readout: what timestamps alone give away, before any model is fitted.

**One server** (`readout_latency`): with service time s no two events leave less than s apart, and whoever had to wait
leaves exactly s after the one before.  Of the waits between successive events of different pixels, none is shorter
than s, and an atom sits at s on a density that is smooth elsewhere.

**A grid** (`timestamp_quantisation`): all timestamps are multiples of a tick that is coarser than the file's own, or
the waits of single pixels are multiples of a scan period (`inspection.tick`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import poisson

from pixelid.inspection.intervals import pixel_intervals
from pixelid.inspection.tick import find_tick
from pixelid.recordings.recording import Recording

FEWEST = 20  # events in an atom
SURE = 1e-12  # chance of an atom by accident
FEWEST_STAMPS = 100
LEAST_GRID = 1.5  # times the file's own unit


@dataclass(frozen=True)
class Fingerprint:
    """effect, parameter: names;  value, interval: in s;  p: chance of it by accident;  nats_per_event: what knowing
    it gains per event concerned;  concerned: share of events concerned;  where: in words"""

    effect: str
    parameter: str
    value: float
    interval: tuple[float, float]
    p: float
    nats_per_event: float
    concerned: float
    where: str


def fingerprints(recordings: Sequence[Recording]) -> list[Fingerprint]:
    """What the timestamps of the recordings (of one sensor) give away."""
    queue = service(recordings)
    # a busy server stamps its pixels a whole number of service times apart: then only a common divisor is a grid
    found = [queue, grid(recordings, scans=queue is None)]
    return [f for f in found if f is not None]


def service(recordings: Sequence[Recording]) -> Fingerprint | None:
    """The service time of one server; None where there is no sign of it."""
    waits = []
    for r in recordings:
        other = np.diff(r.events.pixel) != 0
        waits.append(np.diff(r.events.t)[other])
    wait = np.concatenate(waits) if waits else np.empty(0, np.int64)
    unit = max((r.events.tick_ns for r in recordings), default=1)
    if len(wait) < 5 * FEWEST:
        return None
    least = int(wait.min())
    if least < 2 * unit:
        return None
    width = 2 * unit  # rounding of two timestamps
    atom = wait[(wait >= least) & (wait <= least + width)]
    reach = max(20 * width, least)
    beyond = np.count_nonzero((wait > least + width) & (wait <= least + width + reach))
    density = max(beyond, 1) / reach  # per ns
    expected = density * (width + unit)
    p = float(poisson.sf(len(atom) - 1, expected))
    if len(atom) < FEWEST or p > SURE:
        return None
    value = float(atom.mean()) * 1e-9
    error = max(float(atom.std()), 0.29 * unit) * 1e-9 / np.sqrt(len(atom))
    gain = float(np.log(len(atom) / expected) + density * least / len(atom))
    share = len(atom) / sum(len(r.events) for r in recordings)
    return Fingerprint(
        "readout_latency", "readout_latency.service_s", value, (value - 1.96 * error, value + 1.96 * error), p, gain,
        share,
        f"no two pixels' events are less than {1e6 * value:.4g} µs apart, and {100 * share:.0f} % of all events come "
        "exactly that after the one before",
    )  # fmt: skip


def grid(recordings: Sequence[Recording], scans: bool = True) -> Fingerprint | None:
    """The tick of the timestamps, where it is coarser than the unit that the files count in.

    scans: also look for the period of a scan in the waits of single pixels
    """
    t = np.concatenate([r.events.t for r in recordings]) if recordings else np.empty(0, np.int64)
    unit = max((r.events.tick_ns for r in recordings), default=1) * 1e-9
    if len(t) < FEWEST_STAMPS:
        return None
    tick, error, of = float(np.gcd.reduce(t)) * 1e-9, 0.5e-9, "all timestamps"
    if tick < LEAST_GRID * unit:
        if not scans:
            return None
        largest = max(recordings, key=lambda r: len(r.events)).events
        found = find_tick(largest, pixel_intervals(largest))
        if found.scan_s is None or found.scan_s < LEAST_GRID * unit:
            return None
        tick, error = found.scan_s, float(found.scan_jitter_s or 0.0) / float(np.sqrt(len(largest)))
        of = "the intervals of single pixels"
    gain = float(np.log(tick / unit))
    return Fingerprint(
        "timestamp_quantisation", "timestamp_quantisation.tick_s", tick, (tick - 1.96 * error, tick + 1.96 * error),
        float(np.exp(-min(gain * len(t), 700.0))), gain, 1.0, f"{of} are multiples of {1e6 * tick:.6g} µs",
    )  # fmt: skip
