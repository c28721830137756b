"""Phases of each recording's own: likelihood, gradient, start and fit, against light multiplied by hand."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from pixelid.fit.coordinates import Coordinates
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.fit import fit
from pixelid.fit.maximise import maximise
from pixelid.fit.own_values import in_event_times
from pixelid.fit.result import FitResult
from pixelid.gap.attribute.candidates import remove_effect, start_in_each
from pixelid.gap.attribute.significance import (
    SMALLEST,
    _log_chi2_sf,
    chance_of_gain,
    log_chance_of_gain,
    own_values,
)
from pixelid.gap.gap import gap
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.shipped import find_model
from pixelid.simulate import simulate
from pixelid.stimuli.resample import resampled
from pixelid.stimuli.shapes import chirp, slow, steps
from pixelid.stimuli.stimulus import Stimulus

MODULATION, PHASES = 0.12, {"chirp": 0.4, "steps": 2.3, "slow": 4.9}
PHASE = "mains_flicker.phase_rad"
MODEL = find_model("dvs128").set({"threshold_sigma": 0.03, "refractory_s": 2e-4})


def flickering(light, phase, hz=100.0):
    """The light times 1 + m sin(2π f t + φ), sampled every 0.1 ms."""
    t = np.arange(light.start_s, light.end_s, 1e-4)
    radiance = np.exp(np.interp(t, light.t, np.log(light.radiance)))
    return Stimulus.from_arrays(t, radiance * (1.0 + MODULATION * np.sin(2.0 * np.pi * hz * t + phase)))


def session(duration_s=0.5, side=2):
    """Recordings whose lamp flickered, by a camera that knows nothing of it; their stimuli do not say so."""
    lights = {
        "chirp": chirp(60.0, stop_hz=40.0, duration_s=duration_s),
        "steps": steps(60.0, seed=1, duration_s=duration_s),
        "slow": slow(24.0, seed=2, duration_s=duration_s),
    }
    made = []
    for i, (name, light) in enumerate(lights.items()):
        seen = flickering(resampled(light, "smooth"), PHASES[name])
        r = simulate(MODEL, seen, width=side, height=side, seed=i, sensor_seed=3)
        made.append(replace(r, stimulus=light, condition=name, attributes={}))
    return made


@pytest.fixture(scope="module")
def likelihood():
    return EventTimes([r.with_stimulus(resampled(r.stimulus, "smooth")) for r in session()])


def grown(phases=PHASES):
    return MODEL.with_effect("mains_flicker", {"modulation": MODULATION}).with_nuisances({PHASE: phases})


def test_a_recording_has_its_own_phase_and_the_others_theirs():
    model = grown()
    assert model.circuit().flicker_phase == 0.0
    for name, phase in PHASES.items():
        assert model.circuit().in_recording(name) == model.in_recording(name).circuit()
        assert model.in_recording(name).values[PHASE] == phase
    assert model.circuit().in_recording("another").flicker_phase == 0.0
    names = Coordinates.of(model).names
    assert PHASE not in names
    assert {f"{PHASE}[{name}]" for name in PHASES} <= set(names)
    assert not remove_effect(model, "mains_flicker", MODEL).nuisances


def test_the_likelihood_is_that_of_each_recording_under_its_own_circuit(likelihood):
    model = grown()
    alone = [EventTimes([r]).changes(model.in_recording(r.name).circuit()) for r in likelihood.recordings]
    together = likelihood.changes(model.circuit())
    np.testing.assert_array_equal(together.events.change, np.concatenate([each.events.change for each in alone]))
    np.testing.assert_array_equal(together.ends.rise, np.concatenate([each.ends.rise for each in alone]))


def test_the_gradient_by_a_phase_is_a_difference_of_values(likelihood):
    objective = EventTimesObjective(likelihood, Coordinates.of(grown()))
    x = objective.coordinates.start
    gradient = objective.gradient(x)
    for name in PHASES:
        i = objective.coordinates.names.index(f"{PHASE}[{name}]")
        up, down = x.copy(), x.copy()
        up[i], down[i] = x[i] + 1e-4, x[i] - 1e-4
        slope = (objective.value(up) - objective.value(down)) / 2e-4
        assert gradient[i] == pytest.approx(slope, rel=1e-3, abs=0.05)


def test_modulation_and_phases_come_back_from_light_multiplied_by_hand(likelihood):
    found = start_in_each(likelihood, MODEL, "mains_flicker")
    assert found is not None
    start, value = found
    assert own_values(start, "mains_flicker") == 3
    end = maximise(likelihood, start.fix({name: None for name in MODEL.free if "threshold" not in name}),
                   tolerance=0.01, max_steps=30)  # fmt: skip
    assert end.value > value
    assert end.values["mains_flicker.modulation"] == pytest.approx(MODULATION, rel=0.02)
    for name, phase in PHASES.items():
        off = end.model.in_recording(name).values[PHASE] - phase
        assert abs((off + np.pi) % (2.0 * np.pi) - np.pi) < 0.05


@pytest.fixture(scope="module")
def fitted():
    camera = MODEL.with_effect("mains_flicker", {"modulation": 0.05})
    return fit(session(), camera, fixed={f"{PHASE}[slow]": PHASES["slow"]}, starts=0)


def test_a_fit_frees_the_phase_in_every_recording(fitted):
    assert fitted.status == "converged"
    assert fitted.estimates["mains_flicker.modulation"].value == pytest.approx(MODULATION, rel=0.02)
    interval = fitted.estimates["mains_flicker.modulation"].interval_95
    assert interval[0] < MODULATION < interval[1]
    for name, phase in PHASES.items():
        found = fitted.estimates[f"{PHASE}[{name}]"]
        assert abs((found.value - phase + np.pi) % (2.0 * np.pi) - np.pi) < 0.05
        assert found.fixed == (name == "slow")  # held where it was told
    assert PHASE not in fitted.coordinates.names
    assert "clocks" not in fitted.details["curvature"]


def test_a_fit_with_phases_of_each_recording_is_read_back(fitted, tmp_path):
    fitted.save(tmp_path / "fit")
    again = FitResult.load(tmp_path / "fit")
    assert again.coordinates.names == fitted.coordinates.names
    assert again.model.nuisances.keys() == {f"{PHASE}[{name}]" for name in PHASES}
    likelihood = EventTimes(session())
    here, there = (likelihood.log_likelihood(result.coordinates.circuit(result.x)) for result in (fitted, again))
    assert there == pytest.approx(here, abs=1e-6)


def test_a_phase_that_is_held_is_one_for_all_recordings(likelihood):
    camera = MODEL.with_effect("mains_flicker", {"modulation": MODULATION}).fix({PHASE: 0.4})
    assert in_event_times(camera, likelihood) is camera
    free = in_event_times(camera.release([PHASE]), likelihood)
    assert free.nuisances.keys() == {f"{PHASE}[{name}]" for name in PHASES}
    for name, phase in PHASES.items():
        off = free.in_recording(name).values[PHASE] - phase
        assert abs((off + np.pi) % (2.0 * np.pi) - np.pi) < 0.5 * np.pi


@pytest.mark.slow
def test_pooled_counts_have_a_phase_in_every_recording():
    """Thresholds far below the modulation: the pooled rate is the limit of many events per swing."""
    made, sensitive = [], MODEL.set({"on_threshold": 0.02, "off_threshold": 0.02, "refractory_s": 1e-6})
    for i, (name, phase) in enumerate((("one", 0.5), ("other", 2.9))):
        t = np.arange(0.0, 1.0, 1e-3)
        light = Stimulus(t, 100.0 * np.exp(0.8 * np.sin(2.0 * np.pi * 7.0 * t + i)))
        seen = flickering(light, phase)
        r = simulate(sensitive, seen, width=100, seed=i)
        events = replace(r.events, x=np.zeros(len(r.events), np.uint16), width=1)
        made.append(replace(r, events=events, stimulus=light, condition=name, pooled=True, attributes={}))
    end = fit(made, MODEL.with_effect("mains_flicker", {"modulation": 0.05}))
    assert end.estimates["mains_flicker.modulation"].value == pytest.approx(MODULATION, rel=0.1)
    apart = end.estimates[f"{PHASE}[other]"].value - end.estimates[f"{PHASE}[one]"].value
    assert abs((apart - 2.4 + np.pi) % (2.0 * np.pi) - np.pi) < 0.1


def test_nothing_starts_anew_in_one_recording_or_in_recordings_of_one_name(likelihood):
    assert start_in_each(EventTimes(likelihood.recordings[:1]), MODEL, "mains_flicker") is None
    assert start_in_each(likelihood, MODEL, "leak") is None
    twice = EventTimes([replace(r, condition="same") for r in likelihood.recordings])
    assert start_in_each(twice, MODEL, "mains_flicker") is None


def test_more_values_need_more_gain():
    shared, own = chance_of_gain("mains_flicker", 10.0, 5), chance_of_gain("mains_flicker", 10.0, 5, own=2)
    assert shared < own < chance_of_gain("mains_flicker", 10.0, 5, own=6)


def test_gains_whose_chances_no_number_holds_are_told_apart():
    assert chance_of_gain("mains_flicker", 5000.0, 1) == chance_of_gain("mains_flicker", 7000.0, 1, own=12) == 0.0
    # amplitude and phase, tried at two frequencies: χ² of two degrees is an exponential
    assert log_chance_of_gain("mains_flicker", 5000.0, 1) == pytest.approx(np.log(2.0) - 5000.0, rel=1e-12)
    assert log_chance_of_gain("mains_flicker", 7000.0, 1, own=12) < log_chance_of_gain("mains_flicker", 5000.0, 1)
    for degrees in (1, 3, 13, 40):
        near = np.nextafter(0.5 * chi2.isf(2.0 * SMALLEST, degrees), 0.0)
        exact, series = (_log_chi2_sf(half, degrees) for half in (near, near + 1.0))
        assert series - exact == pytest.approx(-1.0 + (0.5 * degrees - 1.0) / near, abs=1e-3)


@pytest.mark.slow
def test_flicker_of_free_phases_is_named():
    report = gap(session(duration_s=1.5, side=3), find_model("dvs128"), recommend=False)
    assert (report.verdict, [e.name for e in report.effects]) == ("named", ["mains_flicker"])
    parameters = report.effects[0].parameters
    assert parameters["mains_flicker.modulation"][0] == pytest.approx(MODULATION, rel=0.02)
    assert {f"{PHASE}[{name}]" for name in PHASES} < set(parameters)
