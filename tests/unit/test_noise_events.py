"""Rates of noise events: against brute simulation, scaling laws, and limits with closed forms."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from pixelid.errors import InputError
from pixelid.model.shipped import find_model
from pixelid.tables.noise.chain import Crossings, chain_of
from pixelid.tables.noise.crossings import add_at_lag, add_sums, exp_of_minus, means_after_crossing
from pixelid.tables.noise.first_passage import mean_rates, noise_rates, rates_of, typical_rates, typical_thresholds
from pixelid.tables.noise.intervals import noise_intervals
from pixelid.tables.noise.process import LAST_LAG, noise_process
from pixelid.tables.noise.quadrature import ROUGH, WHOLE, hermite, rayleigh_nodes
from tests.oracles.noise_events import simulate_noise_events, stages

DENSITY = 3.2e-4  # fA/Hz: 2q


def circuit(**changes):
    return find_model("dvs128").circuit().with_(shot_density=DENSITY, noise=0.0, mismatch=0.0, **changes)


def thresholds(c, radiance, on, off):
    """The circuit with thresholds in standard deviations of its noise."""
    sigma = noise_process(c, radiance).sigma
    return c.with_(on_threshold=on * sigma, off_threshold=off * sigma)


def simulated(c, radiance, events, seed=0):
    """(ON rate, OFF rate, relative standard error of their sum) by brute force."""
    rates = noise_rates(c, radiance)
    t, p, duration = simulate_noise_events(
        c.alpha * radiance, c.beta + c.gamma * radiance, c.follower, c.differencing, DENSITY / radiance,
        c.on_threshold, c.off_threshold, dead_s=c.refractory, duration_s=events / (rates.on_hz + rates.off_hz),
        leak=c.leak_hz * c.on_threshold, threshold_noise=c.noise, seed=seed,
    )  # fmt: skip
    blocks = np.histogram(t, 40, (0.0, duration))[0]
    return (p == 1).sum() / duration, (p == 0).sum() / duration, blocks.std(ddof=1) / math.sqrt(40) / blocks.mean()


def test_covariance_is_the_oracle_s():
    c = circuit()
    A, P = stages(c.alpha * 24.0, c.beta + c.gamma * 24.0, c.follower, c.differencing, DENSITY / 24.0)
    process = noise_process(c, 24.0)
    assert pytest.approx(A) == process.A
    assert pytest.approx(P, rel=1e-9, abs=1e-15) == process.P
    late = process.propagators[-1]
    assert np.abs(late).max() < 10.0 * math.exp(-LAST_LAG)


def test_exponential_of_multiplications():
    x = np.linspace(0.0, 50.0, 20001)
    assert np.array([exp_of_minus.py_func(v) for v in x]) == pytest.approx(np.exp(-x), rel=1e-10)


def test_sums_over_lags_are_those_of_single_lags():
    """Hidden states as in bright light, where there are two."""
    p = noise_process(circuit(), 2000.0)
    at = Crossings.of(p, WHOLE)
    n, lags = at.hidden.moments - 1, len(at.weights)
    assert n == 2
    before, mean, after = np.array([0.7, -0.4]), np.empty((2, lags)), np.empty((n, lags))
    means_after_crossing(at.means, at.hidden.arrays, 0.9 * p.sigma, at.slopes[1], mean, after)
    levels, size = (1.1 * p.sigma, -1.3 * p.sigma), 2 * len(at.slopes) * (n + 1)
    summed, one_by_one = np.zeros((n + 1, size)), np.zeros((n + 1, size))
    rest = (mean, at.laws, at.hidden.arrays, before, after)
    for k, sign in enumerate((1.0, -1.0)):
        part = summed[:, k * size // 2 : (k + 1) * size // 2]
        add_sums(part, at.weights, *rest, levels[k], sign, at.slopes, at.factors)
    for t in range(lags):
        add_at_lag(one_by_one, at.weights[t], t, *rest, levels, at.slopes, at.factors)
    assert (summed != 0.0).any(axis=0).all()
    assert summed == pytest.approx(one_by_one, rel=1e-9, abs=1e-12 * np.abs(summed).max())


def test_variance_of_a_second_order_photoreceptor():
    """Behind stages without poles of their own the variance is S ωn² / 4 (2ζωn), S one-sided."""
    c = circuit(follower=1e9, differencing=1e10)
    a, b2 = c.alpha * 24.0, c.beta + c.gamma * 24.0
    assert noise_process(c, 24.0).sigma ** 2 == pytest.approx(DENSITY / 24.0 * a / (4 * b2), rel=1e-3)


def test_slopes_of_crossings():
    nodes, weights = rayleigh_nodes(4)
    for power, moment in ((0, 1.0), (1, math.sqrt(math.pi / 2)), (2, 2.0), (6, 48.0)):
        assert weights @ nodes**power == pytest.approx(moment, rel=1e-10)


@pytest.mark.parametrize(
    ("radiance", "on", "off", "dead_s", "leak_hz"),
    [
        (24.0, 2.5, 3.0, 1e-3, 0.0),
        (2000.0, 2.4, 2.8, 3e-4, 0.0),
        (24.0, 2.6, 2.2, 2e-2, 0.0),
        (24.0, 2.8, 3.0, 1e-3, 2.0),
    ],
)
def test_rates_are_those_of_brute_simulation(radiance, on, off, dead_s, leak_hz):
    c = thresholds(circuit(refractory=dead_s, leak_hz=leak_hz), radiance, on, off)
    rates = noise_rates(c, radiance)
    seen_on, seen_off, error = simulated(c, radiance, 6000)
    assert rates.on_hz == pytest.approx(seen_on, rel=0.02 + 3.5 * error)
    assert rates.off_hz == pytest.approx(seen_off, rel=0.02 + 3.5 * error)


def test_rates_where_on_and_off_events_undo_each_other():
    """Equal thresholds and a short dead time: a crossing depends on what the stages remember of the one before."""
    c = thresholds(circuit(refractory=1e-4), 500.0, 3.0, 3.0)
    seen_on, seen_off, error = simulated(c, 500.0, 100_000)
    rates = noise_rates(c, 500.0)
    assert rates.on_hz == pytest.approx(rates.off_hz, rel=1e-6)
    assert rates.on_hz + rates.off_hz == pytest.approx(seen_on + seen_off, rel=0.01 + 3.0 * error)


@pytest.mark.parametrize("leak_hz", [0.0, 3.0])
def test_intervals_are_those_of_brute_simulation(leak_hz):
    """Shares of ON–ON, ON–OFF, … intervals within edges over four decades."""
    c = thresholds(circuit(refractory=1e-3, leak_hz=leak_hz), 24.0, 2.6, 2.9)
    t, p, _ = simulate_noise_events(
        c.alpha * 24.0, c.beta + c.gamma * 24.0, c.follower, c.differencing, DENSITY / 24.0, c.on_threshold,
        c.off_threshold, dead_s=1e-3, duration_s=300.0, leak=leak_hz * c.on_threshold, seed=8,
    )  # fmt: skip
    edges = np.array([2e-3, 3e-3, 5e-3, 0.01, 0.03, 0.1, 0.3])
    found = noise_intervals(c, 24.0)
    predicted = found.within(edges)
    waits, events = np.diff(t), len(t) - 1
    for i, before in enumerate((1, 0)):
        for j, after in enumerate((1, 0)):
            chosen = waits[(p[:-1] == before) & (p[1:] == after)]
            seen = np.searchsorted(np.sort(chosen), edges) / events
            error = np.sqrt(seen * (1 - seen) / events) * 1.5  # intervals come in bursts
            assert predicted[i, j] == pytest.approx(seen, abs=3.5 * error.max() + 0.01)
    assert found.passed[:, :, -1].sum() == pytest.approx(1.0, abs=0.01)


def test_intervals_and_rates_agree():
    c = thresholds(circuit(refractory=1e-3), 24.0, 3.0, 3.3)
    found, rates = noise_intervals(c, 24.0), noise_rates(c, 24.0)
    total = found.passed.sum((0, 1))
    mean = np.sum(np.diff(total) * np.sqrt(found.time_s[1:] * found.time_s[:-1])) / total[-1]
    assert mean == pytest.approx(rates.wait_s, rel=0.02)
    ended_on = found.passed[:, 0, -1].sum() / total[-1]
    assert ended_on == pytest.approx(rates.on_hz / (rates.on_hz + rates.off_hz), abs=0.005)


def test_threshold_noise_is_that_of_brute_simulation():
    c = thresholds(circuit(refractory=1e-3), 24.0, 2.8, 2.8).with_(noise=0.08)
    seen_on, seen_off, error = simulated(c, 24.0, 6000)
    rates = noise_rates(c, 24.0)
    assert rates.on_hz + rates.off_hz == pytest.approx(seen_on + seen_off, rel=0.02 + 3.5 * error)
    quiet = noise_rates(c.with_(noise=0.0), 24.0)
    assert quiet.on_hz != pytest.approx(rates.on_hz, rel=0.01)


@pytest.mark.parametrize(("threshold_sd", "dead_s"), [(3.0, 1e-3), (4.0, 1e-4), (3.2, 1e-5)])
def test_the_law_of_events_is_the_one_that_the_chain_leaves_unchanged(threshold_sd, dead_s):
    """Where events forget those before at once, and where an ON and an OFF event undo each other for long."""
    c = thresholds(circuit(refractory=dead_s), 24.0, threshold_sd, threshold_sd)
    chain = chain_of(noise_process(c, 24.0), c, 0.0)
    law, shares = chain.share, chain.share[:: chain.resets.at.hidden.moments]
    np.testing.assert_allclose(chain.moved.T @ law, law, rtol=0, atol=1e-11 * np.abs(law).max())
    assert shares.sum() == pytest.approx(1.0, rel=1e-12)


def test_thresholds_and_noise_have_one_scale():
    c = thresholds(circuit(), 24.0, 3.0, 3.4)
    twice = c.with_(on_threshold=2 * c.on_threshold, off_threshold=2 * c.off_threshold, shot_density=4 * c.shot_density)
    assert noise_rates(twice, 24.0).on_hz == pytest.approx(noise_rates(c, 24.0).on_hz, rel=1e-6)
    floor = c.with_(shot_density=0.5 * c.shot_density)
    assert noise_rates(floor, 24.0, 0.5 * DENSITY / 24.0).off_hz == pytest.approx(noise_rates(c, 24.0).off_hz, rel=1e-6)


def test_polarities_are_alike_without_leak():
    c = thresholds(circuit(), 24.0, 3.0, 3.6)
    other = c.with_(on_threshold=c.off_threshold, off_threshold=c.on_threshold)
    one, two = noise_rates(c, 24.0), noise_rates(other, 24.0)
    assert one.on_hz == pytest.approx(two.off_hz, rel=1e-6)
    assert one.off_hz == pytest.approx(two.on_hz, rel=1e-6)


def test_references_move_as_far_up_as_down():
    """Stored references are bounded, so with a dead time far below the noise's own times N_on C_on = N_off C_off."""
    c = thresholds(circuit(refractory=1e-7), 2.0, 2.5, 3.0)
    rates = noise_rates(c, 2.0)
    assert rates.on_hz / rates.off_hz == pytest.approx(3.0 / 2.5, rel=0.03)


