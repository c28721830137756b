"""Light that is only known at samples: first passages of a Brownian path, and what the density makes of them."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from pixelid.fit.coordinates import Coordinates
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.measured_light import as_light_tells, unresolved
from pixelid.likelihood.event_times import EventTimes
from pixelid.likelihood.light_between_samples import BETWEEN, first_passage, told
from pixelid.likelihood.light_drawn import light_in_a_row
from pixelid.model.shipped import find_model
from pixelid.recordings.recording import Recording
from pixelid.recordings.sensor_light import ATTRIBUTE, MEASURED
from pixelid.simulate import simulate
from pixelid.stimuli.pixel_lights import PixelLights
from pixelid.stimuli.stimulus import Stimulus


@pytest.mark.parametrize(("mean", "sd"), [(0.3, 0.1), (0.05, 0.2), (-0.1, 0.1), (-0.5, 0.1), (-1.0, 0.1), (2.0, 0.05)])
def test_moments_at_first_passages(mean, sd):
    """Against quadrature of the normal density weighted by the distance."""
    since = 0.02
    moment = [
        quad(lambda y, k=k: y ** (k + 1) * norm.pdf(y, mean, sd), 0.0, max(mean, 0) + 12 * sd, epsabs=0)[0]
        for k in range(3)
    ]
    found = first_passage(np.array([mean / since]), np.array([since]), np.array([sd**2]))
    tolerance = 0.1 if mean < -4 * sd else 1e-6  # far below zero only the leading term is kept
    assert found.speed[0] == pytest.approx(moment[0] / since, rel=tolerance)
    assert mean + found.shift[0] == pytest.approx(moment[1] / moment[0], rel=tolerance)
    variance = moment[2] / moment[0] - (moment[1] / moment[0]) ** 2
    assert found.variance[0] == pytest.approx(variance, rel=2 * tolerance)


def test_first_passages_of_simulated_bridges():
    """Brownian bridges stepped finely: how far those that first reach a random level in a short time had come."""
    rng, steps, end, variance = np.random.default_rng(0), 1000, 0.5, 0.16
    walk = np.cumsum(rng.normal(0.0, np.sqrt(variance / steps), (20_000, steps)), axis=1)
    w = np.arange(1, steps + 1) / steps
    path = walk - w * walk[:, -1:] + w * end
    level = rng.uniform(0.0, 1.5, len(path))
    reached = path >= level[:, None]
    at = np.where(reached.any(axis=1), reached.argmax(axis=1), -1)
    mine = (at > 690) & (at <= 710)
    found = first_passage(np.array([end]), np.array([0.7]), np.array([variance * 0.7 * 0.3]))
    assert level[mine].mean() == pytest.approx(
        0.7 * end + found.shift[0], abs=4 * level[mine].std() / mine.sum() ** 0.5 + 0.01
    )
    assert level[mine].std() == pytest.approx(found.variance[0] ** 0.5, rel=0.2)
    share = mine.sum() / len(path) / 0.02 * 1.5  # levels have density 1/1.5
    assert share == pytest.approx(found.speed[0], rel=0.2)


@pytest.fixture(scope="module")
def recording():
    rng = np.random.default_rng(1)
    lights = []
    for _ in range(6):
        t = np.concatenate([[0.0], np.sort(rng.uniform(0.01, 0.99, 60)), [1.0]])
        lights.append(Stimulus(t, 500 * np.exp(np.cumsum(rng.normal(0.0, 0.4, len(t))))))
    shown = PixelLights.of_groups(lights, np.arange(6)[None, :])
    events = simulate(find_model("dvs128"), shown, seed=1).events
    return Recording(events, shown, condition="a", sensor="s", attributes={ATTRIBUTE: MEASURED})


def test_gradient_is_that_of_the_value(recording):
    model = as_light_tells(find_model("dvs128"), [recording]).fix({"delay_s": None})
    objective = EventTimesObjective(EventTimes([recording]), Coordinates.of(model))
    x = objective.coordinates.start + 0.05
    gradient = objective.local(x).gradient
    for i in range(len(x)):
        step = np.zeros(len(x))
        step[i] = 1e-5
        slope = (objective.value(x + step) - objective.value(x - step)) / 2e-5
        assert gradient[i] == pytest.approx(slope, rel=1e-4, abs=1e-3)


def test_what_it_tells_is_remembered_and_others_tell_nothing(recording):
    found = told(recording)
    assert found is not None
    assert found.variance >= 0
    assert found.noise > 0
    plain = Recording(recording.events, recording.stimulus)
    assert told(plain) is None
    assert EventTimes([plain]).unknown_light is None
    assert told(Recording(plain.events, attributes={ATTRIBUTE: MEASURED, BETWEEN: found._asdict()})) == found


def test_only_what_the_samples_resolve_is_free(recording):
    model = find_model("dvs128")
    held = {"alpha", "beta", "gamma", "sf_cutoff_hz", "diff_cutoff_hz", "refractory_s"}
    assert set(unresolved(model)) == held
    assert set(as_light_tells(model, [recording]).free) == set(model.free) - held | {"delay_s"}
    assert as_light_tells(model, [Recording(recording.events)]) is model


def test_drawn_light_goes_through_the_samples(recording):
    pixels, told_before = np.array([2, 2, 5]), {"variance": 0.09, "noise": 0.01}
    known = Recording(recording.events, recording.stimulus, attributes={ATTRIBUTE: MEASURED, BETWEEN: told_before})
    middle = []
    for seed in range(20):
        drawn = light_in_a_row(known, recording.stimulus, pixels, seed)
        assert drawn.size == (3, 1)
        assert (drawn.lights[0].radiance != drawn.lights[1].radiance).any()
        for pixel, light in zip(pixels, drawn.lights, strict=True):
            own = recording.stimulus.lights[pixel]
            u, line = np.log(light.radiance), np.log(own.radiance)
            np.testing.assert_allclose(np.interp(own.t[1:-1], light.t, u), line[1:-1], rtol=1e-9)
            halves = 0.5 * (own.t[1:-2] + own.t[2:-1])
            middle.append(np.interp(halves, light.t, u) - 0.5 * (line[1:-2] + line[2:-1]))
    assert np.concatenate(middle).std() == pytest.approx(np.sqrt(0.09 / 4), rel=0.05)
