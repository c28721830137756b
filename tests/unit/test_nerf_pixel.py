"""The pixel inside the reconstruction: the same filter as everywhere else, with exact gradients."""

import math

import numpy as np
import pytest
import torch
from oracles.output_weights import output_weights

from pixelid.dynamics.trajectory import Dynamics, integrate
from pixelid.nerf.events.intervals import CHAIN, chains, intervals
from pixelid.nerf.pixel.scan import respond
from pixelid.nerf.training.losses import changes, terms

HARD = Dynamics(alpha=61287.0 * 20, beta=1851.0, gamma=1.1236 * 20, follower=19616.1, differencing=100531.0)
FULL = HARD._replace(extra_pole=5000.0, lower_cutoff=3.0)
FLOOR = HARD._replace(floor=0.4)
COMPLEX_AND_COINCIDENT = Dynamics(alpha=4e6, beta=2000.0, gamma=10.0, follower=1000.0, differencing=1000.0)


def tensor(dynamics: Dynamics) -> torch.Tensor:
    return torch.tensor(dynamics.uniform(), dtype=torch.float64)


def light(t):
    """Radiance 0.2 … 1.2 with several frequencies."""
    return 0.2 + 0.5 * (1 + 0.7 * np.sin(2 * np.pi * 90 * t) + 0.3 * np.sin(2 * np.pi * 310 * t + 1))


def runs(seed=0, lengths=(30, 1, 22)):
    """Times, log radiance and run starts of random samples, two of them simultaneous."""
    rng = np.random.default_rng(seed)
    first = np.concatenate([[0], np.cumsum(lengths)])
    t = np.concatenate([np.sort(rng.uniform(0, 0.03, n)) for n in lengths])
    u = np.log(light(t) * np.exp(0.3 * rng.normal(size=len(t))))
    t[5], u[5] = t[4], u[4]
    return t, u, first


@pytest.mark.parametrize("dynamics", [HARD, FULL, FLOOR], ids=["plain", "full", "floor"])
def test_importance_samples_equal_the_simulators_filter_in_the_dense_limit(dynamics):
    """S = 200 past inputs against the trajectory that events are simulated from: 1e-3 in ln L."""
    fine = np.linspace(0.0, 0.2, 40001)
    truth = integrate(fine, light(fine), dynamics)
    slowest = 33.1 * 20 * 0.2  # α L / β at the darkest light
    for output in (0.1, 0.1434, 0.19):
        t = output + np.log1p(-0.95 * np.arange(200)[::-1] / 199) / slowest
        u = torch.tensor(np.log(light(t)))
        level, changed = respond(u, tensor(dynamics), t, np.array([0, 200]))
        state = truth.at([output])[0]
        if dynamics.lower_cutoff == 0:
            assert float(level[-1]) == pytest.approx(state[3], abs=1e-3)
            assert float(changed[-1]) == pytest.approx(state[5], abs=1e-3)
        else:  # a cutoff of 0.5 Hz remembers longer than the samples reach: the same samples, both ways
            same = integrate(t, light(t), dynamics)
            assert float(changed[-1]) == pytest.approx(same.states[-1, 5], abs=1e-9)


def test_pixels_that_differ_are_scanned_each_with_its_own_numbers():
    t, u, first = runs()
    own = torch.stack([tensor(HARD), tensor(FLOOR), tensor(HARD._replace(follower=3000.0))])
    together, _ = respond(torch.tensor(u), own, t, first)
    for run in range(3):
        some = slice(first[run], first[run + 1])
        alone, _ = respond(torch.tensor(u[some]), own[run], t[some], np.array([0, len(t[some])]))
        torch.testing.assert_close(together[some], alone)


def test_the_scan_is_the_weighted_sum():
    t, u, _ = runs(lengths=(40,))
    weights = output_weights(
        np.diff(t)[:, None], np.exp(u)[:, None], HARD, linearisation="newer", past="steady"
    )  # fmt: skip
    _, output = respond(torch.tensor(u), tensor(HARD), t, np.array([0, 40]), midpoint=False)
    assert float(output[-1]) == pytest.approx(float(weights[:, 0] @ u), abs=1e-10)
    assert weights.sum() == pytest.approx(1.0)


def test_weights_and_response_against_independent_numbers(shared):
    """The oracle's normalised weights, linearised at the newer sample, without the steady past."""
    data = np.load(shared / "oracle" / "foh_weights.npz")
    A_amp, A_loop, tau_out, q_in, q_mil, f_sf, f_diff = data["case1/params"]
    q = q_in + q_mil
    dynamics = Dynamics(
        (A_loop + 1) / (q * tau_out), (q_in + (A_amp + 1) * q_mil) / (q * tau_out), 1 / q,
        follower=2 * math.pi * f_sf, differencing=2 * math.pi * f_diff,
    )  # fmt: skip
    radiance, dt, expected = data["case1/radiance"], data["case1/dt_s"], data["case1/weights_sf_diff"][..., 1]
    u = np.log(radiance)
    for pixel in range(radiance.shape[1]):
        t = np.concatenate([[0.0], np.cumsum(dt[:, pixel])])
        log_light = torch.tensor(u[:, pixel])
        _, output = respond(log_light, tensor(dynamics), t, np.array([0, len(t)]), midpoint=False)
        left = (1 - expected[:, pixel].sum()) * u[0, pixel]  # what the oracle leaves to the light before
        assert float(output[-1]) == pytest.approx(float(expected[:, pixel] @ u[:, pixel] + left), abs=1e-8)


