"""Fits of many events: pixels of a part first, then all of them, to the optimum that all of them have."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from pixelid.fit import refine as refining
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.engines import engine
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.newton import Optimum
from pixelid.fit.objective import Local, Objective
from pixelid.fit.refine import BETWEEN, refine
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import Model
from pixelid.model.shipped import find_model
from pixelid.recordings import Recording
from pixelid.recordings.own_light import with_fine_light, with_pixel_lights
from pixelid.recordings.selection import only
from pixelid.simulate import simulate
from pixelid.stimuli import resample
from pixelid.stimuli.pixel_lights import pixel_lights
from pixelid.stimuli.resample import with_overshoots, without_long_steps
from pixelid.stimuli.shapes import chirp, grating, steps
from pixelid.stimuli.stimulus import Stimulus

MODEL = find_model("dvs128")


def sampled(light: Stimulus, every: int) -> Stimulus:
    return Stimulus(light.t[::every], light.radiance[::every], light.unit, light.interpolation)


@pytest.fixture(scope="module")
def session() -> list[Recording]:
    """Ten pixels under a smooth light, of which a fit is given every 20th sample, and under steps."""
    recordings = []
    for k, light in enumerate((chirp(200.0, stop_hz=300.0, dt=2e-5), steps(30.0))):
        made = simulate(MODEL, light, width=5, height=2, seed=k, sensor_seed=1)
        shown = sampled(light, 20) if k == 0 else light
        recordings.append(Recording(made.events, shown, condition=f"light {k}", sensor="one"))
    return recordings


def refined(session, monkeypatch, part: int, decided: float = 20.0):
    monkeypatch.setattr(refining, "PART_EVENTS", part)
    monkeypatch.setattr(refining, "DECIDED_NATS", decided)
    coordinates = Coordinates.of(MODEL)
    start = coordinates.start + 0.05
    told: list[float] = []
    end = refine(session, coordinates, start, BETWEEN, engine("scipy"), np.random.default_rng(0), told.append)
    assert told == sorted(told)
    assert told[-1] == 1.0
    return end


def test_a_part_first_ends_at_the_optimum_of_all(session, monkeypatch):
    events = sum(len(recording.events) for recording in session)
    whole, from_part = refined(session, monkeypatch, events), refined(session, monkeypatch, events // 10)
    assert whole.between == from_part.between == "smooth"
    assert "smooth_or_linear_events" not in whole.details
    assert 0 < from_part.details["smooth_or_linear_events"] <= events / 4
    assert whole.details["smooth_minus_linear_nats"] > from_part.details["smooth_minus_linear_nats"] > 20
    assert from_part.objective.likelihood.events == whole.objective.likelihood.events
    error = np.sqrt(np.diag(np.linalg.inv(whole.optimum.local.information)))
    np.testing.assert_allclose(from_part.optimum.x / error, whole.optimum.x / error, atol=0.002, rtol=0)
    moved = from_part.optimum.x - whole.optimum.x
    assert moved @ whole.optimum.local.information @ moved < 1e-5  # each end is within 1e-6 nats of the top: 8e-6
    assert from_part.optimum.local.value == pytest.approx(whole.optimum.local.value, abs=1e-4)


def test_a_turn_that_leads_nowhere_is_the_last():
    """A search at a corner of the likelihood promises more than it finds: each further turn was the same one again."""

    class Corner:
        """An objective whose levels share the noise of stamps, held anew wherever it is asked to."""

        likelihood = SimpleNamespace(carried=object())
        held = 0

        def near(self, x):
            Corner.held += 1
            return Corner()

        def local(self, x):
            return Local(0.0, np.ones(1), np.eye(1))

    class Stuck:
        turns = 0

        def maximise(self, objective, x, *, max_steps):
            self.turns += 1
            return Optimum(x, objective.local(x), False, np.zeros(1, bool), max_steps)

    engine = Stuck()
    _, optimum = refining._at_rest(Corner(), np.zeros(1), engine)
    assert (engine.turns, Corner.held, optimum.converged) == (1, 2, False)


def test_a_part_that_does_not_decide_leaves_it_to_all_events(session, monkeypatch):
    events = sum(len(recording.events) for recording in session)
    undecided = refined(session, monkeypatch, events // 10, decided=1e9)
    assert "smooth_or_linear_events" not in undecided.details
    assert undecided.between == "smooth"


WITH_LEAK = MODEL.with_effect("leak", {"rate_hz": 2.0}).with_effect("polarity_memory").with_effect("threshold_drift")
PHASES = MODEL.with_effect("mains_flicker", {"modulation": 0.1, "phase_rad": 0.3})


@pytest.mark.parametrize("model", [MODEL, WITH_LEAK, PHASES], ids=["plain", "leak", "own phases"])
def test_a_hessian_that_shares_changes_is_that_of_differences(session, model: Model, monkeypatch):
    if model is PHASES:
        model = model.with_nuisances({"mains_flicker.phase_rad": {r.name: 0.3 + k for k, r in enumerate(session)}})
    objective = EventTimesObjective(EventTimes(session), Coordinates.of(model))
    x = objective.coordinates.start + 0.01
    local = objective.local(x)
    calls = []
    counted = EventTimes.changes
    monkeypatch.setattr(EventTimes, "changes", lambda *a, **k: calls.append(1) or counted(*a, **k))
    found = objective.hessian(x, local)
    shared = len(calls)
    calls.clear()
    plain = Objective.hessian(objective, x, local)
    assert shared < len(calls)
    scale = 1.0 / np.sqrt(np.abs(np.diag(plain)))
    names = objective.coordinates.names
    of_density = ("threshold_sigma", "threshold_mismatch.sigma", "threshold_drift.per_s", "polarity_memory.strength")
    in_density = [names.index(name) for name in of_density if name in names]
    others = [i for i in range(len(x)) if i not in in_density and not names[i].startswith(("on_", "off_"))]
    both = np.ix_(others, others)
    np.testing.assert_array_equal(found[both], plain[both])
    for i in in_density:
        step = objective.difference_steps()[i]
        moved = x + step * (np.arange(len(x)) == i)
        row = (objective.gradient(moved) - local.gradient) / step
        np.testing.assert_allclose(found[i] * scale[i] * scale, row * scale[i] * scale, atol=2e-3)


def test_finer_samples_are_made_of_the_lights_of_pixels_with_events_only():
    light = grating(100.0, 0.6, 12.0, 8.0, width=4, height=2, duration_s=0.1, dt=2e-4)
    recordings = with_pixel_lights([simulate(MODEL, light, seed=1)])
    assert len(recordings[0].stimulus.lights) == 4
    fine = with_fine_light(only(recordings, np.array([2, 6]))[0], "smooth").stimulus
    assert len(fine.lights) == 1
    whole = with_fine_light(recordings[0], "smooth").stimulus
    np.testing.assert_array_equal(fine.lights[0].radiance, whole.lights[whole.of_pixel[0, 2]].radiance)


def test_held_light_is_looked_at_where_a_pixel_overshoots():
    """Survivals at the samples alone missed 0.1 % of a log-likelihood, 458 nats here, and biased poles by 4 sd."""
    model, rng = find_model("dvs128"), np.random.default_rng(0)
    t = 2e-3 * np.arange(101)
    light = Stimulus(t, 200.0 * np.exp(rng.normal(0, 0.5, len(t))), "fA", "previous")
    recording = simulate(model, light, width=12, height=1, seed=1)
    dense = np.unique(np.concatenate([(t[:-1, None] + 4e-6 * np.arange(500)).ravel(), t]))
    lights = {
        "samples": light,
        "looked at": with_overshoots(light),
        "dense": replace(light, t=dense, radiance=light.radiance[np.searchsorted(t, dense + 1e-12, side="right") - 1]),
    }
    for name in ("looked at", "dense"):
        again = simulate(model, lights[name], width=12, height=1, seed=1).events
        np.testing.assert_allclose(again.t, recording.events.t, atol=1000)
    found = {
        name: EventTimes([replace(recording, stimulus=one)]).log_likelihood(model.circuit())
        for name, one in lights.items()
    }
    assert found["samples"] - found["dense"] > 10.0
    assert abs(found["looked at"] - found["dense"]) < 0.05 * (found["samples"] - found["dense"])


def test_samples_after_jumps_have_a_budget(monkeypatch):
    """Of a video's pixels each jumps with every frame: a hundred times its samples would be gigabytes."""
    t = 0.025 * np.arange(41)
    radiance = 100.0 * np.exp(np.random.default_rng(0).normal(0, 0.5, (len(t), 2, 2)))
    video = Stimulus(t, radiance, "fA", "previous")
    pixels = pixel_lights(video, np.arange(4))
    assert pixels is not None
    monkeypatch.setattr(resample, "MOST_ADDED", 20 * 4 * 40)
    monkeypatch.setattr(resample, "STEPS_IN_ALL", 4 * 40)
    looked_at = with_overshoots(pixels)
    assert all(41 < len(one.t) <= 41 + 20 * 40 for one in looked_at.lights)
    monkeypatch.setattr(resample, "MOST_ADDED", 100)
    assert [len(one.t) for one in with_overshoots(pixels).lights] == [41] * 4


@pytest.mark.parametrize("interpolation", ["linear", "previous"])
def test_a_light_has_many_steps_and_is_what_it_was(interpolation):
    """A circuit may change with time though the light does not, or hardly."""
    t = np.array([0.0, 0.1, 1.5])
    light = Stimulus(t, np.array([20.0, 40.0, 30.0]), interpolation=interpolation)
    fine = without_long_steps(light)
    assert np.diff(fine.t).max() <= 1.5 / resample.LEAST_STEPS * (1 + 1e-9)
    assert len(fine.t) <= resample.LEAST_STEPS + 3
    assert np.isin(t, fine.t).all()
    before = np.searchsorted(t, fine.t, side="right") - 1
    between = np.exp(np.interp(fine.t, t, np.log(light.radiance)))
    np.testing.assert_allclose(fine.radiance, between if interpolation == "linear" else light.radiance[before])
    assert without_long_steps(fine) is fine
