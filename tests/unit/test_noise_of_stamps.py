"""Noise of stamps shared by neighbouring levels, against dense Gaussian algebra, quadrature and another simulator."""

from types import SimpleNamespace

import gap_certification as certified
import numpy as np
import pytest
from scipy.stats import norm

from pixelid import check, find_model, fit
from pixelid.fit.ridge_of_stamps import Ridge
from pixelid.likelihood.stamps import Bend, Carried, _innovations, _take
from tests.oracles.bench_sessions import make_session


def sequence(n=9, seed=1):
    """(y, rate, moved, stamp, thresholds) of one pixel's events, and what each stamp adds to all levels."""
    rng = np.random.default_rng(seed)
    rate, moved = rng.uniform(10.0, 80.0, n), rng.uniform(-90.0, 10.0, n)
    stamp, thresholds = rng.uniform(0.1, 1.0, n) * 1e-6, rng.uniform(0.5, 2.0, n) * 1e-3
    late = np.diag(rate) + np.diag(moved[1:], -1)
    return 0.05 * rng.standard_normal(n), rate, moved, stamp, thresholds, late


def innovations(y, rate, moved, stamp, thresholds):
    """(left, by, level, S) of events that follow each other, the first without one before."""
    n = len(y)
    left, by, level, S = np.ones((4, n))
    after = np.arange(n) > 0
    _innovations(np.arange(n), after, y, rate, moved, stamp, rate**2 * stamp, thresholds, left, by, level, S)
    return left, by, level, S


def test_innovations_are_those_of_dense_gaussian_algebra():
    y, rate, moved, stamp, thresholds, late = sequence()
    _, _, level, S = innovations(y, rate, moved, stamp, thresholds)
    before = np.append(stamp[0] * moved[0] ** 2, np.zeros(len(y) - 1))  # the stamp before the first event
    L = np.linalg.cholesky(np.diag(thresholds + before) + late @ np.diag(stamp) @ late.T)
    np.testing.assert_allclose(S, np.diag(L) ** 2, rtol=1e-9)
    np.testing.assert_allclose(level / np.sqrt(S), np.linalg.solve(L, y), rtol=1e-9)


def test_changes_become_innovations_of_what_they_are():
    """Also where they are not those that all was taken at, and in one recording alone."""
    y, rate, moved, stamp, thresholds, _ = sequence()
    n = len(y)
    _, by, level, S = innovations(y, rate, moved, stamp, thresholds)
    other = y + 0.01 * np.sin(np.arange(n))
    expected = innovations(other, rate, moved, stamp, thresholds)[2]
    held = np.arange(n), np.arange(n) > 0, by, np.ones(n), y, level, np.sqrt(S), np.zeros(n)
    row = other.copy()
    _take(row, np.ones(n, bool), *held)
    np.testing.assert_allclose(row, expected, rtol=1e-9)
    row = other.copy()
    _take(row, np.zeros(n, bool), *held)
    np.testing.assert_array_equal(row, other)


