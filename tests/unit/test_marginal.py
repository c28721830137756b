"""Newton steps with the true times integrated out, against dense algebra and against what was planted."""

from dataclasses import replace

import numpy as np
import pytest

from pixelid.fit.coordinates import Coordinates
from pixelid.gap.imputation.blurred import follow, likeliest_spread
from pixelid.gap.imputation.imputed import JITTER, Imputation
from pixelid.gap.imputation.marginal import _Linear, _selected_inverse, _times, _trace, _variances, marginal_step
from pixelid.gap.imputation.paths import draw_paths
from pixelid.gap.imputation.windows import jitter_windows, with_times
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.shipped import find_model
from pixelid.recordings.own_light import with_fine_light
from pixelid.simulate import simulate
from pixelid.stimuli.shapes import chirp, steps

MODEL = find_model("dvs128")


def made_up(n: int, rng: np.random.Generator) -> _Linear:
    follows = rng.random(n) < 0.8
    follows[0] = False
    return _Linear(
        rng.normal(size=n), rng.normal(size=(n, 2)), rng.uniform(1.0, 3.0, n), -rng.uniform(0.5, 3.0, n),
        rng.uniform(0.5, 1.5, n), rng.integers(0, 4, n), follows,
    )  # fmt: skip


def dense(linear: _Linear, sigma: float) -> np.ndarray:
    """V as thresholds' noise and a matrix that takes each event's displacement to its two intervals."""
    n = len(linear.y)
    spread = np.zeros((n, 2 * n))  # displacements: of each interval's event, and of one before where none ends there
    for k in range(n):
        spread[k, k] = linear.r[k]
        spread[k, k - 1 if linear.follows[k] else n + k] = linear.g[k]
    return np.diag(linear.noise) + sigma**2 * spread @ spread.T


def test_the_covariance_is_that_of_displacements_shared_by_neighbours():
    rng = np.random.default_rng(0)
    linear = made_up(30, rng)
    V = dense(linear, 0.7)
    np.testing.assert_allclose(linear.solve(0.7, linear.y), np.linalg.solve(V, linear.y))
    inverse = np.linalg.inv(V)
    diagonal, below = _selected_inverse(*linear.covariance(0.7))
    np.testing.assert_allclose(diagonal, np.diag(inverse))
    np.testing.assert_allclose(below[:-1], np.diag(inverse, -1))
    part = linear.covariance(1.3)
    np.testing.assert_allclose(_trace(np.array([diagonal, below]), part), np.trace(inverse @ dense(linear, 1.3)))
    np.testing.assert_allclose(_times(part, linear.y), dense(linear, 1.3) @ linear.y)


def test_dropping_an_interval_cuts_its_chain():
    linear = made_up(12, np.random.default_rng(3))
    linear = replace(linear, follows=np.arange(12) > 0)
    kept = np.arange(12) != 5
    V = dense(linear, 0.7)[np.ix_(kept, kept)]
    np.testing.assert_allclose(linear.only(kept).solve(0.7, linear.y[kept]), np.linalg.solve(V, linear.y[kept]))


def test_steps_of_noise_and_spread_lead_to_what_was_planted():
    rng = np.random.default_rng(1)
    linear = made_up(4000, rng)
    n, sigma, factor = len(linear.y), 0.7, 1.2
    own, earlier = rng.normal(size=n), rng.normal(size=n)
    before = np.where(linear.follows, np.concatenate([[0.0], own[:-1]]), earlier)
    y = factor * np.sqrt(linear.noise) * rng.normal(size=n) + sigma * (linear.r * own + linear.g * before)
    found = 0.4
    log_noise = 0.0
    for _ in range(12):
        here = replace(linear, noise=linear.noise * np.exp(2.0 * log_noise))
        by_noise, by_sigma, noise_error, error = _variances(here, y, found, True)
        log_noise, found = log_noise + by_noise, found * np.exp(by_sigma)
    assert abs(np.log(found / sigma)) < 4 * error
    assert abs(log_noise - np.log(factor)) < 4 * noise_error
    assert 0.005 < error < 0.05


