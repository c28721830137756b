"""Recordings whose light or clock is not what they say: no part of the camera."""

from dataclasses import replace

import numpy as np
import pytest

from pixelid.fit.coordinates import Coordinates
from pixelid.fit.event_times import EventTimesObjective
from pixelid.gap import search
from pixelid.gap.gap import gap
from pixelid.gap.options import Context, Options
from pixelid.gap.steps.recordings_differ import DELAY, GAIN, _explained, in_words
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.shipped import find_model
from pixelid.simulate import simulate
from pixelid.stimuli.resample import resampled
from pixelid.stimuli.shapes import chirp, slow, steps

MODEL = find_model("dvs128").set({"threshold_sigma": 0.03, "refractory_s": 2e-4})
LEVELS = {"chirp": 1.0, "steps": 1.2, "dim": 0.8}  # most events are the chirp's
DELAYS = {"chirp": 8e-4, "steps": -6e-4, "dim": 1.3e-3}


def session(levels=None, delays=None, side=3, model=MODEL):
    """Recordings whose light was `levels` times what they say, and whose stamps are `delays` s late."""
    lights = {
        "chirp": chirp(100.0, stop_hz=200.0, duration_s=0.5),
        "steps": steps(60.0, seed=1, duration_s=0.5),
        "dim": slow(6.0, seed=2, frequency_hz=6.0, duration_s=0.8),
    }
    made = []
    for i, (name, light) in enumerate(lights.items()):
        seen = replace(light, radiance=light.radiance * (levels or {}).get(name, 1.0))
        r = simulate(model, resampled(seen, "smooth"), width=side, height=side, seed=i, sensor_seed=3)
        events = replace(r.events, t=r.events.t + round(1e9 * (delays or {}).get(name, 0.0)))
        made.append(replace(r, events=events, stimulus=light, condition=name, attributes={}).within_stimulus())
    return made


def test_a_gain_of_a_recording_is_brighter_light_there():
    model = MODEL.with_nuisances({GAIN: {"dim": 0.8}})
    light = resampled(slow(6.0, seed=2), "smooth")
    dimmer = replace(light, radiance=0.8 * light.radiance)
    found, expected, other = (
        simulate(camera, seen, width=2, height=2, seed=1).events
        for camera, seen in ((model.in_recording("dim"), light), (MODEL, dimmer), (model.in_recording("x"), light))
    )
    np.testing.assert_array_equal(found.t, expected.t)
    assert len(other) != len(found) or (other.t != found.t).any()
    circuit = model.circuit()
    assert (circuit.in_recording("dim").light_gain, circuit.in_recording("x").light_gain) == (0.8, 1.0)
    assert model.without_effect("threshold_mismatch").nuisances == model.nuisances


@pytest.mark.parametrize("parameter", [GAIN, DELAY])
def test_the_gradient_is_a_difference_of_values(parameter):
    likelihood = EventTimes([r.with_stimulus(resampled(r.stimulus, "smooth")) for r in session(side=2)])
    values = LEVELS if parameter == GAIN else dict.fromkeys(DELAYS, 1e-05)
    objective = EventTimesObjective(likelihood, Coordinates.of(MODEL.with_nuisances({parameter: values})))
    x = objective.coordinates.start
    gradient = objective.gradient(x)
    for name in values:
        i = objective.coordinates.names.index(f"{parameter}[{name}]")
        h = 1e-5 if parameter == GAIN else 1e-8
        up, down = x.copy(), x.copy()
        up[i] += h
        down[i] -= h
        numeric = (objective.value(up) - objective.value(down)) / (2 * h)
        assert gradient[i] == pytest.approx(numeric, rel=5e-3, abs=1e-3 * np.abs(gradient).max())


@pytest.mark.parametrize(("levels", "delays"), [(LEVELS, None), (None, DELAYS)])
def test_what_recordings_differ_in_is_found_and_leaves_nothing(levels, delays):
    options = Options(alpha=0.01)
    context = Context(options, None, lambda *_: None)
    state = search.begin(session(levels, delays), find_model("dvs128"), context)
    assert state.remainder(options.alpha_each)
    found = _explained(state.hypothesis, context)
    assert found is not None
    assert found.seen.p > options.alpha_each
    own = {name: p.value for name, p in found.fit.model.nuisances.items()}
    if levels:
        assert set(own) == {f"{GAIN}[{name}]" for name in ("steps", "dim")}  # beside the chirp's
        for name in ("steps", "dim"):
            assert own[f"{GAIN}[{name}]"] == pytest.approx(LEVELS[name], rel=0.05)
    else:
        assert set(own) == {f"{DELAY}[{name}]" for name in DELAYS}
        for name, delay in DELAYS.items():
            assert own[f"{DELAY}[{name}]"] == pytest.approx(delay, abs=1e-4)


def test_recordings_alike_and_a_leak_are_not_taken_for_it():
    context = Context(Options(alpha=0.01), None, lambda *_: None)
    leaking = session(model=MODEL.with_effect("leak", {"rate_hz": 5.0}))
    for recordings in (session(), leaking):
        state = search.begin(recordings, find_model("dvs128"), context)
        assert _explained(state.hypothesis, context) is None


def test_words():
    assert in_words(MODEL) == ""
    told = in_words(MODEL.with_nuisances({GAIN: {"a": 0.9, "b": 1.05}, DELAY: {"a": 1e-3, "b": -2e-3}}))
    assert "by up to 10 %, in a" in told
    assert "by up to -2 ms, in b" not in told
    assert "by up to 2 ms, in b" in told


@pytest.mark.slow
@pytest.mark.parametrize(("levels", "delays"), [(LEVELS, None), (None, DELAYS)])
def test_a_search_names_nothing_for_recordings_that_differ(levels, delays, tmp_path):
    report = gap(session(levels, delays), find_model("dvs128"), recommend=False)
    assert (report.verdict, report.effects, report.described) == ("none", (), ())
    assert report.global_p < report.alpha  # of light and clocks as they were said
    assert set(report.details["recordings_differ"]) == set(report.model.nuisances)
    assert "no part of the camera" in report.sentence
    report.save(tmp_path / "gap")
