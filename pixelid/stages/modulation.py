"""A modulation: one quantity of a circuit depends on one covariate through a short form, as numbers.

A covariate v is known before the event.  For thresholds and dead time it is that of the pixel's previous event, which
begins the interval: its polarity, its time, the effective radiance L and |d ln L/dt| at that time; or the time since
then.  For light, response and rate it is that of the moment.  With a strength s the form is

    constant    g = s          linear  g = s v          power  g = s (v / reference)^exponent
    relaxation  g = s exp(−v / scale)                   step   g = s where v > edge, else 0

and the quantity q becomes q (1 + g), or q + g for a dead time in seconds.  A threshold C_i of a pixel becomes C_i + g C
with the mean C over pixels, as an incomplete reset does it; its noise stays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

FORMS = ("constant", "linear", "power", "relaxation", "step")
# Of the moment when the pixel was reset; what is known then holds for the whole interval.
AT_RESET = ("none", "previous_polarity", "time_in_recording", "radiance", "speed")
SINCE_EVENT = "time_since_event"
COVARIATES = (*AT_RESET, SINCE_EVENT)
OF_LIGHT = ("light", "response", "rate")
THRESHOLDS = ("on_threshold", "off_threshold", "threshold")
LEAST = 0.01  # of a quantity that a modulation leaves
COLUMNS = 7  # of `at_reset`
NEVER = 1e300  # seconds: a scale over which nothing relaxes


@dataclass(frozen=True)
class Modulation:
    """One quantity, what it depends on, and how.

    shape: exponent, scale or edge of the form;  reference: of a power, in the covariate's unit
    """

    quantity: str
    covariate: str
    form: str
    strength: float
    shape: float = 1.0
    reference: float = 1.0

    def of(self, v):
        """g at values of the covariate, a number or an array."""
        return self.strength * value_of(FORMS.index(self.form), v, self.shape, self.reference)


def value_of(form, v, shape, reference):
    """g / s of a form, by its place in `FORMS`, at v; also compiled for the simulator."""
    if form == 0:
        return v
    if form == 1:
        return v / reference
    if form == 2:
        return (v / reference) ** shape
    if form == 3:
        return np.exp(-v / shape)
    return 1.0 * (v > shape)


def factor_of(modulations, quantity: str, radiance: np.ndarray, time: np.ndarray):
    """(n,) what a quantity of the light path is multiplied by under radiance (n,) at time (n,); 1.0: by nothing."""
    factor = 1.0
    for one in modulations:
        if one.quantity == quantity:
            g = one.of(np.real(radiance) if one.covariate == "radiance" else time)
            factor = factor * np.maximum(1.0 + g, LEAST)
    return factor


def at_reset(circuit) -> np.ndarray:
    """(e, 7) modulations that an event sets for the interval after it: place of covariate and form, shape, reference,
    and the strength for ON threshold, OFF threshold (log radiance) and dead time (s)."""
    rows = [
        (AT_RESET.index(m.covariate), FORMS.index(m.form), m.shape, m.reference, *_strengths(m, circuit))
        for m in circuit.described
        if m.quantity not in OF_LIGHT and m.covariate != SINCE_EVENT
    ]
    return np.array(rows, dtype=np.float64).reshape(len(rows), COLUMNS)


def since_event(circuit) -> tuple[float, float, float]:
    """(ON, OFF, scale s): shifts of the thresholds just after an event, in log radiance, and how fast they relax."""
    for m in circuit.described:
        if m.quantity in THRESHOLDS and m.covariate == SINCE_EVENT:
            return (*_strengths(m, circuit)[:2], float(m.shape))
    return 0.0, 0.0, NEVER


def _strengths(m: Modulation, circuit) -> tuple[float, float, float]:
    """(ON, OFF, dead time): what a modulation of form value 1 adds."""
    on = m.strength * circuit.on_threshold if m.quantity in ("on_threshold", "threshold") else 0.0
    off = m.strength * circuit.off_threshold if m.quantity in ("off_threshold", "threshold") else 0.0
    if m.quantity == "threshold" and m.covariate == "previous_polarity":
        off = -off  # of both: whether the polarity before is the event's own
    return float(on), float(off), float(m.strength) if m.quantity == "dead_time" else 0.0


def set_at_reset(table, polarity, time, radiance, speed):
    """(ON, OFF, dead time): what an event of this polarity, time, light and |d ln L/dt| adds to them until the next.

    Numbers or arrays; also compiled for the simulator.  table: of `at_reset`
    """
    on, off, dead = 0.0 * time, 0.0 * time, 0.0 * time
    for k in range(len(table)):
        covariate = table[k, 0]
        v = 1.0 + 0.0 * time
        if covariate == 1.0:
            v = v * polarity
        elif covariate == 2.0:
            v = v * time
        elif covariate == 3.0:
            v = v * radiance
        elif covariate == 4.0:
            v = v * speed
        g = value_of(table[k, 1], v, table[k, 2], table[k, 3])
        on, off, dead = on + table[k, 4] * g, off + table[k, 5] * g, dead + table[k, 6] * g
    return on, off, dead