@pytest.mark.parametrize("thresholds_sd", [9.5, 12.0, 20.0])
def test_leak_under_noise_is_that_of_brute_simulation_however_far_the_thresholds(thresholds_sd):
    """Leak brings the reference near, and noise does the rest: events come earlier than by leak alone."""
    c = thresholds(circuit(refractory=1e-3, leak_hz=1.0), 200.0, thresholds_sd, thresholds_sd)
    on, off, _ = simulated(c, 200.0, 400, seed=3)
    rates = noise_rates(c, 200.0)
    assert rates.on_hz == pytest.approx(on, rel=0.06)  # events are regular: ± 1.5 %
    assert rates.off_hz == off == 0.0
    assert rates.on_hz > 1.1


def test_rates_by_leak_do_not_jump_where_thresholds_get_out_of_reach():
    here, there = (
        noise_rates(thresholds(circuit(refractory=1e-3, leak_hz=0.3), 200.0, far, far), 200.0).on_hz
        for far in (8.99, 9.01)
    )
    assert here == pytest.approx(there, rel=5e-3)


def test_leak_alone_is_regular():
    """With next to no noise; that crosses a level some ms late, where a reference passes it faster than noise does."""
    c = circuit(leak_hz=0.3, refractory=1e-3, on_threshold=2.0, off_threshold=2.0)
    regular = 1.0 / (1 / 0.3 + 1e-3)
    whole, least = (noise_rates(c.with_(shot_density=DENSITY * by), 5000.0) for by in (1.0, 1e-8))
    assert whole.on_hz > 1.01 * regular
    assert least.on_hz == pytest.approx(regular, rel=2e-3)
    assert least.off_hz == 0.0
    near = thresholds(circuit(leak_hz=0.3, refractory=1e-4), 24.0, 8.0, 8.0)  # noise that only rounds the corner
    assert noise_rates(near, 24.0).on_hz == pytest.approx(0.3, rel=0.02)


