"""The light as the photoreceptor receives it: a stimulus turned into samples of effective radiance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from pixelid.errors import InputError
from pixelid.stages.circuit import Circuit
from pixelid.stages.modulation import Modulation, factor_of
from pixelid.stages.photocurrent import logarithm
from pixelid.stimuli.stimulus import Stimulus

HELD_S = 10.0  # longer than any dead time or clock delay
PER_CYCLE, MOST_SAMPLES = 64, 1 << 25  # of mains flicker: 87 minutes at 100 Hz, 270 MB a column


@dataclass(frozen=True)
class Drive:
    """Effective radiance (n,) > 0 at times t (n,) seconds, non-decreasing; log radiance is linear in between.

    Two samples may share a time: the light jumps there.  knee, knee_slope: of the circuit, whose response is linear in
    low light (`photocurrent.logarithm`);  described: its modulations of response and rate (`stages/modulation.py`).
    """

    t: np.ndarray
    radiance: np.ndarray
    knee: float = 0.0
    knee_slope: float = 1.0
    described: tuple[Modulation, ...] = ()

    @cached_property
    def log_radiance(self) -> np.ndarray:
        """(n,) log radiance as the pixel responds: taken once for all circuits that see this light."""
        logs = logarithm(Circuit(knee=self.knee, knee_slope=self.knee_slope), self.radiance)
        return logs + np.log(factor_of(self.described, "response", self.radiance, self.t)) if self.described else logs

    @cached_property
    def rate_radiance(self) -> np.ndarray:
        """(n,) the radiance that the photoreceptor's rates are those of."""
        if not self.described:
            return self.radiance
        return self.radiance * factor_of(self.described, "rate", self.radiance, self.t)

    @property
    def straight(self) -> bool:
        """Whether the response is the logarithm of the radiance."""
        return self.knee == 0 and all(m.quantity != "response" for m in self.described)

    @cached_property
    def log_light(self) -> np.ndarray:
        """(n,) the logarithm of the radiance, whatever the response."""
        return self.log_radiance if self.straight else np.log(self.radiance)


@dataclass(frozen=True)
class StackedDrive(Drive):
    """The drives of several lights, one after the other: time starts again with each.

    first: (lights + 1,) where the samples of each begin, and where the last ones end
    """

    first: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))


def knots(stimulus: Stimulus, until_s: float | None = None) -> tuple[np.ndarray, np.ndarray]:
    """(t, index): where a full-field stimulus has knots, and which sample each takes its radiance from.

    A held stimulus ("previous") gets two knots per change, so that it jumps; its last value holds to `until_s`.
    """
    t = stimulus.t
    index = np.arange(len(t))
    if stimulus.interpolation == "previous":
        t = np.repeat(t, 2)[1:]
        index = np.repeat(index, 2)[:-1]
    if until_s is not None and until_s > t[-1]:
        t, index = np.append(t, until_s), np.append(index, index[-1])
    return t, index


def refined(t: np.ndarray, longest_step: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(t, left, weight): knots refined to steps ≤ longest_step; a new knot mixes log radiance of left and left+1."""
    gaps = np.diff(t)
    parts = np.maximum(np.ceil(gaps / longest_step - 1e-9), 1).astype(np.int64)
    left = np.repeat(np.arange(len(gaps)), parts)
    first = np.concatenate([[0], np.cumsum(parts)[:-1]])
    weight = (np.arange(len(left)) - first[left]) / parts[left]
    return (
        np.append(t[left] + weight * gaps[left], t[-1]),
        np.append(left, len(t) - 2),
        np.append(weight, 1.0),
    )


def refined_radiance(t: np.ndarray, radiance: np.ndarray, longest_step: float) -> tuple[np.ndarray, np.ndarray]:
    """(t, radiance) at knots refined to steps ≤ longest_step; log radiance is linear in between."""
    t, left, weight = refined(t, longest_step)
    logs = np.log(radiance)
    return t, np.exp((1 - weight) * logs[left] + weight * logs[left + 1])


def drive(stimulus: Stimulus, circuit: Circuit, until_s: float | None = None) -> Drive:
    """The effective radiance of a full-field stimulus under a circuit: dark current and flicker included.

    Mains flicker is sampled at least `PER_CYCLE` times per cycle.  Values may be complex.
    Raises InputError for a per-pixel stimulus, for radiance that dark current leaves at 0, and for mains flicker over
    so long a light that it would take more than `MOST_SAMPLES`.
    """
    if not stimulus.full_field:
        raise InputError("this needs a full-field stimulus, found one radiance per pixel")
    t, index = knots(stimulus, until_s)
    radiance = stimulus.radiance[index].astype(np.float64)
    if circuit.light_gain != 1.0:
        radiance = radiance * circuit.light_gain
    if circuit.flicker_modulation != 0:
        per_second = PER_CYCLE * circuit.flicker_hz.real
        if per_second * (t[-1] - t[0]) > MOST_SAMPLES:
            longest, found = MOST_SAMPLES / per_second, float(t[-1] - t[0])
            raise InputError(
                f"mains_flicker at {circuit.flicker_hz.real:g} Hz: expected light of at most {longest:.0f} s, found "
                f"{found:.0f} s; take a part of it (--time), or leave it out (--without mains_flicker)"
            )
        t, radiance = refined_radiance(t, radiance, 1.0 / per_second)
        radiance = radiance * (
            1 + circuit.flicker_modulation * np.sin(2 * np.pi * circuit.flicker_hz * t + circuit.flicker_phase)
        )
    radiance = radiance + circuit.dark
    if not circuit.described:
        return Drive(t, radiance, circuit.knee, circuit.knee_slope)
    radiance = radiance * factor_of(circuit.described, "light", radiance, t)
    return Drive(t, radiance, circuit.knee, circuit.knee_slope, behind_light(circuit))


def behind_light(circuit: Circuit) -> tuple[Modulation, ...]:
    """The modulations of response and rate."""
    return tuple(m for m in circuit.described if m.quantity in ("response", "rate"))


def stacked_drive(lights: Sequence[Stimulus], circuit: Circuit, until_s: float) -> StackedDrive:
    """The drives of full-field lights of one span, one after the other.

    One light alone is as `drive` gives it.  Of several, each is held for `HELD_S` after its end, so that no time of
    interest lies in the step from the last sample of one light to the first of the next.
    """
    response = circuit.knee, circuit.knee_slope, behind_light(circuit)
    if len(lights) == 1:
        only = drive(lights[0], circuit, until_s)
        return StackedDrive(only.t, only.radiance, *response, np.array([0, len(only.t)]))
    times, radiances = [], []
    for light in lights:
        part = drive(light, circuit, until_s)
        times += [part.t, [part.t[-1] + HELD_S]]
        radiances += [part.radiance, part.radiance[-1:]]
    first = np.concatenate([[0], np.cumsum([len(t) + 1 for t in times[::2]])])
    return StackedDrive(np.concatenate(times), np.concatenate(radiances), *response, first)
