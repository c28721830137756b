"""The closed-form trajectory: against adaptive integrators, its order, its derivatives, its edge cases."""

import numpy as np
import pytest
from numba import njit
from oracles.first_order_hold import first_order_hold
from scipy.integrate import solve_ivp

from pixelid.dynamics import kernels
from pixelid.dynamics.equations import ABSENT_DIFFERENCING, ABSENT_EXTRA, ABSENT_FOLLOWER
from pixelid.dynamics.trajectory import STAGES, Dynamics, integrate
from pixelid.errors import InputError

PIXEL = Dynamics(61283.0, 1848.0, 1.12, follower=19616.0, differencing=100531.0)
FULL = PIXEL._replace(extra_pole=8000.0, lower_cutoff=30.0)
OUTPUTS = {
    "photoreceptor": "log_photoreceptor",
    "source_follower": "log_source_follower",
    "differencing": "log_diff_no_reset",
}


def stimulus(kind, parameters, t):
    """Log radiance of an oracle case."""
    level, f, m, end = parameters
    phase = 2 * np.pi * f * t
    logistic = 1 / (1 + np.exp(-(t - end / 4) / (0.002 * end)))
    factor = {
        "sine": 1 + m * np.sin(phase),
        "step_up": 1 + 3 * m * logistic,
        "step_down": 1 - m * logistic,
        "chirp": np.exp(m * np.sin(phase + 2 * np.pi * 4 * f * t**2 / end)),
        "pulse": 1 + 4 * m * np.exp(-0.5 * ((t - end / 2) / (0.01 * end)) ** 2),
        "edge": 1 + m * np.tanh(8 * np.sin(phase)),
    }
    return np.log(level * factor[kind])


def oracle_error(data, case, refinement, linearisation):
    """{stage: largest error} with the oracle's sampling refined so many times."""
    amp, loop, tau_out, q_in, q_mil, follower, differencing = data[f"case{case}/params"][:7]
    q = q_in + q_mil
    alpha, beta = (loop + 1) / (q * tau_out), (q_in + (amp + 1) * q_mil) / (q * tau_out)
    dynamics = Dynamics(alpha, beta, 1 / q, follower=2 * np.pi * follower, differencing=2 * np.pi * differencing)
    t = data[f"case{case}/t_s"]
    fine = np.interp(np.arange((len(t) - 1) * refinement + 1) / refinement, np.arange(len(t)), t)
    radiance = np.exp(stimulus(str(data[f"case{case}/kind"]), data[f"case{case}/stimulus"], fine))
    trajectory = integrate(fine, radiance, dynamics, linearisation=linearisation)
    return {
        stage: np.abs(trajectory.stage(stage)[::refinement] - data[f"case{case}/{key}"]).max()
        for stage, key in OUTPUTS.items()
    }


@pytest.mark.parametrize("case", range(6))
def test_against_the_oracle(shared, case):
    data = np.load(shared / "oracle" / "pixel_trajectories.npz")
    assert max(oracle_error(data, case, 64, "midpoint").values()) < 1e-6


@pytest.mark.parametrize("case", range(6))
@pytest.mark.parametrize(("linearisation", "order", "within"), [("midpoint", 2, 0.1), ("newer", 1, 0.15)])
def test_order_of_convergence(shared, case, linearisation, order, within):
    data = np.load(shared / "oracle" / "pixel_trajectories.npz")
    coarse, fine = (oracle_error(data, case, n, linearisation) for n in (8, 32))
    for stage in OUTPUTS:
        assert np.log(coarse[stage] / fine[stage]) / np.log(4) == pytest.approx(order, abs=within)