@pytest.mark.parametrize(
    ("dead_s", "noise", "within"), [pytest.param(1e-3, 0.0, 0.01, marks=pytest.mark.slow), (1e-4, 0.04, 0.03)]
)
def test_mismatch_raises_the_mean_rate(dead_s, noise, within):
    """Against the plain average over a fine grid of thresholds."""
    c = thresholds(circuit(refractory=dead_s), 24.0, 3.2, 3.3).with_(mismatch=0.03, noise=noise)
    process = noise_process(c, 24.0)
    x = 0.6 * (np.arange(10) - 4.5)
    weights = np.exp(-0.5 * x**2) / np.exp(-0.5 * x**2).sum()
    mean = 0.0
    for a, wa in zip(1 + 0.03 * x, weights, strict=True):
        for b, wb in zip(1 + 0.03 * x, weights, strict=True):
            pixel = c.with_(on_threshold=c.on_threshold * a, off_threshold=c.off_threshold * b)
            mean += wa * wb * rates_of(process, pixel, 24.0).on_hz
    assert mean_rates(c, 24.0)[0] == pytest.approx(mean, rel=within)


@pytest.mark.parametrize(("mismatch", "apart"), [pytest.param(0.03, 1.0, marks=pytest.mark.slow), (0.06, 0.99)])
def test_mean_rates_have_no_waves_where_few_pixels_have_equal_thresholds(mismatch, apart):
    """That maximum is narrower than the 3.4 % that nodes of the difference were once apart: rates 25 % too low."""
    c = thresholds(circuit(refractory=1e-4), 50.0, 4.2 * apart, 4.2).with_(mismatch=mismatch, noise=0.04)
    process, resolution = noise_process(c, 50.0), replace(ROUGH, pixels=WHOLE.pixels)
    across, mean = np.linspace(-3.5, 3.5, 57), 0.0
    across_weights = np.exp(-0.5 * across**2) / np.exp(-0.5 * across**2).sum()
    for s, along_weight in zip(*hermite(5), strict=True):
        for d, weight in zip(across, across_weights, strict=True):
            on, off = (1.0 + mismatch * (s + sign * d) / math.sqrt(2.0) for sign in (1, -1))
            pixel = c.with_(on_threshold=c.on_threshold * on, off_threshold=c.off_threshold * off)
            mean += along_weight * weight * rates_of(process, pixel, 50.0, resolution).on_hz
    assert mean_rates(c, 50.0, resolution=resolution)[0] == pytest.approx(mean, rel=0.015)


