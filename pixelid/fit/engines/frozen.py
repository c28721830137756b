"""The discrete choices inside the event-time likelihood, made once and shared by every engine.

Which sample carries an extreme, which step holds an event, which events are strays: these are decided by the compiled
likelihood (`EventTimes`) at a point.  Given them the log-likelihood is one smooth expression, the same for every
engine, and the engines must agree on it to rounding.  A fit refreshes the choices as it moves.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pixelid.dynamics.equations import PRESENT_BELOW
from pixelid.dynamics.of_circuit import dynamics_of
from pixelid.errors import InputError
from pixelid.fit.event_times import EventTimesObjective
from pixelid.stages.circuit import Circuit
from pixelid.stages.comparator import threshold_factors
from pixelid.stimuli.drive import drive


@dataclass(frozen=True)
class FrozenRecording:
    """One recording's samples and where its n events and m pixels stand among them.

    t, radiance: (samples,) seconds and radiance without dark current
    previous, time, sign: (n,) of the intervals;  last: (m,) start of the censored ones
    step_r, step_e: (n,) and step_l: (m,) steps that hold release, event, and the last release
    opposite_at: (n,) and rise_at, fall_at: (m,) samples of extremes; −1: none
    """

    t: np.ndarray
    radiance: np.ndarray
    previous: np.ndarray
    time: np.ndarray
    sign: np.ndarray
    last: np.ndarray
    step_r: np.ndarray
    step_e: np.ndarray
    step_l: np.ndarray
    opposite_at: np.ndarray
    rise_at: np.ndarray
    fall_at: np.ndarray


@dataclass(frozen=True)
class Frozen:
    """Everything an engine needs to write the log-likelihood as one expression of the circuit's numbers.

    circuit: the real circuit at the point, which tells what is present
    kept: indices of events that are not strays;  strays: how many are;  survived: indices with a survival factor
    sign, time, tick, clock_share: (n,);  group: (n,) of 2 · pixel + ON;  last_pixel: (m,)
    """

    circuit: Circuit
    recordings: tuple[FrozenRecording, ...]
    kept: np.ndarray
    strays: int
    survived: np.ndarray
    sign: np.ndarray
    time: np.ndarray
    tick: np.ndarray
    clock_share: np.ndarray
    group: np.ndarray
    pixels: int
    last_pixel: np.ndarray
    last_time: np.ndarray
    circuit_of: Callable

    @property
    def samples(self) -> int:
        """Stimulus samples of all recordings."""
        return sum(len(recording.t) for recording in self.recordings)


def freeze(objective: EventTimesObjective, x: np.ndarray) -> Frozen:
    """The discrete choices at x.

    Raises InputError for effects that only the compiled engine has: extra pole, lower cutoff, mains flicker, thresholds
    that depend on the polarity before.
    """
    likelihood = objective.likelihood
    circuit = objective.coordinates.circuit(x)
    dynamics = dynamics_of(circuit)
    for name, there in (
        ("extra_pole", dynamics.extra_pole < PRESENT_BELOW),
        ("lower_cutoff", dynamics.lower_cutoff > 0),
        ("mains_flicker", circuit.flicker_modulation != 0),
        ("a threshold that depends on the polarity before", threshold_factors(circuit, 1.0) != (1.0, 1.0)),
        ("an unlimited photoreceptor", dynamics.beta > PRESENT_BELOW and dynamics.gamma == 0),
    ):
        if there:
            raise InputError(f"{name}: not in the symbolic form of the likelihood; use its compiled form")
    gathered, density = objective.density(x)
    n, m = likelihood.events, len(likelihood.last_pixel)
    opposite, opposite_drift = gathered[4 * n : 6 * n].reshape(2, n)
    growth = 1.0 + circuit.threshold_drift * likelihood.time_s
    reached = (opposite + circuit.on_threshold * opposite_drift) / growth
    assert len(gathered) == 7 * n + 4 * m
    return Frozen(
        circuit=circuit,
        recordings=tuple(_frozen(evaluator, circuit) for evaluator in likelihood.evaluators),
        kept=np.flatnonzero(~density.stray),
        strays=int(density.stray.sum()),
        survived=np.flatnonzero(reached > 0),
        sign=likelihood.sign,
        time=likelihood.time_s,
        tick=likelihood.tick_s,
        clock_share=likelihood.clock_share,
        group=likelihood.group,
        pixels=likelihood.pixels,
        last_pixel=likelihood.last_pixel,
        last_time=likelihood.last_time_s,
        circuit_of=objective.coordinates.model.circuit,
    )


def _frozen(evaluator, circuit: Circuit) -> FrozenRecording:
    iv = evaluator.intervals
    light = drive(evaluator.recording.stimulus, circuit, iv.end_s)

    def step_of(times):
        return np.maximum(np.searchsorted(light.t, times, side="right") - 1, 0)

    opposite_at, rise_at, fall_at = (at.copy() for at in evaluator.extremes_at)
    return FrozenRecording(
        t=light.t,
        radiance=light.radiance - circuit.dark,
        previous=iv.previous_s,
        time=iv.time_s,
        sign=iv.sign,
        last=iv.last_s,
        step_r=step_of(iv.previous_s + circuit.refractory - circuit.delay),
        step_e=step_of(iv.time_s - circuit.delay),
        step_l=step_of(iv.last_s + circuit.refractory - circuit.delay),
        opposite_at=opposite_at,
        rise_at=rise_at,
        fall_at=fall_at,
    )
