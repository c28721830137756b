"""From a camera's file and a light trace to a fit: a few sessions of `benchmarks/round_trip.py`, which does thirty."""

import pytest
from round_trip import run
from scipy.stats import binom

SESSIONS = 10
# Without a trigger these lie along a curved ridge, where the normal approximation is too narrow: docs/limits/fitting.md
RIDGE = {"diff_cutoff_hz", "refractory_s", "alignment.delay_s"}


@pytest.mark.slow
def test_intervals_hold_the_truth_and_delays_are_close(tmp_path):
    table = run(SESSIONS, tmp_path / "round_trip.json", first=1000)
    for way, part in table.items():
        assert part["sessions"] == SESSIONS, way
        for name, row in part["parameters"].items():
            if way == "auto" and name in RIDGE:
                continue
            # 95 % intervals would hold fewer in one of 2000 runs
            assert row["held"] >= binom.ppf(5e-4, row["of"], 0.95), (way, name, row)
        assert part["delay_error_us"]["fit"]["share"] == 1.0, way
