"""A model with shot noise, fitted to events of a sensor that has it, or has not."""

from dataclasses import replace

import pytest

from pixelid.errors import InputError
from pixelid.fit import fit
from pixelid.fit.data import event_times_of
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.shipped import find_model
from pixelid.recordings.own_light import with_fine_light
from pixelid.simulate import simulate
from pixelid.stimuli.shapes import chirp, slow

PIXEL = find_model("dvs128").without_effect("threshold_mismatch").set({"threshold_sigma": 0.03})
BASE = find_model("dvs128").without_effect("threshold_mismatch").with_effect("shot_noise", {"density": 1e-4})
DENSITY = 5e-5


def session(model):
    lights = {"chirp": chirp(24.0, stop_hz=200.0), "bright": chirp(400.0, stop_hz=400.0), "slow": slow(24.0, seed=3)}
    return [
        replace(simulate(model, light, width=4, height=2, seed=7 + k, sensor_seed=7), condition=name)
        for k, (name, light) in enumerate(lights.items())
    ]


@pytest.fixture(scope="module")
def noisy():
    recordings = session(PIXEL.with_effect("shot_noise", {"density": DENSITY}))
    return recordings, fit(recordings, BASE, between="linear", seed=1)


def test_density_circuit_and_thresholds_come_back(noisy):
    _, result = noisy
    found = result.estimates["shot_noise.density"]
    assert found.identified
    low, high = found.interval_95
    assert low < DENSITY < high
    assert high / low < 1.4
    values = result.model.values
    for name, within in (("alpha", 0.02), ("on_threshold", 0.01), ("off_threshold", 0.01)):
        assert values[name] == pytest.approx(PIXEL.values[name], rel=within)
    assert values["threshold_sigma"] == pytest.approx(0.03, rel=0.15)  # a fit without shot noise: 0.1
    assert result.model.parameters["shot_noise.density"].prior is None


def test_noise_that_the_thresholds_do_not_have_is_worth_hundreds_of_nats(noisy):
    recordings, result = noisy
    without = fit(recordings, BASE.without_effect("shot_noise"), between="linear", seed=1)
    assert result.log_likelihood > without.log_likelihood + 500.0
    assert without.model.values["threshold_sigma"] > 0.07
    assert result.details["background_events"] <= without.details["background_events"]


def test_the_objective_of_a_fit_comes_back(noisy):
    recordings, result = noisy
    again = event_times_of(result, recordings)
    assert again.terms(result.x).total == pytest.approx(result.log_likelihood, abs=1e-3)
    fine = [with_fine_light(r, "linear") for r in recordings]
    assert EventTimes(fine).log_likelihood(result.model.circuit()) < result.log_likelihood - 500.0


def test_strong_noise_is_fitted_without_a_false_alarm():
    """To first order thresholds come out 1.5 % and their noise a third off, and residuals seem to have structure."""
    truth = PIXEL.with_effect("shot_noise", {"density": 3.2e-4})
    result = fit(session(truth), BASE, between="linear", seed=1)
    assert result.status.name == "converged", result.advice
    for name, within in (("on_threshold", 0.01), ("off_threshold", 0.01), ("threshold_sigma", 0.2), ("alpha", 0.02)):
        assert result.model.values[name] == pytest.approx(truth.values[name], rel=within)
    assert result.model.values["shot_noise.density"] == pytest.approx(3.2e-4, rel=0.06)
    known = {n: e.interval_95 for n, e in result.estimates.items() if n in truth.values and e.identified}
    outside = [n for n, limits in known.items() if limits and not limits[0] <= truth.values[n] <= limits[1]]
    assert len(outside) <= 1, outside
    assert result.details["residual_tests"][-1]["expected"] > 0.01


def test_an_effect_that_is_missing_beside_it_still_shows():
    """What simulated sessions show is no excuse for what they do not."""
    truth = PIXEL.with_effect("shot_noise", {"density": 1e-4}).with_effect("lower_cutoff", {"cutoff_hz": 0.5})
    result = fit(session(truth), BASE, between="linear", seed=1)
    assert result.status.name == "misfit"


def test_a_held_density_is_held(noisy):
    recordings, _ = noisy
    held = BASE.set({"shot_noise.density": DENSITY}).fix({"shot_noise.density": None})
    result = fit(recordings, held, between="linear", seed=1)
    assert result.model.values["shot_noise.density"] == DENSITY
    assert result.model.values["threshold_sigma"] < 0.05


def test_a_sensor_without_shot_noise_has_none():
    result = fit(session(PIXEL), BASE, between="linear", seed=1)
    assert not result.estimates["shot_noise.density"].identified
    assert result.model.values["shot_noise.density"] < 1e-6
    assert result.model.values["threshold_sigma"] == pytest.approx(0.03, rel=0.1)


def test_what_is_not_done_beside_it_is_refused():
    recordings = session(PIXEL)[:1]
    with pytest.raises(InputError, match="discrete form only"):
        fit(recordings, BASE, form="continuous")
    with pytest.raises(InputError, match="levels of pixels"):
        fit(recordings, BASE, pixel_levels="gain")
