"""The compiled plain pixel against the general loops: same changes and extremes."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from pixelid.likelihood import plain_changes
from pixelid.likelihood.changes import ChangeEvaluator
from pixelid.likelihood.sequences import sequences
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


@pytest.mark.parametrize("refractory", [1e-6, 1e-4, 2e-3])
@pytest.mark.parametrize("kind", ["sines", "jitter", "steps"])
def test_changes_and_extremes_equal_the_general_loops(kind, refractory, monkeypatch):
    recording = session(kind)
    circuit = MODEL.circuit().with_(refractory=refractory)
    fast, general = (ChangeEvaluator(recording, sequences(recording)) for _ in range(2))
    found = fast(circuit)
    monkeypatch.setattr(plain_changes, "applicable", lambda circuit: False)
    expected = general(circuit)
    possible = ~expected.early  # before its release, a change is an extrapolation to e^(many time constants)
    for field in fields(found):
        pair = getattr(found, field.name), getattr(expected, field.name)
        if field.name in ("change", "slope"):
            pair = pair[0][possible], pair[1][possible]
        np.testing.assert_allclose(*pair, rtol=0, atol=1e-7 if field.name == "slope" else 1e-12, err_msg=field.name)
    assert (np.concatenate(fast.extremes_at) >= 0).sum() > 5
    for where, there in zip(fast.extremes_at, general.extremes_at, strict=True):
        np.testing.assert_array_equal(where >= 0, there >= 0)


@pytest.mark.parametrize(
    "absent",
    [("differencing_pole",), ("source_follower_pole",), ("source_follower_pole", "differencing_pole")],
)
def test_stages_without_a_pole_have_the_slopes_of_the_general_loops(absent, monkeypatch):
    recording, model = session("sines"), MODEL
    for effect in absent:
        model = model.without_effect(effect)
    circuit = model.circuit()
    found = ChangeEvaluator(recording, sequences(recording))(circuit)
    monkeypatch.setattr(plain_changes, "applicable", lambda circuit: False)
    expected = ChangeEvaluator(recording, sequences(recording))(circuit)
    np.testing.assert_allclose(found.change, expected.change, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.slope, expected.slope, rtol=1e-9, atol=1e-7)
    assert (found.slope * np.sign(found.change) > 0).mean() > 0.5
