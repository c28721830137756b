"""A circuit as numbers: where the effects of all stages meet, and what simulators and likelihoods read."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

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
    dark: float = 0.0  # added to the radiance
    flicker_modulation: float = 0.0
    flicker_hz: float = 100.0
    flicker_phase: float = 0.0
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
    mismatch: float = 0.0  # pixel-to-pixel standard deviation, relative to the threshold
    noise: float = 0.0  # event-to-event standard deviation, relative to the threshold
    threshold_drift: float = 0.0  # relative, per second
    polarity_memory: float = 0.0  # relative, of the threshold of the polarity before
    refractory: float = 0.0
    hot_count: int = 0
    hot_hz: float = 0.0
    # readout
    service: float = 0.0
    jitter: float = 0.0
    tick: float = 0.0
    # clock of the events against the stimulus
    delay: float = 0.0

    def with_(self, **changes) -> Circuit:
        """The same circuit with some numbers changed."""
        return replace(self, **changes)
