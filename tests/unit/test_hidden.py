"""The demo's comparison of what was hidden with what was found, and the session that it calibrates."""

from dataclasses import replace

import numpy as np
import pytest
from make_demo_bench import DEMO

from pixelid.bench.check import check
from pixelid.bench.files import find_bench
from pixelid.demo.demo import BENCH, TRUTH, hidden_and_found, hidden_values, sentence
from pixelid.documents import read_json
from pixelid.fit.result import Estimate
from pixelid.recordings.reading import open_recording
from pixelid.stimuli.files import load_stimulus
from tests.oracles.bench_sessions import make_session

MOST_BYTES = 450_000


@pytest.fixture(scope="module")
def truth():
    return read_json(BENCH / TRUTH)


def estimate(name: str, value: float, interval) -> Estimate:
    return Estimate(name, value, "unit", 0.1 * abs(value), interval, True, False)


def test_inside_outside_and_not_estimated(truth):
    hidden = hidden_values(truth)
    names = list(hidden)
    estimates = {name: estimate(name, v, (0.9 * v, 1.1 * v)) for name, v in hidden.items()}
    wrong, open_below, absent = names[:3]
    value = hidden[wrong]
    estimates[wrong] = estimate(wrong, 2 * value, (1.8 * value, 2.2 * value))
    estimates[open_below] = replace(estimates[open_below], interval_95=(None, 2 * hidden[open_below]))
    del estimates[absent]
    inside = {each.name: each.inside for each in hidden_and_found(truth, estimates)}
    assert inside == dict.fromkeys(names, True) | {wrong: False, absent: None}
    values = hidden_and_found(truth, estimates)
    share = f"{len(names) - 2} of {len(names)} hidden values lie in their 95 % intervals"
    assert sentence(values, ("leak",), ("leak",)) == f"{share}; the missing effect was found: leak"
    assert "missed: leak; named, and not there: dark current" in sentence(values, ("leak",), ("dark_current",))


def test_every_hidden_value_is_a_parameter_of_a_fit(truth):
    from pixelid.model.model import CLOCK_RATE
    from pixelid.model.shipped import find_model

    grown = find_model("dvs128")
    for name in truth["effects"]:
        grown = grown.with_effect(name)
    assert set(hidden_values(truth)) - {CLOCK_RATE.name} <= set(grown.parameters)


def test_the_session_is_the_generators(truth, tmp_path):
    """`benchmarks/make_demo_bench.py` makes the files that are shipped; they stay small, and say what they hide."""
    again = make_session(tmp_path, 1, **DEMO)
    assert sum(file.stat().st_size for file in BENCH.iterdir()) < MOST_BYTES
    assert {file.name for file in BENCH.iterdir()} == {file.name for file in tmp_path.iterdir()}
    assert again["effects"] == truth["effects"]
    assert again["alpha"] == pytest.approx(truth["alpha"], rel=1e-9)
    for name in truth["recordings"]:
        shipped, made = (open_recording(folder / f"{name}.raw").events for folder in (BENCH, tmp_path))
        assert len(made) == pytest.approx(len(shipped), rel=0.01)  # draws may differ in the last digit elsewhere
        lights = [load_stimulus(folder / f"{name}_light.npz").radiance for folder in (BENCH, tmp_path)]
        np.testing.assert_allclose(*lights, rtol=0.01)


def test_the_check_uses_every_recording_and_does_not_read_the_truth(truth):
    assert BENCH / TRUTH not in find_bench(BENCH).paths
    report = check(BENCH)
    assert [row.name for row in report.rows if row.used] == sorted(truth["recordings"])
    for row in report.rows:
        true_s = truth["recordings"][row.name]["camera_at_light_zero_us"] * 1e-6
        off_s = (row.aligned["offset_s"] - true_s + 0.5) % 1.0 - 0.5  # the files count from a whole second
        assert abs(off_s) < 3e-6
