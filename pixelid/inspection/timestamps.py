"""Timestamp signatures: what the readout did to the timestamps, seen in them alone, before any model is fitted.

**One server** (`readout_latency`): with service time s no two events leave less than s apart, and an event that had to
wait leaves exactly s after the one before.  Of the waits between successive events of different pixels, none is shorter
than s, and an atom sits at s on a density that is smooth elsewhere.

**A grid** (`timestamp_quantisation`): all timestamps are multiples of a tick that is coarser than the file's own, or
the waits of single pixels are multiples of a scan period, up to a small jitter (both found by `inspection.tick`).  Of
the two the coarser limits what is known of a time.  A divisor far below the intervals of a pixel, such as the rounding
of a float, is a fact about the file and explains nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pixelid.errors import InputError
from pixelid.inspection.intervals import pixel_intervals
from pixelid.inspection.tick import MIN_EVENTS, common_divisor, find_tick
from pixelid.recordings.events import COARSE_UNIT_SHARE, SHORT_QUANTILE, Events
from pixelid.recordings.recording import Recording
from pixelid.statistics import Z95

MIN_ATOM_EVENTS = 20
MAX_ATOM_CHANCE = 1e-12  # of an atom by accident; a recording offers some 1e6 places where one could be
MIN_GRID_UNITS = 1.5  # a grid is coarser than the file's own unit
ROUNDING_SD = 12.0**-0.5  # of what rounding moves a number by, in units
# Of the shortest intervals of a pixel (their 1 % quantile).  Thresholds scatter by 2 % and more of an interval; a tick
# of a thousandth adds (1e-3/√12)² to that variance, 2e-4 of it: nobody could tell.
MIN_TICK_SHARE = 1e-3


@dataclass(frozen=True)
class TimestampSignature:
    """One effect that the timestamps show.

    Attributes:
        effect, parameter: their names in the effect library.
        value, interval: in the parameter's unit, the interval at 95 %.
        p: chance of it by accident.
        nats_per_event: what knowing it gains per event concerned.
        concerned: share of the events concerned.
        where: in words.
    """

    effect: str
    parameter: str
    value: float
    interval: tuple[float, float]
    p: float
    nats_per_event: float
    concerned: float
    where: str


def find_timestamp_signatures(recordings: Sequence[Recording]) -> list[TimestampSignature]:
    """What the timestamps of the recordings (of one sensor) show."""
    queue = find_service_time(recordings)
    # a busy server stamps its pixels a whole number of service times apart: then only a common divisor is a grid
    signatures = [queue, find_grid(recordings, scans=queue is None)]
    return [signature for signature in signatures if signature is not None]


def with_coarse_units_as_grids(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings, whose stated unit is a nanosecond where the one they state is as coarse as pixels are fast.

    A fine unit is a fact about the file, and its rounding a small noise of the stamps.  One of `COARSE_UNIT_SHARE` of
    the shortest intervals or more is a grid like any other: what is between its lines has to be found.

    Raises:
        InputError: where one recording counts so coarsely and another does not: a sensor has one grid.
    """
    if not any(_is_coarse(r.events) for r in recordings):
        return list(recordings)
    coarsest, finest = (most(recordings, key=lambda r: r.events.tick_ns) for most in (max, min))
    if coarsest.events.tick_ns != finest.events.tick_ns:
        raise InputError(
            f"{coarsest.name} counts time in units of {1e-6 * coarsest.events.tick_ns:g} ms, as coarse as its pixels "
            f"are fast, and {finest.name} in {1e-6 * finest.events.tick_ns:g} ms: search them apart"
        )
    return [replace(r, events=replace(r.events, tick_ns=1)) for r in recordings]


def _is_coarse(events: Events) -> bool:
    intervals = pixel_intervals(events) if events.tick_ns > 1 else np.empty(0)
    apart = intervals[intervals > 0]
    return len(apart) > 0 and events.tick_ns >= COARSE_UNIT_SHARE * float(np.quantile(apart, SHORT_QUANTILE))


def find_service_time(recordings: Sequence[Recording]) -> TimestampSignature | None:
    """The service time of one server; None where there is no sign of it."""
    from scipy.stats import poisson

    waits = []
    for r in recordings:
        other = np.diff(r.events.pixel) != 0
        waits.append(np.diff(r.events.t)[other])
    wait = np.concatenate(waits) if waits else np.empty(0, np.int64)
    unit = max((r.events.tick_ns for r in recordings), default=1)
    if len(wait) < 5 * MIN_ATOM_EVENTS:
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
    if len(atom) < MIN_ATOM_EVENTS or p > MAX_ATOM_CHANCE:
        return None
    value = float(atom.mean()) * 1e-9
    # waits average out their rounding, but not where arrivals are whole nanoseconds (a simulator's): those are rounded
    # alike.  The mean of waits that are there by chance lies half a width further.
    rounding = ROUNDING_SD * np.hypot(unit / np.sqrt(len(atom)), 1.0)
    by_chance = 0.5 * width * min(expected / len(atom), 1.0)
    error = float(np.sqrt(atom.var() / len(atom) + rounding**2 + by_chance**2)) * 1e-9
    gain = float(np.log(len(atom) / expected) + density * least / len(atom))
    share = len(atom) / sum(len(r.events) for r in recordings)
    return TimestampSignature(
        "readout_latency", "readout_latency.service_s", value, (value - Z95 * error, value + Z95 * error), p, gain,
        share,
        f"no two pixels' events are less than {1e6 * value:.4g} µs apart, and {100 * share:.0f} % of all events come "
        "exactly that after the one before",
    )  # fmt: skip


def find_grid(recordings: Sequence[Recording], scans: bool = True) -> TimestampSignature | None:
    """The tick of the timestamps, where it is coarser than the unit that the files count in.

    scans: also look for the period of a scan in the waits of single pixels
    """
    t = np.concatenate([r.events.t for r in recordings]) if recordings else np.empty(0, np.int64)
    unit = max((r.events.tick_ns for r in recordings), default=1) * 1e-9
    if len(t) < MIN_EVENTS:
        return None
    tick, error, of = common_divisor(t) * 1e-9, 0.5e-9, "all timestamps"
    largest = max(recordings, key=lambda r: len(r.events)).events
    intervals = pixel_intervals(largest)
    if scans:
        seen = find_tick(largest, intervals)
        if seen.scan_s is not None and seen.scan_s > MIN_GRID_UNITS * tick:
            tick, error = seen.scan_s, float(seen.scan_jitter_s or 0.0) / float(np.sqrt(len(largest)))
            of = "the intervals of single pixels"
    apart = intervals[intervals > 0]
    explains = len(apart) > 0 and tick >= MIN_TICK_SHARE * 1e-9 * float(np.quantile(apart, SHORT_QUANTILE))
    if tick < MIN_GRID_UNITS * unit or not explains:
        return None
    gain = float(np.log(tick / unit))
    return TimestampSignature(
        "timestamp_quantisation", "timestamp_quantisation.tick_s", tick, (tick - Z95 * error, tick + Z95 * error),
        float(np.exp(-min(gain * len(t), 700.0))), gain, 1.0, f"{of} are multiples of {1e6 * tick:.6g} µs",
    )  # fmt: skip
