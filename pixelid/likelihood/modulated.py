"""Changes under described effects: what a pixel's last event set for the interval after it (`stages/modulation.py`).

Dead times differ from interval to interval.  Thresholds are held to be those of the population; what an event adds to
them is taken from the changes instead, at the event and at the extremes:

    ON  change − C_on g          OFF  −change − C_off g          slope less that of C g

A shift that is the same throughout an interval does not move its extremes.  One that relaxes does: every sample of the
interval is looked at.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pixelid.stages.circuit import Circuit
from pixelid.stages.modulation import AT_RESET, OF_LIGHT, at_reset, set_at_reset, since_event


@dataclass(frozen=True)
class Modulated:
    """What previous events set for k intervals.

    before_s: (k,) time of the previous event, on the light's clock
    dead_s: (k,) added to the dead time;  on, off: (k,) added to the thresholds throughout, log radiance
    relaxing: (ON, OFF, scale s), added just after the previous event
    """

    before_s: np.ndarray
    dead_s: np.ndarray
    on: np.ndarray
    off: np.ndarray
    relaxing: tuple[float, float, float]

    @property
    def relaxes(self) -> bool:
        """Whether thresholds change during an interval."""
        return self.relaxing[0] != 0.0 or self.relaxing[1] != 0.0

    def just_after(self, sign: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """(time of the previous event (k,), shift of the thresholds of polarities `sign` (k,) just after it, scale)."""
        return self.before_s, np.where(sign > 0, self.relaxing[0], self.relaxing[1]), self.relaxing[2]

    def shifts(self, sign: np.ndarray, time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(k,) shift of the thresholds of polarities `sign` (k,) at times (k,), and its slope."""
        on, off, scale = self.relaxing
        rising = sign > 0
        relaxed = np.where(rising, on, off) * np.exp(-(time_s - self.before_s) / scale)
        return np.where(rising, self.on, self.off) + relaxed, -relaxed / scale


def moves_changes(circuit: Circuit) -> bool:
    """Whether a described effect acts on thresholds or dead time."""
    return any(m.quantity not in OF_LIGHT for m in circuit.described)


def modulated(
    circuit: Circuit, t: np.ndarray, logs: np.ndarray, sample: np.ndarray, before_s: np.ndarray, polarity: np.ndarray
) -> Modulated:
    """What events set for the intervals after them.

    Args:
        circuit: With described effects.
        t, logs: (samples,) times and log radiance.
        sample: (k,) the sample at or before each event.
        before_s: (k,) its time.
        polarity: (k,) ±1.
    """
    table = at_reset(circuit)
    radiance, speed = np.ones(len(before_s)), np.zeros(len(before_s))
    if np.isin(table[:, 0], (AT_RESET.index("radiance"), AT_RESET.index("speed"))).any():
        after = np.minimum(sample + 1, len(t) - 1)
        step = t[after] - t[sample]
        slope = np.where(step > 0, (logs[after] - logs[sample]) / np.where(step > 0, step, 1.0), 0.0)
        radiance, speed = np.exp(logs[sample] + slope * (before_s - t[sample])), np.abs(slope)
    on, off, dead = set_at_reset(table, polarity, before_s, radiance, speed)
    return Modulated(before_s, np.maximum(dead, -circuit.refractory), on, off, since_event(circuit))


def subtract(
    of: Modulated, growth: float, sign: np.ndarray, time_s: np.ndarray, reached_s: np.ndarray, events: np.ndarray
) -> None:
    """Take the shifts from the rows (7, n) of `changes.PER_EVENT`.

    growth: of thresholds, per second;  reached_s: (n,) time of the other polarity's extreme
    """
    own, slope = of.shifts(sign, time_s)
    grown = 1.0 + growth * time_s
    events[0] -= sign * own * grown
    events[1] -= sign * (own * growth + slope * grown)
    events[4] -= of.shifts(-sign, reached_s)[0] * grown


def subtract_from_ends(
    of: Modulated, growth: float, end_s: float, reached_s: Sequence[np.ndarray], pixels: np.ndarray
) -> None:
    """Take the shifts from the rows (4, m) of `changes.PER_PIXEL`; reached_s: times (m,) of both extremes."""
    for sign, when, row in ((1.0, reached_s[0], pixels[0]), (-1.0, reached_s[1], pixels[2])):
        row -= of.shifts(np.full(len(when), sign), when)[0] * (1.0 + growth * end_s)
