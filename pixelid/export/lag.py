"""How late a pixel answers: the mean delay of each stage, which other simulators have one or two numbers for.

A linear stage of unit gain H(s) follows a ramp of ln L late by −H'(0), the mean of its impulse response, and the area
between a small step and its response is that long as well.  Delays of stages in a row add.  With a = αL and
b = β + γL the photoreceptor is H = a/(s² + bs + a), so that

    delay = b/a = (β/α)/L + γ/α

is a part proportional to 1/L and a constant, at every light and exactly; a first-order stage is late by 1/ω.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from pixelid.stages.circuit import Circuit


@dataclass(frozen=True)
class Lag:
    """Mean delays [s] of the stages.

    Attributes:
        by_light: Of the photoreceptor, × radiance.
        floor: Radiance added to the light that `by_light` is divided by.
        photoreceptor: Its constant part.
        follower: Source follower and a pole after it.
        differencing: Of the amplifier that each reset restarts.
    """

    by_light: float
    floor: float
    photoreceptor: float
    follower: float
    differencing: float

    def of_photoreceptor(self, effective: float) -> float:
        """Under an effective radiance (signal and dark)."""
        return (self.by_light / (effective + self.floor) if self.by_light > 0 else 0.0) + self.photoreceptor

    def total(self, effective: float) -> float:
        """Of all stages under an effective radiance."""
        return self.of_photoreceptor(effective) + self.follower + self.differencing


def lag_of(circuit: Circuit) -> Lag:
    """The delays of a circuit; the lower cutoff has none (its gain at rest is zero) and is left out."""
    by_light, constant = 0.0, 0.0
    if circuit.photoreceptor == "one_pole":
        by_light = 1.0 / circuit.corner
    elif circuit.photoreceptor == "second_order":
        by_light, constant = circuit.beta / circuit.alpha, circuit.gamma / circuit.alpha
    follower = _of_pole(circuit.follower) + _of_pole(circuit.extra_pole)
    return Lag(by_light, circuit.bandwidth_floor, constant, follower, _of_pole(circuit.differencing))


def _of_pole(cutoff: float) -> float:
    return 1.0 / cutoff if math.isfinite(cutoff) else 0.0