@pytest.fixture(scope="module")
def blurred():
    """Two recordings jittered by 1.5 dead times, outside the package."""
    truth = MODEL.set({"threshold_sigma": 0.02, "refractory_s": 2e-4, "alpha": 0.85 * MODEL.values["alpha"]})
    rng, sd, recordings = np.random.default_rng(4), 3e5, []
    for i, light in enumerate((chirp(100.0, stop_hz=120.0, duration_s=0.4), steps(60.0, seed=1))):
        r = simulate(truth, light, width=3, height=2, seed=i, sensor_seed=9)
        late = np.clip(r.events.t + rng.normal(0.0, sd, len(r.events)), 0, 1e9 * light.end_s)
        order = np.argsort(late, kind="stable")
        events = replace(r.events.select(order), t=np.rint(late[order]).astype(int), tick_ns=1)
        recordings.append(with_fine_light(replace(r, events=events), "smooth"))
    return truth, 1e-9 * sd, recordings


@pytest.mark.slow
def test_steps_lead_to_the_model_behind_blurred_stamps(blurred):
    truth, sd, recordings = blurred
    model, sigma, rng = MODEL.set({"refractory_s": 1.2e-4}), 0.6 * sd, np.random.default_rng(0)
    times = [r.events.t.astype(float) for r in recordings]
    for _ in range(10):
        windows = [jitter_windows(r, sigma) for r in recordings]
        times = draw_paths(recordings, windows, times, model.circuit(), rng).times
        likelihood = EventTimes(with_times(recordings, times))
        stamps = [1e-9 * r.events.t[np.argsort(t, kind="stable")] for r, t in zip(recordings, times, strict=True)]
        step = marginal_step(likelihood, stamps, model, sigma, True)
        model, sigma = Coordinates.of(model).model_at(step.x), step.sigma_s
    assert sigma == pytest.approx(sd, rel=0.1)
    sure = dict(zip(Coordinates.of(model).names, step.sd, strict=True))
    for name in ("alpha", "refractory_s", "on_threshold", "off_threshold"):
        assert abs(np.log(model.values[name] / truth.values[name])) < 4 * sure[name] + 0.02, name
    assert (step.missing_sd <= step.sd + 1e-12).all()


def imputation(recordings, sigma_s):
    windows = tuple(jitter_windows(r, sigma_s) for r in recordings)
    times = tuple(r.events.t.astype(float) for r in recordings)
    random = np.random.default_rng(0).bit_generator.state
    stimuli = tuple(r.stimulus for r in recordings)
    return Imputation(JITTER, stimuli, tuple(recordings), windows, times, random, {}, by_paths=True)


def test_the_spread_follows_displacements_and_goes_farther_the_less_they_tell(blurred):
    _, sd, recordings = blurred
    at = imputation(recordings, sd)
    rng = np.random.default_rng(0)
    moved = replace(at, times=tuple(w.centre + 1.1e9 * sd * rng.normal(size=len(w.lo)) for w in at.windows))
    n = sum(len(w.lo) for w in at.windows)
    off = np.concatenate([w.centre - t for w, t in zip(moved.windows, moved.times, strict=True)])
    rms = 1e-9 * np.sqrt(np.mean(off**2))
    assert likeliest_spread(moved, sd, 0.1 / np.sqrt(n)) == pytest.approx(rms)
    assert likeliest_spread(moved, sd, 1.0 / np.sqrt(n)) == pytest.approx(sd * (rms / sd) ** 2)  # half is missing


@pytest.mark.slow
def test_following_the_stamps_finds_the_jitter_and_says_how_well(blurred):
    """Single runs come out up to 16 % too long, and say so."""
    _, sd, recordings = blurred
    off, errors = [], []
    for seed in range(4):
        begun = replace(imputation(recordings, 0.6 * sd), random=np.random.default_rng(seed).bit_generator.state)
        followed, _ = follow(begun, MODEL, 0, lambda what: None)
        off.append(np.log(followed.sigma_s / sd))
        errors.append(followed.error)
    assert (np.abs(off) < 4 * np.array(errors)).all()
    assert np.mean(errors) < 0.1
    assert abs(np.mean(off)) < 0.1
