"""Gain and background of every pixel: scores and curvatures against differences of plain likelihoods; refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import halfnorm, norm

from pixelid.errors import InputError
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.levels.covariance import Joint
from pixelid.fit.levels.objective import LevelledObjective
from pixelid.fit.levels.pixel_levels import PixelLevels, Scales, Wanted, half_normal, half_normal_slope, with_own_lights
from pixelid.fit.levels.scales import Told
from pixelid.fit.newton import maximise
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.shipped import find_model
from pixelid.recordings.recording import Recording
from pixelid.recordings.selection import only
from pixelid.simulate import simulate
from pixelid.stimuli.pixel_lights import PixelLights
from pixelid.stimuli.shapes import grating, sine

HELD = ("beta", "gamma", "sf_cutoff_hz", "diff_cutoff_hz", "refractory_s")  # what one short recording does not tell
MODEL = find_model("dvs128").fix(dict.fromkeys(HELD))
SCALES = Scales(gain=0.2, background=0.03 * 60.0)
GAIN, BACKGROUND = np.array([0.8, 1.1, 1.3, 0.95]), np.array([0.5, 3.0, 1.0, 2.0])


@pytest.fixture(scope="module")
def recording() -> Recording:
    """Four pixels under a grating, each with another gain and background than the light beside the events says."""
    video = grating(60.0, 0.6, 25.0, 8.0, width=2, height=2, duration_s=0.4, dt=2e-4)
    seen = replace(video, radiance=video.radiance * GAIN.reshape(2, 2) + BACKGROUND.reshape(2, 2))
    return simulate(MODEL, seen, seed=1).with_stimulus(video)


@pytest.fixture(scope="module")
def objective(recording) -> LevelledObjective:
    likelihood = EventTimes(with_own_lights([recording]))
    return LevelledObjective(likelihood, Coordinates.of(MODEL), SCALES)


def plainly(recording: Recording, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """(4,) log posterior by pixel, the light multiplied and added to before a likelihood is made of it."""
    light = recording.stimulus.radiance.astype(float).reshape(-1, 4)
    seen = np.exp(SCALES.gain * u[:, 0]) * light + SCALES.background * halfnorm.ppf(norm.cdf(u[:, 1]))
    stimulus = replace(recording.stimulus, radiance=seen.reshape(-1, 2, 2))
    terms = EventTimes([recording.with_stimulus(stimulus)]).terms(Coordinates.of(MODEL).circuit(x))
    return terms.per_pixel - 0.5 * (u**2).sum(axis=1)


def test_half_normal_levels():
    u = np.linspace(-5.0, 5.0, 21)
    np.testing.assert_allclose(half_normal(u), halfnorm.isf(norm.sf(u)), rtol=1e-10)
    slope = (half_normal(u + 1e-5) - half_normal(u - 1e-5)) / 2e-5
    np.testing.assert_allclose(half_normal_slope(u), slope, rtol=1e-6, atol=1e-10)  # rounding of values near 0
    gain, background = SCALES.levels(np.array([[1.0, 0.0]]))
    assert gain[0] == pytest.approx(np.exp(0.2))
    assert background[0] == pytest.approx(1.8 * halfnorm.median())


def test_scores_of_all_pixels_are_differences_of_each_pixels_likelihood(recording, objective):
    x, u = objective.coordinates.start + 0.02, np.array([[-0.5, 0.3], [0.2, -0.4], [1.0, 0.1], [0.0, 0.9]])
    at = objective._around(x, u)
    np.testing.assert_allclose(at.value, plainly(recording, x, u), rtol=1e-10)
    for k in range(2):
        step = 1e-4 * np.eye(2)[k]
        slope = (plainly(recording, x, u + step) - plainly(recording, x, u - step)) / 2e-4
        np.testing.assert_allclose(at.score[:, k], slope, rtol=2e-3, atol=0.02)


def test_best_levels_are_the_maximum_for_each_pixel(recording, objective):
    x = objective.coordinates.start
    best = objective.best(x)
    top = plainly(recording, x, best.u)
    np.testing.assert_allclose(best.value, top, rtol=1e-10)
    for k in range(2):
        for move in (-0.02, 0.02):
            assert (plainly(recording, x, best.u + move * np.eye(2)[k]) < top).all()


@pytest.fixture(scope="module")
def optimum(objective):
    return maximise(objective, objective.coordinates.start, tolerance=1e-5)


def test_the_schur_complement_is_that_of_all_second_derivatives(recording, objective, optimum):
    """Four pixels: the covariance of the camera's parameters is that block of the inverse of everything."""
    x, u = optimum.x, objective.best(optimum.x).u
    d, n = len(x), len(x) + u.size
    coordinates = objective.coordinates

    def gradient(z: np.ndarray) -> np.ndarray:
        """Of everything, levels by differences of the plain likelihood, θ by the plain objective under that light."""
        at, levels = z[:d], z[d:].reshape(4, 2)
        out = np.empty(n)
        held = EventTimesObjective(objective._under(levels), coordinates)
        out[:d] = held.gradient(at)
        for k in range(2):
            step = 1e-3 * np.eye(2)[k]
            slope = (plainly(recording, at, levels + step) - plainly(recording, at, levels - step)) / 2e-3
            out[d:].reshape(4, 2)[:, k] = slope
        return out

    z, full = np.concatenate([x, u.ravel()]), np.empty((n, n))
    steps = np.where(np.arange(n) < d, 1e-3, 1e-2)
    for i in range(n):
        up, down = z.copy(), z.copy()
        up[i] += steps[i]
        down[i] -= steps[i]
        full[i] = (gradient(up) - gradient(down)) / (2.0 * steps[i])
    brute = np.linalg.inv(-0.5 * (full + full.T))
    schur = np.linalg.inv(-objective.hessian(x))
    scale = np.sqrt(np.outer(np.diag(brute)[:d], np.diag(brute)[:d]))
    np.testing.assert_allclose(schur / scale, brute[:d, :d] / scale, atol=0.03)
    block, cross = objective.curvature(x)
    joint = Joint(schur, block, np.linalg.solve(block, cross))
    np.testing.assert_allclose(joint.level_variances.ravel(), np.diag(brute)[d:], rtol=0.06)
    mean = np.zeros(n)
    mean[d::2] = 0.25  # of the gains
    towards = brute @ mean
    known = brute - np.outer(towards, towards) / (mean @ towards)
    given, levels = joint.given_mean(0)
    np.testing.assert_allclose(np.diag(given), np.diag(known)[:d], rtol=0.06)
    np.testing.assert_allclose(levels.ravel(), np.diag(known)[d:], rtol=0.06, atol=2e-3)


