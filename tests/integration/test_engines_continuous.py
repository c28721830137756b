"""The continuous-time model: collocation, shooting, torch's solvers, and reference events."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.trajectories import oracle_case
from test_engines import light

from pixelid.dynamics.of_circuit import dynamics_of
from pixelid.dynamics.trajectory import integrate
from pixelid.errors import InputError
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.engines.collocation import MultipleShooting, continuous_log_posterior, continuous_optimum
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.newton import maximise
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.shipped import find_model
from pixelid.simulate import simulate
from pixelid.stimuli.resample import resampled

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
    continuous = continuous_optimum(objective, discrete.x)
    assert continuous.converged
    sd = np.sqrt(np.diag(np.linalg.inv(discrete.local.information)))
    return np.abs((continuous.x - discrete.x) / sd).max(), continuous, sd


def test_continuous_and_discrete_fits_agree_when_sampling_is_fine_and_part_when_it_is_coarse(measured):
    fine, middle, coarse = (shift(objective_of(measured, n))[0] for n in (1601, 801, 201))
    assert fine < 0.01
    assert fine <= middle < 0.2
    assert coarse > 0.5


@pytest.mark.slow
def test_multiple_shooting_finds_the_single_shooting_optimum(measured):
    objective = objective_of(measured, 201)
    _, single, sd = shift(objective)
    multiple = MultipleShooting(objective, segments=3).maximise(single.x + 0.1 * sd)
    assert multiple.converged
    assert np.abs((multiple.x - single.x) / sd).max() < 0.01


def test_collocation_has_converged(measured):
    objective = objective_of(measured, 801)
    x = objective.coordinates.start
    assert continuous_log_posterior(objective, x, parts=2) == pytest.approx(
        continuous_log_posterior(objective, x, parts=5), abs=3e-3
    )


def test_continuous_fit_refuses_what_it_lacks(measured):
    model = MODEL.without_effect("differencing_pole")
    objective = EventTimesObjective(EventTimes(measured), Coordinates.of(model))
    with pytest.raises(InputError, match="continuous"):
        continuous_log_posterior(objective, objective.coordinates.start)


def test_torch_trajectories_and_their_adjoint():
    from pixelid.fit.engines.torch_continuous import log_linear, trajectory

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
    from pixelid.fit.engines.torch_continuous import events, log_linear

    circuit, shown, times, polarities = oracle_case(np.load(shared / "oracle" / "pixel_trajectories.npz"), 0)
    fine = shown(20001)
    found, signs = events(circuit, log_linear(fine.t, fine.radiance), 0.0, float(times[3]) + 1e-5, rtol=1e-8)
    np.testing.assert_allclose(found, times[:4], rtol=0, atol=1e-6)
    np.testing.assert_array_equal(signs, polarities[:4])
