"""A circuit as numbers: where the effects of all stages meet, and what simulators and likelihoods read."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pixelid.stages.modulation import Modulation

PHOTORECEPTORS = ("second_order", "one_pole", "unlimited")


@dataclass(frozen=True)
class Circuit:
    """One pixel design in numbers.  Neutral defaults: a field left alone has no effect.

    Values may be complex (complex-step derivatives) or symbols of an engine.  Angular cutoffs in rad/s,
    thresholds in log radiance, times in seconds.
    """

    photoreceptor: str = "second_order"
    linearisation: str = "midpoint"
    # photocurrent
    light_spread: float = 0.0  # of pooled pixels' light, standard deviation of its logarithm
    light_gain: float = 1.0  # of the stimulus, in one recording
    dark: float = 0.0  # added to the radiance
    flicker_modulation: float = 0.0
    flicker_hz: float = 100.0
    flicker_phase: float = 0.0
    knee: float = 0.0  # radiance below which the response is linear
    knee_slope: float = 1.0  # there, of the logarithm's slope at the knee
    shot_density: float = 0.0  # one-sided relative PSD = shot_density / L  [radiance/Hz]
    # photoreceptor
    alpha: float = math.nan
    beta: float = math.nan
    gamma: float = math.nan
    corner: float = math.nan  # one pole: ωc = corner · L
    bandwidth_floor: float = 0.0  # added to the radiance that sets the rates, not to ln L
    # source follower
    follower: float = math.inf
    extra_pole: float = math.inf
    lower_cutoff: float = 0.0
    slew_rise: float = math.inf  # log radiance per second
    slew_fall: float = math.inf
    # differencing amplifier
    differencing: float = math.inf
    leak_hz: float = 0.0  # drift of leak_hz · C_on per second
    leak_hz_per_radiance: float = 0.0
    # comparator
    on_threshold: float = math.nan
    off_threshold: float = math.nan
    threshold_gain: float = 1.0  # of both thresholds, in one recording
    mismatch: float = 0.0  # pixel-to-pixel standard deviation, relative to the threshold
    noise: float = 0.0  # event-to-event standard deviation, relative to the threshold
    threshold_drift: float = 0.0  # relative, per second
    polarity_memory: float = 0.0  # relative, of the threshold of the polarity before
    refractory: float = 0.0
    silent: float = 0.0  # seconds after an event in which the comparator is blind; the reference stays
    hot_count: int = 0
    hot_hz: float = 0.0
    # readout
    lost: float = 0.0  # share of the events
    service: float = 0.0
    per_cycle: float = 0.0  # seconds that a cycle of a shared readout lasts, and those more for each event in it
    per_event: float = 0.0
    cycle_spread: float = 0.0  # of its length, relative
    jitter: float = 0.0
    tick: float = 0.0
    # quantities that depend on a covariate
    described: tuple[Modulation, ...] = ()
    # clock of the events against the stimulus
    delay: float = 0.0
    clock_rate: float | None = None  # of the camera's clock against the light's, less one; None: as recordings have it
    # (recording, ((field, number), …)), …: what is a recording's own
    of_recordings: tuple[tuple[str, tuple[tuple[str, float], ...]], ...] = ()

    def with_(self, **changes) -> Circuit:
        """The same circuit with some numbers changed.

        As `dataclasses.replace`, which takes ten times as long: fits make a dozen circuits per evaluation.
        """
        if not changes.keys() <= self.__dict__.keys():
            raise TypeError(f"a circuit has no {', '.join(sorted(changes.keys() - self.__dict__.keys()))}")
        changed = object.__new__(Circuit)
        changed.__dict__.update(self.__dict__, **changes)
        return changed

    def later_by(self, seconds: float) -> Circuit:
        """The circuit whose events are stamped later, in every recording."""
        own = tuple(
            (name, tuple((key, number + seconds if key == "delay" else number) for key, number in numbers))
            for name, numbers in self.of_recordings
        )
        return self.with_(delay=self.delay + seconds, of_recordings=own)

    def brighter_by(self, factor: float) -> Circuit:
        """The circuit under a light `factor` times what it is, in every recording."""
        own = tuple(
            (name, tuple((key, number * factor if key == "light_gain" else number) for key, number in numbers))
            for name, numbers in self.of_recordings
        )
        return self.with_(light_gain=self.light_gain * factor, of_recordings=own)

    def in_recording(self, name: str) -> Circuit:
        """The circuit as it was in the recording of that name, with the numbers that are the recording's own."""
        if not self.of_recordings:
            return self
        own = self.with_(of_recordings=(), **dict(dict(self.of_recordings).get(name, ())))
        gain = own.threshold_gain
        if isinstance(gain, float) and gain == 1.0:
            return own
        return own.with_(on_threshold=gain * own.on_threshold, off_threshold=gain * own.off_threshold)