@pytest.mark.parametrize("midpoint", [True, False])
@pytest.mark.parametrize(
    "dynamics", [HARD, FULL, COMPLEX_AND_COINCIDENT, FLOOR], ids=["plain", "full", "coincident", "floor"]
)
def test_gradients_are_those_of_finite_differences(dynamics, midpoint):
    t, u, first = runs()
    rng = np.random.default_rng(1)
    by_level, by_output = rng.normal(size=len(u)), rng.normal(size=len(u))

    def value(u, numbers):
        level, output = respond(torch.as_tensor(u), torch.as_tensor(numbers), t, first, midpoint=midpoint)
        return float(level.detach() @ torch.tensor(by_level) + output.detach() @ torch.tensor(by_output))

    x, numbers = torch.tensor(u, requires_grad=True), tensor(dynamics).requires_grad_()
    level, output = respond(x, numbers, t, first, midpoint=midpoint)
    (level @ torch.tensor(by_level) + output @ torch.tensor(by_output)).backward()
    assert x.grad is not None
    assert numbers.grad is not None
    for i in range(0, len(u), 7):
        up, down = u.copy(), u.copy()
        up[i] += 1e-5
        down[i] -= 1e-5
        slope = (value(up, numbers.detach()) - value(down, numbers.detach())) / 2e-5
        assert float(x.grad[i]) == pytest.approx(slope, rel=1e-3, abs=1e-5)
    for j in (0, 1, 2, 3, 6, *([7] if dynamics.floor else [])):
        up, down = numbers.detach().clone(), numbers.detach().clone()
        up[j] *= 1 + 1e-5
        down[j] *= 1 - 1e-5
        slope = (value(u, up) - value(u, down)) / 2e-5
        assert float(numbers.grad[j] * numbers.detach()[j]) == pytest.approx(slope, rel=1e-3, abs=1e-4)


@pytest.mark.parametrize("dynamics", [HARD, FULL, FLOOR], ids=["plain", "full", "floor"])
@pytest.mark.parametrize("apart", [False, True], ids=["alike", "pixels apart"])
def test_both_engines_agree(dynamics, apart):
    t, u, first = runs()
    factors = torch.ones(len(first) - 1, 8, dtype=torch.float64)
    if apart:
        factors[:, [0, 3, 6]] = torch.tensor(np.random.default_rng(2).uniform(0.5, 2, (len(first) - 1, 3)))
    passes = []
    for engine in ("compiled", "tensors"):
        x, nominal = torch.tensor(u, requires_grad=True), tensor(dynamics)
        numbers = (nominal * factors if apart else nominal).requires_grad_()
        level, output = respond(x, numbers, t, first, engine=engine)
        (level.sum() + (output**2).sum()).backward()
        assert x.grad is not None
        assert numbers.grad is not None
        passes.append((level.detach(), output.detach(), x.grad, numbers.grad[..., [0, 1, 2, 3, 6]]))
    for compiled, tensors in zip(*passes, strict=True):
        torch.testing.assert_close(compiled, tensors, rtol=1e-7, atol=1e-8)


@pytest.mark.parametrize("extra", [{}, {"extra_pole": 1000.0}, {"extra_pole": 1000.0, "lower_cutoff": 3.0}])
def test_both_engines_agree_where_cutoffs_coincide(extra):
    t, u, first = runs()
    passes = []
    for engine in ("compiled", "tensors"):
        x, numbers = torch.tensor(u, requires_grad=True), tensor(COMPLEX_AND_COINCIDENT._replace(**extra))
        level, output = respond(x, numbers.requires_grad_(), t, first, engine=engine)
        (level.sum() + (output**2).sum()).backward()
        assert x.grad is not None
        assert numbers.grad is not None
        slopes = (numbers.grad * numbers.detach())[[0, 1, 2, 3, 6]]
        passes.append((level.detach(), output.detach(), x.grad, slopes))
    for compiled, tensors in zip(*passes, strict=True):
        torch.testing.assert_close(compiled, tensors, rtol=1e-3, atol=1e-3)


