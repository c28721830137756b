"""The closed-form trajectory of a slew-limited follower against a Runge-Kutta integration of it."""

import numpy as np
import pytest
from oracles.slew_runge_kutta import slewed_outputs

from pixelid.dynamics import slew
from pixelid.dynamics.of_circuit import dynamics_of
from pixelid.dynamics.slewed import slewed
from pixelid.dynamics.trajectory import integrate
from pixelid.errors import InputError
from pixelid.model.shipped import find_model
from pixelid.simulate import simulate
from pixelid.simulate.laws import rules_of
from pixelid.simulate.light import noise_step
from pixelid.simulate.step import cubic
from pixelid.stimuli.drive import Drive, drive, refined
from pixelid.stimuli.resample import resampled
from pixelid.stimuli.shapes import chirp, steps

DVS128 = find_model("dvs128")
CHAINS = {
    "plain": {},
    "high-pass": {"lower_cutoff": {"cutoff_hz": 2.0}},
    "extra pole": {"extra_pole": {"cutoff_hz": 1500.0}},
    "both": {"extra_pole": {"cutoff_hz": 1500.0}, "lower_cutoff": {"cutoff_hz": 2.0}},
}


def chain(name):
    model = DVS128
    for effect, values in CHAINS[name].items():
        model = model.with_effect(effect, values)
    return model


def limited(model, rise, fall):
    return model.with_effect("slew_limit", {"rise_per_s": rise, "fall_per_s": fall}).circuit()


def trajectory(light, circuit, dynamics):
    return slewed(light.t, light.radiance, circuit, dynamics)


def shown(light, per_time_constant=20.0):
    """(as read, as the Runge-Kutta steps need it) of one light."""
    read = drive(resampled(light, "smooth"), DVS128.circuit(), float(light.t[-1]))
    t, left, weight = refined(
        read.t, slew.longest_step(tuple(dynamics_of(DVS128.circuit()))[3:7], 1.0, per_time_constant)
    )
    logs = np.log(read.radiance)
    return read, Drive(t, np.exp((1 - weight) * logs[left] + weight * logs[left + 1]))


@pytest.mark.parametrize("limits", [(400.0, 250.0), (1200.0, 900.0), (30.0, 1000.0)], ids=str)
@pytest.mark.parametrize("name", CHAINS)
def test_states_equal_runge_kutta(name, limits):
    model = chain(name)
    _, fine = shown(steps(400.0, duration_s=0.25, seed=3))
    circuit, dynamics = limited(model, *limits), dynamics_of(model.circuit())
    path = trajectory(fine, circuit, dynamics)
    rates = slew.rates_of(circuit, dynamics)
    driven, wanted = slewed_outputs(fine.t, fine.radiance, dynamics, rates)
    assert len(path.change_s) >= 2
    np.testing.assert_allclose(path.states[:, 3] - path.states[:, 4], driven, atol=1e-6)
    np.testing.assert_allclose(path.states[:, 5], wanted, atol=1e-6)
    stepped = slew.slewed_states(fine.t, fine.radiance, dynamics.uniform(), rates, True)  # as the simulator goes
    np.testing.assert_allclose(stepped[:, 3], driven, atol=1e-6)
    np.testing.assert_allclose(stepped[:, 5], wanted, atol=1e-6)
    free = integrate(fine.t, fine.radiance, dynamics).states
    assert np.abs(free[:, 5] - wanted).max() > 0.01  # the limit acts


@pytest.mark.parametrize("light", [steps(400.0, duration_s=0.25, seed=3), chirp(400.0, duration_s=0.25, stop_hz=400.0)])
def test_between_coarse_samples_switches_are_found(light):
    """Excursions within one long step, ringing included, as in steps that resolve everything."""
    circuit, dynamics = limited(DVS128, 400.0, 250.0), dynamics_of(DVS128.circuit())
    read, fine = shown(light)
    found, wanted = trajectory(read, circuit, dynamics).at(fine.t), trajectory(fine, circuit, dynamics).states
    np.testing.assert_allclose(found[:, 1:], wanted[:, 1:], atol=5e-5)  # a missed switch: 5e-3


