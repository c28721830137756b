"""The filter that shares noise out between thresholds and shot noise, against dense Gaussian algebra and simulation."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from pixelid.dynamics.linear import linear_stages, stationary_covariance
from pixelid.fit.maximise import maximise
from pixelid.likelihood.event_times import EventTimes
from pixelid.likelihood.shot_noise import _doubled, _filter, share_out
from pixelid.model.shipped import find_model
from pixelid.recordings.own_light import with_fine_light
from pixelid.simulate import simulate
from pixelid.stimuli.shapes import chirp, slow

MODEL = find_model("dvs128").without_effect("threshold_mismatch")


@pytest.mark.parametrize("name", ["dvs128", "dvs128_low_light", "photoreceptor"])
def test_stages_are_the_differential_equations_of_the_circuit(name):
    """The step response of the matrices is that of the equations, written out anew."""
    circuit = find_model(name).circuit()
    light = 24.0
    A, drive, stored = linear_stages(circuit, light)
    times = np.linspace(1e-4, 5e-3, 7)
    response = np.array([np.linalg.solve(A, (expm(A * t) - np.eye(len(A))) @ drive) for t in times])
    a, b = circuit.alpha * light, circuit.beta + circuit.gamma * light
    poles = [w for w in (circuit.follower, circuit.extra_pole, circuit.differencing) if np.isfinite(w)]

    def rhs(t, s):
        if circuit.photoreceptor == "second_order":
            d = [a * (1.0 - s[1]) - b * s[0], s[0]]
        else:
            d = [circuit.corner * light * (1.0 - s[0])]
        for k, w in enumerate(poles, len(d)):
            d.append(w * (s[k - 1] - s[k]))
        return d

    exact = solve_ivp(rhs, (0.0, times[-1]), np.zeros(len(A)), t_eval=times, rtol=1e-10, atol=1e-12, method="LSODA").y
    np.testing.assert_allclose(response[:, -1], exact[-1], rtol=1e-6)
    np.testing.assert_allclose(response[:, stored], exact[stored], rtol=1e-6)


def test_the_filter_is_dense_gaussian_algebra():
    """Mean and covariance of all levels at once, from the noise's autocovariance, against one event after another."""
    rng = np.random.default_rng(1)
    step, n = 2e-5, 12
    A, drive, stored = linear_stages(MODEL.circuit(), 24.0)
    P = stationary_covariance(A, drive) * 0.5 / 24.0
    event = np.cumsum(rng.integers(20, 200, n))
    reference = np.append(0, event[:-1]) + rng.integers(0, 15, n)
    sign = rng.choice([-1.0, 1.0], n)
    variance, ratio = rng.uniform(0.5, 2.0, n) * 1e-3, 2e-4
    y = 0.05 * rng.standard_normal(n)
    rate, moved, stamp = rng.uniform(10.0, 80.0, n), rng.uniform(-90.0, 10.0, n), rng.uniform(0.1, 1.0, n) * 1e-6

    def covariance(i, first, j, second):
        """Of the component i at one step with j at another."""
        lag = (second - first) * step
        return (P @ expm(A * lag).T)[i, j] if lag >= 0 else (expm(A * -lag) @ P)[i, j]

    out, S = len(A) - 1, np.zeros((n, n))
    for k in range(n):
        for m in range(n):
            S[k, m] = sign[k] * sign[m] * ratio * (
                covariance(out, event[k], out, event[m]) - covariance(out, event[k], stored, reference[m])
                - covariance(stored, reference[k], out, event[m])
                + covariance(stored, reference[k], stored, reference[m])
            )  # fmt: skip
    late = np.diag(rate) + np.diag(moved[1:], -1)  # of each stamp, in its own level and the next
    first = np.append(stamp[0] * moved[0] ** 2, np.zeros(n - 1))  # the stamp before the first event
    S += np.diag(variance + first) + late @ np.diag(stamp) @ late.T
    E = expm(A * step)
    light = (np.zeros(2, np.int16), np.array([event[5] + 7, event[-1] + 1]))  # the same one twice
    still = (*_doubled(E[None], (P - E @ P @ E.T)[None]), P[None], A[-1][None])
    logs, squares, count = _filter(
        y,
        variance,
        sign,
        np.ones(n, bool),
        rate,
        moved,
        stamp,
        reference,
        event,
        *light,
        *still,
        stored,
        ratio,
        np.empty((n, 7)),
    )
    assert count == n
    assert logs == pytest.approx(np.linalg.slogdet(S)[1], rel=1e-9)
    assert squares == pytest.approx(y @ np.linalg.solve(S, y), rel=1e-9)


