"""What the benchmark of bench sessions counts, on calibrations written by hand."""

import copy
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
UNIT = 10.0  # numbers in the file are ten times those in fA
CIRCUIT = {
    "alpha": 6e4, "beta": 1800.0, "gamma": 1.1, "sf_cutoff_hz": 3000.0, "diff_cutoff_hz": 16e3, "on_threshold": 0.2,
    "off_threshold": 0.18, "refractory_s": 2e-4,
}  # fmt: skip
TRUTH = CIRCUIT | {
    "effects": {"I_dark": 2.0, "leak": 0.2}, "unit": "illuminance_lux", "unit_factor": UNIT, "clock_ppm": 44.0,
    "fault": "level", "fault_recordings": ["chirp_24"],
}  # fmt: skip


@pytest.fixture
def tally(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    import bench_tally

    return bench_tally


def reported(value: float) -> dict:
    return {"value": value, "interval_95": [value * 0.99, value * 1.01]}


def row(**changes) -> dict:
    """A run that finds everything."""
    parameters = {name: reported(value) for name, value in CIRCUIT.items()}
    parameters |= {"alpha": reported(6e4 / UNIT), "gamma": reported(1.1 / UNIT)}
    parameters |= {"dark_current.radiance": reported(2.0 * UNIT), "leak.rate_hz": reported(0.2)}
    calibration = {
        "status": "converged",
        "verdict": "named",
        "parameters": parameters,
        "effects": [{"name": "dark_current"}, {"name": "leak"}],
        "described": [],
        "bench": [{"statement": "level", "recording": "chirp_24", "interval_95": [1.55, 1.65]}],
    }
    run = {"seed": 1, "exit": 0, "cpu_seconds": 100.0, "truth": TRUTH, "calibration": calibration}
    run = copy.deepcopy(run)
    for key, value in changes.items():
        run[key] |= value
    return run


def test_a_right_calibration(tally):
    found = tally.summary([row()])
    for name, counts in found["parameters"].items():
        assert counts["covered"] == counts["reported"] == 1
        assert counts["largest_error"] < 1e-12, name
    assert found["effects"]["dark_current"] == {
        "above_limit": [1, 1], "below_limit": [0, 0], "wrongly_named": 0, "covered": [1, 1],
    }  # fmt: skip
    assert found["effects"]["leak"]["below_limit"] == [1, 1]
    assert found["faults"]["level"] == {"found": 1, "missed": 0}
    assert found["doubted_without_cause"] == []


def test_values_off_by_the_unit_are_wrong(tally):
    wrong = row()
    wrong["calibration"]["parameters"]["alpha"] = reported(6e4)
    counts = tally.summary([row(), wrong])["parameters"]["alpha"]
    assert (counts["covered"], counts["reported"], counts["within_target"]) == (1, 2, 1)
    assert counts["largest_error"] == pytest.approx(9.0)


def test_effects_missed_and_wrongly_named(tally):
    found = tally.summary([row(calibration={"effects": [{"name": "shot_noise"}, {"name": "slew_limit"}]})])["effects"]
    assert found["dark_current"]["above_limit"] == [0, 1]
    assert found["leak"]["below_limit"] == [0, 1]
    assert found["shot_noise"]["wrongly_named"] == found["slew_limit"]["wrongly_named"] == 1


@pytest.mark.parametrize(
    ("bench", "found", "doubts"),
    [
        ([], 0, []),
        ([{"statement": "level", "recording": "chirp_3"}], 0, ["level"]),
        ([{"statement": "clock_rate", "recording": None, "interval_95": [43.0, 45.0]}], 0, []),
        ([{"statement": "clock_rate", "recording": None, "interval_95": [43e-6, 45e-6]}], 0, []),
        ([{"statement": "clock_rate", "recording": None, "interval_95": [50.0, 52.0]}], 0, ["clock_rate"]),
        ([{"statement": "polarity", "recording": None}, {"statement": "offset", "recording": None}], 0, ["polarity"]),
        ([{"statement": "level", "recording": "chirp_24"}, {"statement": "unit", "recording": None}], 1, []),
    ],
)
def test_statements_found_and_doubted(tally, bench, found, doubts):
    counted = tally.summary([row(calibration={"bench": bench})])
    assert counted["faults"]["level"] == {"found": found, "missed": 1 - found}
    assert counted["doubted_without_cause"] == doubts


def test_a_run_without_a_result_counts_as_missed(tally):
    failed = row() | {"calibration": {}, "exit": 2}
    found = tally.summary([row(), failed])
    assert found["status"] == {"converged": 1, "exit 2": 1}
    assert found["parameters"]["alpha"]["reported"] == 1
    assert found["effects"]["dark_current"]["above_limit"] == [1, 2]
    assert found["faults"]["level"] == {"found": 1, "missed": 1}
