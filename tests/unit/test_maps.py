"""Scores of squared residuals against the χ² law that they have."""

import numpy as np
import pytest
from scipy.stats import chi2, norm

from pixelid.gap.detect.maps import normal_score


@pytest.mark.parametrize("events", [30, 60, 200, 2000])
def test_a_sum_of_squares_is_as_rare_as_its_normal_score(events):
    """The chance of a tail, from 1 in 100 to 1 in 100,000, within 3 % of its logarithm: the cube root's own error."""
    for p in (1e-2, 1e-3, 1e-5):
        high = (chi2.isf(p, events) - events) / np.sqrt(2 * events)
        low = (chi2.ppf(p, events) - events) / np.sqrt(2 * events)
        score = normal_score([high, low], np.sqrt(8 / events))
        np.testing.assert_allclose(norm.logsf(score[0]), np.log(p), rtol=0.03)
        np.testing.assert_allclose(norm.logcdf(score[1]), np.log(p), rtol=0.03)
        assert norm.logsf(high) < 1.03 * np.log(p) or events == 2000  # what it is without: too rare


def test_the_sign_of_the_skewness_mirrors_and_none_changes_nothing():
    z = np.array([-3.0, -0.5, 0.0, 2.0, 4.5])
    np.testing.assert_allclose(normal_score(z, -0.4), -normal_score(-z, 0.4))
    np.testing.assert_array_equal(normal_score(z, 0.0), z)
    np.testing.assert_allclose(normal_score(z, 1.1e-3), z, atol=5e-3)
    assert (np.diff(normal_score(z, 0.4)) > 0).all()


def test_scores_of_weighted_squares_have_normal_tails():
    """Weights of either sign, as a cell has within groups of a few events; only the third moment is matched."""
    rng = np.random.default_rng(1)
    weights = np.concatenate([np.full(25, 0.6), np.full(50, -0.3)])
    weights /= np.sqrt(weights @ weights)
    squares = (rng.standard_normal((200_000, 75)) ** 2 - 1) / np.sqrt(2)
    sums = squares @ weights
    score = normal_score(sums, np.sqrt(8) * np.sum(weights**3))
    for level in (2.0, 3.0):
        assert np.log(np.mean(score > level)) == pytest.approx(norm.logsf(level), rel=0.08)
        assert np.log(np.mean(score < -level)) == pytest.approx(norm.logsf(level), rel=0.08)
    assert np.mean(sums > 3.0) > 2 * norm.sf(3.0)  # as they are
