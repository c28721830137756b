"""What a circuit's numbers mean to the compiled simulator."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pixelid.dynamics import kernels, slew
from pixelid.dynamics.equations import PRESENT_BELOW
from pixelid.dynamics.of_circuit import dynamics_of
from pixelid.dynamics.trajectory import Dynamics
from pixelid.errors import InputError
from pixelid.simulate import random
from pixelid.stages.circuit import Circuit
from pixelid.stages.comparator import drifts_to_zero, memory_factor
from pixelid.stages.differencing import leaked
from pixelid.stages.modulation import at_reset, since_event


class Laws(NamedTuple):
    """The comparator's laws as the kernels want them; see `comparator.events_in_step`.

    history: what ON and OFF thresholds are multiplied by after an OFF event, and after an ON event
    described, relaxing: `modulation.at_reset` and `modulation.since_event`
    silent: seconds after an event in which nothing is compared
    """

    refractory: float
    leak: float
    parasitic: float
    drift: float
    noise: float
    key: np.uint64
    history: tuple[tuple[float, float], tuple[float, float]]
    described: np.ndarray
    relaxing: tuple[float, float, float]
    silent: float


class Rules(NamedTuple):
    """Everything constant about a simulation.

    chain: (w1, w2, wh, wd, coincide, smooth), see `step.py`;  smooth: the follower is slew limited
    """

    circuit: Circuit
    dynamics: Dynamics
    chain: tuple
    laws: Laws
    seed: int
    synchronous: bool

    @property
    def slewing(self) -> bool:
        """Whether the follower is slew limited."""
        return self.chain[5]

    @property
    def rates(self) -> tuple:
        """The cutoffs and slew rates as `dynamics.slew` wants them."""
        return slew.rates_of(self.circuit, self.dynamics)


def rules_of(circuit: Circuit, seed: int, synchronous: bool, t_end: float) -> Rules:
    """The rules of a circuit.  Raises InputError for thresholds that are absent or drift to zero before t_end."""
    if not (circuit.on_threshold > 0 and circuit.off_threshold > 0):
        raise InputError("thresholds must be positive")
    if drifts_to_zero(circuit.threshold_drift, t_end):
        raise InputError(f"threshold_drift.per_s = {circuit.threshold_drift:g} brings the thresholds to zero")
    slewing = slew.slews(circuit)
    if slewing and not math.isfinite(circuit.follower):
        raise InputError("slew_limit needs source_follower_pole: without it there is nothing to slew")
    dynamics = dynamics_of(slew.without_slew_limit(circuit)).uniform()
    w1, w2, wh, wd = dynamics[3:7]
    unlimited = circuit.photoreceptor == "unlimited" and min(w1, w2, wd) > PRESENT_BELOW
    if circuit.shot_density > 0 and unlimited:
        raise InputError("shot_noise needs a bandwidth limit: white noise on ln L has no finite level without one")
    chain = (w1, w2, wh, wd, bool(kernels.cutoffs_coincide(w1, w2, wh, wd)), slewing)
    like = float(memory_factor(circuit.polarity_memory, 1.0)), float(memory_factor(circuit.polarity_memory, -1.0))
    laws = Laws(
        circuit.refractory,
        circuit.on_threshold * leaked(circuit, 1.0, 0.0),
        circuit.on_threshold * leaked(circuit, 0.0, 1.0),
        circuit.threshold_drift,
        circuit.noise,
        np.uint64(random.stream_key(seed, random.THRESHOLD)),  # as int, compiled code would overflow from some seeds on
        ((like[1], like[0]), like),
        at_reset(circuit),
        since_event(circuit),
        circuit.silent,
    )
    return Rules(circuit, dynamics, chain, laws, seed, synchronous)