def test_moments_are_those_of_dense_gaussian_algebra():
    """Mean and variance of the level by shot noise, and its slope, given the events before."""
    step, stored = 2e-5, linear_stages(MODEL.circuit(), 24.0)[2]
    A, drive, _ = linear_stages(MODEL.circuit(), 24.0)
    P = stationary_covariance(A, drive) * 0.5 / 24.0
    E, density, variance = expm(A * step), 2e-4, np.array([1e-3, 1.0])
    event, reference, y = np.array([50, 90]), np.array([0, 55]), np.array([0.03, 0.0])
    moments = np.empty((2, 7))
    _filter(
        y, variance, np.ones(2), np.ones(2, bool), *np.zeros((3, 2)), reference, event, np.zeros(1, np.int16),
        np.array([91]), *_doubled(E[None], (P - E @ P @ E.T)[None]), P[None], A[-1][None], stored, density, moments,
    )  # fmt: skip
    # states at steps 0, 50, 55, 90 together
    steps = [0, 50, 55, 90]
    joint = np.block([
        [density * (P @ expm(A * (b - a) * step).T if b >= a else expm(A * (a - b) * step) @ P) for b in steps]
        for a in steps
    ])  # fmt: skip
    n = len(A)
    first, second, slope = np.zeros((3, 4 * n))
    first[n + n - 1], first[stored] = -1.0, 1.0
    second[3 * n + n - 1], second[2 * n + stored] = -1.0, 1.0
    slope[3 * n : 4 * n] = A[-1]
    gain = joint @ first / (first @ joint @ first + variance[0])
    after = joint - np.outer(gain, first @ joint)
    expected = [second @ gain * y[0], second @ after @ second, slope @ gain * y[0], slope @ after @ second,
                slope @ after @ slope]  # fmt: skip
    np.testing.assert_allclose(moments[1], [*expected, 0.0, 0.0], rtol=1e-8)


def test_light_that_changes_is_followed_from_step_to_step():
    """Against the joint covariance of the states of all steps, made one step after another."""
    step, per_step, stored = 1e-4, np.repeat([0, 1, 0], [9, 14, 17]), linear_stages(MODEL.circuit(), 24.0)[2]
    parts = [(linear_stages(MODEL.circuit(), light)[:2], light) for light in (24.0, 3.0)]
    P = np.array([stationary_covariance(*stages) * 0.5 / light for stages, light in parts])
    E = np.array([expm(stages[0] * step) for stages, _ in parts])
    Q = P - E @ P @ E.transpose(0, 2, 1)
    density, n, m = 2e-4, E.shape[1], len(per_step) + 1
    joint = np.zeros((m * n, m * n))
    joint[:n, :n] = P[0] * density
    for k, light in enumerate(per_step):  # the row of one more state
        here, new, before = slice(k * n, (k + 1) * n), slice((k + 1) * n, (k + 2) * n), slice(0, (k + 1) * n)
        joint[new, before] = E[light] @ joint[here, before]
        joint[before, new] = joint[new, before].T
        joint[new, new] = E[light] @ joint[here, here] @ E[light].T + Q[light] * density
    event, reference, sign = np.array([7, 21, 26, 40]), np.array([0, 8, 22, 26]), np.array([1.0, 1.0, -1.0, 1.0])
    rows = np.zeros((4, m * n))
    for k in range(4):
        rows[k, event[k] * n + n - 1] -= sign[k]
        rows[k, reference[k] * n + stored] += sign[k]
    variance, y = np.full(4, 1e-3), np.array([0.03, -0.02, 0.01, 0.04])
    S = rows @ joint @ rows.T + np.diag(variance)
    slope = np.zeros((2, n))
    logs, squares, _ = _filter(
        y, variance, sign, np.ones(4, bool), *np.zeros((3, 4)), reference, event,
        np.array([0, 1, 0], np.int16), np.array([9, 23, 40]), *_doubled(E, Q), P, slope, stored, density,
        np.empty((4, 7)),
    )  # fmt: skip
    assert logs == pytest.approx(np.linalg.slogdet(S)[1], rel=1e-9)
    assert squares == pytest.approx(y @ np.linalg.solve(S, y), rel=1e-9)


