"""The likelihood that profiles, posteriors and comparisons look at is the one whose optimum the fit found."""

from dataclasses import replace

import numpy as np
import pytest

from pixelid.compare import compare
from pixelid.errors import InputError
from pixelid.fit import fit
from pixelid.fit.data import event_times_of
from pixelid.fit.uncertainty.profiles import objective_of, profile
from pixelid.gap.gap import gap
from pixelid.model.shipped import find_model
from pixelid.sample.sample import Target
from pixelid.sensors.sensor import fit_sensor
from pixelid.simulate import simulate
from pixelid.stimuli.resample import resampled
from pixelid.stimuli.shapes import chirp, steps

JITTER = "timestamp_jitter.sigma_s"


def recorded(model, side=4, **lights):
    made = []
    for i, (name, light) in enumerate(lights.items()):
        r = simulate(model, resampled(light, "smooth"), width=side, height=side, seed=i, sensor_seed=3)
        made.append(replace(r, stimulus=light, condition=name, attributes={}, events=replace(r.events, tick_ns=1)))
    return made


@pytest.fixture(scope="module")
def jittered():
    """Fitted are those that the jitter tells of; (recordings, result)."""
    camera = find_model("dvs128").set({"threshold_sigma": 0.04}).with_effect("timestamp_jitter", {"sigma_s": 2e-4})
    lights = {"chirp": chirp(60.0, stop_hz=40.0, duration_s=0.8), "steps": steps(60.0, seed=1, duration_s=0.8)}
    free = ("on_threshold", "off_threshold", "threshold_sigma", JITTER)
    model = camera.fix({name: None for name in camera.free if name not in free})
    recordings = recorded(camera, **lights)
    return recordings, fit(recordings, model, starts=0)


def test_jitter_counts_at_the_reset_too(jittered):
    """Counted once, as it was, the gradient was 17 standard deviations off and a profile one-sided."""
    recordings, result = jittered
    for objective in (objective_of(result, recordings), Target(result, recordings).objective):
        assert objective.value(result.x) == pytest.approx(result.log_likelihood, abs=0.5)
        slopes = objective.gradient(result.x) * np.sqrt(np.diag(result.covariance))
        assert np.abs(slopes).max() < 0.3
    found = profile(objective_of(result, recordings), result.x, JITTER, result.covariance)
    assert found.interval_95 == pytest.approx(result.estimates[JITTER].interval_95, rel=0.05)


def test_pixels_held_out_are_judged_likewise(jittered):
    recordings, result = jittered
    comparison = compare(
        recordings, [result.model, replace(result.model.without_effect("timestamp_jitter"), name="none")], folds=2
    )
    with_jitter = comparison.contenders[result.model.name].held_out.sum()
    assert with_jitter == pytest.approx(result.log_likelihood, abs=0.02 * abs(result.log_likelihood))


def test_a_fit_speaks_the_unit_of_its_light():
    """A fit under lux by a circuit in fA said per fA, and a table of noise in lux then took it as 7.7 times faster."""
    camera = find_model("dvs128")
    model = camera.fix({name: None for name in camera.free if name != "alpha"})
    one, two = (
        replace(r, stimulus=replace(r.stimulus, unit=unit))
        for r, unit in zip(recorded(camera, 2, a=steps(60.0), b=steps(24.0)), ("lux", "W/m2"), strict=True)
    )
    result = fit([one], model, starts=0)
    assert result.model.radiance_unit == "lux"
    assert result.estimates["alpha"].unit == "1/s²/lux"
    assert fit([replace(one, stimulus=steps(60.0))], model, starts=0).model.radiance_unit == "fA"
    for refusing in (fit, gap, fit_sensor):
        with pytest.raises(InputError, match="light is in one unit, found W/m2, lux"):
            refusing([one, two], model)


def test_recordings_of_one_name_keep_their_own_nuisances():
    """Of two of one name both took the phase of the first, and the profile of the second was flat."""
    base = find_model("dvs128").set({"threshold_sigma": 0.04})
    camera = base.with_effect("mains_flicker", {"modulation": 0.1, "frequency_hz": 100.0, "phase_rad": 0.3})
    later = camera.set({"mains_flicker.phase_rad": 2.2})
    light = chirp(60.0, stop_hz=40.0, duration_s=0.8)
    recordings = [recorded(c, chirp=light)[0] for c in (camera, later)]
    free = ("on_threshold", "off_threshold", "mains_flicker.modulation", "mains_flicker.phase_rad")
    model = camera.fix({name: None for name in camera.free if name not in free})
    result = fit(recordings, model, starts=0)
    assert event_times_of(result, recordings).value(result.x) == pytest.approx(result.log_likelihood, abs=0.5)
    second = next(name for name in result.estimates if name.startswith("mains_flicker.phase_rad") and "(2)" in name)
    found = profile(objective_of(result, recordings), result.x, second, result.covariance)
    assert found.kind == "bounded"
    assert result.estimates[second].value == pytest.approx(2.2, abs=0.1)
