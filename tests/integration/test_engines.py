"""All engines on the same problem: the same log-likelihood, derivatives and optimum."""

from __future__ import annotations

import numpy as np
import pytest

from pixelid.errors import InputError
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.engines import ENGINES, engine
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.newton import maximise
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.shipped import find_model
from pixelid.simulate import simulate
from pixelid.stimuli.stimulus import Stimulus

EVERYTHING = (
    "leak", "parasitic_photocurrent", "dark_current", "threshold_drift", "timestamp_jitter", "polarity_memory",
)  # fmt: skip


def light(level, frequency, samples=401, duration=0.2, depth=1.0):
    t = np.linspace(0.0, duration, samples)
    return Stimulus(t, np.exp(np.log(level) + depth * np.sin(2 * np.pi * frequency * t)), "fA")


def objective_of(effects=(), samples=401, pixels=4):
    model = find_model("dvs128")
    for effect in effects:
        model = model.with_effect(effect)
    shown = [light(60, 25, samples), light(300, 80, samples)]
    recordings = [simulate(model, s, width=pixels, height=1, seed=i, as_sampled=True) for i, s in enumerate(shown)]
    # so few events do not pin the amplifier's pole: held, so that there is one optimum to agree on; with effects it is
    # free and only values and derivatives are compared
    model = model.release(["delay_s"]) if effects else model.fix({"diff_cutoff_hz": None})
    return EventTimesObjective(EventTimes(recordings), Coordinates.of(model))


@pytest.fixture(scope="module")
def plain():
    return objective_of()


@pytest.fixture(scope="module")
def optimum(plain):
    return maximise(plain, plain.coordinates.start, tolerance=1e-9)


def points(objective, centre, count, seed=0):
    rng = np.random.default_rng(seed)
    spread = 0.3 * objective.coordinates.longest_moves()
    lower, upper = objective.coordinates.bounds()
    return [np.clip(centre + spread * rng.uniform(-1, 1, len(centre)), lower, upper) for _ in range(count)]


def test_engines_agree_at_fifty_points(plain, optimum):
    casadi, torch = engine("casadi"), engine("torch")
    for x in points(plain, optimum.x, 50):
        expected = plain.value(x)
        assert casadi.value(plain, x) == pytest.approx(expected, rel=1e-8)
        assert torch.value(plain, x) == pytest.approx(expected, rel=1e-8)


def test_engines_agree_with_every_effect_of_the_expression():
    objective = objective_of(EVERYTHING)
    casadi, torch = engine("casadi"), engine("torch")
    for x in points(objective, objective.coordinates.start, 3, seed=1):
        expected = objective.value(x)
        assert casadi.value(objective, x) == pytest.approx(expected, rel=1e-8)
        assert torch.value(objective, x) == pytest.approx(expected, rel=1e-8)
        gradients = [e.gradient(objective, x) for e in (casadi, torch, engine("scipy"))]
        error = 1.0 / np.sqrt(np.maximum(np.diag(objective.local(x).information), 1e-12))
        np.testing.assert_allclose(gradients[1] * error, gradients[0] * error, atol=1e-6)
        np.testing.assert_allclose(gradients[2] * error, gradients[0] * error, atol=2e-3)


