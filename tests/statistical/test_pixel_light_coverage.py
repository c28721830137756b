"""Known answers under light that differs from pixel to pixel, simulated at finer frames than the fit is given."""

import pytest
from pixel_light import coverage, verdict


@pytest.mark.slow
def test_intervals_hold_the_truth():
    """As full-field intervals do: tests/statistical/test_coverage.py."""
    table = coverage(12, 5, None, first=1000)["parameters"]
    assert sum(row["sessions"] for row in table.values()) > 80
    held = sum(row["covered"] for row in table.values()) / sum(row["sessions"] for row in table.values())
    assert held > 0.87
    for name, row in table.items():
        assert row["share_interval_95"][1] > 0.92, name


@pytest.mark.slow
def test_the_gap_search_names_a_leak_and_nothing_else():
    assert verdict(1, 5, 0.0) == ("none", [])
    assert verdict(1, 5, 2.0) == ("named", ["leak"])