@pytest.fixture(scope="module")
def lights():
    return [chirp(24.0, stop_hz=200.0), slow(24.0, seed=3)]


def divided(truth, lights, seed, model=MODEL):
    recordings = [
        with_fine_light(simulate(truth, light, width=4, height=2, seed=seed + k, sensor_seed=seed), "linear")
        for k, light in enumerate(lights)
    ]
    likelihood = EventTimes(recordings).weighed(model.circuit())
    fit = maximise(likelihood, model, tolerance=0.05, max_steps=40)
    found = share_out(likelihood, fit.model.circuit())
    assert found is not None
    return found, fit


def test_without_a_pole_noise_is_not_shared_out(lights):
    ideal = find_model("ideal").with_effect("threshold_noise")
    likelihood = EventTimes([simulate(ideal, light, width=2, height=2, seed=1) for light in lights])
    assert share_out(likelihood, ideal.circuit()) is None


def test_planted_shot_noise_is_told_from_threshold_noise(lights):
    truth = MODEL.set({"threshold_sigma": 0.03}).with_effect("shot_noise", {"density": 6e-5})
    found, fit = divided(truth, lights, 11)
    assert found.gain > 100.0
    assert abs(np.log(found.density / 6e-5)) < 4.0 * found.error + 0.05
    assert fit.values["threshold_sigma"] > 0.05  # all of the noise
    assert np.sqrt(found.thresholds) * fit.values["threshold_sigma"] == pytest.approx(0.03, rel=0.2)


def test_shot_noise_passes_a_slew_limited_follower_as_small_signals_do(lights):
    limited = MODEL.with_effect("slew_limit", {"rise_per_s": 3000.0, "fall_per_s": 3000.0})
    truth = limited.set({"threshold_sigma": 0.03}).with_effect("shot_noise", {"density": 6e-5})
    held = limited.fix(dict.fromkeys(("slew_limit.rise_per_s", "slew_limit.fall_per_s")))
    found, _ = divided(truth, lights, 11, held)
    assert found.gain > 100.0
    assert abs(np.log(found.density / 6e-5)) < 4.0 * found.error + 0.05


def test_what_fires_at_the_end_of_a_silence_is_not_taken_for_noise(lights):
    """Its level lies anywhere beyond the threshold: by much where the light went on meanwhile."""
    silent = MODEL.with_effect("dead_time_without_reset", {"s": 5e-3})
    truth = silent.set({"threshold_sigma": 0.03}).with_effect("shot_noise", {"density": 6e-5})
    found, _ = divided(truth, lights, 11, silent.fix({"dead_time_without_reset.s": None}))
    assert found.gain > 20.0  # half as many events as without silences
    assert abs(np.log(found.density / 6e-5)) < 4.0 * found.error + 0.05
    assert found.thresholds < 0.5


def test_threshold_noise_alone_is_no_shot_noise(lights):
    found, _ = divided(MODEL.set({"threshold_sigma": 0.06}), lights, 21)
    assert found.gain < 3.0
    assert found.thresholds == pytest.approx(1.0, abs=0.1)
