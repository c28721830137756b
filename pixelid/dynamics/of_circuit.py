"""The linear dynamics of a circuit, as the compiled kernels want them."""

from __future__ import annotations

import math

from pixelid.dynamics.equations import ABSENT_DIFFERENCING, ABSENT_EXTRA, ABSENT_FOLLOWER
from pixelid.dynamics.slew import slews
from pixelid.dynamics.trajectory import Dynamics
from pixelid.errors import InputError
from pixelid.stages.circuit import Circuit


def dynamics_of(circuit: Circuit) -> Dynamics:
    """`Dynamics` of a circuit; infinite cutoffs become absent stages.

    Raises InputError for a slew limit: a slew-limited follower is not linear (see `slew.py`).
    """
    if slews(circuit):
        raise InputError("slew_limit: a slew-limited follower has no linear dynamics")
    stages = {
        "follower": _finite(circuit.follower, ABSENT_FOLLOWER),
        "extra_pole": _finite(circuit.extra_pole, ABSENT_EXTRA),
        "lower_cutoff": circuit.lower_cutoff,
        "differencing": _finite(circuit.differencing, ABSENT_DIFFERENCING),
        "floor": circuit.bandwidth_floor,
    }
    if circuit.photoreceptor == "one_pole":
        return Dynamics.low_light(circuit.corner, **stages)
    if circuit.photoreceptor == "unlimited":
        return Dynamics.unlimited(**stages)
    return Dynamics(circuit.alpha, circuit.beta, circuit.gamma, **stages)


def _finite(cutoff, absent: float):
    return absent if isinstance(cutoff, float) and math.isinf(cutoff) else cutoff