@pytest.mark.parametrize("effects", [(), *((name,) for name in EVERYTHING), EVERYTHING])
def test_the_symbolic_form_equals_the_compiled_density_with_its_gradient(effects):
    """Also with timestamp noise counted at the reset, and with factors of the thresholds; what levels share with those
    before is of the compiled form alone."""
    objective = objective_of(effects)
    x = objective.coordinates.start + 0.01 * objective.coordinates.longest_moves()
    weighed = objective.likelihood.weighed(objective.coordinates.circuit(x))
    if weighed.carried is not None:
        with pytest.raises(InputError, match="jitter of stamps"):
            engine("casadi").value(EventTimesObjective(weighed, objective.coordinates), x)
        weighed = weighed.with_stamps(None, weighed.clock_share, None)
    factor = np.exp(0.02 * np.random.default_rng(1).normal(size=weighed.events))
    objective = EventTimesObjective(weighed.with_threshold_factor(factor), objective.coordinates)
    assert objective.terms(x).layout.groups > objective.terms(x).layout.pixels > 1
    casadi = engine("casadi")
    assert casadi.value(objective, x) == pytest.approx(objective.value(x), rel=1e-8)
    compiled, symbolic = objective.gradient(x), casadi.gradient(objective, x)
    error = 1.0 / np.sqrt(np.maximum(np.diag(objective.local(x).information), 1e-12))
    in_density = (
        "threshold_sigma", "threshold_mismatch.sigma", "threshold_drift.per_s", "timestamp_jitter.sigma_s",
        "polarity_memory.strength",
    )  # fmt: skip
    for i, name in enumerate(objective.coordinates.names):
        if name.endswith("_threshold") or name in in_density:  # no changes between them: no difference quotients
            assert compiled[i] == pytest.approx(symbolic[i], rel=1e-8, abs=1e-8 / error[i]), name
        else:
            assert compiled[i] * error[i] == pytest.approx(symbolic[i] * error[i], abs=1e-3), name


def test_symbolic_gradient_and_hessian_equal_differences(plain, optimum):
    x = optimum.x + 0.02
    casadi = engine("casadi")
    gradient, hessian = casadi.gradient(plain, x), casadi.hessian(plain, x)
    error = 1.0 / np.sqrt(np.diag(plain.local(x).information))
    torch = engine("torch")
    np.testing.assert_allclose(torch.gradient(plain, x) * error, gradient * error, atol=1e-8)
    for i in range(len(x)):
        h = 1e-5 * np.eye(len(x))[i] * error[i] / error.max()
        h[i] = 1e-3 * error[i]
        quotient = (plain.value(x + h) - plain.value(x - h)) / (2 * h[i])
        assert gradient[i] * error[i] == pytest.approx(quotient * error[i], abs=1e-3)
        rows = (casadi.gradient(plain, x + h) - casadi.gradient(plain, x - h)) / (2 * h[i])
        np.testing.assert_allclose(hessian[i] * error[i] * error, rows * error[i] * error, atol=1e-3)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("casadi", {"evaluation": "compiled"}),
        ("casadi", {"evaluation": "expression"}),
        ("torch", {"evaluation": "compiled"}),
        ("scipy", {}),
        pytest.param("torch", {"evaluation": "expression"}, marks=pytest.mark.slow),
        pytest.param("scipy", {"method": "lbfgs"}, marks=pytest.mark.slow),
    ],
)
def test_engines_find_the_same_optimum(plain, optimum, name, options):
    start = optimum.x + 0.05 * np.cos(np.arange(len(optimum.x)))
    maximum = engine(name, **options).maximise(plain, start, tolerance=1e-8, max_steps=400)
    sd = np.sqrt(np.diag(np.linalg.inv(optimum.local.information)))
    assert maximum.converged
    assert np.abs((maximum.x - optimum.x) / sd).max() < 1e-3


def test_effects_without_an_expression_are_refused_and_fitted_compiled():
    model = find_model("dvs128").with_effect("lower_cutoff")
    recording = simulate(model, light(100, 40), width=3, height=1, seed=0)
    objective = EventTimesObjective(EventTimes([recording]), Coordinates.of(model))
    with pytest.raises(InputError, match="lower_cutoff"):
        engine("casadi").value(objective, objective.coordinates.start)
    end = engine("casadi").maximise(objective, objective.coordinates.start, max_steps=3)
    assert np.isfinite(end.local.value)


def test_unknown_engines_and_options_are_refused():
    with pytest.raises(InputError, match=", ".join(ENGINES)):
        engine("jax")
    for name in ENGINES:
        with pytest.raises(InputError):
            engine(name, **{"scipy": {"method": "x"}}.get(name, {"evaluation": "x"}))
