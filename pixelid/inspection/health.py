"""Everything `inspect` says about a recording, in one value."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from pixelid.inspection.ceiling import Ceiling, find_ceiling
from pixelid.inspection.counts import Counts, count
from pixelid.inspection.dead_time import DeadTime, find_dead_time
from pixelid.inspection.hot_pixels import HotPixel, find_hot_pixels
from pixelid.inspection.intervals import pixel_interval_pairs, pixel_intervals
from pixelid.inspection.lines import Line, find_lines
from pixelid.inspection.tick import Tick, find_tick
from pixelid.recordings.recording import Recording

HOT_PIXELS_LISTED = 100


@dataclass(frozen=True)
class Health:
    """What the events of a recording show by themselves."""

    name: str
    sensor: str
    width: int
    height: int
    pooled: bool
    counts: Counts
    dead_time: DeadTime
    tick: Tick
    lines: list[Line]
    hot_pixels: list[HotPixel]
    ceiling: Ceiling | None

    def to_dict(self) -> dict:
        """The stable keys of `inspect --json`."""
        counts, dead, tick = self.counts, self.dead_time, self.tick
        return {
            "name": self.name,
            "sensor": self.sensor,
            "events": counts.events,
            "duration_s": counts.duration_s,
            "width": self.width,
            "height": self.height,
            "pooled": self.pooled,
            "active_pixels": counts.active_pixels,
            "on_fraction": counts.on_fraction,
            "rate_hz": {"mean": counts.mean_hz, "peak": counts.peak_hz, "peak_window_s": counts.peak_window_s},
            "duplicates": counts.duplicates,
            "dead_time_s": {
                "value": dead.value_s,
                "interval_95": dead.interval_95_s,
                "visible": dead.value_s is not None,
                "reason": dead.reason,
                "intervals": dead.intervals,
                "below": dead.below,
                "kind": dead.kind,
                "edge_95": dead.edge_95_s,
            },
            "tick_s": tick.tick_s,
            "tick": {
                "clock_s": tick.clock_s,
                "scan_s": tick.scan_s,
                "scan_jitter_s": tick.scan_jitter_s,
                "concentration": tick.concentration,
            },
            "lines": [asdict(line) for line in self.lines],
            "hot_pixels": [asdict(pixel) for pixel in self.hot_pixels[:HOT_PIXELS_LISTED]],
            "hot_pixel_count": len(self.hot_pixels),
            "ceiling": None if self.ceiling is None else asdict(self.ceiling),
        }


def inspect(recording: Recording) -> Health:
    """Health of `recording` from its events; O(n log n) time, memory a small multiple of the events.

    A pooled recording has no pixels: its dead time, hot pixels, duplicates and ceiling are not looked for.
    """
    events, pooled = recording.events, recording.pooled
    intervals = pixel_intervals(events)
    tick = find_tick(events, intervals)
    if pooled:
        dead_time = DeadTime(None, None, "pixels are pooled", 0)
    else:
        dead_time = find_dead_time(intervals, tick.tick_s, pixel_interval_pairs(events))
    return Health(
        name=recording.name,
        sensor=recording.sensor,
        width=events.width,
        height=events.height,
        pooled=pooled,
        counts=count(events, pooled),
        dead_time=dead_time,
        tick=tick,
        lines=find_lines(events, tick.tick_s),
        hot_pixels=[] if pooled else find_hot_pixels(events),
        ceiling=None if pooled else find_ceiling(events, tick.clock_s),
    )
