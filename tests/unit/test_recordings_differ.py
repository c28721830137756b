"""Recordings whose light or clock is not what they say, or whose thresholds are others: the pixel lacks nothing."""

from dataclasses import replace

import numpy as np
import pytest

from pixelid.fit.coordinates import Coordinates
from pixelid.fit.event_times import EventTimesObjective
from pixelid.gap import search
from pixelid.gap.gap import gap
from pixelid.gap.options import Context, Options
from pixelid.gap.steps.recordings_differ import DELAY, GAIN, THRESHOLDS, _drifting, _explained, in_words
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.shipped import find_model
from pixelid.simulate import simulate
from pixelid.stimuli.resample import resampled
from pixelid.stimuli.shapes import chirp, slow, steps

MODEL = find_model("dvs128").set({"threshold_sigma": 0.03, "refractory_s": 2e-4})
LEVELS = {"chirp": 1.0, "steps": 1.2, "dim": 0.8}  # most events are the chirp's
DELAYS = {"chirp": 8e-4, "steps": -6e-4, "dim": 1.3e-3}
OWN = "described.off_threshold.radiance.relaxation"
FACTORS = {"chirp": 1.0, "steps": 1.06, "dim": 0.93}


def session(levels=None, delays=None, thresholds=None, side=3, model=MODEL):
    """Recordings whose light was `levels` times what they say, whose stamps are `delays` s late, and whose thresholds
    are `thresholds` times those of the model."""
    lights = {
        "chirp": chirp(100.0, stop_hz=200.0, duration_s=0.5),
        "steps": steps(60.0, seed=1, duration_s=0.5),
        "dim": slow(6.0, seed=2, frequency_hz=6.0, duration_s=0.8),
    }
    made = []
    for i, (name, light) in enumerate(lights.items()):
        seen = replace(light, radiance=light.radiance * (levels or {}).get(name, 1.0))
        factor = (thresholds or {}).get(name, 1.0)
        here = model.set({key: factor * model.values[key] for key in ("on_threshold", "off_threshold")})
        r = simulate(here, resampled(seen, "smooth"), width=side, height=side, seed=i, sensor_seed=3)
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


@pytest.mark.parametrize(
    "effects", [{}, {"leak": {"rate_hz": 5.0}, "dead_time_without_reset": {"s": 1e-3}}, {OWN: {"strength": 0.1}}]
)
def test_a_factor_on_thresholds_is_other_thresholds_in_that_recording(effects):
    model = MODEL
    for effect, values in effects.items():
        model = model.with_effect(effect, values)
    r = session(side=2, model=model)[0].with_stimulus(resampled(chirp(100.0, stop_hz=200.0, duration_s=0.5), "smooth"))
    likelihood, own = EventTimes([r]), model.with_nuisances({THRESHOLDS: {"chirp": 0.93}})
    expected = own.in_recording("chirp")
    assert expected.values["off_threshold"] == 0.93 * model.values["off_threshold"]
    found, alone = likelihood.terms(own.circuit()), likelihood.terms(expected.circuit())
    np.testing.assert_allclose(0.93 * found.event.level, alone.event.level, rtol=1e-12)
    np.testing.assert_allclose(0.93 * found.group_mean, alone.group_mean, rtol=1e-12)
    assert found.total == pytest.approx(alone.total, rel=1e-9)


@pytest.mark.parametrize("parameter", [GAIN, DELAY, THRESHOLDS])
def test_the_gradient_is_a_difference_of_values(parameter):
    likelihood = EventTimes([r.with_stimulus(resampled(r.stimulus, "smooth")) for r in session(side=2)])
    values = {GAIN: LEVELS, DELAY: dict.fromkeys(DELAYS, 1e-05), THRESHOLDS: FACTORS}[parameter]
    objective = EventTimesObjective(likelihood, Coordinates.of(MODEL.with_nuisances({parameter: values})))
    x = objective.coordinates.start
    gradient = objective.gradient(x)
    for name in values:
        i = objective.coordinates.names.index(f"{parameter}[{name}]")
        h = 1e-8 if parameter == DELAY else 1e-5
        up, down = x.copy(), x.copy()
        up[i] += h
        down[i] -= h
        numeric = (objective.value(up) - objective.value(down)) / (2 * h)
        assert gradient[i] == pytest.approx(numeric, rel=5e-3, abs=1e-3 * np.abs(gradient).max())


@pytest.mark.parametrize(
    ("levels", "delays", "thresholds"), [(LEVELS, None, None), (None, DELAYS, None), (None, None, FACTORS)]
)
def test_what_recordings_differ_in_is_found_and_leaves_nothing(levels, delays, thresholds):
    options = Options(alpha=0.01)
    context = Context(options, None, lambda *_: None)
    state = search.begin(session(levels, delays, thresholds), find_model("dvs128"), context)
    assert state.remainder(options.alpha_each)
    found = _explained(state.hypothesis, context)
    assert found is not None
    assert found.seen.p > options.alpha_each
    own = {name: p.value for name, p in found.fit.model.nuisances.items()}
    factors, error = (LEVELS, 0.05) if levels else (FACTORS, 0.01)
    if levels or thresholds:
        kind = GAIN if levels else THRESHOLDS
        assert set(own) == {f"{kind}[{name}]" for name in ("steps", "dim")}  # beside the chirp's
        for name in ("steps", "dim"):
            assert own[f"{kind}[{name}]"] == pytest.approx(factors[name], rel=error)
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
        assert _drifting(state.hypothesis, state.model, context) is None


def test_words():
    assert in_words(MODEL) == ""
    told = in_words(MODEL.with_nuisances({GAIN: {"a": 0.9, "b": 1.05}, DELAY: {"a": 1e-3, "b": -2e-3}}))
    assert "by up to 10 %, in a" in told
    assert "by up to -2 ms, in b" not in told
    assert "by up to 2 ms, in b" in told
    told = in_words(MODEL.with_nuisances({THRESHOLDS: {"a": 0.9, "b": 1.05}}))
    assert "thresholds that differ from recording to recording (by up to 10 %, in a" in told


@pytest.mark.slow
@pytest.mark.parametrize(
    ("levels", "delays", "thresholds"), [(LEVELS, None, None), (None, DELAYS, None), (None, None, FACTORS)]
)
def test_a_search_names_nothing_for_recordings_that_differ(levels, delays, thresholds, tmp_path):
    report = gap(session(levels, delays, thresholds), find_model("dvs128"), recommend=False)
    assert (report.verdict, report.effects, report.described) == ("none", (), ())
    assert report.global_p < report.alpha  # of light and clocks as they were said
    assert set(report.details["recordings_differ"]) == set(report.model.nuisances)
    assert ("as biases and temperature move them" if thresholds else "no part of the camera") in report.sentence
    report.save(tmp_path / "gap")


@pytest.mark.slow
def test_a_drift_that_goes_on_between_recordings_is_named():
    per_s = 0.15
    drifting = MODEL.with_effect("threshold_drift", {"per_s": per_s})
    found = {"chirp": 1.0, "steps": 1.0 + 0.4 * per_s, "dim": 1.0 - 0.2 * per_s}
    report = gap(session(thresholds=found, model=drifting), find_model("dvs128"), recommend=False)
    assert (report.verdict, [effect.name for effect in report.effects]) == ("named", ["threshold_drift"])
    assert report.model.values["threshold_drift.per_s"] == pytest.approx(per_s, rel=0.15)
    own = report.details["recordings_differ"]
    for name in ("steps", "dim"):
        assert own[f"{THRESHOLDS}[{name}]"]["value"] == pytest.approx(found[name], abs=0.01)
