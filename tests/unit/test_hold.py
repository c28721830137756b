"""Divided differences and the first-order hold, against mpmath at 50 digits."""

import mpmath as mp
import numpy as np
import pytest
from oracles.exact_hold import exact_hold
from oracles.first_order_hold import first_order_hold

from pixelid.dynamics.continuous import present_states
from pixelid.dynamics.trajectory import Dynamics
from pixelid.lowlight.response import exp_divided_difference

GAPS = (0.0, 1e-15, 1e-13, 1e-11, 1e-9, 1e-7, 1e-5, 1e-3, 1e-2)
UNDERFLOW = 1e-290


def exact_difference(nodes):
    """By the definition, nodes parted by 1e-58 k, at a precision that leaves 50 digits of it."""
    with mp.workdps(60 * len(nodes) + 60):
        z = [mp.mpc(complex(node)) + mp.mpf(10) ** -58 * k for k, node in enumerate(nodes)]
        f = [mp.exp(node) for node in z]
        for m in range(1, len(z)):
            f = [(f[i + 1] - f[i]) / (z[i + m] - z[i]) for i in range(len(z) - m)]
        return f[0]


def close_nodes(rng, n, widest):
    z = -(10 ** rng.uniform(-9, widest, n))
    z[rng.random(n) < 0.25] = 0
    near = rng.random(n) < 0.4
    z[near] = z[0] * (1 + rng.choice(GAPS, near.sum()))
    return z


def test_divided_differences_of_real_nodes():
    rng = np.random.default_rng(0)
    for trial in range(400):
        nodes = close_nodes(rng, rng.integers(1, 9), (6, 2, 0.5)[trial % 3])
        exact = exact_difference(nodes)
        assert abs(exp_divided_difference(nodes) - exact) <= 1e-13 * abs(exact) + UNDERFLOW


def test_divided_differences_of_conjugate_nodes():
    rng = np.random.default_rng(1)
    for _ in range(300):
        nodes = close_nodes(rng, rng.integers(2, 9), 3).astype(complex)
        nodes[0] = complex(nodes[0].real, 10 ** rng.uniform(-3, 3))
        nodes[1] = nodes[0].conjugate()
        exact = exact_difference(nodes)
        envelope = abs(exact) + abs(exact_difference(nodes[1:])) / max(1, abs(nodes[0].imag))
        assert abs(exp_divided_difference(nodes) - exact) <= 1e-13 * envelope + UNDERFLOW


def test_divided_differences_refuse_other_shapes():
    with pytest.raises(ValueError, match="shape"):
        exp_divided_difference(np.zeros((2, 2)))


def check(dynamics, dt, oscillates):
    """Relative error ≤ 1e-10 of each coefficient.

    Coefficients that change sign (slope rows, what passed the high-pass; all of them when the poles are complex)
    are compared relative to |x| + |dx/d ln dt| / (1 + ωn dt), which is of the size of their envelope.
    """
    hold = first_order_hold(dynamics, 1.0, dt)
    exact, derivative = exact_hold(dynamics, 1.0, dt)
    cycles = np.sqrt(dynamics.alpha) * dt if "photoreceptor_slope" in hold.names else 0.0
    last = len(hold.names) - 1
    for i, name in enumerate(hold.names):
        signed = oscillates or name == "photoreceptor_slope" or ("lower_cutoff" in hold.names and i == last)
        for j in range(last + 3):
            x, dx, ours = (
                (exact[0][i, j], derivative[0][i, j], hold.A[i, j])
                if j <= last
                else (exact[j - last][i], derivative[j - last][i], (hold.B, hold.B_next)[j - last - 1][i])
            )
            scale = abs(x) + (abs(dx) / (1 + cycles) if signed else 0)
            assert abs(ours - x) <= 1e-10 * scale + UNDERFLOW, (dynamics, dt, name, j)


@pytest.mark.parametrize("gap", GAPS)
@pytest.mark.parametrize("step", [1e-9, 1e-3, 1.0, 30.0, 1e6])
def test_coincident_poles(gap, step):
    """ω Δt = step; each pair of poles in turn, all three, all four."""
    w = 1e4 if step < 1e4 else 1e5
    for l1, l2, follower, differencing in (
        (1, 1 + gap, 3, 7),  # near critical damping
        (1, 5, 1 + gap, 0.2),
        (1, 5, 0.3, 5 * (1 - gap)),
        (1, 5, 2, 2 * (1 + gap)),
        (1, 1 + gap, 1 - 2 * gap, 9),
        (1, 3, 1 + gap, 1 - gap),
        (1, 1 + gap, 1 - 2 * gap, 1 + 3 * gap),
    ):
        l1, l2 = l1 * w, l2 * w
        dynamics = Dynamics(l1 * l2, l1 + l2, 0.0, follower * w, differencing=differencing * w)
        check(dynamics, step / w, oscillates=dynamics.beta**2 < 4 * dynamics.alpha)


@pytest.mark.parametrize("seed", range(6))
def test_all_structures_and_steps(seed):
    """Random structures, pole spreads of six decades, near-coincidences, steps of 1 µs to 10 s."""
    rng = np.random.default_rng(seed)
    for _ in range(25):
        w = 10 ** rng.uniform(1, 5)

        def pole(w=w):
            return w * (1 + rng.choice(GAPS)) if rng.random() < 0.4 else w * 10 ** rng.uniform(-3, 3)

        dt = float(np.clip(10 ** rng.uniform(-9, 6) / w, 1e-6, 10.0))
        stages = {name: pole() for name in ("follower", "extra_pole", "lower_cutoff") if rng.random() < 0.6}
        stages["differencing"] = pole()
        real = rng.random() < 0.5
        l1, l2 = pole(), pole()
        alpha, beta = (l1 * l2, l1 + l2) if real else (w * w, 2 * w * 10 ** rng.uniform(-4, 0))
        front = rng.random()
        if front < 0.7:
            check(Dynamics(alpha, beta, 0.0, **stages), dt, oscillates=beta**2 < 4 * alpha)
        elif front < 0.9:
            check(Dynamics.low_light(l1, **stages), dt, oscillates=False)
        else:
            check(Dynamics.unlimited(**stages), dt, oscillates=False)


def test_photoreceptor_alone_and_names():
    dynamics = Dynamics(6e4, 1.8e3, 1.1)
    assert present_states(dynamics) == ("photoreceptor_slope", "photoreceptor")
    check(dynamics, 1e-3, oscillates=False)
    assert present_states(Dynamics.low_light(30.0, lower_cutoff=0.1, differencing=1e5)) == (
        "photoreceptor",
        "lower_cutoff",
        "differencing",
    )
