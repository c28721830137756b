"""What is stated about a bench, as parameters of a fit: priors of clocks and of light levels, and what they came to.

A laboratory's statements are never exact.  Each is a nuisance of the model with a prior about what was stated
(Student's t with `DF` degrees of freedom), fitted with the circuit, and reported where the data contradict it:

    alignment.delay_s[NAME]   what the alignment of a recording has left of a delay
    alignment.clock_rate      what the camera counts per second of the light, less one, in the whole session
    light_gain[NAME]          the light of a recording over what its trace says, where levels are not exact
    light_offset[NAME]        the zero of a recording's trace, where it was digitised
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from pixelid.errors import InputError, did_you_mean
from pixelid.fit.result import Estimate
from pixelid.likelihood.clocks import clock_in
from pixelid.likelihood.pooled_rate import delay_name
from pixelid.model.model import CLOCK_DELAY, CLOCK_RATE, LIGHT_GAIN, LIGHT_OFFSET, ONLY_OWN, Model
from pixelid.parameters.parameter import Parameter, Prior
from pixelid.recordings.bench import bench_of
from pixelid.recordings.clocks import CRYSTAL, clock_of
from pixelid.recordings.recording import Recording
from pixelid.stimuli.pixel_lights import lights_in

DF = 4.0  # degrees of freedom of the priors: heavy tails, and still a variance
FAR = 2.5  # times half the 95 % interval of a recording's alignment, five standard deviations: how far its delay may go
MEASURED = 0.5  # of what crystals keep: a rate with a smaller error was measured


def with_bench(model: Model, recordings: Sequence[Recording], delays: bool = True) -> Model:
    """The model with the nuisances of the recordings' bench, free; itself where every statement is exact.

    Args:
        model: Without them, or with values of them to begin at.
        recordings: With names of their own.
        delays: False: where the likelihood has delays of its own.
    """
    parameters = [p for recording in recordings for p in of_recording(recording, delays)]
    rate = common_rate(recordings)
    nuisances = {p.name: p for p in (*parameters, *([] if rate is None else [rate]))}
    known = {name: p.within(model.nuisances[name].value) for name, p in nuisances.items() if name in model.nuisances}
    at = {name: p.at(known[name]) if name in known else p for name, p in nuisances.items()}
    return replace(model, nuisances={**model.nuisances, **at}) if nuisances else model


def with_stated_only(model: Model) -> Model:
    """The model without nuisances of recordings but those that `with_bench` gives it."""
    clocks = clocks_of(model)
    stated = {n: p for n, p in model.nuisances.items() if n in clocks or (is_of_bench(n) and p.prior is not None)}
    return replace(model, nuisances=stated)


def of_recording(recording: Recording, delays: bool = True) -> list[Parameter]:
    """A recording's own nuisances: its clock's delay, the level and the zero of its light."""
    clock, bench, name = clock_of(recording), bench_of(recording), recording.name
    parameters = []
    if clock is not None and delays:
        known = clock.prior.delay_sd_s
        prior = None if known is None else Prior(0.0, known, DF)
        most = max(CLOCK_DELAY.upper, FAR * clock.half_s)
        delay = replace(CLOCK_DELAY, name=f"{CLOCK_DELAY.name}[{name}]", lower=-most, upper=most, prior=prior)
        parameters.append(delay)
    if bench.level_sd > 0:
        parameters.append(replace(LIGHT_GAIN, name=f"{LIGHT_GAIN.name}[{name}]", prior=Prior(0.0, bench.level_sd, DF)))
    most_offset = 0.5  # of the dimmest light: what is left of it stays positive
    if bench.offset_sd > 0:
        prior, most = Prior(0.0, bench.offset_sd, DF), most_offset * dimmest_light(recording)
        offset = replace(LIGHT_OFFSET, name=f"{LIGHT_OFFSET.name}[{name}]", lower=-most, upper=most, prior=prior)
        parameters.append(offset)
    return parameters


def dimmest_light(recording: Recording) -> float:
    """The least radiance that a recording's light has anywhere."""
    assert recording.stimulus is not None
    return min(float(one.radiance.min()) for one in lights_in(recording.stimulus))


def common_rate(recordings: Sequence[Recording]) -> Parameter | None:
    """The rate of the clocks of a session; None where no recording was aligned."""
    clocks = [clock for clock in map(clock_of, recordings) if clock is not None]
    if not clocks:
        return None
    prior = rate_prior([(clock.prior.rate_mean, clock.prior.rate_sd) for clock in clocks])
    return replace(CLOCK_RATE, value=CLOCK_RATE.within(prior.mean), prior=prior)