def test_changes_reset_at_the_end_of_the_dead_time():
    """Events of an ideal comparator on the exact trajectory: every change is ± the threshold."""
    fine = np.linspace(0.0, 0.4, 80001)
    truth = integrate(fine, light(fine), HARD)
    dead, threshold = 4e-4, 0.15
    times, polarity, release = [], [], 0.0
    at_release = truth.at([0.0])[0]
    for k in range(len(fine)):
        if fine[k] <= release:
            continue
        moved = truth.states[k, 5] - at_release[3]
        moved -= (at_release[5] - at_release[3]) * math.exp(-HARD.differencing * (fine[k] - release))
        if abs(moved) >= threshold:
            times.append(fine[k])
            polarity.append(moved > 0)
            release = fine[k] + dead
            at_release = truth.at([release])[0]
    t, on = np.array(times), np.array(polarity)
    zero = np.zeros(len(t), int)
    spans = intervals(t, zero, zero, on, 1, dead=dead)
    assert len(spans.starts) == len(t) - 1
    batch = chains(spans, np.array([20]), 300, 130.0, np.random.default_rng(0))
    numbers, u = tensor(HARD), torch.tensor(np.log(light(batch.t)))
    level, output = respond(u, numbers, batch.t, batch.first)
    change = changes(level, output, batch, numbers[6])
    signed = threshold * torch.tensor(batch.rise - batch.fall)
    assert batch.weight.sum() == CHAIN
    assert float((change - signed).abs().max()) < 0.02 * threshold
    parts = terms(change, level, batch, torch.tensor(threshold), torch.tensor(threshold))
    assert float(parts["diff"]) < 1e-4
    assert float(parts["chain"]) < 1e-3


def test_what_every_second_stretch_says_of_silence_stands_for_all():
    """ℓ_tv of light that rises evenly: the parts asked, a third of their stretch long on average, times its slope."""
    rng = np.random.default_rng(2)
    t = np.arange(1.0, 4001.0)
    x = rng.integers(0, 4, len(t))
    spans = intervals(t, x, np.zeros(len(t), int), rng.random(len(t)) < 0.5, 4)
    batch = chains(spans, np.arange(0, len(spans.starts), 3), 1, 1.0, rng)
    level = torch.tensor(0.1 * batch.t)
    tv = float(terms(torch.zeros(batch.weight.shape), level, batch, *[torch.tensor(0.5)] * 2)["tv"])
    lengths = (batch.t[batch.end] - batch.t[batch.begin])[batch.weight > 0]
    assert tv == pytest.approx(0.1 * lengths.mean() / 3 / 0.5, rel=0.03)


@pytest.mark.parametrize(("shortest", "samples"), [(0.0, 30), (4e-3, 30), (4e-3, 1)])
def test_chains_are_sorted_padded_and_within_one_pixel(shortest, samples):
    rng = np.random.default_rng(3)
    t = np.sort(rng.uniform(0, 1, 400))
    x = rng.integers(0, 3, 400)
    spans = intervals(t, x, np.zeros(400, int), rng.random(400) < 0.5, 3, dead=1e-3, shortest=shortest)
    starts = np.arange(0, len(spans.starts), 5)
    batch = chains(spans, starts, samples, 100.0, rng)
    for run in range(len(starts)):
        some = slice(batch.first[run], batch.first[run + 1])
        assert (np.diff(batch.t[some]) >= 0).all()
    ends = batch.weight > 0
    for side in (batch.begin, batch.end):
        inside = (side >= batch.first[:-1, None]) & (side < batch.first[1:, None])
        assert inside.all()
    lengths = batch.t[batch.end] - batch.t[batch.begin]
    assert (lengths[ends] > 0).all()
    assert (batch.sub >= batch.begin[..., None])[ends].all()
    assert (batch.sub <= batch.end[..., None])[ends].all()
    quiet = ends & ~batch.burst
    asked = batch.sub[..., 0] < batch.sub[..., 1]
    assert not asked[~quiet].any()
    assert (batch.sub == batch.begin[..., None])[ends & ~asked].all()
    parts = batch.t[batch.sub][asked]
    inside = (parts[:, 0] > batch.t[batch.begin][asked]) & (parts[:, 1] < batch.t[batch.end][asked])
    assert inside.all()  # samples of their own, with and without a past
    later = chains(spans, np.append(starts[0], starts), samples, 100.0, rng)  # the same ones in other places
    others = (later.sub[..., 0] < later.sub[..., 1])[1:]
    assert (asked ^ others)[quiet].all()  # every second stretch, and over batches all of them
    assert abs(int(asked.sum()) - int(others.sum())) < 0.2 * quiet.sum()
    last_of_pixel = spans.stretches.pixel[spans.starts[starts]] == batch.pixel
    assert last_of_pixel.all()


def test_the_past_before_a_chain_is_that_of_an_exponential_and_one_sample_is_none():
    """Of thirty samples an output places ten itself: at tenths of 95 % of the exponential's probability."""
    t, zero = np.linspace(0.5, 1.0, 40), np.zeros(40, int)
    spans = intervals(t, zero, zero, t > 0, 1)
    rng = np.random.default_rng(0)
    first = spans.stretches.begin[spans.starts[3]]
    past = first - chains(spans, np.array([3]), 30, 100.0, rng).t[:11]
    assert past[:10] == pytest.approx([-math.log(1 - 0.095 * k) / 100 for k in range(10, 0, -1)])
    assert past[10] == 0
    assert chains(spans, np.array([3]), 1, 100.0, rng).t[0] == first
