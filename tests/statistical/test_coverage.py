"""Coverage of 95 % intervals on a few simulated sessions; `benchmarks/interval_coverage.py` does hundreds."""

import pytest
from interval_coverage import one, summary


@pytest.mark.slow
def test_intervals_hold_the_truth():
    table = summary([one(seed) for seed in range(1000, 1012)])
    assert sum(row["sessions"] for row in table.values()) > 100
    held = sum(row["covered"] for row in table.values()) / sum(row["sessions"] for row in table.values())
    assert held > 0.87
    for name, row in table.items():
        assert row["share_interval_95"][1] > 0.92, name