def test_information_is_a_fair_copy_of_the_second_derivatives(objective, optimum):
    exact, fair = -objective.hessian(optimum.x), objective.local(optimum.x).information
    np.testing.assert_allclose(np.sqrt(np.diag(np.linalg.inv(fair)) / np.diag(np.linalg.inv(exact))), 1.0, atol=0.2)


@pytest.mark.parametrize("positive", [False, True])
def test_the_evidence_of_a_scale_is_the_integral_over_levels(positive):
    told = Told(np.array([0.3, -0.1, 0.8]), np.array([0.01, 0.04, 0.09]), positive)

    def integral(scale: float) -> float:
        total = 0.0
        for c, w in zip(told.centre, told.variance, strict=True):
            prior = halfnorm(scale=scale).pdf if positive else norm(scale=scale).pdf
            density = lambda b, c=c, w=w, prior=prior: prior(b) * norm.pdf(c, b, np.sqrt(w))  # noqa: E731
            total += np.log(quad(density, 0.0 if positive else -4.0, 4.0, points=[max(c, 0.0)], limit=200)[0])
        return total

    differences = [f(0.5) - f(0.2) for f in (told.evidence, integral)]
    assert differences[0] == pytest.approx(differences[1], abs=1e-6)
    scale = told.likeliest(1e-3, 2.0)
    assert told.evidence(scale) >= max(told.evidence(s) for s in (0.99 * scale, 1.01 * scale))
    low, high = told.interval(scale, 1e-3, 100.0)
    assert low < scale < high
    assert told.evidence(high) == pytest.approx(told.evidence(scale) - 1.9207, abs=1e-6)


