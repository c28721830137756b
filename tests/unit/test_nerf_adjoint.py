"""The hand-written gradient of a step against matrix exponentials."""

import numpy as np
import pytest
from scipy.linalg import expm

from pixelid.nerf.pixel import scan_adjoint

TINY = 1e-30


def by_exponentials(values, tau, row):
    """The gradient of row · the state after, by each of (v, y, s, d, u0, u1, a, b2, ω1, ωd): the augmented system's
    matrix exponential, differentiated by complex steps."""
    unit = np.sqrt(values[6])  # of v

    def after(v, y, s, d, u0, u1, a, b2, w1, wd):
        system = np.zeros((6, 6), complex)  # of (v/unit, y, s, d, u, u1 − u0)
        system[0, [0, 1, 4]] = -b2, -a / unit, a / unit
        system[1, 0] = unit
        system[2, [1, 2]] = w1, -w1
        system[3, [2, 3]] = wd, -wd
        system[4, 5] = 1.0 / tau
        out = expm(system * tau) @ np.array([v / unit, y, s, d, u0, u1 - u0])
        return np.dot([row[0] * unit, *row[1:]], out[:4])

    gradient = []
    for j in range(len(values)):
        moved = [complex(value) for value in values]
        scale = abs(values[j]) if j > 5 else 1.0
        moved[j] += 1j * TINY * scale
        gradient.append(after(*moved).imag / (TINY * scale))
    return np.array(gradient)


def drawn(rng, damping):
    """(values, tau, row): poles of some hundred to some ten thousand rad/s, steps of all lengths."""
    wn = 10 ** rng.uniform(2.5, 4.5)
    a, b2 = wn**2, 2 * damping * wn
    w1, wd = 10 ** rng.uniform(2.5, 5, 2)
    values = [wn * rng.standard_normal(), *(5 + rng.standard_normal(5)), a, b2, w1, wd]
    return values, 10 ** rng.uniform(-6, -2), rng.standard_normal(4) * [1 / wn, 1, 1, 1]


@pytest.mark.parametrize("damping", [0.05, 0.7, 0.999, 1.0, 1.001, 3.0, 100.0])
def test_gradient_of_a_step(damping):
    """To the accuracy that `kernels.COINCIDENCE` leaves the closed form, and far better where no poles are close."""
    rng = np.random.default_rng(round(1000 * damping))
    errors = []
    for _ in range(150):
        values, tau, row = drawn(rng, damping)
        v, y, s, d, u0, u1, a, b2, w1, wd = values
        r = (u1 - u0) / tau
        if not scan_adjoint.accurate(r, tau, a, b2, w1, wd):
            continue
        state, older, newer, *by_rates = scan_adjoint.step_back((v, y, s, d), u0, r, tau, a, b2, w1, wd, tuple(row))
        expected = by_exponentials(values, tau, row)
        scale = np.abs(values)  # by logs of the rates, by ω for the slope, so that all are of the output's size
        scale[1:6], scale[0] = 1.0, np.sqrt(a)
        apart = np.abs((np.array([*state, older, newer, *by_rates]) - expected) * scale)
        errors.append(apart.max() / np.abs(expected * scale).max())
    assert len(errors) > 100
    assert np.median(errors) < 1e-11
    assert max(errors) < 1e-8