@pytest.mark.parametrize("level", [3.0, 24.0, 400.0])
def test_under_noisy_light_long_steps_err_little(level):
    """The cubics between knots of a simulation with shot noise, against Runge-Kutta steps that resolve every pole."""
    circuit = limited(DVS128, 1200.0, 900.0).with_(shot_density=3.5e-4)
    rules = rules_of(circuit, 0, False, 0.0)
    step_s = float(noise_step(rules, level))
    logs = np.log(level) + np.sqrt(0.5 * 3.5e-4 / level / step_s) * np.random.default_rng(3).standard_normal(400)

    def resolved(per_time_constant):
        t, left, weight = refined(
            step_s * np.arange(len(logs)), slew.longest_step(rules.chain[:4], 1.0, per_time_constant)
        )
        return t, (1 - weight) * logs[left] + weight * logs[left + 1]

    t, u = resolved(slew.STEPS_PER_TIME_CONSTANT_UNDER_NOISE)
    states = slew.slewed_states(t, np.full(len(t), level), rules.dynamics, rules.rates, False, u)
    fine, light = resolved(20.0)
    # one photoreceptor throughout: it runs at `level`, and not at what the noise makes of it
    _, wanted = slewed_outputs(fine, np.exp(light), rules.dynamics, rules.rates, at=level)
    k = np.clip(np.searchsorted(t, fine, "right") - 1, 0, len(t) - 2)
    h, d, slope = np.diff(t)[k], states[:, 5], rules.chain[3] * (states[:, 3] - states[:, 5])
    found, _ = cubic((fine - t[k]) / h, h, d[k], d[k + 1], slope[k], slope[k + 1])
    assert np.abs(wanted - logs[0]).max() > 0.1  # a fifth of that is a threshold's noise
    np.testing.assert_allclose(found, wanted, atol=1e-5)


def test_a_limit_out_of_reach_changes_nothing():
    dynamics = dynamics_of(DVS128.circuit())
    read, _ = shown(steps(24.0, duration_s=0.25, seed=1))
    path = trajectory(read, limited(DVS128, 1e7, 1e7), dynamics)
    assert len(path.change_s) == 0
    np.testing.assert_allclose(path.states[:, 1:], integrate(read.t, read.radiance, dynamics).states[:, 1:], atol=1e-9)


@pytest.mark.parametrize("missing", ["source_follower_pole", "differencing_pole"])
def test_its_likelihood_needs_both_poles(missing):
    circuit = limited(DVS128.without_effect(missing), 400.0, 400.0)
    with pytest.raises(InputError, match="slew_limit"):
        slewed([0.0, 1.0], [1.0, 2.0], circuit, dynamics_of(circuit))


def test_a_pole_far_beyond_the_light_needs_no_finer_steps(monkeypatch):
    """As a fit may leave it that lets a cutoff run off: the same events as with steps that resolve it."""
    model = DVS128.with_effect("slew_limit", {"rise_per_s": 600.0, "fall_per_s": 300.0}).set({"diff_cutoff_hz": 3e5})
    light = resampled(chirp(24.0, duration_s=0.1, stop_hz=200.0), "smooth")
    events = simulate(model, light, width=3, height=3, seed=1).events
    monkeypatch.setattr(slew, "FASTEST_RAD_S", np.inf)
    resolved = simulate(model, light, width=3, height=3, seed=1).events
    assert len(events.t) == len(resolved.t) > 100
    np.testing.assert_allclose(events.t, resolved.t, atol=2e-9)


def test_a_stimulus_that_needs_too_many_steps_is_refused():
    with pytest.raises(InputError, match="needs more than"):
        slew.longest_step((2e5, 1e12), 1e4)
