"""The continuous form: three integrators that must agree, with the discrete form, and with reference trajectories."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.trajectories import oracle_case
from test_engines import light

from pixelid.dynamics.of_circuit import dynamics_of
from pixelid.dynamics.trajectory import integrate
from pixelid.errors import InputError
from pixelid.fit import fit
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.engines import ENGINES, engine
from pixelid.fit.engines.collocation import collocation_objective
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.newton import maximise
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.shipped import find_model
from pixelid.simulate import simulate
from pixelid.status import Status
from pixelid.stimuli.resample import resampled
from pixelid.stimuli.shapes import chirp
from pixelid.stimuli.stimulus import Stimulus

MODEL = find_model("dvs128")


@pytest.fixture(scope="module")
def measured():
    return [simulate(MODEL, shown, width=3, height=2, seed=1) for shown in lights(40001)]


def lights(samples):
    return [light(20, 10, samples, duration=0.4, depth=1.2), light(400, 20, samples, duration=0.4, depth=0.8)]


def objective_of(measured, samples):
    model = MODEL.fix({"diff_cutoff_hz": None, "refractory_s": None, "sf_cutoff_hz": None})
    recordings = [r.with_stimulus(shown) for r, shown in zip(measured, lights(samples), strict=True)]
    return EventTimesObjective(EventTimes(recordings), Coordinates.of(model))


def shift(objective):
    """How far the continuous fit is from the discrete one, in standard errors."""
    discrete = maximise(objective, objective.coordinates.start)
    continuous = maximise(engine("casadi").continuous(objective, discrete.x), discrete.x)
    assert continuous.converged
    sd = np.sqrt(np.diag(np.linalg.inv(discrete.local.information)))
    return np.abs((continuous.x - discrete.x) / sd).max(), continuous, sd


@pytest.mark.slow
def test_continuous_and_discrete_fits_agree_when_sampling_is_fine_and_part_when_it_is_coarse(measured):
    fine, middle, coarse = (shift(objective_of(measured, n))[0] for n in (1601, 801, 201))
    assert fine < 0.01
    assert fine <= middle < 0.2
    assert coarse > 0.5


@pytest.mark.parametrize("samples", [pytest.param(201, marks=pytest.mark.slow), 801])
def test_engines_agree_on_the_continuous_form(measured, samples):
    objective = objective_of(measured, samples)
    x = objective.coordinates.start + 0.01
    sd = 1.0 / np.sqrt(np.diag(objective.local(x).information))
    forms = [engine(name).continuous(objective, x) for name in ENGINES]
    expected = forms[0].local(x)
    for form in forms[1:]:
        local = form.local(x)
        assert local.value == pytest.approx(expected.value, abs=0.02)
        np.testing.assert_allclose(local.gradient * sd, expected.gradient * sd, rtol=2e-3, atol=0.02)
        assert form.value(x) == pytest.approx(local.value, abs=1e-6)


def test_collocation_has_converged(measured):
    objective = objective_of(measured, 201)
    x = objective.coordinates.start
    chosen, finer = collocation_objective(objective, x), collocation_objective(objective, x, parts=24)
    assert chosen.value(x) == pytest.approx(finer.value(x), abs=3e-3)


def test_light_that_stands_still_is_exact_however_long_the_step(measured):
    """Steps of constant light are as long as one likes: the continuous form equals the discrete one there."""
    held = [r.with_stimulus(Stimulus(r.stimulus.t[[0, 20_000, -1]], np.full(3, 50.0), "fA")) for r in measured]
    objective = EventTimesObjective(EventTimes(held), Coordinates.of(MODEL))
    x = objective.coordinates.start
    for name in ENGINES:
        assert engine(name).continuous(objective, x).value(x) == pytest.approx(objective.value(x), abs=1e-6), name


def test_the_continuous_form_refuses_what_it_lacks(measured):
    for model in (MODEL.without_effect("differencing_pole"), MODEL.with_effect("extra_pole")):
        objective = EventTimesObjective(EventTimes(measured), Coordinates.of(model))
        for name in ENGINES:
            with pytest.raises(InputError, match="form"):
                engine(name).continuous(objective, objective.coordinates.start)


def test_fit_in_the_continuous_form(measured):
    # two slow sines leave the faster poles open, and the end of a search along an open direction to chance
    model = MODEL.fix({"diff_cutoff_hz": None, "refractory_s": None, "sf_cutoff_hz": None})
    results = [fit(measured, model, starts=0, between="linear", engine="casadi", form=form)
               for form in ("discrete", "continuous")]  # fmt: skip
    discrete, continuous = results
    assert continuous.status == discrete.status == Status.converged
    assert continuous.details["form"] == "continuous"
    sd = np.sqrt(np.diag(discrete.covariance))
    assert np.abs((continuous.x - discrete.x) / sd).max() < 0.1
    assert abs(continuous.details["continuous_minus_discrete_nats"]) < 0.5
    with pytest.raises(InputError, match="form"):
        fit(measured, MODEL, form="both")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["casadi", "torch"])
def test_forms_agree_on_a_real_sized_chirp(name):
    recording = simulate(MODEL, chirp(), width=3, height=3, seed=1)
    finer = recording.with_stimulus(resampled(recording.stimulus, "smooth"))
    objective = EventTimesObjective(EventTimes([finer]), Coordinates.of(MODEL))
    discrete = maximise(objective, objective.coordinates.start)
    end = maximise(engine(name).continuous(objective, discrete.x), discrete.x, tolerance=1e-4)
    sd = np.sqrt(np.diag(np.linalg.inv(discrete.local.information)))
    assert end.converged
    assert np.abs((end.x - discrete.x) / sd).max() < 0.1


def test_torch_trajectories_and_their_adjoint():
    from oracles.continuous_events import log_linear, trajectory

    shown = light(100, 500, 31, duration=0.0006)
    fine = resampled(shown, largest_change=0.0025)  # the closed form freezes the photoreceptor within a step
    dynamics = dynamics_of(MODEL.circuit())
    at, log_radiance = shown.t[::15], log_linear(shown.t, shown.radiance)
    gradients = []
    for adjoint in (False, True):
        module, states = trajectory(dynamics, log_radiance, at, adjoint=adjoint)
        states[-1, -1].backward()
        gradients.append(module.values.grad.numpy()[[0, 1, 2, 3, 6]])
    expected = integrate(fine.t, fine.radiance, dynamics).at(at)[:, [1, 2, 5]]
    np.testing.assert_allclose(states.detach().numpy()[:, 1:], expected, rtol=0, atol=1e-6)
    values = np.array(dynamics)[[0, 1, 2, 3, 6]]
    np.testing.assert_allclose(gradients[0] * values, gradients[1] * values, rtol=0, atol=1e-6)


def test_reference_events_equal_the_oracle(shared):
    from oracles.continuous_events import events, log_linear

    circuit, shown, times, polarities = oracle_case(np.load(shared / "oracle" / "pixel_trajectories.npz"), 0)
    fine = shown(20001)
    found, signs = events(circuit, log_linear(fine.t, fine.radiance), 0.0, float(times[3]) + 1e-5, rtol=1e-8)
    np.testing.assert_allclose(found, times[:4], rtol=0, atol=1e-6)
    np.testing.assert_array_equal(signs, polarities[:4])
