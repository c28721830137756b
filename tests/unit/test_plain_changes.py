"""The changes of intervals and their extremes against the same written out one interval at a time."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from oracles.changes import plain_changes

from pixelid.likelihood.changes import ChangeEvaluator
from pixelid.likelihood.located import located
from pixelid.likelihood.sections import sections_of
from pixelid.model.shipped import find_model
from pixelid.simulate import simulate
from pixelid.stimuli.stimulus import Stimulus

MODEL = find_model("dvs128").set({"threshold_sigma": 0.15})  # noisy, so that many extremes come near a threshold


def light(kind: str) -> Stimulus:
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 0.4, 5e-5)
    u = {
        "sines": np.sin(2 * np.pi * 6 * t) + 0.3 * np.sin(2 * np.pi * 31 * t),
        "jitter": 0.8 * np.sin(2 * np.pi * 15 * t) + 0.05 * rng.normal(size=len(t)),
        "steps": 1.2 * ((t * 40).astype(int) % 2),
    }[kind]
    return Stimulus(t, 150.0 * np.exp(u), "fA")


def session(kind: str, seed: int = 5):
    return simulate(MODEL, light(kind), width=3, height=2, seed=seed)


def assert_equal(found, expected, near=-np.inf):
    """Two sets of changes; of extremes, those that may come near a threshold."""
    possible = ~found.early  # before its release, a change is an extrapolation to e^(many time constants)
    np.testing.assert_array_equal(found.early, expected["early"])
    for field in fields(found):
        pair = getattr(found, field.name), expected[field.name]
        if field.name in ("change", "slope"):
            pair = pair[0][possible], pair[1][possible]
        if field.name in ("opposite", "opposite_drift"):
            seen = expected["opposite"] >= near
            pair = pair[0][seen], pair[1][seen]
        np.testing.assert_allclose(*pair, rtol=1e-9, atol=1e-7 if "slope" in field.name else 1e-11, err_msg=field.name)
    assert (found.opposite != 0).sum() + (found.rise != 0).sum() + (found.fall != 0).sum() > 5


@pytest.mark.parametrize("refractory", [1e-6, 1e-4, 2e-3])
@pytest.mark.parametrize("kind", ["sines", "jitter", "steps"])
def test_changes_and_extremes_written_out(kind, refractory):
    recording = session(kind)
    circuit = MODEL.circuit().with_(refractory=refractory)
    evaluator = ChangeEvaluator(*sections_of(recording)[1])
    assert_equal(evaluator(circuit), plain_changes(evaluator, circuit), near=0.2)


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        ("leak", {"rate_hz": 2.0}),
        ("parasitic_photocurrent", {"rate_hz_per_radiance": 0.02}),
        ("lower_cutoff", {"cutoff_hz": 2.0}),
        ("extra_pole", {"cutoff_hz": 1500.0}),
        ("slew_limit", {"rise_per_s": 400.0, "fall_per_s": 250.0}),
        ("dead_time_without_reset", {"s": 3e-3}),
    ],
)
def test_effects_that_change_the_changes_written_out(effect, values):
    recording, circuit = session("steps"), MODEL.with_effect(effect, values).circuit()
    evaluator = ChangeEvaluator(*sections_of(recording)[1])
    assert_equal(evaluator(circuit), plain_changes(evaluator, circuit), near=0.2)


def test_silence_with_a_leak_and_without_poles_written_out():
    """A leak moves the extremes; ends of silences are extremes where the change has turned meanwhile."""
    recording = session("jitter")
    for effects in ((), ("source_follower_pole", "differencing_pole")):
        model = MODEL.with_effect("leak", {"rate_hz": 20.0}).with_effect("dead_time_without_reset", {"s": 5e-3})
        for effect in effects:
            model = model.without_effect(effect)
        evaluator = ChangeEvaluator(*sections_of(recording)[1])
        assert_equal(evaluator(model.circuit()), plain_changes(evaluator, model.circuit()), near=0.2)


@pytest.mark.parametrize(
    "absent",
    [("differencing_pole",), ("source_follower_pole",), ("source_follower_pole", "differencing_pole")],
)
def test_stages_without_a_pole_written_out(absent):
    recording, model = session("sines"), MODEL
    for effect in absent:
        model = model.without_effect(effect)
    evaluator = ChangeEvaluator(*sections_of(recording)[1])
    evaluated = evaluator(model.circuit())
    assert_equal(evaluated, plain_changes(evaluator, model.circuit()), near=0.2)
    assert (evaluated.slope * np.sign(evaluated.change) > 0).mean() > 0.5


def test_extremes_are_returned_and_taken_where_they_are():
    recording = session("jitter")
    evaluator, circuit = ChangeEvaluator(*sections_of(recording)[1]), MODEL.circuit()
    rows = np.empty((7, len(evaluator.intervals))), np.empty((4, len(evaluator.intervals.last_s)))
    again = np.empty_like(rows[0]), np.empty_like(rows[1])
    extremes = evaluator.fill(circuit, True, *rows)
    assert (extremes.rise >= 0).any()
    assert (extremes.opposite >= 0).any()
    evaluator.fill(circuit.with_(alpha=2.0 * circuit.alpha), True, *again)  # must not move what was returned
    assert evaluator.fill(circuit, extremes, *again) is extremes
    for first, second in zip(rows, again, strict=True):
        np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("kind", ["even", "random", "decades", "jumps"])
def test_samples_are_located_wherever_the_search_begins(kind):
    rng = np.random.default_rng(9)
    steps = {
        "even": lambda n: np.full(n, 1e-3),
        "random": rng.standard_exponential,
        "decades": lambda n: 10.0 ** rng.uniform(-9, 0, n),
        "jumps": lambda n: rng.integers(0, 2, n) / 7.0,
    }[kind]
    lights = [np.cumsum(steps(n)) for n in (1, 40, 300)]
    t, first = np.concatenate(lights), np.cumsum([0, 1, 40, 300])
    light_of = rng.integers(0, 3, 2000).astype(np.int32)
    times = np.array([rng.choice(lights[k]) + rng.choice([0.0, 0.3]) * rng.standard_normal() for k in light_of])
    expected = [
        first[k] + max(np.searchsorted(lights[k], time, side="right") - 1, 0)
        for k, time in zip(light_of, times, strict=True)
    ]
    for near in (rng.integers(0, len(t), 2000), np.zeros(2000, np.int64), np.array(expected)):
        np.testing.assert_array_equal(located(t, times, near, first, light_of), expected)