def rate_prior(rates: Sequence[tuple[float, float]]) -> Prior:
    """The prior of the common rate: what crystals are known to keep, and the rates that recordings' triggers measured.

    Measurements contradict each other where an edge stands wrong, so each is Student's t about the rate; the mode of
    their product, and its curvature there, are the prior's mean and scale.

    Args:
        rates: (mean, sd) of each recording; those no better than crystals say nothing beyond them.
    """
    measured = [Prior(mean, sd, DF) for mean, sd in rates if sd < MEASURED * CRYSTAL]
    parts = [Prior(0.0, CRYSTAL, DF), *measured]
    if not measured:
        return parts[0]
    best = max((part.mean for part in parts), key=lambda rate: sum(part.log_density(rate) for part in parts))
    reweightings = 50  # more than enough for a fixed point of a few dozen rates
    for _ in range(reweightings):  # a fixed point: each mean at its weight there
        weights = [part.slope_and_information(best)[1] for part in parts]
        best = sum(w * part.mean for w, part in zip(weights, parts, strict=True)) / sum(weights)
    return Prior(best, sum(part.slope_and_information(best)[1] for part in parts) ** -0.5, DF)


def held(model: Model, fixed: Mapping[str, float]) -> Model:
    """The model with nuisances of its recordings held at the values of `fixed`.

    Raises:
        InputError: A name in `fixed` that is none of them, and a value out of bounds.
    """
    nuisances = dict(model.nuisances)
    for name, value in fixed.items():
        if name not in nuisances:
            meant = did_you_mean(name, [*model.parameters, *nuisances])
            raise InputError(f"model {model.name} has no parameter {name!r} to hold{meant}")
        nuisances[name] = nuisances[name].at(value).fixed()
    return replace(model, nuisances=nuisances)


def clocks_of(model: Model) -> dict[str, Parameter]:
    """The nuisances of a model that are of clocks: a base that lacks an effect may shift levels to cover for it."""
    return {
        name: p for name, p in model.nuisances.items() if name.split("[", 1)[0] in (CLOCK_DELAY.name, CLOCK_RATE.name)
    }


def is_of_bench(name: str) -> bool:
    """Whether a nuisance is a statement about the bench."""
    return name == CLOCK_RATE.name or name.split("[", 1)[0] in ONLY_OWN


def clocks_found(recordings: Sequence[Recording], model: Model, estimates: Mapping[str, Estimate]) -> dict[str, Any]:
    """What fit.json says of the clock of every recording that the fit carried nuisances for, by its name.

    `convert` put the light's moment τ at s = b + (1 + r) τ of the recording.  With the delay δ at the moment a, an
    event stamped t belongs to s = t − δ − ρ (t − a).  So τ happened at t = (s + δ − ρ a)/(1 − ρ).

    Args:
        recordings: With a stimulus each.
        model: As fitted, with its nuisances.
        estimates: Of all parameters, by name.
    """
    clocks, rate = {}, estimates.get(CLOCK_RATE.name)
    if rate is None:
        return clocks
    circuit = model.circuit({CLOCK_RATE.name: rate.value})
    for i, recording in enumerate(recordings):
        aligned, clock, name = clock_of(recording), clock_in(recording, circuit), recording.name
        if aligned is None or clock is None:
            continue
        delay = estimates.get(f"{CLOCK_DELAY.name}[{name}]") or estimates[delay_name(recordings, i)]
        slope, at_s = float(clock.slope), clock.at_s
        zero_s = recording.attributes["alignment"].get("zero_ns", 0) * 1e-9
        begin_s = aligned.offset_s - zero_s
        clocks[name] = {
            "method": aligned.method,
            "delay_s": delay.value,
            "delay_interval_95": delay.interval_95,
            "at_s": at_s,
            "offset_s": zero_s + (begin_s + delay.value - slope * at_s) / (1.0 - slope),
            "clock_rate_ppm": 1e6 * rate.value,
            "clock_rate_ppm_interval_95": _ppm(rate.interval_95),
        }
    return clocks


def common_delay(recordings: Sequence[Recording]) -> str:
    """What no fit can say of the recordings' clocks, in words; "" where there is nothing of the kind.

    A delay common to all recordings is the clocks' or the readout's: only a trigger, or a clock that is known,
    separates them.
    """
    clocks = [clock_of(recording) for recording in recordings]
    if not clocks or any(clock is None or clock.prior.delay_sd_s is not None for clock in clocks):
        return ""
    return (
        "a common delay of all recordings: without a trigger the clocks' delay cannot be distinguished from the "
        f"readout's (delay_s), so {CLOCK_DELAY.name} is the sum of both"
    )


def _ppm(limits: tuple[float | None, float | None] | None) -> list[float | None] | None:
    return None if limits is None else [None if limit is None else 1e6 * limit for limit in limits]
