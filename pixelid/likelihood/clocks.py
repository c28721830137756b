"""Clocks of recordings as parameters: what an alignment has left of a delay, and of a drift between two clocks.

An event that the camera stamps t belongs to the light at

    t − delay − drift · (t − at)/span

with delay [s] at the moment `at`, and drift [s] what the clocks part by over `span`, the length of the light: its rate
in seconds, so that both are steps of the same size to an optimiser.  A recording that was not aligned, or whose
alignment was given, has no such parameters, and its times are taken as they are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pixelid.errors import InputError
from pixelid.parameters.parameter import Parameter, Prior
from pixelid.recordings.clocks import AlignedClock, clock_of
from pixelid.recordings.recording import Recording

DELAY, DRIFT = "alignment.delay_s", "alignment.drift_s"
MOST_DELAY_S = 0.02  # bound of what an alignment may be off by: `--align auto` refines within the same
MOST_RATE = 1e-3  # bound of the rate: twice what a ceramic resonator is off by


@dataclass(frozen=True)
class Clock:
    """A recording's clock beside that of its light: delay_s at `at_s`, and drift_s over `span_s`.

    delay_s and drift_s may be symbols of an engine.
    """

    at_s: float
    span_s: float
    delay_s: Any = 0.0
    drift_s: Any = 0.0

    def on_light(self, t: Any) -> Any:
        """(n,) times of the light at times (n,) of the recording, in an engine's numbers."""
        return t - self.delay_s - self.drift_s * ((t - self.at_s) / self.span_s)


def names_of(recordings: Sequence[Recording]) -> list[str]:
    """One name per recording, numbered where two share one."""
    return numbered([recording.name for recording in recordings])


def numbered(names: list[str]) -> list[str]:
    """The names, with their place where two are alike."""
    return [name if names.count(name) == 1 else f"{name} #{i}" for i, name in enumerate(names)]


def clock_parameters(recordings: Sequence[Recording], delays: bool = True) -> tuple[Parameter, ...]:
    """The delay and the drift of every recording whose alignment is uncertain.

    Args:
        recordings: With a stimulus each.
        delays: False: the drifts alone, where the likelihood has delays of its own.
    """
    parameters = []
    for name, recording in zip(names_of(recordings), recordings, strict=True):
        clock = clock_of(recording)
        if clock is None:
            continue
        known, source = clock.prior, f"pixelid convert --align {clock.method}"
        if delays:
            prior = None if known.delay_sd_s is None else Prior(0.0, known.delay_sd_s)
            parameters.append(
                Parameter(f"{DELAY}[{name}]", 0.0, "s", -MOST_DELAY_S, MOST_DELAY_S, "linear", prior, source=source)
            )
        most = MOST_RATE * known.span_s
        prior = Prior(known.span_s * (known.rate_mean - clock.rate_error), known.span_s * known.rate_sd)
        parameters.append(Parameter(f"{DRIFT}[{name}]", 0.0, "s", -most, most, "linear", prior, source=source))
    return tuple(parameters)


def clocks_of(recordings: Sequence[Recording], values: Mapping[str, Any]) -> tuple[Clock | None, ...] | None:
    """The clocks that parameter values say, one per recording; None where they say nothing of any.

    Raises:
        InputError: `values` has the clock of a recording that is not among these.
    """
    told = {name for name in values if name.startswith((f"{DELAY}[", f"{DRIFT}["))}
    if not told:
        return None
    clocks: list[Clock | None] = []
    for name, recording in zip(names_of(recordings), recordings, strict=True):
        mine = [f"{part}[{name}]" for part in (DELAY, DRIFT)]
        clock = clock_of(recording) if told & set(mine) else None
        if clock is None:
            clocks.append(None)
            continue
        told -= set(mine)
        clocks.append(Clock(clock.prior.at_s, clock.prior.span_s, *(values.get(part, 0.0) for part in mine)))
    if told:
        raise InputError(f"{min(told)}: no such recording here that was aligned; give those that were fitted")
    return tuple(clocks)


def unseparated(recordings: Sequence[Recording]) -> str:
    """What no fit can tell of the recordings' clocks, in words; "" when there is nothing of the kind.

    A delay common to all recordings is the clocks' or the readout's: only a trigger, or a clock that is known, tells.
    """
    clocks = [clock_of(recording) for recording in recordings]
    if not clocks or any(clock is None or clock.prior.delay_sd_s is not None for clock in clocks):
        return ""
    return (
        "a common delay of all recordings: without a trigger the clocks' delay cannot be told from the readout's "
        f"(delay_s), so {DELAY} is the sum of both"
    )


__all__ = ["DELAY", "DRIFT", "AlignedClock", "Clock", "clock_parameters", "clocks_of", "names_of", "unseparated"]
