"""What histograms of a still scene's intervals showed: one value per polarity and light, and all together."""

from __future__ import annotations

from dataclasses import dataclass

from pixelid.inspection.leak_by_light import LeakByLight
from pixelid.inspection.renewal import Slow

Value = tuple[float, float, float]  # value, 95 % interval


@dataclass(frozen=True)
class Condition:
    """What one polarity at one light shows.

    duration_s: of the recording, from pixels with ten intervals or more;  None with fewer than 20 such pixels
    duration_at_least_s: the longest sum of a pixel's shortest possible intervals
    fast: how many pixels have ten intervals or more;  fast_share: of all intervals that is theirs
    rate_hz: of the median pixel;  cv: of a pixel's own intervals;  None where too few
    cv_of_poisson: of Poisson pixels with the same numbers of events, found the same way
    slow: the fit to pixels with few intervals, for which rate_hz and cv are then quoted;  None where most are fast
    second_event_hz: where nothing repeats, the rate below which it must lie (95 %)
    kind: "regular" | "irregular" | "silent"
    """

    name: str
    polarity: str
    lux: float
    pixels: int
    intervals: int
    without_intervals: float
    duration_s: Value | None
    duration_at_least_s: float
    fast: int
    fast_share: float
    rate_hz: Value | None
    cv: Value | None
    cv_of_poisson: float | None
    slow: Slow | None
    second_event_hz: float | None
    kind: str


@dataclass(frozen=True)
class StaticNoise:
    """All conditions, leak against light where two lights have regular ON firing, and sentences."""

    conditions: tuple[Condition, ...]
    by_light: LeakByLight | None
    lux: tuple[float, float] | None
    findings: tuple[str, ...]
    unknown: tuple[str, ...]