def test_levels_without_spread_are_an_upper_limit():
    noise = np.random.default_rng(0).standard_normal(50)
    told = Told(0.1 * noise, np.full(50, 0.01), False)
    scale = told.likeliest(1e-3, 2.0)
    low, high = told.interval(scale, 1e-3, 2.0)
    assert low == 0.0
    assert high < 0.08


def test_what_is_asked_for():
    assert Wanted.of(None) is None
    assert Wanted.of("both") == Wanted(("gain", "background"), {})
    assert Wanted.of("background, gain=0.2") == Wanted(("gain", "background"), {"gain": 0.2})
    assert Wanted.of({"background": 3, "gain": None}) == Wanted(("gain", "background"), {"background": 3.0})
    for wrong in ("", "loud", "gain,gain", "gain=0", "gain=nan", "gain=much", "both=1", 3, {}, {"gain": -1}):
        with pytest.raises(InputError, match="pixel_levels"):
            Wanted.of(wrong)


def test_refusals(recording):
    both = Wanted.of("both")
    both.check([recording], MODEL, "discrete")
    with pytest.raises(InputError, match="discrete form"):
        both.check([recording], MODEL, "continuous")
    dark = MODEL.with_effect("dark_current")
    with pytest.raises(InputError, match="a background that all pixels share is a dark current"):
        both.check([recording], dark, "discrete")
    Wanted.of("gain").check([recording], dark, "discrete")
    both.check([recording], dark.fix({"dark_current.radiance": 4.0}), "discrete")
    one = replace(recording, events=recording.events.select(recording.events.pixel == 0))
    with pytest.raises(InputError, match="the gain of a single pixel is the radiance's scale"):
        Wanted.of("gain=0.2").check([one], MODEL, "discrete")
    with pytest.raises(InputError, match="1 pixels do not identify how far levels spread"):
        Wanted.of("background").check([one], MODEL, "discrete")
    Wanted.of("background=2").check([one], MODEL, "discrete")
    lux = recording.with_stimulus(replace(recording.stimulus, unit="lux"))
    with pytest.raises(InputError, match="one unit"):
        both.check([recording, lux], MODEL, "discrete")
    with pytest.raises(InputError, match="unit shape"):
        both.check([recording.with_stimulus(replace(sine(), unit="shape"))], MODEL, "discrete")
    with pytest.raises(InputError, match="pooled"):
        both.check([replace(recording, pooled=True)], MODEL, "discrete")


def test_each_pixel_has_its_own_light(recording):
    three = only([recording], np.array([0, 2, 3]))[0]
    for light in (recording.stimulus, sine(), PixelLights.of_video(recording.stimulus)):
        own = with_own_lights([three.with_stimulus(light)])[0].stimulus
        assert len(own.lights) == 3
        np.testing.assert_array_equal(own.of_pixel, [[0, -1], [1, 2]])
    np.testing.assert_array_equal(own.lights[1].radiance, recording.stimulus.radiance[:, 1, 0])


def test_light_as_the_pixels_saw_it_and_back_from_a_file(recording):
    found = PixelLevels(
        np.array([0, 1, 0]), np.array([0, 0, 1]), GAIN[:3], np.ones(3), np.empty(0), np.empty(0),
        {"gain": {"value": 0.2, "unit": "1", "interval_95": [0.1, 0.3], "given": False}}, {}, ("a note",),
    )  # fmt: skip
    seen = found.seen([recording])[0]
    assert set(seen.events.pixel) == {0, 1, 2}
    np.testing.assert_allclose(
        seen.stimulus.lights[2].radiance, GAIN[2] * recording.stimulus.radiance[:, 1, 0].astype(float)
    )
    back = PixelLevels.from_dict(
        {**found.as_dict(), "pixels": {k: list(v) for k, v in found.as_dict()["pixels"].items()}}
    )
    np.testing.assert_array_equal(back.gain, found.gain)
    assert (len(back.background), back.notes) == (0, ("a note",))
    broken = found.as_dict()
    broken["pixels"]["gain"] = [1.0]
    with pytest.raises(ValueError, match="different lengths"):
        PixelLevels.from_dict(broken)
