"""The continuous right-hand side under two of SciPy's solvers, against the fine closed-form trajectory."""

import numpy as np
import pytest
from oracles.continuous_events import steady_state
from scipy.integrate import solve_ivp

from pixelid.dynamics.continuous import present_states, right_hand_side
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


def log_radiance(t):
    """Starts flat, so that the steady state is also the discrete start's."""
    return np.log(LEVEL * (1 + CONTRAST * np.sin(RATE * t) ** 2))


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
    _, derivatives = right_hand_side(ORDERS[name])

    def f(t, x):
        u = log_radiance(t)
        return np.stack(derivatives(tuple(x), u, np.exp(u)))

    # DOP853's interpolant between its steps is coarser than the steps themselves
    options = {"rtol": 1e-9, "max_step": 5e-4} if method == "DOP853" else {"rtol": 1e-8}
    got = solve_ivp(f, (0, END), x0, method=method, t_eval=GRID, atol=1e-10, **options).y.T
    assert np.abs((got - fine[name]) / scale(name)).max() < 3e-8


def test_absent_stages_are_left_out_and_steady_state_is_one():
    for dynamics, order in zip(ORDERS.values(), (4, 2, 3, 5, 5, 6, 2, 2), strict=True):
        states, derivatives = right_hand_side(dynamics)
        assert states == order
        slope = derivatives(tuple(steady_state(dynamics, 1.7)), 1.7, np.exp(1.7))
        np.testing.assert_array_equal(slope, np.zeros(order))
