"""What is known of a recording's clock before its events are looked at: what a fit carries as nuisances.

`pixelid convert --align` puts the light on the camera's clock as well as it can.  What it leaves, a delay and a
difference of the clocks' rates, is a Gaussian whose two numbers are independent at one moment of the recording:

    trigger     the delay at the edge as well as the camera stamps edges
    given       the delay at the light's time zero as well as stated, 1 ms where it is not
    auto        the delay not at all
    inherited   1 ms: a light that does not change, or no events

and the rate as well as clocks are known to agree, unless they are stated to be one.  `auto` says nothing of what it has
found: it has found it among the same events, and a fit that took its interval for a prior would count them twice.  For
the same reason a second trigger edge, which is as easily misplaced as the first, does not count as the rate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from pixelid.documents import is_number
from pixelid.errors import InputError
from pixelid.recordings.recording import Recording

# Standard deviation of two clocks' rate difference: each crystal is within ± 100 ppm over make, temperature
# and age, evenly: 100 √2/√3 = 82 ppm, and a few are worse.
CRYSTAL = 1e-4
ONE_CLOCK = 1e-7  # the same of two devices on one clock: rounding of their ticks
# Ways of alignment that leave an uncertainty.  Without an interval it is exact: "first-event", and files from before
# `given` had one.
ESTIMATED = ("trigger", "auto", "given", "inherited")


@dataclass(frozen=True)
class ClockPrior:
    """A Gaussian of the delay and of the clocks' rate, independent at one moment.

    at_s: that moment, on the recording's clock;  span_s: how long the light lasts
    delay_sd_s: of the delay that the alignment has left, about 0; None: nothing is known of it
    rate_mean, rate_sd: of the clock rate error, seconds that the camera counts per second of the light, less one
    """

    at_s: float
    span_s: float
    delay_sd_s: float | None
    rate_mean: float
    rate_sd: float


@dataclass(frozen=True)
class AlignedClock:
    """What a recording says of how it was aligned.

    method: of `ESTIMATED`;  offset_s, rate_error: as of `recordings.alignment.Alignment`;  prior: see there
    half_s: half the 95 % interval of the offset
    """

    method: str
    offset_s: float
    rate_error: float
    prior: ClockPrior
    half_s: float


def clock_of(recording: Recording) -> AlignedClock | None:
    """How a recording was aligned, where that leaves an uncertainty: its attribute `alignment` has an interval.

    Raises:
        InputError: numbers missing or impossible in it.
    """
    written = recording.attributes.get("alignment")
    if not isinstance(written, Mapping):  # nothing, or words that somebody else put there
        return None
    where = f"{recording.source or recording.name}: alignment"
    method, interval = written.get("method"), written.get("offset_interval_95")
    if method not in ESTIMATED or interval is None:
        return None
    if not isinstance(interval, Sequence) or len(interval) != 2 or not all(map(is_number, interval)):
        raise InputError(f"{where}: offset_interval_95: expected two numbers, found {str(interval)[:40]!r}")
    half_s = 0.5 * abs(float(interval[1]) - float(interval[0]))
    offset_s, rate_error = (_number(written, name, where) for name in ("offset_s", "clock_rate_error"))
    prior, light = written.get("prior"), recording.stimulus
    if prior is None and light is not None:  # files from before it was written
        middle = 0.5 * (light.start_s + light.end_s)
        prior = asdict(ClockPrior(middle, light.duration_s, None, 0.0, CRYSTAL))
    where = f"{where}.prior"
    if not isinstance(prior, Mapping):
        raise InputError(f"{where}: expected a JSON object, found {str(prior)[:40]!r}")
    at_s, mean = (_number(prior, name, where) for name in ("at_s", "rate_mean"))
    span_s, sd = (_number(prior, name, where, positive=True) for name in ("span_s", "rate_sd"))
    delay_sd_s = None if prior.get("delay_sd_s") is None else _number(prior, "delay_sd_s", where, positive=True)
    return AlignedClock(method, offset_s, rate_error, ClockPrior(at_s, span_s, delay_sd_s, mean, sd), half_s)


def _number(table: Mapping[str, Any], name: str, where: str, positive: bool = False) -> float:
    value = table.get(name)
    if not is_number(value) or not np.isfinite(value) or (positive and value <= 0):
        raise InputError(f"{where}: {name}: expected a {'positive ' * positive}number, found {str(value)[:40]!r}")
    return float(value)


@dataclass(frozen=True)
class Alignment:
    """Where the light's time zero lies on the camera's clock.

    offset_s: seconds on the camera's clock;  offset_interval_95: None where it counts as exact
    rate_error: seconds that the camera counts per second of the light, less one
    rate_interval_95: likewise;  method: "trigger", "first-event", "auto", "given" or "inherited"
    prior: of the clock without the events, at a moment of the light's clock; None: offset and rate count as exact
    start_s, start_half_s: the light's first sample on the camera's clock, and half its 95 % interval: far from the time
        zero of a trace that began long before, the rate's uncertainty has not added up
    note: what has to be stated with it
    """

    offset_s: float
    method: str
    offset_interval_95: tuple[float, float] | None = None
    rate_error: float = 0.0
    rate_interval_95: tuple[float, float] | None = None
    prior: ClockPrior | None = None
    start_s: float | None = None
    start_half_s: float | None = None
    note: str = ""

    def as_dict(self) -> dict:
        """What the recording's attribute `alignment` says."""
        return {
            "method": self.method,
            "offset_s": self.offset_s,
            "offset_interval_95": self.offset_interval_95,
            "clock_rate_error": self.rate_error,
            "clock_rate_interval_95": self.rate_interval_95,
        }

    def sentence(self) -> str:
        """The alignment in words."""
        start = self.offset_s if self.start_s is None else self.start_s
        if self.start_half_s is None:
            return f"light starts at {start:.6f} s of the camera's clock ({self.method})"
        text = f"light starts at {start:.6f} s ± {_digits(1e6 * self.start_half_s)} µs of the camera's clock"
        if self.rate_interval_95 is not None:
            half = 0.5e6 * (self.rate_interval_95[1] - self.rate_interval_95[0])
            text += f", clocks differ by {_digits(1e6 * self.rate_error, half)} ± {_digits(half)} ppm"
        return f"{text} ({self.note})" if self.note else text


def _digits(value: float, error: float | None = None) -> str:
    """A value with as many places as its error deserves, its own size where none is given."""
    return f"{value:.{0 if abs(value if error is None else error) >= 9.5 else 1}f}"
