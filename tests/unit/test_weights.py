"""The weighted form against 40-digit numbers, the scan, and its own definition."""

import mpmath as mp
import numpy as np
import pytest
from oracles.exact_hold import exact_hold
from oracles.output_weights import output_weights

from pixelid.dynamics.trajectory import Dynamics, integrate

NOMINAL = Dynamics(61283.0, 1848.0, 1.12, follower=19616.0, differencing=100531.0)


def batch(samples, pixels, seed=0, longest=1e-3):
    rng = np.random.default_rng(seed)
    dt = rng.exponential(longest, (samples - 1, pixels))
    return dt, np.exp(rng.normal(3.0, 1.0, (samples, pixels)))


@pytest.mark.parametrize("case", range(4))
@pytest.mark.parametrize(("column", "output"), [(0, "source_follower"), (1, "differencing")])
def test_against_the_oracle(shared, case, column, output):
    data = np.load(shared / "oracle" / "foh_weights.npz")
    amp, loop, tau_out, q_in, q_mil, follower, differencing = data[f"case{case}/params"]
    q = q_in + q_mil
    dynamics = Dynamics(
        (loop + 1) / (q * tau_out),
        (q_in + (amp + 1) * q_mil) / (q * tau_out),
        1 / q,
        follower=2 * np.pi * follower,
        differencing=2 * np.pi * differencing,
    )
    dt, radiance = data[f"case{case}/dt_s"], data[f"case{case}/radiance"]
    expected = data[f"case{case}/weights_sf_diff"][..., column]
    raw = output_weights(dt, radiance, dynamics, output=output, past="dropped")
    np.testing.assert_allclose(raw, expected, rtol=1e-8, atol=0)  # weights down to 1e-107 among them
    normalised = output_weights(dt, radiance, dynamics, output=output)
    np.testing.assert_allclose(normalised, expected / expected.sum(axis=0), rtol=1e-8, atol=0)


@pytest.mark.parametrize("stages", [{}, {"extra_pole": 19616.0}, {"lower_cutoff": 3.0}])
def test_weights_at_fifty_digits(stages):
    """Also where ωsf equals another pole, and for weights far below one."""
    dt, radiance = batch(12, 1, seed=3, longest=1e-2)
    dynamics = NOMINAL._replace(**stages)
    weights = output_weights(dt, radiance, dynamics, past="dropped")[:, 0]
    with mp.workdps(50):
        expected = [mp.mpf(0)] * 12
        row = None
        for k in range(10, -1, -1):
            (a, b, b_next), _ = exact_hold(dynamics, radiance[k + 1, 0], dt[k, 0])
            if row is None:
                row = mp.matrix([[0] * (len(b) - 1) + [1]])
            expected[k + 1] += sum(row[i] * b_next[i] for i in range(len(b)))
            expected[k] += sum(row[i] * b[i] for i in range(len(b)))
            row = row * a
    if "lower_cutoff" not in stages:
        assert min(expected) < 1e-20
    for ours, exact in zip(weights, expected, strict=True):
        assert abs(ours - exact) <= 1e-11 * abs(exact)


@pytest.mark.parametrize("linearisation", ["newer", "midpoint"])
@pytest.mark.parametrize("output", ["photoreceptor", "source_follower", "extra_pole", "differencing"])
@pytest.mark.parametrize(
    "dynamics",
    [
        NOMINAL,
        NOMINAL._replace(extra_pole=6e3, lower_cutoff=40.0),
        NOMINAL._replace(differencing=1e35, lower_cutoff=40.0),
        Dynamics.low_light(33.0, follower=2e4, differencing=2e4),
        Dynamics.unlimited(lower_cutoff=40.0),
        Dynamics.unlimited(),
    ],
)
def test_steady_past_is_the_scan(dynamics, output, linearisation):
    dt, radiance = batch(9, 3, longest=3e-4)
    dt[4] = 0.0  # a jump
    weights = output_weights(dt, radiance, dynamics, output=output, linearisation=linearisation, past="steady")
    t = np.vstack([np.zeros(3), np.cumsum(dt, axis=0)])
    for i in range(3):
        scan = integrate(t[:, i], radiance[:, i], dynamics, linearisation=linearisation)
        expected = scan.stage(output)[-1]
        if output == "differencing" and dynamics.differencing > 1e29:
            expected = scan.stage("extra_pole")[-1] - scan.stage("lower_cutoff")[-1]
        assert weights[:, i] @ np.log(radiance[:, i]) == pytest.approx(expected, abs=1e-10)
    high_passed = output == "differencing" and dynamics.lower_cutoff > 0
    np.testing.assert_allclose(weights.sum(axis=0), 0.0 if high_passed else 1.0, atol=1e-12)