@pytest.mark.parametrize("dynamics", [PIXEL, FULL], ids=["plain", "full"])
def test_against_dop853(dynamics):
    """The equations written out once more, solved adaptively at rtol 1e-12."""
    alpha, beta, gamma, w1, w2, wh, wd, _ = dynamics
    plain = wh == 0

    def log_radiance(t):
        return 3.0 + 0.8 * np.sin(60 * t) * np.sin(60 * t)

    def slope(t, x):
        v, y, s, e, z, d = x
        light = np.exp(log_radiance(t))
        acceleration = alpha * light * (log_radiance(t) - y) - (beta + gamma * light) * v
        if plain:
            return [acceleration, v, w1 * (y - s), 0.0, 0.0, wd * (s - d)]
        return [acceleration, v, w1 * (y - s), w2 * (s - e), wh * (e - z), wd * (e - z - d)]

    start = [0.0, 3.0, 3.0, 3.0, 3.0, 3.0 if plain else 0.0]
    exact = solve_ivp(slope, (0, 0.01), start, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    t = np.linspace(0, 0.01, 40_001)
    states = integrate(t, np.exp(log_radiance(t)), dynamics).states[-1]
    for stage in ("photoreceptor", "source_follower", "differencing"):
        assert states[STAGES.index(stage)] == pytest.approx(exact[STAGES.index(stage)], abs=1e-8)


@njit(error_model="numpy")
def stepped_scan(t, u, light, values):
    """The scan by the step of `kernels` on complex numbers; light: (n − 1,) where each step is linearised."""
    alpha, beta, gamma, w1, w2, wh, wd, floor = values
    states = np.empty((len(t), 6), np.complex128)
    zero = 0j
    rest = u[0] if wh.real > 0 else zero
    state = (zero, u[0], u[0], u[0], rest, u[0] - rest)
    coincide = kernels.cutoffs_coincide(w1, w2, wh, wd)
    for k in range(len(t)):
        if k > 0:
            tau, seen = t[k] - t[k - 1], light[k - 1] + floor
            r = (u[k] - u[k - 1]) / tau
            state = kernels.advance(
                state, u[k - 1], r, tau, alpha * seen, beta + gamma * seen, w1, w2, wh, wd, coincide
            )
        for j in range(6):
            states[k, j] = state[j]
    return states


@pytest.mark.parametrize("field", Dynamics._fields)
@pytest.mark.parametrize("coincident", [False, True])
def test_complex_step_derivatives(field, coincident):
    """d states / d ln parameter by complex steps, against fourth-order central differences."""
    t = np.linspace(0, 0.01, 201)
    radiance = 24 * np.exp(0.8 * np.sin(700 * t))
    base = FULL._replace(floor=5.0)
    base = base._replace(differencing=FULL.follower) if coincident else base
    value = getattr(base, field)

    def states(factor):
        return integrate(t, radiance, base._replace(**{field: value * factor})).states

    stepped = np.array([complex(x, 1e-30 * x if name == field else 0.0) for name, x in base._asdict().items()])
    exact = stepped_scan(t, np.log(radiance) + 0j, np.sqrt(radiance[1:] * radiance[:-1]), stepped).imag / 1e-30
    h = 1e-3
    central = (8 * (states(1 + h) - states(1 - h)) - states(1 + 2 * h) + states(1 - 2 * h)) / (12 * h)
    scale = np.abs(central).max(axis=0) + 1e-6
    assert (np.abs(exact - central).max(axis=0) < 1e-7 * scale + 1e-9).all()
    assert np.abs(exact[:, 5]).max() > 1e-6


def test_vector_and_scalar_scans_agree():
    """The vector form of the plain pixel is the scalar form, to rounding."""
    t = np.cumsum(np.random.default_rng(0).exponential(2e-5, 3000))
    radiance = np.exp(2 + 2 * np.sin(900 * t))
    for dynamics in (PIXEL, Dynamics.low_light(33.0, follower=2e4, differencing=1e5), FULL):
        run, scalar = integrate(t, radiance, dynamics), np.empty((len(t), 6))
        kernels.scan(t, np.log(radiance), radiance, dynamics.uniform(), True, scalar)
        assert np.abs(run.states[:, 1:] - scalar[:, 1:]).max() < 1e-11
        between, there = t[:-1] + 0.3 * np.diff(t), np.empty((len(t) - 1, 6))
        kernels.states_at(
            between, np.arange(len(t) - 1), t, np.log(radiance), radiance, dynamics.uniform(), True, scalar, there
        )
        assert np.abs(run.at(between)[:, 1:4] - there[:, 1:4]).max() < 1e-11
        assert np.abs(run.at(between)[:, 5] - there[:, 5]).max() < 1e-11


@pytest.mark.parametrize("dynamics", [PIXEL, FULL], ids=["plain", "full"])
def test_jumps_and_long_steps(dynamics):
    """Two samples at one time are a jump; a step of 10 s forgets everything but the lower cutoff's past."""
    t = np.array([0.0, 1e-3, 1e-3, 1.1e-3, 10.0011])
    radiance = np.array([10.0, 10.0, 40.0, 40.0, 40.0])
    trajectory = integrate(t, radiance, dynamics)
    np.testing.assert_array_equal(trajectory.states[1], trajectory.states[2])
    hold = first_order_hold(dynamics, 40.0, t[3] - t[2])
    x = np.array([trajectory.stage(name)[2] for name in hold.names])
    expected = hold.A @ x + (hold.B + hold.B_next) * np.log(40.0)
    got = np.array([trajectory.stage(name)[3] for name in hold.names])
    np.testing.assert_allclose(got, expected, rtol=1e-10)
    final = np.log(40.0) if dynamics.lower_cutoff == 0 else 0.0
    assert trajectory.stage("differencing")[-1] == pytest.approx(final, abs=1e-12)


def test_absent_stages_are_the_identity():
    t = np.linspace(0, 0.01, 500)
    radiance = 24 * np.exp(0.8 * np.sin(700 * t))
    bare = PIXEL._replace(follower=ABSENT_FOLLOWER, extra_pole=ABSENT_EXTRA, differencing=ABSENT_DIFFERENCING)
    trajectory = integrate(t, radiance, bare)
    for stage in ("source_follower", "extra_pole", "differencing"):
        np.testing.assert_allclose(trajectory.stage(stage), trajectory.stage("photoreceptor"), rtol=0, atol=1e-13)
    np.testing.assert_allclose(
        integrate(t, radiance, Dynamics.unlimited()).stage("differencing"), np.log(radiance), rtol=0, atol=1e-13
    )


def test_refusals():
    with pytest.raises(InputError, match="positive"):
        integrate([0.0, 1.0], [1.0, 0.0], PIXEL)
    with pytest.raises(InputError, match="'older'"):
        integrate([0.0, 1.0], [1.0, 1.0], PIXEL, linearisation="older")
