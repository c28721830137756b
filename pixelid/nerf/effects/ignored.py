"""What a circuit has and a reconstruction does not model: named for the user, never dropped silently."""

from __future__ import annotations

import math
from dataclasses import fields

import numpy as np

from pixelid.nerf.events.intervals import Intervals, rows_of
from pixelid.stages import LIBRARY
from pixelid.stages.circuit import Circuit
from pixelid.stages.described import PREFIX

# Fields of a circuit that training reads, or whose pixels it leaves out (hot ones).
MODELLED = frozenset(
    (
        "photoreceptor", "linearisation", "dark", "alpha", "beta", "gamma", "corner", "follower", "extra_pole",
        "lower_cutoff", "differencing", "leak_hz", "leak_hz_per_radiance", "on_threshold", "off_threshold", "mismatch",
        "noise", "refractory", "threshold_drift", "polarity_memory", "bandwidth_floor", "hot_count", "hot_hz",
    )
)  # fmt: skip


FORGOTTEN = 0.05  # ln L of drift over a chain per ln L of contrast: a tenth of a threshold of 0.25 at a contrast of 0.5
NO_EFFECTS = ("delay", "of_recordings")  # of the clock of a stimulus, and bookkeeping


def ignored_effects(circuit: Circuit) -> tuple[str, ...]:
    """The effects that act in this circuit and that a reconstruction leaves out, in the library's order.

    A field that no effect of the library sets appears under its own name.

    >>> ignored_effects(Circuit(slew_rise=3000.0, leak_hz=2.0))
    ('slew_limit',)
    """
    acting = acting_fields(circuit) - MODELLED - {*NO_EFFECTS}
    names = []
    for effect in LIBRARY.values():
        shipped = {parameter.name: parameter.value for parameter in effect.parameters}
        touched = acting_fields(effect.apply(Circuit(), shipped)) & acting
        if touched:
            names.append(effect.name)
            acting -= touched
    if "described" in acting:
        acting -= {"described"}
        names += [f"{PREFIX}{m.quantity}.{m.covariate}.{m.form}" for m in circuit.described if m.strength != 0.0]
    return (*names, *sorted(acting))


def truncated_memory(circuit: Circuit, every: Intervals) -> tuple[str, ...]:
    """What a lower cutoff remembers from before the chains of events, in words, where it would matter.

    A chain begins in the steady state of its first light.  What the high-pass still held of lights before would go at
    ω_h times their contrast, and is missed over the chain.

    Args:
        circuit: of the pixel.
        every: stretches, and where chains may begin.

    Returns:
        One sentence, or none.
    """
    rows = rows_of(every, np.arange(0, len(every.starts), max(len(every.starts) // 4096, 1)))
    first, last = rows[:, 0], rows[:, -1]
    whole = every.stretches.pixel[first] == every.stretches.pixel[last]
    if not (circuit.lower_cutoff > 0 and whole.any()):
        return ()
    lasts_s = float(np.median((every.stretches.end[last] - every.stretches.begin[first])[whole]))
    if circuit.lower_cutoff * lasts_s < FORGOTTEN:
        return ()
    cutoff_hz = circuit.lower_cutoff / (2 * math.pi)
    return (f"what a lower cutoff of {cutoff_hz:.3g} Hz remembers from before {lasts_s:.2g} s of a pixel's events",)


def acting_fields(circuit: Circuit) -> set[str]:
    """The fields in which a circuit differs from one that does nothing."""
    pairs = ((field.name, getattr(circuit, field.name), getattr(Circuit, field.name)) for field in fields(Circuit))
    return {name for name, own, neutral in pairs if own is not neutral and own != neutral}  # NaN: neither has it
