"""The fast step wherever poles lie, against the first-order hold of the model that has only its stages."""

import numpy as np
import pytest
from oracles.first_order_hold import first_order_hold

from pixelid.dynamics import kernels
from pixelid.dynamics.continuous import present_states
from pixelid.dynamics.trajectory import STAGES, Dynamics, integrate

PIXEL = Dynamics(61283.0, 1848.0, 1.12, follower=19616.0, differencing=100531.0)


def step_error(dynamics, dt, rng):
    """Largest difference of one step of the kernel and of the hold from a random state; slopes in units of ωn."""
    hold = first_order_hold(dynamics, 1.0, dt)
    u0, u1 = rng.uniform(-1, 1, 2)
    x = rng.uniform(-1, 1, len(hold.names))
    wn = np.sqrt(dynamics.alpha) if "photoreceptor_slope" in hold.names else 1.0
    unit = np.array([wn if name == "photoreceptor_slope" else 1.0 for name in hold.names])
    x *= unit
    state = dict(zip(hold.names, x, strict=True))
    y = state.get("photoreceptor", u0)
    s = state.get("source_follower", y)
    e = state.get("extra_pole", s)
    z = state.get("lower_cutoff", 0.0)
    full = (state.get("photoreceptor_slope", 0.0), y, s, e, z, state.get("differencing", e - z))
    cutoffs = dynamics.uniform()[3:7]
    coincide = kernels.cutoffs_coincide(*cutoffs)
    a, b2 = dynamics.alpha, dynamics.beta + dynamics.gamma
    got = kernels.advance(full, u0, (u1 - u0) / dt, dt, a, b2, *cutoffs, coincide)
    got = np.array([got[STAGES.index(name)] for name in hold.names])
    return np.abs((got - hold.A @ x - hold.B * u0 - hold.B_next * u1) / unit).max()


@pytest.mark.parametrize("structure", ["second_order", "low_light", "unlimited"])
def test_coincident_poles_and_absent_stages(structure):
    """Every structure, against the hold of the model that has only its stages; poles apart, close and equal."""
    rng = np.random.default_rng(4)
    gaps = (0, 1e-15, 1e-11, 1e-7, 1e-5, -1e-5, 1e-3, -1e-3, 1.5e-3, 2.5e-3, 1e-2, 3e-2)
    for _ in range(1500):
        w = 10 ** rng.uniform(1, 5)

        def pole(w=w):
            return w * (1 + rng.choice(gaps)) if rng.random() < 0.5 else w * 10 ** rng.uniform(-2, 2)

        stages = ("follower", "extra_pole", "lower_cutoff", "differencing")
        cutoffs = {name: pole() for name in stages if rng.random() < 0.6}
        l1, l2 = pole(), pole()
        if structure == "second_order":
            real = rng.random() < 0.7
            alpha, beta = (l1 * l2, l1 + l2) if real else (w * w, 2 * w * 10 ** rng.uniform(-3, 0))
            dynamics = Dynamics(alpha, beta, 0.0, **cutoffs)
        elif structure == "low_light":
            dynamics = Dynamics.low_light(l1, **cutoffs)
        else:
            dynamics = Dynamics.unlimited(**cutoffs)
        if present_states(dynamics):
            assert step_error(dynamics, 10 ** rng.uniform(-9, 6) / w, rng) < 1e-9, dynamics


def test_scan_through_coincidences():
    """A whole trajectory hardly notices poles that meet while the light changes: equal cutoffs, nearly equal ones."""
    t = np.linspace(0, 0.02, 2001)
    radiance = np.exp(np.linspace(0, 9, 2001))  # the fast pole sweeps through both cutoffs
    equal, apart = (
        integrate(t, radiance, PIXEL._replace(differencing=19616.0 * (1 + gap))).states[:, 1:] for gap in (0.0, 1e-9)
    )
    assert np.abs(equal - apart).max() < 1e-8
    assert np.isfinite(equal).all()
