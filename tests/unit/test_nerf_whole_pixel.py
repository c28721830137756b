"""What a fitted pixel has: stages that are absent stay out, a leak enters the change, the rest is named."""

import math

import numpy as np
import pytest
import torch

from pixelid.dynamics.of_circuit import dynamics_of
from pixelid.dynamics.trajectory import Dynamics
from pixelid.model.shipped import find_model
from pixelid.nerf.effects.ignored import MODELLED, ignored_effects, truncated_memory
from pixelid.nerf.events.intervals import chains, intervals
from pixelid.nerf.pixel.model import Bandwidth, Pixel, filter_parameters, limits_bandwidth
from pixelid.nerf.pixel.scan import respond
from pixelid.nerf.training.losses import amplifier_drift, changes
from pixelid.stages import LIBRARY
from pixelid.stages.circuit import Circuit

ABSENT = {
    "nothing": Dynamics.unlimited(),
    "follower alone": Dynamics.unlimited(follower=2e4),
    "amplifier alone": Dynamics.unlimited(differencing=1e5),
    "lower cutoff alone": Dynamics.unlimited(lower_cutoff=3.0),
    "one pole alone": Dynamics.low_light(2000.0),
    "one pole and follower": Dynamics.low_light(2000.0, follower=2e4, differencing=1e5),
    "photoreceptor alone": Dynamics(1.2e6, 1850.0, 22.0),
}


@pytest.mark.parametrize("dynamics", ABSENT.values(), ids=ABSENT)
def test_gradients_are_finite_and_agree_where_stages_are_absent(dynamics):
    rng = np.random.default_rng(0)
    first = np.array([0, 12, 25])
    t = np.concatenate([np.sort(rng.uniform(0, 0.03, n)) for n in (12, 13)])
    u = rng.normal(size=25)
    outcomes = []
    for engine in ("compiled", "tensors"):
        x = torch.tensor(u, requires_grad=True)
        numbers = torch.tensor(dynamics.uniform(), dtype=torch.float64, requires_grad=True)
        level, output = respond(x, numbers, t, first, engine=engine)
        (level.sum() + (output**2).sum()).backward()
        assert x.grad is not None
        outcomes.append((level.detach(), output.detach(), x.grad))
        if engine == "compiled":
            assert numbers.grad is not None
            assert torch.isfinite(numbers.grad).all()
    for compiled, tensors in zip(*outcomes, strict=True):
        torch.testing.assert_close(compiled, tensors, rtol=1e-6, atol=1e-7)


def test_only_stages_that_are_there_filter_and_are_trained():
    every = find_model("dvs128").circuit()
    assert filter_parameters(every) == ("alpha", "beta", "gamma", "follower")
    ideal = Circuit(photoreceptor="unlimited", on_threshold=0.2, off_threshold=0.2)
    assert filter_parameters(ideal) == ()
    assert not limits_bandwidth(ideal)
    assert not Pixel(ideal, Bandwidth("joint")).filtering
    assert Pixel(ideal, Bandwidth("joint")).moves.sum() == 0
    one_pole = ideal.with_(photoreceptor="one_pole", corner=2000.0)
    pixel = Pixel(one_pole, Bandwidth("joint"))
    assert filter_parameters(one_pole) == ("alpha",)
    assert pixel.slowest(0.5) == pytest.approx(1000.0, rel=1e-6)
    assert Pixel(ideal.with_(lower_cutoff=3.0), Bandwidth()).slowest(0.5) == 3.0


def test_a_leak_is_part_of_the_change():
    """Constant light, leak 40 Hz and 3 Hz per radiance at radiance 2: ON events every 1/46 s, each change a threshold;
    merged into bursts, as many thresholds as events."""
    leak, parasitic, threshold = 40.0, 3.0, 0.2
    t = np.arange(1, 60) / (leak + 2.0 * parasitic)
    zero, on = np.zeros(len(t), int), np.ones(len(t), bool)
    for shortest in (0.0, 1.0):
        spans = intervals(t, zero, zero, on, 1, shortest=shortest)
        batch = chains(spans, spans.starts[:1], 30, 100.0, np.random.default_rng(0))
        u = torch.full((len(batch.t),), math.log(2.0), dtype=torch.float64)
        drift = amplifier_drift(u, batch.t, torch.tensor(threshold, dtype=torch.float64), leak, parasitic)
        change = changes(u, u, batch, None, drift=drift).numpy()
        expected = threshold * (batch.rise - batch.fall)
        np.testing.assert_allclose(change * batch.weight, expected * batch.weight, rtol=1e-9)


