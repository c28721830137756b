"""Clocks of the recordings in a fit: which nuisances it carries for them, and what it has found of each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pixelid.errors import InputError, did_you_mean
from pixelid.fit.result import Estimate
from pixelid.likelihood.clocks import DELAY, DRIFT, clock_parameters, names_of
from pixelid.likelihood.pooled_rate import delay_name
from pixelid.model.model import Model
from pixelid.parameters.parameter import Parameter
from pixelid.recordings.clocks import clock_of
from pixelid.recordings.recording import Recording


def held_clocks(recordings: Sequence[Recording], fixed: Mapping[str, float], model: Model) -> tuple[Parameter, ...]:
    """The clocks' nuisances of an event-time fit, those in `fixed` held at the value given.

    Raises:
        InputError: a name in `fixed` that is none of them, and a value out of bounds.
    """
    parameters = {p.name: p for p in clock_parameters(recordings)}
    for name, value in fixed.items():
        if name not in parameters:
            meant = did_you_mean(name, [*model.parameters, *parameters])
            raise InputError(f"model {model.name} has no parameter {name!r} to hold{meant}")
        parameters[name] = parameters[name].at(value).fixed()
    return tuple(parameters.values())


def clocks_found(recordings: Sequence[Recording], estimates: Mapping[str, Estimate]) -> dict[str, dict[str, Any]]:
    """What fit.json says of the clock of every recording that the fit carried nuisances for, by its name.

    `convert` put the light's moment τ at s = b + (1 + r) τ of the recording.  With the delay δ at the moment a and
    ρ = drift/span, an event stamped t belongs to s = t − δ − ρ (t − a).  So τ happened at t = (s + δ − ρ a)/(1 − ρ),
    and the whole rate error is (1 + r)/(1 − ρ) − 1.

    Args:
        recordings: with a stimulus each.
        estimates: of all parameters, by name.
    """
    found = {}
    for i, (name, recording) in enumerate(zip(names_of(recordings), recordings, strict=True)):
        clock, drift = clock_of(recording), estimates.get(f"{DRIFT}[{name}]")
        if clock is None or drift is None:
            continue
        delay = estimates.get(f"{DELAY}[{name}]") or estimates[delay_name(recordings, i)]
        at_s, span_s = clock.prior.at_s, clock.prior.span_s
        zero_s = recording.attributes["alignment"].get("zero_ns", 0) * 1e-9
        begin_s = clock.offset_s - zero_s

        def ppm(drift_s: float | None, rate_error=clock.rate_error, span_s=span_s) -> float | None:
            return None if drift_s is None else 1e6 * ((1.0 + rate_error) / (1.0 - drift_s / span_s) - 1.0)

        rate = drift.value / span_s
        found[name] = {
            "method": clock.method,
            "delay_s": delay.value,
            "delay_interval_95": delay.interval_95,
            "at_s": at_s,
            "offset_s": zero_s + (begin_s + delay.value - rate * at_s) / (1.0 - rate),
            "clock_rate_ppm": ppm(drift.value),
            "clock_rate_ppm_interval_95": None if drift.interval_95 is None else [*map(ppm, drift.interval_95)],
        }
    return found
