"""The continuous right-hand side under SciPy, CasADi and torchdiffeq, against the fine closed-form trajectory."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pixelid.dynamics.continuous import (
    casadi_function,
    right_hand_side,
    scipy_function,
    steady_state,
    torch_module,
)
from pixelid.dynamics.hold import present_states
from pixelid.dynamics.trajectory import Dynamics, integrate

# A slow pixel, so that explicit solvers need few steps.
PIXEL = Dynamics(1500.0, 60.0, 1.5, follower=900.0, differencing=2500.0)
ORDERS = {
    "fourth": PIXEL,
    "photoreceptor": Dynamics(1500.0, 60.0, 1.5),
    "low_light": Dynamics.low_light(12.0, follower=900.0, differencing=2500.0),
    "lower_cutoff": PIXEL._replace(lower_cutoff=8.0),
    "extra_pole": PIXEL._replace(extra_pole=700.0),
    "full": PIXEL._replace(extra_pole=700.0, lower_cutoff=8.0),
    "unlimited": Dynamics.unlimited(follower=900.0, differencing=2500.0),
    "cutoff_alone": Dynamics.low_light(12.0, lower_cutoff=8.0),
}
LEVEL, CONTRAST, RATE, END = 20.0, 0.6, 2 * np.pi * 12.0, 0.25
GRID = np.linspace(0.0, END, 26)


def log_radiance(t, sin=np.sin, log=np.log):
    """Starts flat, so that the steady state is also the discrete start's."""
    return log(LEVEL * (1 + CONTRAST * sin(RATE * t) * sin(RATE * t)))


@pytest.fixture(scope="module")
def fine():
    """{order: (26, order) states on GRID from 200 000 closed-form steps}; error about 1e-9."""
    t = np.linspace(0.0, END, 200_001)
    radiance = np.exp(log_radiance(t))
    return {
        name: np.stack([integrate(t, radiance, d).stage(s)[::8000] for s in present_states(d)], axis=1)
        for name, d in ORDERS.items()
    }


def scale(name):
    """The slope is compared in units of the photoreceptor's bandwidth."""
    return np.array([200.0 if s == "photoreceptor_slope" else 1.0 for s in present_states(ORDERS[name])])


@pytest.mark.parametrize("name", ORDERS)
@pytest.mark.parametrize("method", ["DOP853", "Radau"])
def test_scipy(name, method, fine):
    x0 = steady_state(ORDERS[name], np.log(LEVEL))
    f = scipy_function(ORDERS[name], log_radiance)
    # DOP853's interpolant between its steps is coarser than the steps themselves
    options = {"rtol": 1e-9, "max_step": 5e-4} if method == "DOP853" else {"rtol": 1e-8}
    got = solve_ivp(f, (0, END), x0, method=method, t_eval=GRID, atol=1e-10, **options).y.T
    assert np.abs((got - fine[name]) / scale(name)).max() < 3e-8


@pytest.mark.parametrize("name", ORDERS)
def test_casadi_cvodes(name, fine):
    import casadi as ca

    order, _ = right_hand_side(ORDERS[name])
    x, t, p = ca.MX.sym("x", order), ca.MX.sym("t"), ca.MX.sym("p", len(Dynamics._fields))
    dx = casadi_function(ORDERS[name])(x, log_radiance(t, ca.sin, ca.log), p)
    options = {"reltol": 1e-10, "abstol": 1e-11, "max_num_steps": 100_000}
    solver = ca.integrator("pixel", "cvodes", {"x": x, "t": t, "p": p, "ode": dx}, 0.0, GRID[1:], options)
    got = np.array(solver(x0=steady_state(ORDERS[name], np.log(LEVEL)), p=list(ORDERS[name]))["xf"]).T
    assert np.abs((got - fine[name][1:]) / scale(name)).max() < 3e-8


@pytest.mark.parametrize("name", ["fourth", "low_light", "full"])
def test_torchdiffeq(name, fine):
    torch = pytest.importorskip("torch")
    odeint = pytest.importorskip("torchdiffeq").odeint
    f = torch_module(ORDERS[name], lambda t: log_radiance(t, torch.sin, torch.log))
    x0 = torch.tensor(steady_state(ORDERS[name], np.log(LEVEL)))
    with torch.no_grad():
        got = odeint(f, x0, torch.tensor(GRID), method="dopri8", rtol=1e-8, atol=1e-10).numpy()
    assert np.abs((got - fine[name]) / scale(name)).max() < 3e-8


def test_torch_gradient_and_batch():
    torch = pytest.importorskip("torch")
    f = torch_module(PIXEL, lambda t: torch.full((3,), 3.0, dtype=torch.float64))
    x = torch.rand(3, 4, dtype=torch.float64)
    f(torch.tensor(0.0), x).sum().backward()
    v, y, s, d = x.unbind(-1)
    light = float(np.exp(3.0))
    expected = [light * (3 - y).sum(), -v.sum(), -light * v.sum(), (y - s).sum(), 0.0, 0.0, (s - d).sum()]
    expected.append(PIXEL.alpha * (3 - y).sum() - PIXEL.gamma * v.sum())
    np.testing.assert_allclose(f.values.grad, [float(value) for value in expected], rtol=1e-12)


def test_casadi_is_the_same_function():
    rng = np.random.default_rng(0)
    for dynamics in ORDERS.values():
        order, f = right_hand_side(dynamics)
        x = rng.normal(size=order)
        got = np.array(casadi_function(dynamics)(x, 2.5, list(dynamics))).ravel()
        np.testing.assert_allclose(got, f(tuple(x), 2.5, np.exp(2.5)), rtol=1e-14)


def test_absent_stages_are_left_out_and_steady_state_is_one():
    for dynamics, order in zip(ORDERS.values(), (4, 2, 3, 5, 5, 6, 2, 2), strict=True):
        assert right_hand_side(dynamics)[0] == order
        slope = scipy_function(dynamics, lambda t: 1.7)(0.0, steady_state(dynamics, 1.7))
        np.testing.assert_array_equal(slope, np.zeros(order))