@pytest.mark.parametrize("e", [-0.02, 0.0, 0.013, 0.03])
def test_what_bent_levels_add_is_the_slope_of_the_exact_density(e):
    """Against the integral over both stamps of the density of a level that is quadratic in them."""
    rate, moved, sd, threshold_sd, left = 3000.0, -2500.0, 3e-6, 0.008, 0.8
    H = np.array([[3e7, -2e7], [-2e7, 1.5e7]])  # 1/s²: a tenth of the rate within σ
    nodes, weights = np.polynomial.hermite_e.hermegauss(40)
    j, i = sd * nodes[:, None], sd * np.sqrt(left) * nodes[None, :]
    bend = 0.5 * (H[0, 0] * j * j + 2.0 * H[0, 1] * j * i + H[1, 1] * i * i)
    slope = rate - H[0, 0] * j - H[0, 1] * i

    def log_density(level):
        exact = norm.pdf(level - rate * j - moved * i + bend, scale=threshold_sd) * slope
        return np.log(weights @ exact @ weights)

    step = 1e-5
    score = (log_density(e + step) - log_density(e - step)) / (2.0 * step)
    S = threshold_sd**2 + sd**2 * (rate**2 + left * moved**2)
    one = np.ones(1)
    carried = Carried(one, one, one, one, one, e * one, np.sqrt(S) * one, left * sd**2 * one, 0.0 * one, 0.0 * one)
    terms = SimpleNamespace(event=SimpleNamespace(rate=rate * one))
    second = Bend(H[0, 0] * one, H[1, 1] * one, H[0, 1] * one)
    held = carried.with_bend(terms, moved * one, sd**2 * one, second)
    bent = held.bent
    assert abs(bent[0]) > 0.01 * np.sqrt(S)
    # with the shift the score is −(e − shift)/S; what is left is of second order in the bend
    assert -(e - bent[0]) / S == pytest.approx(score, abs=0.25 * abs(bent[0]) / S)
    value = held.gain[0] - 0.5 * (e - bent[0]) ** 2 / S
    unbent = -0.5 * e * e / S
    exact = log_density(e) - log_density(0.0)
    assert value == pytest.approx(exact, abs=0.3 * abs(exact - unbent) + 1e-3)


def test_a_ridge_opens_one_parameter_and_leaves_what_is_known_given_it():
    information = np.array([[9.0, 4.0, 1.0], [4.0, 8.0, 2.0], [1.0, 2.0, 5.0]])
    ridge = Ridge("b", None, None, 0.1)
    before, after = np.linalg.inv(information), np.linalg.inv(ridge.opened(("a", "b", "c"), information))
    assert after[1, 1] == pytest.approx(10.0 * before[1, 1])
    np.testing.assert_allclose(after[:, 1] / after[1, 1], before[:, 1] / before[1, 1])
    given = [after[i, i] - after[i, 1] ** 2 / after[1, 1] for i in (0, 2)]
    np.testing.assert_allclose(given, [before[i, i] - before[i, 1] ** 2 / before[1, 1] for i in (0, 2)])


@pytest.mark.slow
def test_fits_behind_jitter_scatter_as_they_say():
    """Along the ridge of the amplifier and the dead time fits had ended 8 standard errors off, with 8 us of jitter."""
    names, off = ("sf_cutoff_hz", "diff_cutoff_hz", "refractory_s", "gamma"), []
    for seed in range(1, 13):
        camera = certified.camera(seed).with_effect("timestamp_jitter", sigma_s=8e-6)
        recordings = certified.session(camera, seed)
        result = fit(recordings, camera, seed=seed, starts=0)
        assert result.status == "converged"
        for name in names:
            value, (low, high) = result.estimates[name].value, result.estimates[name].interval_95
            truth = camera.values[name]
            side = (high if truth > value else low) or np.nan
            off.append(1.96 * np.log(truth / value) / abs(np.log(side / value)))
    off = np.abs(np.array(off))
    assert np.nanmax(off) < 4.0
    assert np.sqrt(np.nanmean(off**2)) < 1.5


@pytest.mark.slow
def test_poles_and_dead_times_are_found_behind_jitter(tmp_path):
    """Short intervals, to which both stamps belong, once moved a dead time by a tenth and lost the amplifier's pole."""
    truth = make_session(tmp_path / "bench", 500, fault="", gain_sd=0.0, effects={"jitter": 3.5e-6})
    (tmp_path / "bench" / "truth.json").unlink()
    model = find_model("dvs128").with_effect("threshold_mismatch").with_effect("timestamp_jitter")
    result = fit(check(tmp_path / "bench").recordings, model, seed=0)
    assert result.status == "converged"
    for name in ("sf_cutoff_hz", "diff_cutoff_hz", "refractory_s"):
        estimate = result.estimates[name]
        low, high = np.log(estimate.interval_95)
        assert abs(np.log(estimate.value / truth[name])) < 0.75 * (high - low), name
        assert high - low < 0.3, name
    assert result.estimates["timestamp_jitter.sigma_s"].value == pytest.approx(3.5e-6, rel=0.04)
