"""A limit of the slew, which times drawn without it hide: stamps ask for it where there is one, and only there."""

from dataclasses import replace

import numpy as np
import pytest

from pixelid.gap.criteria import Criteria
from pixelid.gap.imputation.imputed import QUEUE, TICK, Imputation
from pixelid.gap.imputation.stamps import Stamps
from pixelid.gap.imputation.windows import Windows
from pixelid.gap.options import Context, Options
from pixelid.gap.search import begin
from pixelid.gap.steps.ask_stamps import ask_stamps
from pixelid.gap.steps.undo_readout import undo_readout
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.shipped import find_model
from pixelid.recordings.own_light import with_fine_light
from pixelid.simulate import simulate
from pixelid.stimuli.resample import resampled
from pixelid.stimuli.shapes import chirp, slow, steps

MODEL = find_model("dvs128")
CONTEXT = Context(Options(0.01, 1, (), Criteria(), False))


def recorded(model, lights, side, seed=3):
    """One camera under each light, given as sampled."""
    fine = [resampled(light, "smooth") for light in lights]
    made = [simulate(model, light, width=side, height=side, seed=i, sensor_seed=seed) for i, light in enumerate(fine)]
    return [
        replace(r, stimulus=light, attributes={}, condition=str(i), events=replace(r.events, tick_ns=1))
        for i, (r, light) in enumerate(zip(made, lights, strict=True))
    ]


def known_exactly(recordings):
    """An imputation whose windows are points."""
    fine = tuple(with_fine_light(r, "smooth") for r in recordings)
    times = tuple(r.events.t.astype(float) for r in fine)
    windows = tuple(Windows(t, t) for t in times)
    return Imputation(
        QUEUE, tuple(r.stimulus for r in fine), fine, windows, times, np.random.default_rng(0).bit_generator.state, {}
    )


def test_stamps_without_a_blur_say_what_the_density_of_event_times_says():
    """Two engines, sums over cells of time and the density at the event: circuits differ by as many nats in both."""
    whole = known_exactly(recorded(MODEL, [chirp(24.0, stop_hz=100.0), slow(24.0, seed=2)], side=3))
    stamps, events = Stamps(whole), EventTimes(whole.fine)
    assert stamps.events == sum(len(r.events) for r in whole.fine)
    here = MODEL.circuit()
    for other in ({"beta": 0.93 * MODEL.values["beta"]}, {"sf_cutoff_hz": 1.15 * MODEL.values["sf_cutoff_hz"]}):
        there = MODEL.set(other).circuit()
        gained = stamps.log_likelihood(here) - stamps.log_likelihood(there)
        known = events.log_likelihood(here) - events.log_likelihood(there)
        assert known > 15.0
        assert gained == pytest.approx(known, rel=0.05)
    assert stamps.per_pixel(here).sum() == pytest.approx(stamps.log_likelihood(here))


def undone(camera, base, lights, side):
    """The search where names are about to be given, the readout undone."""
    state = undo_readout(begin(recorded(camera, lights, side), base, CONTEXT), CONTEXT)
    assert state.imputation is not None
    return state


@pytest.mark.slow
@pytest.mark.parametrize("slews", [True, False])
def test_a_limit_of_the_slew_behind_a_coarse_tick_is_named_where_there_is_one(slews):
    """Times drawn without it are too early for it: no limit that the drawn times know of is worth a fit."""
    camera = MODEL.with_effect("slew_limit", {"rise_per_s": 1500.0, "fall_per_s": 1500.0}) if slews else MODEL
    camera = camera.set({"threshold_sigma": 0.02}).with_effect(TICK, {"tick_s": 2e-4})
    lights = [chirp(400.0, stop_hz=400.0), slow(24.0, seed=2), steps(400.0, seed=5), steps(24.0, seed=6)]
    state = undone(camera, MODEL, lights, side=4)
    asked = ask_stamps(state, CONTEXT)
    if not slews:
        assert asked is state
        return
    assert [step.effect for step in asked.steps] == ["slew_limit"]
    assert asked.hypothesis.fit.values["slew_limit.rise_per_s"] == pytest.approx(1500.0, rel=0.1)
    assert asked.hypothesis.seen.background_fraction < 0.1 * state.hypothesis.seen.background_fraction
