"""Described effects in the compiled simulator: what an event sets for the next one, and thresholds that relax.

A threshold that relaxes is followed by straight pieces, each `SHARE` of the time constant long and longer as the rest
decays: an error of SHARE²/8 = 1e-5 of the shift.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numba.extending import register_jitable

from pixelid.simulate.crossing import NOTHING, first_crossing
from pixelid.simulate.step import probe
from pixelid.stages import modulation

SHARE = 0.01
GONE = 40.0  # time constants after which nothing is left

register_jitable(modulation.value_of)
set_at_reset = njit(modulation.set_at_reset, error_model="numpy")


@njit(forceinline=True, error_model="numpy")
def relaxed(relaxing, since):
    """(ON, OFF) what is left of the thresholds' shifts a time after the last event."""
    left = np.exp(-since / relaxing[2])
    return relaxing[0] * left, relaxing[1] * left


@njit(cache=True, error_model="numpy")
def first_crossing_relaxing(x0, here, step, chain, reset, on, off, drift, relaxing, t0, last, scratch):
    """As `crossing.first_crossing`, of thresholds whose shifts since the event at `last` [s] relax.

    on, off: thresholds without shift and drift;  t0: when the step begins
    """
    tau, scale, x = step[4], relaxing[2], x0
    while True:
        since = (t0 + x - last) / scale
        stop = tau if since > GONE else min(x + SHARE * scale * np.exp(0.5 * since), tau)
        more = relaxed(relaxing, t0 + x - last), relaxed(relaxing, t0 + stop - last)
        grown = 1.0 + drift * (t0 + x), 1.0 + drift * (t0 + stop)
        length = stop - x if stop > x else 1.0
        on_rate = ((on + more[1][0]) * grown[1] - (on + more[0][0]) * grown[0]) / length
        off_rate = ((off + more[1][1]) * grown[1] - (off + more[0][1]) * grown[0]) / length
        at, polarity = first_crossing(
            x, here, step, chain, reset, (on + more[0][0]) * grown[0] - on_rate * x, on_rate,
            (off + more[0][1]) * grown[0] - off_rate * x, off_rate, scratch, stop,
        )  # fmt: skip
        if polarity >= 0:
            return at, polarity
        if stop >= tau:
            return NOTHING, -1
        x = stop
        here = probe(x, step, chain)