def test_noise_of_the_fit_is_the_variance_of_a_threshold():
    t = np.arange(10.0)
    spans = intervals(t, np.zeros(10, int), np.zeros(10, int), np.ones(10, bool), 1, noise=0.2)
    np.testing.assert_allclose(spans.stretches.variance, 0.04)


def test_every_effect_is_modelled_or_named():
    """An effect added to the library is named as ignored until the reconstruction reads its fields."""
    base = find_model("dvs128").without_effect("threshold_mismatch")
    assert ignored_effects(base.circuit()) == ()
    modelled = {
        "dark_current", "source_follower_pole", "extra_pole", "lower_cutoff", "differencing_pole", "leak",
        "parasitic_photocurrent", "threshold_mismatch", "threshold_noise", "refractory_period",
        "second_order_photoreceptor", "threshold_drift", "polarity_memory", "bandwidth_floor", "hot_pixels",
    }  # fmt: skip
    strong = {"mains_flicker.modulation": 0.1, "hot_pixels.count": 3.0}
    for name, effect in LIBRARY.items():
        values = {p.name: strong.get(p.name, p.value) for p in effect.parameters}
        expected = () if name in modelled else (name,)
        if name != "second_order_photoreceptor":
            assert ignored_effects(effect.apply(base.circuit(), values)) == expected, name
    assert ignored_effects(Circuit(jitter=1e-5, slew_rise=100.0)) == ("slew_limit", "timestamp_jitter")
    described = {"threshold.radiance.power": 0.1, "dead_time.none.constant": 0.0, "leak.none.constant": 2.0}
    written = base
    for name, strength in described.items():
        written = written.with_effect(f"described.{name}", {"strength": strength})
    assert ignored_effects(written.circuit()) == ("described.threshold.radiance.power",)  # a leak is a leak
    assert ignored_effects(Circuit(delay=1e-3)) == ()  # of the stimulus's clock


def test_what_a_lower_cutoff_remembers_is_named_where_it_would_matter():
    """Light swings by e both ways at 2 Hz: chains of 90 ms that begin in steady state miss a threshold behind 1 Hz."""
    t, n = np.linspace(0.0, 4.0, 701), np.zeros(701, int)
    spans = intervals(t, n, n, t < 9.0, 1)  # a chain is 16 / 175 s long
    wrong = {}
    for cutoff_hz in (0.01, 1.0):
        circuit = find_model("dvs128").circuit().with_(lower_cutoff=2 * np.pi * cutoff_hz)
        fine = np.arange(0.0, 4.0, 1e-4)
        numbers = torch.tensor(dynamics_of(circuit).uniform(), dtype=torch.float64)
        light = torch.tensor(8.0 + np.sin(2 * np.pi * 2.0 * fine))
        whole = respond(light, numbers, fine, np.array([0, len(fine)]))[0].numpy()
        begins = np.arange(20_000, 38_000, 700)
        parts = [respond(light[k : k + 914], numbers, fine[k : k + 914], np.array([0, 914]))[0] for k in begins]
        apart = [float(part[-1] - part[0]) - (whole[k + 913] - whole[k]) for part, k in zip(parts, begins, strict=True)]
        wrong[cutoff_hz] = np.sqrt(np.mean(np.square(apart)))
        named = truncated_memory(circuit, spans)
        assert (len(named) > 0) == (wrong[cutoff_hz] > 0.025), wrong
    assert 0.2 < wrong[1.0] < 0.4
    assert truncated_memory(find_model("dvs128").circuit(), spans) == ()
    assert set(Circuit.__dataclass_fields__) >= MODELLED