@pytest.mark.parametrize("changed", [("alpha",), ("on_threshold", "off_threshold")])
def test_a_typical_pixel_changes_as_the_mean_of_pixels_does(changed):
    """Slopes of its ln rates are those of ln mean rates; those of the average pixel are some per cent too steep."""
    c = thresholds(circuit(refractory=1e-3), 24.0, 3.6, 5.0).with_(mismatch=0.03)
    fine = replace(ROUGH, pixels=0.25)
    typical = typical_thresholds(c, 24.0, resolution=fine)

    def slope(on_rate):
        up, down = (
            on_rate(c.with_(**{name: math.exp(step) * getattr(c, name) for name in changed})) for step in (0.05, -0.05)
        )
        return math.log(up / down) / 0.1

    mean = slope(lambda c: mean_rates(c, 24.0, resolution=fine)[0])
    of_typical = slope(lambda c: typical_rates(c, 24.0, typical, resolution=fine)[0])
    of_average = slope(lambda c: typical_rates(c, 24.0, np.ones((2, 2)), resolution=fine)[0])
    assert of_typical == pytest.approx(mean, rel=0.005)
    assert abs(of_average - mean) > 3.0 * abs(of_typical - mean)


def test_equal_thresholds_resonate():
    """With a short dead time ON and OFF events of equal thresholds undo each other: a narrow maximum of the rate."""
    c = circuit(refractory=1e-4)
    equal = thresholds(c, 24.0, 3.2, 3.2)
    t, _, duration = simulate_noise_events(
        c.alpha * 24.0, c.beta + c.gamma * 24.0, c.follower, c.differencing, DENSITY / 24.0, equal.on_threshold,
        equal.off_threshold, dead_s=1e-4, duration_s=150.0, seed=2,
    )  # fmt: skip
    rates, apart = noise_rates(equal, 24.0), noise_rates(thresholds(c, 24.0, 3.2, 3.33), 24.0)
    blocks = np.histogram(t, 20, (0.0, duration))[0]
    error = blocks.std(ddof=1) / math.sqrt(20) / blocks.mean()
    assert rates.on_hz + rates.off_hz == pytest.approx(len(t) / duration, rel=0.08 + 3 * error)
    assert rates.on_hz > 2 * apart.on_hz


def test_rates_too_small_for_numbers_are_not_negative():
    """With threshold noise of 23 % only the farthest draw waits, for 10¹¹⁰ s, and rounding takes its sign."""
    circuit = find_model("gen31").with_effect("shot_noise", {"density": 1e-8}).circuit().with_(mismatch=0.0)
    for light in (0.00196, 0.011):
        assert min(mean_rates(circuit, light)) >= 0


def test_what_cannot_be_followed_is_refused():
    with pytest.raises(InputError, match="lower_cutoff"):
        noise_rates(circuit(lower_cutoff=1.0), 24.0)
    with pytest.raises(InputError, match="slew_limit"):
        noise_rates(circuit(slew_rise=3000.0), 24.0)
    with pytest.raises(InputError, match="shot_noise"):
        noise_rates(circuit().with_(shot_density=0.0), 24.0)
    with pytest.raises(InputError, match="three poles"):
        noise_rates(circuit(photoreceptor="one_pole", corner=30.0, differencing=math.inf), 24.0)
