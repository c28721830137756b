"""The discrete choices inside the event-time likelihood, made once and shared by every engine.

Which sample carries an extreme, which step holds an event, which events are background: these are decided by the
compiled likelihood (`EventTimes`) at a point.  Given them the log-likelihood is one smooth expression, the same for
every engine, and the engines must agree on it to rounding.  A fit refreshes the choices as it moves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pixelid.dynamics.equations import PRESENT_BELOW
from pixelid.dynamics.of_circuit import dynamics_of
from pixelid.errors import InputError
from pixelid.fit.event_times import EventTimesObjective
from pixelid.likelihood.changes import ChangeEvaluator
from pixelid.likelihood.clocks import clock_in
from pixelid.likelihood.extremes import Extremes
from pixelid.likelihood.layout import Layout
from pixelid.recordings.recording import Recording
from pixelid.stages.circuit import Circuit
from pixelid.stimuli.drive import drive


@dataclass(frozen=True)
class FrozenRecording:
    """One recording's samples and where its n events and m pixels stand among them.

    recording: whose they are
    t, radiance: (samples,) seconds and radiance without dark current
    previous, time, sign: (n,) of the intervals;  last: (m,) start of the censored ones
    step_r, step_e: (n,) and step_l: (m,) steps that hold release, event, and the last release
    opposite_at: (n,) and rise_at, fall_at: (m,) samples of extremes; −1: none
    """

    recording: Recording
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

    circuit: the real circuit at the point, which shows what is present
    layout: which pixel each of the n events and m unfinished intervals belongs to
    clock_share, threshold_factor: (n,), as of `EventTimes`
    kept: indices of the circuit's events;  background: how many are not;  survived: indices with a survival factor
    """

    circuit: Circuit
    recordings: tuple[FrozenRecording, ...]
    layout: Layout
    clock_share: np.ndarray
    threshold_factor: np.ndarray
    kept: np.ndarray
    background: int
    survived: np.ndarray

    @property
    def samples(self) -> int:
        """Stimulus samples of all recordings."""
        return sum(len(recording.t) for recording in self.recordings)


def freeze(objective: EventTimesObjective, x: np.ndarray) -> Frozen:
    """The discrete choices at x.

    Raises InputError for what only the compiled form has: light of each pixel's own, extra pole, lower cutoff, mains
    flicker, a response that is linear in low light, lost events, silence without reset, described effects.
    """
    likelihood = objective.likelihood
    circuit = objective.coordinates.circuit(x)
    dynamics = dynamics_of(circuit)
    for name, there in (
        ("extra_pole", dynamics.extra_pole < PRESENT_BELOW),
        ("lower_cutoff", dynamics.lower_cutoff > 0),
        ("mains_flicker", circuit.flicker_modulation != 0),
        ("linear_log", circuit.knee != 0),
        ("lost_events", circuit.lost != 0),
        ("dead_time_without_reset", circuit.silent != 0),
        ("a described effect", bool(circuit.described)),
        ("an unlimited photoreceptor", dynamics.beta > PRESENT_BELOW and dynamics.gamma == 0),
    ):
        if there:
            raise InputError(f"{name}: not in the symbolic form of the likelihood; use its compiled form")
    if not all(r.stimulus is not None and r.stimulus.full_field for r in likelihood.recordings):
        raise InputError("light of each pixel's own: not in the symbolic form of the likelihood; use its compiled form")
    if likelihood.is_uneven:
        raise InputError("an uneven field: not in the symbolic form of the likelihood; use its compiled form")
    if likelihood.carried is not None:
        raise InputError("jitter of stamps: not in the symbolic form of the likelihood; use its compiled form")
    own = {name for _, numbers in circuit.of_recordings for name, _ in numbers}
    if own - {"delay"}:
        raise InputError("numbers of one recording: not in the symbolic form of the likelihood; use its compiled form")
    terms, factor = objective.terms(x), likelihood.threshold_factor
    located = zip(likelihood.evaluators, terms.changes.extremes, likelihood.recordings, strict=True)
    return Frozen(
        circuit=circuit,
        recordings=tuple(
            _frozen(evaluator, extremes, circuit, recording) for evaluator, extremes, recording in located
        ),
        layout=likelihood.layout,
        clock_share=likelihood.clock_share,
        threshold_factor=np.ones(likelihood.events) if factor is None else factor,
        kept=np.flatnonzero(~terms.background),
        background=int(terms.background.sum()),
        survived=np.flatnonzero(terms.reached > 0),
    )


def _frozen(evaluator: ChangeEvaluator, extremes: Extremes, circuit: Circuit, recording: Recording) -> FrozenRecording:
    iv, clock = evaluator.intervals, clock_in(recording, circuit)
    circuit = circuit.in_recording(recording.name)
    light = drive(evaluator.section.lights[0], circuit, iv.end_s)

    def step_of(stamps, later):
        times = (stamps if clock is None else clock.on_light(stamps)) + later
        return np.maximum(np.searchsorted(light.t, times, side="right") - 1, 0)

    return FrozenRecording(
        recording=recording,
        t=light.t,
        radiance=light.radiance - circuit.dark,
        previous=iv.previous_s,
        time=iv.time_s,
        sign=iv.sign,
        last=iv.last_s,
        step_r=step_of(iv.previous_s, circuit.refractory - circuit.delay),
        step_e=step_of(iv.time_s, -circuit.delay),
        step_l=step_of(iv.last_s, circuit.refractory - circuit.delay),
        opposite_at=extremes.opposite,
        rise_at=extremes.rise,
        fall_at=extremes.fall,
    )
