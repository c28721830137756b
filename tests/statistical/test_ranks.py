"""Simulation-based calibration on a few sessions; `benchmarks/posterior_ranks.py` does hundreds."""

import numpy as np
import pytest
from posterior_ranks import DRAWS, one, summary
from scipy.stats import kstest


@pytest.mark.slow
def test_the_truth_ranks_anywhere_among_posterior_draws():
    sessions = [one(seed) for seed in range(5000, 5010)]
    assert all(s["posterior"] == "converged" for s in sessions)
    ranks = np.array([list(s["ranks"].values()) for s in sessions]) / DRAWS
    assert ranks.shape == (10, 10)
    for column in ranks.T:
        assert kstest(column, "uniform").pvalue > 1e-3
    # together they show what ten each cannot: too narrow posteriors pile ranks up at the ends
    assert 0.4 < np.abs(2.0 * ranks - 1.0).mean() < 0.6
    assert abs(ranks.mean() - 0.5) < 0.1


def test_the_summary_tells_uniform_ranks_from_others():
    rng = np.random.default_rng(0)
    good = rng.integers(0, 100, (200, 3))
    narrow = np.where(good % 5 == 0, 0, good)  # one in five below every draw

    def sessions(ranks):
        return [{"ranks": dict(zip("abc", row, strict=True)), "posterior": "converged"} for row in ranks.tolist()]

    assert summary(sessions(good))["smallest_p_holm"] > 0.05
    assert summary(sessions(narrow))["smallest_p_holm"] < 1e-6
