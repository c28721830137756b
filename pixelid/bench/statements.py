"""What is stated about a bench, and what the events say of it: only what they contradict is reported."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from pixelid.fit.result import FitResult
from pixelid.model.model import CLOCK_DELAY, CLOCK_RATE, LIGHT_GAIN, LIGHT_OFFSET
from pixelid.parameters.parameter import Parameter
from pixelid.recordings.session_alignment import RecordingAlignment

# Scales of its prior that a value must be away from what was stated.  Of a Student's t with four degrees of freedom 4 %
# are beyond 3, so of a dozen true statements one in two sessions would be reported by the prior alone; but a statement
# is reported only where its interval, too, leaves out everything within 3 scales.
CONTRADICTED = 3.0
STATED_DELAYS = "trigger", "given"  # alignments that state where the light begins; of others it is estimated


@dataclass(frozen=True)
class Statement:
    """A statement that the events contradict.

    statement: "level", "clock_rate", "delay", "unit", "offset", "polarity", "light" or "size"
    recording: that it is about, None for all;  stated, found: numbers, or names;  interval_95: of `found`
    sentence: what is wrong, by how much, and what it may be
    """

    statement: str
    recording: str | None
    stated: float | str
    found: float | str
    interval_95: tuple[float, float] | None
    sentence: str

    def as_dict(self) -> dict[str, Any]:
        """The entry in calibration.json."""
        return asdict(self)


def of_alignment(aligned: Sequence[RecordingAlignment]) -> list[Statement]:
    """What the alignment of a session contradicts: lights, polarity, trigger edges."""
    statements: list[Statement] = []
    for one in aligned:
        for doubt in one.doubts:
            common = doubt.statement == "polarity"
            if common and any(s.statement == "polarity" for s in statements):
                continue
            about = None if common else one.name
            found = doubt.stated, doubt.found, doubt.interval_95
            statements.append(Statement(doubt.statement, about, *found, doubt.sentence))
    return statements


def of_fit(result: FitResult) -> list[Statement]:
    """What a joint fit of circuit and bench contradicts: levels, zeros, delays and the rate of the clocks."""
    statements = []
    for name, parameter in result.coordinates.nuisances.items():
        kind = _SENTENCES.get(name.split("[", 1)[0])
        estimate = result.estimates.get(name)
        if kind is None or parameter.prior is None or estimate is None or estimate.interval_95 is None:
            continue
        low, high = estimate.interval_95
        if low is None or high is None or not contradicts(parameter, low, high):
            continue
        recording = name[name.index("[") + 1 : -1] if "[" in name else None
        if kind is _delay and result.alignment.get(recording or "", {}).get("method") not in STATED_DELAYS:
            continue
        stated = parameter.from_coordinate(parameter.prior.mean)
        statement, sentence = kind(recording or "", estimate.value, (low, high), stated, result.model.radiance_unit)
        statements.append(Statement(statement, recording, stated, estimate.value, (low, high), sentence))
    return statements


def contradicts(parameter: Parameter, low: float, high: float) -> bool:
    """Whether a 95 % interval leaves out all within `CONTRADICTED` scales of what was stated."""
    prior = parameter.prior
    assert prior is not None
    ends = (parameter.to_coordinate(low), parameter.to_coordinate(high))
    return min(ends) > prior.mean + CONTRADICTED * prior.sd or max(ends) < prior.mean - CONTRADICTED * prior.sd


def _level(name: str, value: float, ends: tuple[float, float], stated: float, unit: str) -> tuple[str, str]:
    return "level", (
        f"{name}: the light is {value / stated:.3g} times what was stated ({ends[0]:.3g} to {ends[1]:.3g}): "
        "wrong filter, distance or gain?"
    )


def _offset(name: str, value: float, ends: tuple[float, float], stated: float, unit: str) -> tuple[str, str]:
    return "offset", f"{name}: the zero of its light is off by {value:.3g} {unit} ({ends[0]:.3g} to {ends[1]:.3g})"


def _delay(name: str, value: float, ends: tuple[float, float], stated: float, unit: str) -> tuple[str, str]:
    micro = [1e6 * x for x in (value, *ends)]
    return "delay", (
        f"{name}: its events are {micro[0]:.0f} µs later than its alignment states ({micro[1]:.0f} to {micro[2]:.0f}): "
        "wrong edge?"
    )


def _rate(name: str, value: float, ends: tuple[float, float], stated: float, unit: str) -> tuple[str, str]:
    ppm = [1e6 * x for x in (value, *ends)]
    return "clock_rate", (
        f"the clocks are {ppm[0]:.0f} ppm apart ({ppm[1]:.0f} to {ppm[2]:.0f}), where {1e6 * stated:.0f} were stated: "
        "another sampling rate than the file states?"
    )


_SENTENCES = {LIGHT_GAIN.name: _level, LIGHT_OFFSET.name: _offset, CLOCK_DELAY.name: _delay, CLOCK_RATE.name: _rate}
