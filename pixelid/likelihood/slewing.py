"""Trajectories of a slew-limited follower, as the likelihood of event times reads them."""

from __future__ import annotations

import numpy as np

from pixelid.dynamics import slew
from pixelid.dynamics.equations import PRESENT_BELOW
from pixelid.dynamics.trajectory import Dynamics, Trajectory
from pixelid.errors import InputError
from pixelid.stages.circuit import Circuit
from pixelid.stimuli.drive import Drive, refined

SLEW_FASTEST = 2 * np.pi * 4e4  # rad/s: poles of a slew-limited pixel beyond this are taken as this
SLEW_RESOLUTION = 0.5  # steps per time constant of the fastest stage of a slew-limited pixel


def slewed(light: Drive, circuit: Circuit, dynamics: Dynamics) -> Trajectory:
    """The trajectory of a slew-limited follower, in steps that resolve every pole (`SLEW_RESOLUTION`).

    Raises InputError without source follower or differencing pole: the first would have nothing to slew, the second is
    what the level at an event is read through.  Poles beyond `SLEW_FASTEST` are taken as that: a fit that
    walks there must not ask for nanosecond steps.
    """
    if not (np.isfinite(np.real(circuit.follower)) and np.isfinite(np.real(circuit.differencing))):
        raise InputError("slew_limit: its likelihood needs source_follower_pole and differencing_pole")
    photoreceptor, poles = tuple(dynamics)[:3], tuple(dynamics)[3:]
    values = tuple(float(np.real(v)) for v in photoreceptor) + tuple(
        min(float(np.real(w)), SLEW_FASTEST) if w < PRESENT_BELOW else w for w in poles
    )
    span = float(light.t[-1] - light.t[0])
    t, radiance = light.t, light.radiance
    if np.ptp(radiance) > 0:
        t, left, weight = refined(light.t, slew.longest_step(values[3:], span, SLEW_RESOLUTION))
        logs = np.log(light.radiance)
        radiance = np.exp((1.0 - weight) * logs[left] + weight * logs[left + 1])
    midpoint = circuit.linearisation == "midpoint"
    states = slew.slewed_states(t, radiance, values, slew.rates_of(circuit, values), midpoint)
    return Trajectory(t, np.log(radiance), radiance, Dynamics._make(values), midpoint, states)
