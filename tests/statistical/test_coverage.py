"""Coverage of 95 % intervals on a few simulated sessions; `benchmarks/interval_coverage.py` does hundreds."""

import importlib.util
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "benchmarks" / "interval_coverage.py"


@pytest.mark.slow
def test_intervals_hold_the_truth():
    spec = importlib.util.spec_from_file_location("interval_coverage", SCRIPT)
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    sessions = [script.one(seed) for seed in range(1000, 1012)]
    table = script.summary(sessions)
    assert sum(row["sessions"] for row in table.values()) > 100
    held = sum(row["covered"] for row in table.values()) / sum(row["sessions"] for row in table.values())
    assert held > 0.87
    for name, row in table.items():
        assert row["share_interval_95"][1] > 0.92, name
